//! Frames of a sequence: ranges as people write them, and the number in a file's name.
//!
//! * [`FrameRange`]: `1001-1100x2`, `1,5,9-20`, `-5-5`, `10-1`.
//! * [`Pattern`]: `out/beauty.####.exr`, `%04d`, `$F4`, `@@@@`, `<F4>`.
//!
//! Text alone: nothing here looks at a disk.
//!
//! ```
//! use majorant::sequence::{FrameRange, Pattern};
//!
//! let range: FrameRange = "1001-1005x2".parse().unwrap();
//! let pattern = Pattern::new("out/beauty.####.exr");
//! let names: Vec<_> = range.frames().iter().map(|&f| pattern.path(f)).collect();
//! assert_eq!(names[2].to_str(), Some("out/beauty.1005.exr"));
//! ```

mod pattern;
mod range;

pub use pattern::Pattern;
pub use range::{FrameRange, RangeError};

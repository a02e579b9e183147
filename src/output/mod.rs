//! Film → EXR with provenance, and PNG preview; and back.
//!
//! * `exr`: one scanline part, ZIP compressed: `R G B A` half (associated alpha), and as float `Z`,
//!   `variance.R/G/B` and `sampleCount`; or all of it float, for parts of a frame.
//! * `png`: for looking at: 8 bit sRGB by the exact transfer function, exposure 0, values outside
//!   [0, 1] clamped, no alpha.
//! * `attributes`: where an image comes from, and whether one on disk comes from there too.
//! * `read`: images of this and other programs.
//! * `whole`: files appear whole or not at all.

mod attributes;
mod exr;
mod png;
mod read;
mod samples;
mod whole;

use std::io;
use std::path::PathBuf;

pub use attributes::{Identity, Origin, Provenance};
pub use exr::{half_overflow_count, write_exr, write_float_exr, write_merged_exr};
pub use png::{srgb_byte, write_png, write_rgb_png};
pub use read::{Part, ReadImage, read_exr, read_identity, read_part};
pub use samples::{SampleRanges, SampleRangesError};
pub use whole::{check_writable, remove_remnants, write_bytes, write_text, write_with};

/// An image that could not be written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum OutputError {
    /// The folder or file cannot be made, filled or renamed.
    #[error("{}: cannot be written", path.display())]
    Io {
        /// The image, not the temporary file.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// The EXR encoder refused the image.
    #[error("{}: cannot encode the image", path.display())]
    Exr {
        /// The image.
        path: PathBuf,
        /// What the encoder said.
        source: ::exr::error::Error,
    },
    /// An image that was to be read is missing, damaged or has no colours.
    #[error("{}: cannot read the image: {message}", path.display())]
    Unreadable {
        /// The image.
        path: PathBuf,
        /// What is wrong with it.
        message: String,
    },
    /// The PNG encoder refused the image.
    #[error("{}: cannot encode the image", path.display())]
    Png {
        /// The image.
        path: PathBuf,
        /// What the encoder said.
        source: ::png::EncodingError,
    },
}

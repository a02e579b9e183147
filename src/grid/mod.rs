//! The sparse brick grid: where voxel values live and how rays walk through them.
//!
//! * [`brick`]: the 8³ storage unit, its byte layout and filter footprint.
//! * [`tree`]: root → upper (32³) → lower (16³) → bricks, and the builder.
//! * [`bounds`]: conservative minimum, maximum and mean of every cell.
//! * [`Values`]: the voxel values of all bricks, as rendering reads them.
//! * [`Storage`], [`Encoding`]: how many bits they take, and what that costs in optical depth.
//! * [`sampler`]: trilinear lookups with eight taps, and stochastic ones with one.
//! * [`traverse`]: a ray's gap-free intervals with their bounds.
//! * [`VoxelWalk`], [`Cubic`]: the exact value along a ray, voxel cell by voxel cell.
//! * [`Columns`]: how much density lies between a point and a distant light, coarsely.
//! * [`DensityGrid`]: a scalar tree with bounds, placed in the world.
//!
//! No file format and no optics here: `vdb` fills these structures, `medium` gives the values
//! a meaning.

mod blocks;
pub mod bounds;
pub mod brick;
mod cells;
mod columns;
mod cubic;
mod curve;
mod density;
mod directory;
mod encoding;
mod level;
mod occupied;
mod ranks;
pub mod sampler;
pub(crate) mod sections;
pub mod traverse;
pub mod tree;
mod values;

pub use blocks::{Blocks, LOOKUP_COST};
pub use bounds::Bound;
pub use brick::Voxel;
pub use columns::Columns;
pub use cubic::{Cubic, VoxelWalk};
pub use density::{DensityGrid, GridTooLarge};
pub(crate) use encoding::{BrickSpan, Layers};
pub use encoding::{DepthError, Encoding, Reason, Storage, StorageKind, Stored, TooLargeForHalf};
pub use sampler::Sampler;
pub use traverse::{Cells, Segment, Traversal};
pub use tree::{Tile, Tree, TreeBuilder};
pub use values::Values;
pub(crate) use values::{Range, encode_brick};

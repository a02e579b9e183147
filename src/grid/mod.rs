//! The sparse brick grid: where voxel values live and how rays walk through them.
//!
//! * [`brick`]: the 8³ storage unit, its byte layout and filter footprint.
//! * [`tree`]: root → upper (32³) → lower (16³) → bricks, and the builder.
//! * [`DensityGrid`]: a scalar tree with bounds, placed in the world.
//!
//! No file format and no optics here: `vdb` fills these structures, `medium` gives the values
//! a meaning.

pub mod brick;
mod density;
pub mod tree;

pub use brick::Voxel;
pub use density::DensityGrid;
pub use tree::{Tile, Tree, TreeBuilder};

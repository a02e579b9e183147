//! What samples add up to: statistics of pixels, and images of them.
//!
//! * [`Batch`]: sums over the samples of one pixel; [`Pixel`]: its mean, variance, opacity, depth.
//! * [`Film`]: a rectangle of pixels.
//! * [`Accumulation`]: a rectangle of batches that a render fills, pass by pass; [`Checkpoint`]:
//!   one as bytes, so that another process can go on with it to the same bits.

mod accumulation;
mod checkpoint;
mod image;
mod pixel;

pub use accumulation::{Accumulation, Cell, Tile, half_of};
pub use checkpoint::{Checkpoint, CheckpointError};
pub use image::{Film, Region};
pub use pixel::{Batch, Pixel, PixelCost, Sample};

//! The 8³ brick: value type, index order and filter footprint.
//!
//! ```text
//! one brick of V = f32: 2048 bytes, 32 cache lines, no header, no padding
//!
//!   byte   0        32       64                 256                      2047
//!          ├────────┼────────┼─ … ──────────────┼─ … ────────────────────┤
//!   value  z0 … z7  z0 … z7  z0 … z7            z0 … z7
//!          x0 y0    x0 y1    x0 y2              x1 y0            … x7 y7
//!
//!   offset(x, y, z) = x << 6 | y << 3 | z        shape [x][y][z], z fastest
//! ```
//!
//! The order is OpenVDB's own, so decoded leaves are copied, never shuffled. Values sit at
//! integer index points. The cell of voxel `i` is `[i, i + 1)`: a trilinear lookup there reads
//! samples `i` and `i + 1`, so the 8³ cells of a brick read [`FOOTPRINT`]³ = 9³ samples, the
//! last layer of which belongs to the neighbours in +x, +y and +z. The sampler and the bounds
//! both use that constant: a bound cannot miss a value that the filter can see.

use std::fmt::Debug;
use std::hash::Hash;

use bytemuck::Pod;
use glam::IVec3;

/// Base-2 logarithm of the number of voxels along a brick's edge.
pub const BRICK_LOG2: u32 = 3;
/// Voxels along a brick's edge.
pub const BRICK_DIM: i32 = 1 << BRICK_LOG2;
/// Voxels in a brick.
pub const BRICK_LEN: usize = 1 << (3 * BRICK_LOG2);
/// Samples along each axis that the cells of one brick can read: its own and one more.
pub const FOOTPRINT: i32 = BRICK_DIM + 1;

/// One bit for each voxel of a brick, in value order, bit `o` at `mask[o >> 6] >> (o & 63)`.
pub type BrickMask = [u64; BRICK_LEN / 64];

const _: () = assert!(BRICK_LEN == 512, "offsets are 9 bits");
const _: () = assert!(
    size_of::<[f32; BRICK_LEN]>() == 2048,
    "no header, no padding"
);
const _: () = assert!(
    size_of::<[f32; BRICK_LEN]>().is_multiple_of(64),
    "whole cache lines"
);
const _: () = assert!(size_of::<BrickMask>() * 8 == BRICK_LEN, "one bit a voxel");

/// A value that a grid can store: plain bytes, comparable, with a zero.
///
/// Implemented for `f32`, `f64`, `i32`, `i64` and three-vectors of `f32`, `f64` and `i32`.
pub trait Voxel: Pod + PartialEq + Debug + Default + Send + Sync {
    /// A hashable image of the bits, to recognise equal tile values (NaN equals itself).
    type Bits: Eq + Hash;
    /// Returns the bits of the value.
    fn bits(self) -> Self::Bits;
}

macro_rules! voxel {
    ($($t:ty => $bits:ty),*) => {$(
        impl Voxel for $t {
            type Bits = $bits;
            fn bits(self) -> $bits {
                bytemuck::cast(self)
            }
        }
    )*};
}
voxel!(f32 => u32, f64 => u64, i32 => u32, i64 => u64,
       [f32; 3] => [u32; 3], [f64; 3] => [u64; 3], [i32; 3] => [u32; 3]);

/// Returns the position of voxel `p` in its brick's value array.
#[inline] // bench: lookup
pub fn offset(p: IVec3) -> usize {
    let low = p & (BRICK_DIM - 1);
    // Each component is in 0..8 after masking, so the sum is in 0..512 and positive.
    ((low.x << 6) | (low.y << 3) | low.z).cast_unsigned() as usize
}

/// Returns the lowest voxel of the brick that holds `p`.
pub fn origin(p: IVec3) -> IVec3 {
    p & !(BRICK_DIM - 1)
}

/// Returns the voxel at `offset`, relative to its brick's origin.
///
/// # Panics
/// If `offset` is 512 or more.
pub fn voxel_at(offset: usize) -> IVec3 {
    let o = i32::try_from(offset).expect("an offset is below 512");
    IVec3::new(o >> 6, o >> 3 & 7, o & 7)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn offsets_and_voxels_invert_each_other() {
        for i in 0..BRICK_LEN {
            assert_eq!(offset(voxel_at(i)), i, "offset {i}");
        }
        assert_eq!(
            offset(IVec3::new(-1, -8, -7)),
            7 << 6 | 1,
            "negative coordinates wrap by bits"
        );
        assert_eq!(
            origin(IVec3::new(-1, -8, 7)),
            IVec3::new(-8, -8, 0),
            "floor, not truncation"
        );
    }
}

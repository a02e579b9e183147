//! Where a grid is not empty: boxes that together hold all density.

use glam::{DVec3, IVec3};

use super::brick::{BRICK_DIM, BRICK_LOG2};
use super::density::DensityGrid;
use super::tree::{
    LOWER_LEN, LOWER_LOG2, LOWER_TOTAL_LOG2, UPPER_LEN, UPPER_LOG2, UPPER_TOTAL_LOG2, slot_origin,
};
use crate::space::Aabb;

/// Most lower nodes whose bricks are listed, 16 million cells: of larger grids the nodes are.
const MAX_NODES: usize = 4096;

impl DensityGrid {
    /// Visits the corners, in world space, of boxes outside of which density is zero: of bricks and
    /// larger cells, or of one box about everything where the background is not zero.
    ///
    /// # Cost
    /// A look at each cell's bound.
    pub fn for_each_occupied(&self, mut visit: impl FnMut([DVec3; 8])) {
        let Self { tree, bounds, .. } = self;
        let to_world = self.transform().world_from_index();
        let mut visit_voxels = |first: DVec3, end: DVec3| {
            let cell = Aabb {
                min: first,
                max: end,
            };
            visit(cell.corners().map(|p| to_world.transform_point3(p)));
        };
        let Some((first, last)) = bounds.occupied else {
            return;
        };
        // Not zero: what is not stored is not empty either.
        if tree.background() != 0.0 {
            let scale = f64::from(BRICK_DIM);
            visit_voxels(first.as_dvec3() * scale, (last.as_dvec3() + 1.0) * scale);
            return;
        }
        let mut visit_cell = |origin: IVec3, log2: u32| {
            let first = origin.as_dvec3();
            visit_voxels(first, first + f64::from(1 << log2));
        };
        for (cell, bound) in tree.root.iter().zip(&bounds.root) {
            let Ok(u) = cell.slot.get() else {
                if bound.max > 0.0 {
                    visit_cell(cell.origin, UPPER_TOTAL_LOG2);
                }
                continue;
            };
            for s in (0..UPPER_LEN).filter(|s| bounds.upper[u * UPPER_LEN + s].max > 0.0) {
                let origin = cell.origin + slot_origin(s, UPPER_LOG2, LOWER_TOTAL_LOG2);
                match tree.upper[u * UPPER_LEN + s].get() {
                    Ok(l) if tree.lower_origins.len() <= MAX_NODES => {
                        for s in
                            (0..LOWER_LEN).filter(|s| bounds.lower[l * LOWER_LEN + s].max > 0.0)
                        {
                            visit_cell(origin + slot_origin(s, LOWER_LOG2, BRICK_LOG2), BRICK_LOG2);
                        }
                    }
                    _ => visit_cell(origin, LOWER_TOTAL_LOG2),
                }
            }
        }
    }
}

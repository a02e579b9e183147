//! Where a grid is not empty: boxes that together hold all density.

use glam::{DVec3, IVec3};

use super::brick::{BRICK_DIM, BRICK_LOG2};
use super::density::DensityGrid;
use super::directory::Content;
use super::tree::{LOWER_LEN, LOWER_LOG2, LOWER_TOTAL_LOG2, slot_origin};
use crate::space::Aabb;

/// Most nodes of 128³ voxels that are looked at, 16 million cells: a larger box is one box.
const MAX_NODES: i64 = 4096;

/// Most bricks whose values are read: more, 16 MB and up, may be on disk and stay there.
const MAX_BRICKS: usize = 1 << 15;

/// Edge of the blocks whose voxels are boxed together.
const BLOCK: i32 = 4;

impl DensityGrid {
    /// Visits the corners, in index space, of boxes outside of which density is zero.
    ///
    /// # Cost
    /// A look at each cell's bound, and at each value of up to 32,768 bricks that hold zeros.
    pub fn for_each_occupied(&self, mut visit: impl FnMut([DVec3; 8])) {
        let mut visit = |min: DVec3, max: DVec3| visit(Aabb { min, max }.corners());
        let Some((first, last)) = self.bounds.occupied else {
            return;
        };
        let nodes = (last >> LOWER_LOG2) - (first >> LOWER_LOG2) + 1;
        // Where the background is not zero, what is not stored is not empty either.
        if self.tree.background() != 0.0 || nodes.as_i64vec3().element_product() > MAX_NODES {
            let scale = f64::from(BRICK_DIM);
            visit(first.as_dvec3() * scale, (last.as_dvec3() + 1.0) * scale);
            return;
        }
        let mut bricks_left = MAX_BRICKS;
        for i in 0..nodes.element_product() {
            let offset = IVec3::new(i / (nodes.y * nodes.z), i / nodes.z % nodes.y, i % nodes.z);
            let key = (first >> LOWER_LOG2) + offset;
            let origin = key << LOWER_TOTAL_LOG2;
            let node = self.directory.node(&self.tree, &self.bounds, key);
            match node.content {
                // What is empty itself is reached by the voxels of its neighbours.
                Content::Tile { value, .. } => {
                    if value > 0.0 {
                        let first = origin.as_dvec3();
                        visit(first - 1.0, first + f64::from(1 << LOWER_TOTAL_LOG2));
                    }
                }
                Content::Lower(base) => {
                    for s in 0..LOWER_LEN {
                        let cell = origin + slot_origin(s, LOWER_LOG2, BRICK_LOG2);
                        self.visit_cell(base + s, cell, &mut bricks_left, &mut visit);
                    }
                }
            }
        }
    }

    /// Visits boxes around what is not zero in the cell of 8³ voxels of `slot`, at voxel `origin`.
    fn visit_cell(
        &self,
        slot: usize,
        origin: IVec3,
        bricks_left: &mut usize,
        visit: &mut impl FnMut(DVec3, DVec3),
    ) {
        let bound = self.bounds.lower[slot];
        if bound.max <= 0.0 {
            return;
        }
        // A voxel is felt less than one voxel away, in cells of other bricks as well: those that
        // hold nothing else add nothing.
        let brick = match self.tree.lower[slot].get() {
            Err(tile) if self.tree.tiles[tile].value <= 0.0 => return,
            Ok(brick) if bound.min <= 0.0 && *bricks_left > 0 => brick,
            _ => {
                let first = origin.as_dvec3();
                visit(first - 1.0, first + f64::from(BRICK_DIM));
                return;
            }
        };
        *bricks_left -= 1;
        let mut boxes = [(IVec3::MAX, IVec3::MIN); 8];
        for v in 0..BRICK_DIM * BRICK_DIM * BRICK_DIM {
            let p = IVec3::new(
                v / (BRICK_DIM * BRICK_DIM),
                v / BRICK_DIM % BRICK_DIM,
                v % BRICK_DIM,
            );
            if self.values.get(brick, v.cast_unsigned() as usize) != 0.0 {
                let block = p / BLOCK;
                let (min, max) =
                    &mut boxes[(block.x << 2 | block.y << 1 | block.z).cast_unsigned() as usize];
                *min = min.min(p);
                *max = max.max(p);
            }
        }
        for (min, max) in boxes {
            if min.x <= max.x {
                let around = |p: IVec3, d: f64| (origin + p).as_dvec3() + d;
                visit(around(min, -1.0), around(max, 1.0));
            }
        }
    }
}

//! Where a grid is not empty: boxes that together hold all density.

use glam::{DVec3, IVec3};

use super::brick::{BRICK_DIM, BRICK_LOG2};
use super::curve;
use super::density::DensityGrid;
use super::directory::Content;
use super::tree::{LOWER_LEN, LOWER_LOG2, LOWER_TOTAL_LOG2};
use crate::space::Aabb;

/// Most nodes of 128³ voxels that are looked at, 16 million cells: a larger box is one box.
const MAX_NODES: i64 = 4096;

/// Most bricks whose values are read, 4 MB of half floats: of larger grids most surface is smaller
/// than a pixel, and values may be on disk and stay there.
const MAX_BRICKS: usize = 1 << 13;

/// Bricks of a grid above which several share a box. At 1024³ voxels a box for each of 423,000
/// bricks, with the values of 32,768 of them, took 0.15 CPU s a frame.
const MAX_BOXES: usize = 1 << 15;

/// Edge of the blocks whose voxels are boxed together.
const BLOCK: i32 = 4;

impl DensityGrid {
    /// Visits the corners, in index space, of boxes outside of which density is zero.
    ///
    /// # Cost
    /// A look at each cell's bound, and at each value of up to 8,192 bricks that hold zeros.
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
        let shared = (0..LOWER_LOG2).find(|log2| self.brick_count() >> (3 * log2) <= MAX_BOXES);
        let shared_log2 = shared.unwrap_or(LOWER_LOG2);
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
                Content::Lower(base) if shared_log2 > 0 => {
                    self.visit_blocks(base, origin, shared_log2, &mut visit);
                }
                Content::Lower(base) => {
                    for i in 0..LOWER_LEN {
                        let cell = origin + (curve::cell_at(i) << BRICK_LOG2);
                        self.visit_cell(base + i, cell, &mut bricks_left, &mut visit);
                    }
                }
            }
        }
    }

    /// Visits a box around the cells that are not empty in each block, `2^log2` cells wide, of the
    /// node at voxel `origin` whose cells are those from `base` on.
    fn visit_blocks(
        &self,
        base: usize,
        origin: IVec3,
        log2: u32,
        visit: &mut impl FnMut(DVec3, DVec3),
    ) {
        let block_len = 1 << (3 * log2);
        for block in 0..LOWER_LEN / block_len {
            let (mut min, mut max) = (IVec3::MAX, IVec3::MIN);
            for i in block * block_len..(block + 1) * block_len {
                if self.is_occupied(base + i) {
                    let cell = curve::cell_at(i);
                    (min, max) = (min.min(cell), max.max(cell));
                }
            }
            if min.x <= max.x {
                let voxel = |cell: IVec3| (origin + (cell << BRICK_LOG2)).as_dvec3();
                visit(voxel(min) - 1.0, voxel(max + 1));
            }
        }
    }

    /// Returns whether what the cell itself stores is not all zero. A voxel is felt less
    /// than one voxel away, in cells of other bricks as well: those that hold nothing else add
    /// nothing to a box that reaches one voxel beyond.
    fn is_occupied(&self, cell: usize) -> bool {
        let is_empty_tile = match self.cells[cell].slot.get() {
            Err(tile) => self.tree.tiles[tile].value <= 0.0,
            Ok(_) => false,
        };
        self.cells[cell].bound.max > 0.0 && !is_empty_tile
    }

    /// Visits boxes around what is not zero in a cell of 8³ voxels, at voxel `origin`.
    fn visit_cell(
        &self,
        cell: usize,
        origin: IVec3,
        bricks_left: &mut usize,
        visit: &mut impl FnMut(DVec3, DVec3),
    ) {
        if !self.is_occupied(cell) {
            return;
        }
        let bound = self.cells[cell].bound;
        let brick = match self.cells[cell].slot.get() {
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grid::Tree;
    use crate::space::IndexTransform;

    /// Each voxel's support, one voxel to each side, lies within one box: where boxes are those of
    /// voxels, of bricks, and shared by several.
    #[test]
    fn boxes_hold_all_that_is_not_empty() {
        for (n, step) in [(8, 5), (21, 8), (33, 8)] {
            let at = |i: i32| {
                let cell = IVec3::new(i / (n * n), i / n % n, i % n);
                // Somewhere in its cell, and the same for every run.
                cell * step + IVec3::new(i * 7 % step, i * 3 % step, i * 11 % step) - 50
            };
            let voxels: Vec<IVec3> = (0..n * n * n).map(at).collect();
            let tree = Tree::from_voxels(0.0, voxels.iter().map(|&p| (p, 1.0)));
            let grid = DensityGrid::new(tree, IndexTransform::uniform(1.0), usize::MAX)
                .expect("no limit was set");
            let mut boxes = Vec::new();
            grid.for_each_occupied(|corners| {
                let min = corners.into_iter().fold(DVec3::INFINITY, DVec3::min);
                let max = corners.into_iter().fold(DVec3::NEG_INFINITY, DVec3::max);
                boxes.push((min, max));
            });
            assert!(boxes.len() <= MAX_BOXES, "{} boxes", boxes.len());
            let held = |p: DVec3| {
                boxes
                    .iter()
                    .any(|(min, max)| min.cmple(p - 1.0).all() && max.cmpge(p + 1.0).all())
            };
            // A thousand of them: each is looked for in all boxes.
            for p in voxels.iter().step_by(voxels.len() / 1000 + 1) {
                assert!(held(p.as_dvec3()), "{n}: {p} is in no box");
            }
        }
    }
}

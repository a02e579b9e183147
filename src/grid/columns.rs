//! A coarse lattice of how much density lies between a point and a distant light.
//!
//! For deciding where samples are worth their cost, never for an image: values are taken at
//! the centres of coarse cells and from the means of bricks.

use glam::{DVec3, IVec3};
use rayon::prelude::*;

use super::brick::BRICK_DIM;
use super::density::DensityGrid;
use crate::space::floor_to_voxel;

/// Cells are doubled in size until there are no more than this: 1 MiB. The 90,000 of the
/// comparison cloud take 3·10⁸ instructions to fill.
const MAX_CELLS: i64 = 1 << 18;

/// Base-2 logarithm of the smallest cell: 4 voxels.
const MIN_CELL_LOG2: u32 = 2;

/// Density towards a light, mapped to a number, on a lattice over the occupied box.
#[derive(Clone, Debug)]
pub struct Columns {
    first: IVec3,
    last: IVec3,
    cell_log2: u32,
    /// `[x][y][z]`, z fastest.
    values: Vec<f32>,
}

impl Columns {
    /// Walks from the centre of each cell along the unit vector `direction_world` and stores
    /// what `map` makes of ∫ density dt, in density × world units. `None` for an empty grid.
    pub fn new(
        grid: &DensityGrid,
        direction_world: DVec3,
        map: impl Fn(f64) -> f32 + Sync,
    ) -> Option<Self> {
        let (first_brick, last_brick) = grid.bounds.occupied?;
        let direction = grid
            .transform()
            .index_from_world()
            .transform_vector3(direction_world);
        let lo = first_brick * BRICK_DIM;
        let hi = last_brick * BRICK_DIM + (BRICK_DIM - 1);
        let count = |log2: u32| {
            let n = (hi >> log2) - (lo >> log2) + 1;
            i64::from(n.x) * i64::from(n.y) * i64::from(n.z)
        };
        let cell_log2 = (MIN_CELL_LOG2..31)
            .find(|&log2| count(log2) <= MAX_CELLS)
            .unwrap_or(31);
        let (first, last) = (lo >> cell_log2, hi >> cell_log2);
        let n = last - first + 1;
        let size = f64::from(1_u32 << cell_log2);
        let values = (0..n.x * n.y * n.z)
            .into_par_iter()
            .map(|i| {
                let cell = IVec3::new(i / (n.y * n.z), i / n.z % n.y, i % n.z) + first;
                let centre = (cell.as_dvec3() + 0.5) * size;
                let column = grid.traverse(centre, direction, f64::INFINITY);
                map(column
                    .map(|s| f64::from(s.bound.mean) * (s.t1 - s.t0))
                    .sum())
            })
            .collect();
        Some(Self {
            first,
            last,
            cell_log2,
            values,
        })
    }

    /// Returns the number of the cell nearest to `p_index`.
    #[inline] // bench: frame
    pub fn at(&self, p_index: DVec3) -> f32 {
        let cell = floor_to_voxel(p_index) >> self.cell_log2;
        let i = cell.clamp(self.first, self.last) - self.first;
        let n = self.last - self.first + 1;
        self.values[((i.x * n.y + i.y) * n.z + i.z).cast_unsigned() as usize]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grid::Tree;
    use crate::space::IndexTransform;

    #[test]
    fn columns_measure_what_is_in_the_way() {
        let voxels = (0..32 * 32 * 32).map(|i| IVec3::new(i / 1024, i / 32 % 32, i % 32));
        let tree = Tree::from_voxels(0.0, voxels.map(|p| (p, 2.0)));
        let transform = IndexTransform::uniform(0.5);
        let grid = DensityGrid::new(tree, transform, usize::MAX).unwrap();
        #[expect(clippy::cast_possible_truncation, reason = "test values are small")]
        let columns = Columns::new(&grid, DVec3::X, |c| c as f32).unwrap();
        // From the centre of the cell [8, 12): 22 voxels of 0.5 units and density 2 remain.
        assert!((columns.at(DVec3::new(9.0, 17.0, 17.0)) - 22.0).abs() < 1e-4);
        assert!(
            (columns.at(DVec3::new(1e9, 17.0, 17.0)) - 2.0).abs() < 1e-4,
            "clamped"
        );
        assert!(
            (columns.at(DVec3::new(-9e9, 17.0, 17.0)) - 32.0).abs() < 1e-4,
            "clamped"
        );
    }
}

//! Walks through flat grids of cells: the floor of a step, and bounds that the library lacks.

use glam::{DVec3, IVec3};
use majorant::space::floor_to_voxel;

use super::arrays::Dense;

/// A ray in index space, of unit direction: `t` is in voxels.
#[derive(Clone, Copy)]
pub(crate) struct Chord {
    pub(crate) origin: DVec3,
    pub(crate) direction: DVec3,
    pub(crate) t0: f64,
    pub(crate) t1: f64,
}

/// Maxima over equal cells of a box.
pub(crate) struct FlatBounds {
    low: DVec3,
    cell: DVec3,
    dim: IVec3,
    max: Vec<f32>,
}

impl FlatBounds {
    /// Takes the maxima of `dense` over cells of `cell` voxels an edge that cover its box.
    pub(crate) fn new(dense: &Dense, cell: DVec3) -> Self {
        let low = dense.low.as_dvec3();
        // The last layer of the array serves lookups only.
        let size = (dense.dim - 1).as_dvec3();
        let dim = (size / cell - 1e-9).ceil().as_ivec3().max(IVec3::ONE);
        let mut max = Vec::new();
        for x in 0..dim.x {
            for y in 0..dim.y {
                for z in 0..dim.z {
                    let from = low + IVec3::new(x, y, z).as_dvec3() * cell;
                    max.push(dense.max_in(from, from + cell));
                }
            }
        }
        Self {
            low,
            cell,
            dim,
            max,
        }
    }

    /// Calls `visit` with the bound and the ends of each cell that the chord crosses, in order.
    pub(crate) fn walk(&self, chord: &Chord, mut visit: impl FnMut(f32, f64, f64)) {
        let &Chord {
            origin,
            direction,
            t0,
            t1,
        } = chord;
        let start = (origin + direction * t0 - self.low) / self.cell;
        let mut at = floor_to_voxel(start).clamp(IVec3::ZERO, self.dim - 1);
        let step = direction.signum().as_ivec3();
        // Planes that are never crossed are infinitely far.
        let inverse = direction.recip();
        let plane = |at: i32, axis: usize| {
            let next = f64::from(if step[axis] > 0 { at + 1 } else { at });
            let t = (self.low[axis] + next * self.cell[axis] - origin[axis]) * inverse[axis];
            if t.is_finite() { t } else { f64::INFINITY }
        };
        let mut exit = DVec3::new(plane(at.x, 0), plane(at.y, 1), plane(at.z, 2));
        let mut t = t0;
        loop {
            let axis = usize::from(exit.y < exit.x);
            let axis = if exit.z < exit[axis] { 2 } else { axis };
            let end = exit[axis].min(t1);
            let index = (at.x * self.dim.y + at.y) * self.dim.z + at.z;
            visit(self.max[index.cast_unsigned() as usize], t, end.max(t));
            t = end.max(t);
            at[axis] += step[axis];
            if t >= t1 || at[axis] < 0 || at[axis] >= self.dim[axis] {
                return;
            }
            exit[axis] = plane(at[axis], axis);
        }
    }
}

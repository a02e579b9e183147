//! Where the light of a medium comes from: its power on a lattice of cells, for importance.
//!
//! The lattice covers the box in which the emission is not known to be zero. The weight of a cell
//! estimates what it emits from eight points in it, half by their mean and half by the largest, so
//! that a small part of it cannot be much brighter than its weight: such parts are fireflies. It is
//! at least [`LEAST_SHARE`] of the mean of all cells: none is left out for looking dark at eight
//! points, so whatever uses the weights stays unbiased. Three uses:
//!
//! * [`Lattice::sample`]: a point, by cells in proportion to their power.
//! * [`Lattice::sample_towards`]: a direction, towards such a point of a coarse cell. Its density, the
//!   integral of that of points times the square of their distance, has a closed form in each cell.
//! * [`Lattice::for_each_point`]: points along a ray, in proportion to the weights that it crosses,
//!   at equal steps from a random start: what they add up is an unbiased estimate of an integral.
//!
//! Weights are those of 4³ to 16³ cells together for the latter two: a walk of some ten steps.

use std::ops::ControlFlow;

use glam::{DVec3, IVec3};
use rayon::prelude::*;

use crate::alias::AliasTable;
use crate::sampling::{Stream, StreamKey, sample_cone};
use crate::space::{Aabb, IndexTransform, Ray, floor_to_voxel};

/// Cells are doubled in size until there are no more than this: eight looks at each take 0.1 s.
const MAX_CELLS: i64 = 1 << 18;

/// Most cells along an edge of the coarse lattice.
const MAX_COARSE: i32 = 16;

/// Weight of a dark cell, in means.
const LEAST_SHARE: f32 = 0.01;

/// Lines that are drawn to find out what a typical one collects.
const LINES: u32 = 256;

/// Weights on a box of cells.
#[derive(Clone, Debug)]
pub(super) struct Lattice {
    /// Cells are cubes of this index space.
    transform: IndexTransform,
    fine: Cells,
    coarse: Cells,
    table: AliasTable,
    coarse_table: AliasTable,
    /// Density of a point of weight 1, per unit of world volume.
    density_per_weight: f32,
    /// That of points of coarse cells.
    coarse_density_per_weight: f64,
    power: f64,
    spread: Spread,
    typical: Typical,
}

/// Where the power is, in the world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Spread {
    /// Mean of the points, by power.
    pub centre: DVec3,
    /// Mean square of their distances from it.
    pub radius2: f64,
}

/// What a line through a point, drawn by power, collects.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Typical {
    /// Mean integral of the weight.
    pub(super) radiance: f32,
    /// That divided by the mean weight of the points: how long the emission is along a line.
    pub(super) length: f32,
}

/// A box of cells of `2^log2` index units an edge.
#[derive(Clone, Debug)]
struct Cells {
    log2: u32,
    first: IVec3,
    size: IVec3,
    /// `[x][y][z]`, z fastest.
    weights: Vec<f32>,
}

impl Cells {
    /// Returns the cells of `2^log2` that cover `hull`.
    fn covering(hull: &Aabb, log2: u32) -> Self {
        let first = floor_to_voxel(hull.min) >> log2;
        let last = floor_to_voxel(hull.max.map(f64::ceil) - 1.0) >> log2;
        Self {
            log2,
            first,
            size: (last.max(first) - first).saturating_add(IVec3::ONE),
            weights: Vec::new(),
        }
    }

    fn count(&self) -> i64 {
        let n = self.size.as_i64vec3();
        // Three numbers below 2³¹: two of them times each other fit.
        n.x.saturating_mul(n.y).saturating_mul(n.z)
    }

    fn cell(&self, index: usize) -> IVec3 {
        let (y, z) = (
            self.size.y.unsigned_abs() as usize,
            self.size.z.unsigned_abs() as usize,
        );
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_possible_wrap,
            reason = "below MAX_CELLS"
        )]
        let at = |i: usize| i as i32;
        self.first + IVec3::new(at(index / (y * z)), at(index / z % y), at(index % z))
    }

    /// Returns the index of `cell`, which may lie outside.
    #[inline] // bench: frame
    fn index(&self, cell: IVec3) -> Option<usize> {
        let c = cell - self.first;
        let n = self.size;
        let is_inside = c.cmpge(IVec3::ZERO).all() && c.cmplt(n).all();
        is_inside.then(|| ((c.x * n.y + c.y) * n.z + c.z).unsigned_abs() as usize)
    }

    fn edge(&self) -> f64 {
        f64::from(1 << self.log2)
    }

    /// Draws a point of the cell at `index`.
    #[inline] // bench: frame
    fn point_in(&self, index: usize, stream: &mut Stream) -> DVec3 {
        let mut uniform = || f64::from(stream.uniform());
        let inside = DVec3::new(uniform(), uniform(), uniform());
        (self.cell(index).as_dvec3() + inside) * self.edge()
    }

    /// Returns where the weights of cells in the index space of `transform` are, in the world.
    fn spread(&self, transform: &IndexTransform) -> Spread {
        let to_world = transform.world_from_index();
        let points = self.weights.iter().enumerate().map(|(i, &weight)| {
            let middle = (self.cell(i).as_dvec3() + 0.5) * self.edge();
            (to_world.transform_point3(middle), f64::from(weight))
        });
        let (mut sum, mut sum_p, mut sum_p2) = (0.0, DVec3::ZERO, DVec3::ZERO);
        for (p, weight) in points {
            sum += weight;
            sum_p += p * weight;
            sum_p2 += p * p * weight;
        }
        let centre = sum_p / sum;
        let variance = sum_p2 / sum - centre * centre;
        Spread {
            centre,
            radius2: variance.element_sum().max(0.0),
        }
    }

    /// Visits the pieces of a line in index space that lie in one cell each, from `t` = 0 to
    /// `t_max`, with the cell's weight.
    fn for_each_piece(
        &self,
        (origin, direction): (DVec3, DVec3),
        t_max: f64,
        mut visit: impl FnMut(f64, f64, f32) -> ControlFlow<()>,
    ) {
        let scale = self.edge().recip();
        let (origin, direction) = (origin * scale, direction * scale);
        let hull = Aabb {
            min: self.first.as_dvec3(),
            max: (self.first + self.size).as_dvec3(),
        };
        let inverse = DVec3::ONE / direction;
        let Some((mut t, end)) = hull.intersect_inverse(origin, inverse) else {
            return;
        };
        let end = end.min(t_max);
        let last = self.first + self.size - 1;
        let mut cell = floor_to_voxel(origin + direction * t).clamp(self.first, last);
        while t < end {
            let mut exit = f64::INFINITY;
            let mut axis = 0;
            for i in 0..3 {
                let plane = cell[i] + i32::from(inverse[i] > 0.0);
                let at = (f64::from(plane) - origin[i]) * inverse[i];
                // Not finite: the ray never crosses a plane of this axis.
                if inverse[i].is_finite() && at < exit {
                    (exit, axis) = (at, i);
                }
            }
            let next = exit.max(t).min(end);
            let Some(index) = self.index(cell) else {
                return;
            };
            if next > t && visit(t, next, self.weights[index]).is_break() {
                return;
            }
            t = next;
            cell[axis] += if inverse[axis] > 0.0 { 1 } else { -1 };
        }
    }
}

impl Lattice {
    /// Weighs the cells of `hull`, a box in the index space of `transform`, by `weight` at points in
    /// world space. `None` if it finds nothing.
    ///
    /// # Cost
    /// Eight looks at each of up to 2¹⁸ cells, in parallel.
    pub(super) fn new(
        hull: &Aabb,
        transform: IndexTransform,
        weight: impl Fn(DVec3) -> f32 + Sync,
    ) -> Option<Self> {
        let mut fine = (0..31)
            .map(|log2| Cells::covering(hull, log2))
            .find(|cells| cells.count() <= MAX_CELLS)?;
        let to_world = transform.world_from_index();
        let count = usize::try_from(fine.count()).ok()?;
        fine.weights = (0..count)
            .into_par_iter()
            .map(|i| {
                let cell = fine.cell(i).as_dvec3();
                let points = Aabb {
                    min: (cell + 0.25) * fine.edge(),
                    max: (cell + 0.75) * fine.edge(),
                };
                let weights = points
                    .corners()
                    .map(|p| weight(to_world.transform_point3(p)));
                let most = weights.into_iter().fold(0.0, f32::max);
                0.5 * (weights.iter().sum::<f32>() / 8.0 + most)
            })
            .collect();
        let sum: f64 = fine.weights.iter().map(|&w| f64::from(w)).sum();
        #[expect(clippy::cast_possible_truncation, reason = "an estimate")]
        let least = LEAST_SHARE * (sum / count as f64) as f32;
        for weight in &mut fine.weights {
            *weight = weight.max(least);
        }
        let table = AliasTable::new(&fine.weights)?;
        let cell_volume = to_world.matrix3.determinant().abs() * fine.edge().powi(3);
        let sum: f64 = fine.weights.iter().map(|&w| f64::from(w)).sum();
        #[expect(
            clippy::cast_possible_truncation,
            reason = "a density, to f32's precision"
        )]
        let density_per_weight = (1.0 / (sum * cell_volume)) as f32;
        let coarse = fine.coarser();
        let coarse_volume = to_world.matrix3.determinant().abs() * coarse.edge().powi(3);
        let coarse_sum: f64 = coarse.weights.iter().map(|&w| f64::from(w)).sum();
        let mut lattice = Self {
            spread: coarse.spread(&transform),
            coarse_table: AliasTable::new(&coarse.weights)?,
            coarse_density_per_weight: 1.0 / (coarse_sum * coarse_volume),
            coarse,
            transform,
            fine,
            table,
            density_per_weight,
            power: sum * cell_volume,
            typical: Typical::default(),
        };
        lattice.typical = lattice.typical_line();
        let is_usable = lattice.density_per_weight.is_normal() && lattice.typical.radiance > 0.0;
        is_usable.then_some(lattice)
    }

    /// Returns the integral of the weight over the world.
    pub(super) fn power(&self) -> f64 {
        self.power
    }

    pub(super) fn spread(&self) -> Spread {
        self.spread
    }

    pub(super) fn typical(&self) -> Typical {
        self.typical
    }

    fn typical_line(&self) -> Typical {
        let mut stream = Stream::new(StreamKey::default());
        let (mut collected, mut weights) = (0.0, 0.0);
        for _ in 0..LINES {
            let (origin, density) = self.sample(&mut stream);
            // The whole sphere.
            let direction = sample_cone(DVec3::Z, 2.0, &mut stream);
            for direction in [direction, -direction] {
                let line = self.line(&Ray { origin, direction });
                self.coarse
                    .for_each_piece(line, f64::INFINITY, |t0, t1, weight| {
                        collected += (t1 - t0) * f64::from(weight);
                        ControlFlow::Continue(())
                    });
            }
            weights += f64::from(density / self.density_per_weight);
        }
        #[expect(clippy::cast_possible_truncation, reason = "estimates")]
        let typical = Typical {
            radiance: (collected / f64::from(LINES)) as f32,
            length: (collected / weights) as f32,
        };
        typical
    }

    /// Returns a ray in index space.
    #[inline] // bench: frame
    fn line(&self, ray: &Ray) -> (DVec3, DVec3) {
        let to_index = self.transform.index_from_world();
        let origin = to_index.transform_point3(ray.origin);
        (origin, to_index.transform_vector3(ray.direction))
    }

    /// Draws a point in world space; returns it with its density, per unit of world volume.
    #[inline] // bench: frame
    pub(super) fn sample(&self, stream: &mut Stream) -> (DVec3, f32) {
        let index = self.table.index(stream.bits());
        let p = self.fine.point_in(index, stream);
        let to_world = self.transform.world_from_index();
        let density = self.fine.weights[index] * self.density_per_weight;
        (to_world.transform_point3(p), density)
    }

    /// Draws a direction from `origin`, towards a point of the coarse cells.
    #[inline] // bench: frame
    pub(super) fn sample_towards(&self, origin: DVec3, stream: &mut Stream) -> DVec3 {
        let index = self.coarse_table.index(stream.bits());
        let p = self.coarse.point_in(index, stream);
        let to_world = self.transform.world_from_index();
        // A point at the origin has a probability of zero, or next to it.
        (to_world.transform_point3(p) - origin).normalize_or(DVec3::Z)
    }

    /// Returns the density of [`sample_towards`](Self::sample_towards) per unit of solid angle, from
    /// the origin of `ray` in its direction.
    #[inline] // bench: frame
    pub(super) fn pdf_towards(&self, ray: &Ray) -> f32 {
        let mut sum = 0.0;
        self.coarse
            .for_each_piece(self.line(ray), f64::INFINITY, |t0, t1, weight| {
                // ∫ t² dt
                sum += f64::from(weight) * (t1 * t1 * t1 - t0 * t0 * t0) / 3.0;
                ControlFlow::Continue(())
            });
        #[expect(clippy::cast_possible_truncation, reason = "a density")]
        let pdf = (sum * self.coarse_density_per_weight) as f32;
        pdf
    }

    /// Returns the density of [`sample`](Self::sample) at a point in world space.
    #[inline] // bench: frame
    pub(super) fn pdf(&self, p_world: DVec3) -> f32 {
        let p = self.transform.index_from_world().transform_point3(p_world);
        let cell = floor_to_voxel(p) >> self.fine.log2;
        let index = self.fine.index(cell);
        index.map_or(0.0, |i| self.fine.weights[i] * self.density_per_weight)
    }

    /// Visits points of `ray` up to `t_max`, in order, each with a length: what is found there times
    /// that length adds up to an unbiased estimate of its integral, for `u` uniform in [0, 1).
    ///
    /// There is a point for each `spacing` of the integral of the weight; all are in the box.
    #[inline] // bench: frame
    pub(super) fn for_each_point(
        &self,
        ray: &Ray,
        t_max: f64,
        (spacing, u): (f32, f32),
        mut visit: impl FnMut(f64, f32) -> ControlFlow<()>,
    ) {
        let mut left = f64::from(spacing) * f64::from(u);
        let spacing = f64::from(spacing);
        self.coarse
            .for_each_piece(self.line(ray), t_max, |t0, t1, weight| {
                let weight = f64::from(weight);
                let length = spacing / weight;
                let mut t = t0 + left / weight;
                while t < t1 {
                    #[expect(clippy::cast_possible_truncation, reason = "a length")]
                    visit(t, length as f32)?;
                    t += length;
                }
                left = (t - t1) * weight;
                ControlFlow::Continue(())
            });
    }
}

impl Cells {
    /// Returns cells of at least eight index units an edge, few of them, with weights of these
    /// together.
    fn coarser(&self) -> Self {
        let by = (1_u32..31).find(|by| {
            let n = (self.size >> *by).max_element();
            n < MAX_COARSE && self.log2 + by >= 3
        });
        let by = by.unwrap_or(30);
        let first = self.first >> by;
        let last = (self.first + self.size - 1) >> by;
        let mut coarse = Self {
            log2: self.log2 + by,
            first,
            size: last - first + 1,
            weights: Vec::new(),
        };
        let count = usize::try_from(coarse.count()).unwrap_or(0);
        let mut found = vec![(0.0_f64, 0_u32, 0.0_f32); count];
        for (i, &weight) in self.weights.iter().enumerate() {
            if let Some(at) = coarse.index(self.cell(i) >> by) {
                let (sum, count, most) = &mut found[at];
                *sum += f64::from(weight);
                *count += 1;
                *most = most.max(weight);
            }
        }
        #[expect(clippy::cast_possible_truncation, reason = "a mean of f32")]
        let mean = |(sum, count, most)| 0.5 * ((sum / f64::from(u32::max(count, 1))) as f32 + most);
        coarse.weights = found.into_iter().map(mean).collect();
        coarse
    }
}

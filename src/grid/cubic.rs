//! The exact value along a ray: in each voxel cell a cubic in t.
//!
//! In one cell the trilinear value is a product of three linear factors, so along a line it is a
//! polynomial of degree three. Its integral is a quartic, known in closed form, and the point
//! where the integral reaches a given amount is found by Newton's method inside a bracket. That
//! is all that regular tracking and exact transmittance need; nothing here is random.
//!
//! # Cost
//! One step of a digital differential analyser, eight loads and about 60 operations in `f64`
//! for each voxel cell that the ray crosses.

use glam::{DVec3, IVec3};

use super::bounds::Bound;
use super::sampler::Sampler;
use super::traverse::{Segment, Traversal, smallest};
use crate::space::floor_to_voxel;

/// The value along a ray within one voxel cell.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cubic {
    /// Where the ray enters.
    pub t0: f64,
    /// Where it leaves; not less than `t0`.
    pub t1: f64,
    /// Coefficients in `(t − t0) / (t1 − t0)`, constant first.
    coefficients: [f64; 4],
}

/// Bisection alone reaches the last bit of a number in [0, 1] in about this many steps.
const MAX_STEPS: u32 = 60;

impl Cubic {
    /// Makes the cubic of the trilinear field with these `corners`, z fastest, from the point
    /// `a` at `t0` to the point `b` at `t1`, both in the unit cell.
    #[inline] // bench: lookup
    fn new(corners: &[f32; 8], (t0, a): (f64, DVec3), (t1, b): (f64, DVec3)) -> Self {
        let v = corners.map(f64::from);
        let d = b - a;
        // Lines along z, then parabolas, then the cubic; each lerp multiplies by a + d s.
        let line = |i: usize| {
            let rise = v[i + 1] - v[i];
            [v[i] + rise * a.z, rise * d.z]
        };
        let parabola = |i: usize| {
            let (p, q) = (line(i), line(i + 2));
            let r = [q[0] - p[0], q[1] - p[1]];
            [
                p[0] + r[0] * a.y,
                p[1] + r[1] * a.y + r[0] * d.y,
                r[1] * d.y,
            ]
        };
        let (p, q) = (parabola(0), parabola(4));
        let r = [q[0] - p[0], q[1] - p[1], q[2] - p[2]];
        let coefficients = [
            p[0] + r[0] * a.x,
            p[1] + r[1] * a.x + r[0] * d.x,
            p[2] + r[2] * a.x + r[1] * d.x,
            r[2] * d.x,
        ];
        Self {
            t0,
            t1,
            coefficients,
        }
    }

    /// Returns ∫ value dt over the cell; never negative.
    #[inline] // bench: lookup
    pub fn integral(&self) -> f64 {
        // Values are not negative, but rounding may leave −1e-17.
        ((self.t1 - self.t0) * self.integral_to(1.0)).max(0.0)
    }

    /// Returns ∫ value ds from 0 to `s`, in units of the crossing.
    #[inline] // bench: lookup
    fn integral_to(&self, s: f64) -> f64 {
        let [c0, c1, c2, c3] = self.coefficients;
        s * (c0 + s * (c1 / 2.0 + s * (c2 / 3.0 + s * (c3 / 4.0))))
    }

    /// Returns where ∫ value dt from `t0` on reaches `amount`, at most `t1`.
    ///
    /// Exact to the rounding of `f64`, in about five steps and never more than 60.
    pub fn reach(&self, amount: f64) -> f64 {
        let length = self.t1 - self.t0;
        let amount = amount / length;
        let [c0, c1, c2, c3] = self.coefficients;
        let (mut low, mut high) = (0.0, 1.0);
        let mut s = (amount / self.integral_to(1.0)).clamp(0.0, 1.0);
        for _ in 0..MAX_STEPS {
            let excess = self.integral_to(s) - amount;
            if excess > 0.0 {
                high = s;
            } else {
                low = s;
            }
            let value = c0 + s * (c1 + s * (c2 + s * c3));
            let newton = s - excess / value;
            // Where the value is 0 the quotient is infinite or NaN: outside like any bad step.
            let next = if newton > low && newton < high {
                newton
            } else {
                f64::midpoint(low, high)
            };
            let moved = (next - s).abs();
            s = next;
            if moved <= f64::EPSILON {
                break;
            }
        }
        self.t0 + s * length
    }
}

/// An iterator over the voxel cells that a ray crosses within a segment, in order; together they
/// are the segment, without gap or overlap.
#[derive(Debug)]
pub struct VoxelWalk<'s, 'a> {
    sampler: &'s mut Sampler<'a>,
    origin: DVec3,
    direction: DVec3,
    inverse: DVec3,
    segment: Segment,
    cell: IVec3,
    /// The values at the cell's corners.
    corners: [f32; 8],
    /// Where the ray leaves the cell, for each axis.
    exit: DVec3,
    t: f64,
}

impl<'s, 'a> VoxelWalk<'s, 'a> {
    /// Starts at the beginning of the segment at hand of `walk`.
    #[inline] // bench: lookup
    pub fn new(sampler: &'s mut Sampler<'a>, walk: &Traversal<'_>) -> Self {
        let (origin, direction) = walk.ray();
        // What the bound is does not matter.
        let segment = walk.segment(Bound::EMPTY);
        let start = floor_to_voxel(origin + direction * segment.t0);
        let cell = start.clamp(segment.first, segment.last);
        let corners = sampler.corners(cell);
        let mut walk = Self {
            sampler,
            origin,
            direction,
            inverse: DVec3::ONE / direction,
            segment,
            cell,
            corners,
            exit: DVec3::INFINITY,
            t: segment.t0,
        };
        for axis in 0..3 {
            walk.leave_at(axis);
        }
        walk
    }

    /// Finds where the ray leaves the cell along `axis`; never if it runs across that axis.
    #[inline] // bench: lookup
    fn leave_at(&mut self, axis: usize) {
        let inverse = self.inverse[axis];
        if inverse.is_finite() {
            let plane = f64::from(self.cell[axis]) + f64::from(u8::from(inverse > 0.0));
            self.exit[axis] = (plane - self.origin[axis]) * inverse;
        }
    }
}

impl Iterator for VoxelWalk<'_, '_> {
    type Item = Cubic;

    #[inline] // bench: lookup
    fn next(&mut self) -> Option<Cubic> {
        let (t0, end) = (self.t, self.segment.t1);
        if t0 >= end {
            return None;
        }
        let DVec3 { x, y, z } = self.exit;
        let (axis, exit) = smallest(x, y, z);
        let up = self.inverse[axis] > 0.0;
        let cell = self.cell;
        let next = cell[axis].saturating_add(if up { 1 } else { -1 });
        let inside = next >= self.segment.first[axis] && next <= self.segment.last[axis];
        // The last cell takes whatever rounding leaves before the segment's end.
        let t1 = if inside { exit.clamp(t0, end) } else { end };
        let low = cell.as_dvec3();
        let local = |t: f64| {
            let p = self.origin + self.direction * t - low;
            p.clamp(DVec3::ZERO, DVec3::ONE)
        };
        let cubic = Cubic::new(&self.corners, (t0, local(t0)), (t1, local(t1)));
        self.t = t1;
        if t1 < end {
            self.cell[axis] = next;
            self.leave_at(axis);
            self.load_face(axis, up);
        }
        Some(cubic)
    }
}

impl VoxelWalk<'_, '_> {
    /// Makes the corners those of the current cell, which the ray entered along `axis`: the face
    /// that it came through is known.
    #[inline] // bench: lookup
    fn load_face(&mut self, axis: usize, up: bool) {
        let mut lo = self.cell;
        lo[axis] = lo[axis].saturating_add(i32::from(up));
        let mut extent = IVec3::ONE;
        extent[axis] = 0;
        let [low, high] = FACES[axis];
        let values = self.sampler.some_corners(lo, extent, low);
        let (from, to) = if up { (high, low) } else { (low, high) };
        for k in 0..4 {
            self.corners[to[k]] = self.corners[from[k]];
            self.corners[from[k]] = values[k];
        }
    }
}

/// The corners of the low and the high face across each axis, in matching order.
const FACES: [[[usize; 4]; 2]; 3] = [
    [[0, 1, 2, 3], [4, 5, 6, 7]],
    [[0, 1, 4, 5], [2, 3, 6, 7]],
    [[0, 2, 4, 6], [1, 3, 5, 7]],
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cubic_is_the_trilinear_value() {
        let corners = [0.5, 2.0, 0.0, 3.0, 1.0, 0.25, 4.0, 0.125];
        let (a, b) = (DVec3::new(0.1, 0.9, 0.0), DVec3::new(0.8, 0.2, 1.0));
        let cubic = Cubic::new(&corners, (3.0, a), (5.0, b));
        let value = |s: f64| {
            let p = a + (b - a) * s;
            let mut sum = 0.0;
            for (i, &v) in corners.iter().enumerate() {
                let side = |bit: usize, x: f64| if i >> bit & 1 == 1 { x } else { 1.0 - x };
                sum += f64::from(v) * side(2, p.x) * side(1, p.y) * side(0, p.z);
            }
            sum
        };
        // The midpoint rule with 10^5 points is good to 1e-9 here.
        let n = 100_000;
        let mut expected = 0.0;
        for i in 0..n {
            let s = (f64::from(i) + 0.5) / f64::from(n);
            expected += value(s) * 2.0 / f64::from(n);
            if i % 9973 == 0 {
                let amount = 2.0 * cubic.integral_to(s);
                assert!((cubic.reach(amount) - (3.0 + 2.0 * s)).abs() < 1e-12);
            }
        }
        assert!((cubic.integral() - expected).abs() < 1e-8);
    }

    #[test]
    fn an_amount_is_reached_where_the_value_is_zero_at_the_start() {
        // value = 8 s³ from zero: the integral 2 s⁴ has no slope where Newton starts low.
        let corners = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 8.0];
        let cubic = Cubic::new(&corners, (0.0, DVec3::ZERO), (1.0, DVec3::ONE));
        for amount in [0.0, 1e-30, 1e-12, 0.3, 1.999_999, 2.0] {
            let expected = (amount / 2.0_f64).powf(0.25);
            let got = cubic.reach(amount);
            // The quartic is flat at 0: a relative error of 1e-16 in it is 1e-4 there.
            assert!((got - expected).abs() < 1e-4, "{amount}: {got}");
            assert!(
                (2.0 * got.powi(4) - amount).abs() < 4e-15,
                "{amount}: {got}"
            );
        }
    }
}

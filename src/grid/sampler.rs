//! Reading values at points: trilinear with eight taps, and stochastically with one.
//!
//! The one-tap lookup draws one of the eight corners with its trilinear weight and returns
//! its stored value: its expectation is the trilinear value exactly. Where a value enters
//! **linearly** (a collision accepted with probability `sigma_t / sigma_maj`, a factor
//! `1 − sigma_t / sigma_maj`) that gives the same distribution as eight taps for an eighth of
//! the loads. Inside an exponential or any other non-linear function it would be biased.
//!
//! # Reference
//! `[Pharr2024]`.

use std::ops::ControlFlow;

use glam::{DVec3, IVec3, UVec3, Vec3};

use super::brick::{self, BRICK_DIM, BRICK_LOG2};
use super::cells::Cell;
use super::curve;
use super::density::DensityGrid;
use super::directory::Content;
use super::traverse::{ROUND, Traversal};
use super::tree::{LOWER_TOTAL_LOG2, Tree};
use crate::space::floor_to_voxel;

/// The corners of a voxel cell, z fastest: bit 2 of the position is one further in x, bit 1 in
/// y, bit 0 in z.
const CORNERS: [IVec3; 8] = [
    IVec3::new(0, 0, 0),
    IVec3::new(0, 0, 1),
    IVec3::new(0, 1, 0),
    IVec3::new(0, 1, 1),
    IVec3::new(1, 0, 0),
    IVec3::new(1, 0, 1),
    IVec3::new(1, 1, 0),
    IVec3::new(1, 1, 1),
];

/// Where they are in a brick's values, from the first on.
const CORNER_OFFSETS: [usize; 8] = [0, 1, 8, 9, 64, 65, 72, 73];

/// A reader that remembers the lower node (128³ voxels) it last read from.
#[derive(Clone, Debug)]
pub struct Sampler<'a> {
    grid: &'a DensityGrid,
    tree: &'a Tree<f32>,
    cells: &'a [Cell],
    /// Coordinates of that node, in nodes; the memory is empty at first.
    key: IVec3,
    /// First cell of the node, or the value of a tile that covers it.
    node: Result<usize, f32>,
}

impl<'a> Sampler<'a> {
    /// Makes a reader of `grid`.
    pub fn new(grid: &'a DensityGrid) -> Self {
        // No voxel has this node coordinate: those end at ±2^24.
        Self {
            grid,
            tree: &grid.tree,
            cells: &grid.cells,
            key: IVec3::MAX,
            node: Err(0.0),
        }
    }

    /// Returns the stored value of voxel `p`.
    ///
    /// # Cost
    /// Two dependent loads within the remembered node, up to four and a search elsewhere.
    #[inline] // bench: lookup
    pub fn value(&mut self, p: IVec3) -> f32 {
        match self.stored(p) {
            Ok(b) => self.grid.values.get(b, brick::offset(p)),
            Err(value) => value,
        }
    }

    /// Returns the values at the eight corners of the cell of voxel `lo`, in the order of `CORNERS`.
    ///
    /// # Cost
    /// One walk and eight loads inside a brick (two thirds of all cells), eight walks across
    /// faces.
    #[inline] // bench: lookup
    pub fn corners(&mut self, lo: IVec3) -> [f32; 8] {
        self.some_corners(lo, IVec3::ONE, [0, 1, 2, 3, 4, 5, 6, 7])
    }

    /// Returns the values at some [`CORNERS`] of the cell of voxel `lo`, by their positions:
    /// those that are 0 where `extent` is 0, which is 1 elsewhere.
    #[inline] // bench: lookup
    pub(super) fn some_corners<const N: usize>(
        &mut self,
        lo: IVec3,
        extent: IVec3,
        which: [usize; N],
    ) -> [f32; N] {
        let mut values = [0.0; N];
        if ((lo & (BRICK_DIM - 1)) + extent).max_element() < BRICK_DIM {
            match self.stored(lo) {
                Ok(b) => {
                    let o = brick::offset(lo);
                    for (value, c) in values.iter_mut().zip(which) {
                        *value = self.grid.values.get(b, o + CORNER_OFFSETS[c]);
                    }
                }
                Err(tile) => values = [tile; N],
            }
        } else {
            for (value, c) in values.iter_mut().zip(which) {
                *value = self.value(lo.saturating_add(CORNERS[c]));
            }
        }
        values
    }

    /// Returns the brick that holds voxel `p`, or the value of its tile.
    #[inline] // bench: lookup
    fn stored(&mut self, p: IVec3) -> Result<usize, f32> {
        let cell = self.cell(p)?;
        self.brick(cell)
    }

    /// Returns the brick that a cell is, or the value of its tile.
    #[inline] // bench: lookup
    fn brick(&self, cell: usize) -> Result<usize, f32> {
        let brick = self.cells[cell].slot.get();
        brick.map_err(|tile| self.tree.tiles[tile].value)
    }

    /// Returns the number of the cell of voxel `p`, or the value of a tile that covers its whole node.
    #[inline] // bench: lookup
    fn cell(&mut self, p: IVec3) -> Result<usize, f32> {
        let key = p >> LOWER_TOTAL_LOG2;
        if key != self.key {
            self.key = key;
            let DensityGrid {
                bounds, directory, ..
            } = self.grid;
            self.node = match directory.node(self.tree, bounds, key).content {
                Content::Lower(base) => Ok(base),
                Content::Tile { value, .. } => Err(value),
            };
        }
        Ok(self.node? + curve::place(p >> BRICK_LOG2))
    }

    /// Returns the trilinear value at `p_index`, never outside the range of its eight taps.
    pub fn trilinear(&mut self, p_index: DVec3) -> f32 {
        let lo = floor_to_voxel(p_index);
        // Outside [0, 1] only beyond the ends of i32, where everything is background.
        let f = (p_index - lo.as_dvec3())
            .clamp(DVec3::ZERO, DVec3::ONE)
            .as_vec3();
        let v = self.corners(lo);
        let low = lerp(lerp(v[0], v[1], f.z), lerp(v[2], v[3], f.z), f.y);
        let high = lerp(lerp(v[4], v[5], f.z), lerp(v[6], v[7], f.z), f.y);
        lerp(low, high, f.x)
    }

    /// Returns the stored value of one of the eight voxels around `p_index`, drawn with its
    /// trilinear weight (to within 2⁻²¹) from 64 random `bits`.
    #[inline] // bench: lookup
    pub fn stochastic(&mut self, p_index: DVec3, bits: u64) -> f32 {
        // Beyond the ends of i32 everything is background.
        let ends = [i32::MIN, i32::MAX].map(|end| DVec3::splat(end.into()));
        self.value(Self::tap(p_index.max(ends[0]).min(ends[1]), bits))
    }

    /// Returns one of the eight voxels around `p_index`, whose coordinates an `i32` can hold, drawn
    /// with its trilinear weight.
    #[inline] // bench: lookup
    fn tap(p_index: DVec3, bits: u64) -> IVec3 {
        // Adding a uniform number and rounding down goes up with the probability of the
        // fraction. Three numbers of 21 bits each.
        let u = |shift: u32| {
            #[expect(clippy::cast_possible_truncation, reason = "masked")]
            let digits = (bits >> shift) as u32 & 0x1f_ffff;
            f64::from(digits) * (1.0 / 2_097_152.0)
        };
        let p = p_index + DVec3::new(u(0), u(21), u(42));
        // A third of what a conversion that saturates takes.
        let floor = |x: f64| {
            let near = x + ROUND;
            #[expect(clippy::cast_possible_truncation, reason = "the last bits are meant")]
            let i = near.to_bits() as i32;
            i.wrapping_sub(i32::from(near - ROUND > x))
        };
        IVec3::new(floor(p.x), floor(p.y), floor(p.z))
    }

    /// As [`stochastic`](Self::stochastic), at a point `p` in the segment at hand of a walk, given
    /// relative to its first voxel; clamped into its cell.
    #[inline] // bench: lookup
    pub(super) fn stochastic_in_brick(
        &mut self,
        slot: usize,
        p: DVec3,
        bits: u64,
    ) -> Result<f32, IVec3> {
        // At most 8: in f32, good to 2⁻²¹.
        let q = p.as_vec3().clamp(Vec3::ZERO, Vec3::splat(BRICK_DIM as f32));
        // A uniform number in (0, 1), of 21 bits, in the mantissa of one in (1, 2).
        let u = |shift: u32| {
            #[expect(clippy::cast_possible_truncation, reason = "masked")]
            let mantissa = (bits >> shift) as u32 & 0x1f_ffff;
            f32::from_bits(0x3f80_0000 | mantissa << 2 | 2)
        };
        // Rounding p + u − 1/2 to the nearest integer is rounding p + u down, and adding 1.5·2²³
        // leaves that integer in the last bits.
        let tap = |q: f32, u: f32| ((q + (u - 1.5)) + 12_582_912.0).to_bits() & 15;
        let (x, y, z) = (tap(q.x, u(0)), tap(q.y, u(21)), tap(q.z, u(42)));
        if (x | y | z) >> BRICK_LOG2 != 0 {
            return Err(UVec3::new(x, y, z).as_ivec3());
        }
        Ok(match self.brick(slot) {
            Ok(b) => self.grid.values.get(b, ((x << 6) | (y << 3) | z) as usize),
            Err(value) => value,
        })
    }

    /// Returns an estimate of the value at `t` in the segment at hand of `walk`, as
    /// [`stochastic`](Self::stochastic) does.
    ///
    /// The point is clamped into the segment's cell, so that rounding cannot carry it past a face,
    /// where other voxels are read: the value is inside the segment's bound.
    #[inline] // bench: lookup
    pub fn stochastic_at(&mut self, walk: &Traversal<'_>, t: f64, bits: u64) -> f32 {
        if let Some((slot, p)) = walk.at_in_brick(t) {
            match self.stochastic_in_brick(slot, p, bits) {
                Ok(value) => value,
                Err(offset) => self.value(walk.voxels().0 + offset),
            }
        } else {
            self.stochastic(walk.clamped_at(t), bits)
        }
    }

    /// Decides on the value that [`stochastic_at`](Self::stochastic_at) returns: breaks with what
    /// `accepts` says of it if the bounds of its own cell tell, and returns it to be asked else.
    ///
    /// `accepts` is true of all values from some value on. In blocks of many cells, whose bounds are
    /// loose, most values need not be read, nor where they are.
    #[inline] // bench: frame
    pub fn stochastic_decision(
        &mut self,
        walk: &Traversal<'_>,
        t: f64,
        bits: u64,
        accepts: impl Fn(f32) -> bool,
    ) -> ControlFlow<bool, f32> {
        if walk.is_brick() {
            return ControlFlow::Continue(self.stochastic_at(walk, t, bits));
        }
        let p = Self::tap(walk.clamped_at(t), bits);
        let cell = match self.cell(p) {
            Ok(cell) => cell,
            Err(value) => return ControlFlow::Continue(value),
        };
        let (min, max) = self.grid.hints.range(cell);
        if accepts(min) {
            return ControlFlow::Break(true);
        }
        if !accepts(max) {
            return ControlFlow::Break(false);
        }
        let counted = self.grid.ranks.brick(cell, p);
        ControlFlow::Continue(match counted.map_or_else(|| self.brick(cell), Ok) {
            Ok(b) => self.grid.values.get(b, brick::offset(p)),
            Err(value) => value,
        })
    }

    /// Returns the trilinear value at `t` in the segment at hand of `walk`, clamped likewise.
    pub fn trilinear_at(&mut self, walk: &Traversal<'_>, t: f64) -> f32 {
        self.trilinear(walk.clamped_at(t))
    }
}

/// Interpolates without leaving the interval, whatever the rounding.
fn lerp(a: f32, b: f32, t: f32) -> f32 {
    (a + (b - a) * t).clamp(a.min(b), a.max(b))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::space::IndexTransform;

    fn grid(tree: Tree<f32>) -> DensityGrid {
        DensityGrid::new(tree, IndexTransform::uniform(1.0), usize::MAX).expect("no limit was set")
    }

    fn ramp() -> Tree<f32> {
        let at = |i: i32| IVec3::new(i / 400 - 9, i / 20 % 20 - 9, i % 20 - 9);
        let value = |p: IVec3| (p.x * 100 + p.y * 10 + p.z) as f32;
        Tree::from_voxels(0.0, (0..8000).map(|i| (at(i), value(at(i)))))
    }

    #[test]
    fn trilinear_reproduces_linear_fields_across_bricks() {
        let tree = ramp();
        let grid = grid(tree);
        let mut sampler = grid.sampler();
        for i in 0..2000 {
            let f = f64::from(i);
            let p = DVec3::new((f * 0.37) % 18.0, (f * 0.73) % 18.0, (f * 0.11) % 18.0) - 8.5;
            let expected = p.x * 100.0 + p.y * 10.0 + p.z;
            let got = f64::from(sampler.trilinear(p));
            // Three f32 interpolations of values below 1000: a few times 6e-5.
            assert!(
                (got - expected).abs() < 3e-4,
                "at {p}: {got}, expected {expected}"
            );
        }
    }

    #[test]
    fn one_tap_has_the_trilinear_mean() {
        let tree = Tree::from_voxels(0.0, [(IVec3::new(8, -8, 0), 1.0)]);
        let grid = grid(tree);
        let mut sampler = grid.sampler();
        let p = DVec3::new(7.25, -8.5, 0.75);
        let expected = 0.25 * 0.5 * 0.25;
        assert!((f64::from(sampler.trilinear(p)) - expected).abs() < 1e-7);
        // A full raster of the random bits gives the weight exactly; 2^7 steps an axis do.
        let n = 128_u64;
        let mut sum = 0.0;
        for i in 0..n * n * n {
            let bits = (i % n) << 14 | (i / n % n) << 35 | (i / n / n) << 56;
            sum += f64::from(sampler.stochastic(p, bits));
        }
        let mean = sum / (n * n * n) as f64;
        assert_eq!(mean, expected, "the raster hits fractions of 1/128 exactly");
    }

    #[test]
    fn ends_of_the_index_range_do_not_overflow() {
        let tree = ramp();
        let grid = grid(tree);
        let mut sampler = grid.sampler();
        for x in [-1e300, -2_147_483_648.5, 2_147_483_647.5, 1e300] {
            assert_eq!(sampler.trilinear(DVec3::new(x, 1000.0, 0.0)), 0.0, "at {x}");
            assert_eq!(
                sampler.stochastic(DVec3::new(x, 1000.0, 0.0), u64::MAX),
                0.0,
                "at {x}"
            );
        }
    }
}

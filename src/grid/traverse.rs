//! Walking a ray through the tree: gap-free, ordered intervals of `t` with their bounds.
//!
//! The walk is a digital differential analyser `[Amanatides1987]` over 8³ cells that takes the
//! largest empty step the tree allows: a cell of 4096³, 128³ or 8³ voxels. What keeps it exact:
//!
//! * The cell is an integer; it moves by whole cells and never comes from rounding a point,
//!   save after a large step, where the point is clamped into the cell that was left. No
//!   epsilon anywhere.
//! * Crossings are computed from integer planes each time, never accumulated.
//! * `t` is clamped to be monotone, so consecutive segments share their ends exactly.
//! * A direction component that is zero, or whose reciprocal overflows, never crosses a plane.
//! * Arithmetic is `f64`: at 2³⁰ voxels from the origin a position is good to 1e-7 voxels.

use glam::{DVec3, IVec3};

use super::bounds::{Bound, Bounds};
use super::brick::{BRICK_DIM, BRICK_LOG2};
use super::density::DensityGrid;
use super::directory::{self, Content};
use super::tree::{LOWER_LOG2, lower_slot};
use crate::space::{Aabb, floor_to_voxel};

/// An interval of a ray within one cell.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Segment {
    /// Where the ray enters.
    pub t0: f64,
    /// Where it leaves; greater than `t0`.
    pub t1: f64,
    /// What the filter can read in between.
    pub bound: Bound,
    /// Lowest voxel of the cell.
    pub first: IVec3,
    /// Highest voxel of the cell: 7, 127 or 4095 further, unless the cell is the whole grid.
    pub last: IVec3,
}

/// Which cells a ray is cut into.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Cells {
    /// One: the box of all that is not zero, with the bound of the whole grid.
    Whole,
    /// Bricks of 8³ voxels; tiles and empty nodes, whatever their size, are one cell.
    Bricks,
    /// As `Bricks`, but the whole, or a node of 128³ voxels, is one cell where its maximum, times
    /// the length of the ray inside it, is below this number.
    Merged(f64),
}

/// An iterator over the segments of a ray whose bound is not zero, in order.
///
/// Space between two segments, before the first and after the last is empty.
#[derive(Debug)]
pub struct Traversal<'a> {
    grid: &'a DensityGrid,
    bounds: &'a Bounds,
    origin: DVec3,
    direction: DVec3,
    /// Reciprocal of the direction; not finite where planes are never crossed.
    inverse: DVec3,
    /// +1, −1 or 0 for the axes that never cross a plane.
    step: IVec3,
    /// The 8³ cell of the ray at `t`, in cells; and the box of those that are occupied.
    cell: IVec3,
    first: IVec3,
    last: IVec3,
    /// Where the ray leaves that cell, for each axis.
    exit: DVec3,
    t: f64,
    t_end: f64,
    /// The lower node (16³ cells) that was looked at last, and what it is.
    node_key: IVec3,
    node: Node,
    cells: Cells,
    done: bool,
}

/// What a 16³ block of cells is stored as.
#[derive(Clone, Copy, Debug)]
enum Node {
    /// First slot of a lower node that is not empty.
    Lower(usize),
    /// One bound for a cell of `2^log2` bricks an edge: a tile, or an empty or merged node.
    Large { log2: u32, bound: Bound },
    /// One bound for everything.
    Whole,
}

impl<'a> Traversal<'a> {
    /// Starts the walk of `origin + t · direction`, in index space, for t from 0 to `t_max`.
    pub fn new(
        grid: &'a DensityGrid,
        origin: DVec3,
        direction: DVec3,
        t_max: f64,
        cells: Cells,
    ) -> Self {
        let bounds = &grid.bounds;
        let inverse = DVec3::ONE / direction;
        let signum = |d: f64, inv: f64| match () {
            () if !inv.is_finite() => 0,
            () if d > 0.0 => 1,
            () => -1,
        };
        let step = IVec3::new(
            signum(direction.x, inverse.x),
            signum(direction.y, inverse.y),
            signum(direction.z, inverse.z),
        );
        // Where root cells are missing there is no density, but a sampler reads the background.
        let cells = if grid.tree.background() == 0.0 {
            cells
        } else {
            Cells::Bricks
        };
        let mut walk = Self {
            grid,
            bounds,
            origin,
            direction,
            inverse,
            step,
            cell: IVec3::ZERO,
            first: IVec3::ZERO,
            last: IVec3::ZERO,
            exit: DVec3::ZERO,
            t: 0.0,
            t_end: t_max,
            node_key: IVec3::MAX,
            node: Node::Lower(0),
            cells,
            done: true,
        };
        let Some((first, last)) = bounds.occupied else {
            return walk;
        };
        let size = f64::from(BRICK_DIM);
        let domain = Aabb {
            min: first.as_dvec3() * size,
            max: (last.as_dvec3() + DVec3::ONE) * size,
        };
        if let Some((t0, t1)) = domain.intersect_inverse(origin, inverse)
            && t0 < t1.min(t_max)
        {
            walk.t = t0;
            walk.t_end = t1.min(t_max);
            (walk.first, walk.last) = (first, last);
            walk.cell = walk.cell_at(t0).clamp(first, last);
            walk.exit = DVec3::new(walk.exit(0, 1), walk.exit(1, 1), walk.exit(2, 1));
            walk.done = false;
            if let Cells::Merged(below) = cells
                && f64::from(bounds.whole.max) * (walk.t_end - t0) < below
            {
                walk.cells = Cells::Whole;
            }
        }
        walk
    }

    /// Returns the 8³ cell of the point at `t`, in cells.
    fn cell_at(&self, t: f64) -> IVec3 {
        floor_to_voxel((self.origin + self.direction * t) * (1.0 / f64::from(BRICK_DIM)))
    }

    /// Returns where the ray leaves, along `axis`, the block of `size` cells that holds `cell`.
    #[inline] // bench: traversal
    fn exit(&self, axis: usize, size: i32) -> f64 {
        if self.step[axis] == 0 {
            return f64::INFINITY;
        }
        let low = self.cell[axis] & !(size - 1);
        let plane = f64::from(if self.step[axis] > 0 { low + size } else { low });
        (plane * f64::from(BRICK_DIM) - self.origin[axis]) * self.inverse[axis]
    }

    /// Moves to the cell at the end of a small step over the plane of `axis`.
    #[inline] // bench: traversal
    fn advance(&mut self, axis: usize) {
        self.cell[axis] += self.step[axis];
        self.done |= self.cell[axis] < self.first[axis] || self.cell[axis] > self.last[axis];
        self.exit[axis] = self.exit(axis, 1);
    }

    /// Moves past the block of `size` cells that holds the cell; returns where it ends.
    fn leap(&mut self, size: i32) -> f64 {
        let exit = DVec3::new(self.exit(0, size), self.exit(1, size), self.exit(2, size));
        let axis = smallest(exit);
        let t1 = exit[axis].max(self.t);
        // Where the ray leaves, on the other axes: within the block, and never backwards.
        let block = self.cell & !(size - 1);
        let inside = self.cell_at(t1).clamp(block, block + (size - 1));
        for other in 0..3 {
            self.cell[other] = match self.step[other] {
                1 => inside[other].max(self.cell[other]),
                -1 => inside[other].min(self.cell[other]),
                _ => self.cell[other],
            };
        }
        self.cell[axis] = if self.step[axis] > 0 {
            block[axis] + size
        } else {
            block[axis] - 1
        };
        self.done |= self.cell.cmplt(self.first).any() || self.cell.cmpgt(self.last).any();
        self.exit = DVec3::new(self.exit(0, 1), self.exit(1, 1), self.exit(2, 1));
        t1
    }

    /// Returns whether the 128³ node that holds the cell, of this bound, is walked as one.
    fn merges(&self, bound: Bound) -> bool {
        let Cells::Merged(below) = self.cells else {
            return false;
        };
        let size = 1 << LOWER_LOG2;
        let exit = self.exit(0, size).min(self.exit(1, size));
        let exit = exit.min(self.exit(2, size)).min(self.t_end);
        f64::from(bound.max) * (exit - self.t) < below
    }

    #[inline(never)] // Once in 16 steps: inlined it would crowd the others.
    fn look_up_node(&mut self) {
        if self.cells == Cells::Whole {
            self.node = Node::Whole;
            return;
        }
        self.node_key = self.cell >> LOWER_LOG2;
        let DensityGrid {
            tree,
            bounds,
            directory,
            ..
        } = self.grid;
        let directory::Node { bound, content } = directory.node(tree, bounds, self.node_key);
        self.node = match content {
            Content::Lower(base)
                if bound.max > 0.0 && !bound.is_constant() && !self.merges(bound) =>
            {
                Node::Lower(base)
            }
            Content::Lower(_) => Node::Large {
                log2: LOWER_LOG2,
                bound,
            },
            Content::Tile { log2, .. } => Node::Large { log2, bound },
        };
    }
}

impl Iterator for Traversal<'_> {
    type Item = Segment;

    #[inline] // bench: traversal
    fn next(&mut self) -> Option<Segment> {
        loop {
            if self.done || self.t >= self.t_end {
                return None;
            }
            if self.cell >> LOWER_LOG2 != self.node_key {
                self.look_up_node();
            }
            let t0 = self.t;
            let (bound, first, last, t1) = match self.node {
                Node::Lower(base) => {
                    let voxel = self.cell << BRICK_LOG2;
                    let bound = self.bounds.lower[base + lower_slot(voxel)];
                    let axis = smallest(self.exit);
                    let t1 = self.exit[axis].max(t0);
                    self.advance(axis);
                    (bound, voxel, voxel + (BRICK_DIM - 1), t1)
                }
                Node::Large { log2, bound } => {
                    let size = 1 << log2;
                    let cell = (self.cell & !(size - 1)) << BRICK_LOG2;
                    let t1 = self.leap(size);
                    (bound, cell, cell + ((size << BRICK_LOG2) - 1), t1)
                }
                Node::Whole => {
                    self.done = true;
                    let last = (self.last << BRICK_LOG2) + (BRICK_DIM - 1);
                    let bound = self.bounds.whole;
                    (bound, self.first << BRICK_LOG2, last, self.t_end)
                }
            };
            self.t = t1;
            let t1 = t1.min(self.t_end);
            if bound.max > 0.0 && t1 > t0 {
                return Some(Segment {
                    t0,
                    t1,
                    bound,
                    first,
                    last,
                });
            }
        }
    }
}

/// Returns the axis of the smallest component.
#[inline] // bench: traversal
pub(super) fn smallest(v: DVec3) -> usize {
    if v.x <= v.y {
        if v.x <= v.z { 0 } else { 2 }
    } else if v.y <= v.z {
        1
    } else {
        2
    }
}

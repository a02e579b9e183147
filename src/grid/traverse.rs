//! Walking a ray through the tree: gap-free, ordered intervals of `t` with their bounds.
//!
//! The walk is a digital differential analyser `[Amanatides1987]` over cells of 8³ voxels, or of 16³ to
//! 64³ where that suits a medium (see `level`). Tiles and
//! empty nodes of 128³ or 4096³ voxels are crossed in one step, and so are blocks of cells in which
//! there is nothing, or little (see `blocks`). What keeps it exact:
//!
//! * The cell is an integer; it moves by whole cells and never comes from rounding a point,
//!   save after a large step, where the point is clamped into the cell that was left. No
//!   epsilon anywhere.
//! * Crossings are computed from integer planes each time, never accumulated.
//! * `t` is clamped to be monotone, so consecutive segments share their ends exactly.
//! * A direction component that is zero, or whose reciprocal overflows, never crosses a plane.
//! * Arithmetic is `f64`: at 2³⁰ voxels from the origin a position is good to 1e-7 voxels.
//!
//! Cells are counted along the ray: on an axis on which it goes down, cell `c` is `!c`, which is
//! `−c − 1`. All steps then go up by one, aligned blocks stay aligned, and no step asks for a sign;
//! a plane at `p` lies at `−p`, so crossings are the same numbers to the bit.

use glam::{DVec3, IVec3};

use super::blocks::Blocks;
use super::bounds::Bound;
use super::brick::BRICK_LOG2;
use super::cells::Cell;
use super::curve;
use super::density::DensityGrid;
use super::directory::{self, Content, Directory};
use super::tree::{LOWER_LEN, LOWER_LOG2};
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
    /// Highest voxel of the cell: 7 further in a brick, more in a block, a node or the whole grid.
    pub last: IVec3,
}

/// Which cells a ray is cut into.
#[derive(Clone, Copy, Debug)]
pub enum Cells<'a> {
    /// One: the box of all that is not zero, with the bound of the whole grid.
    Whole,
    /// Bricks of 8³ voxels; tiles and empty nodes, whatever their size, are one cell.
    Bricks,
    /// As `Bricks`, but cells may be larger, and those of a block are one.
    Blocks(&'a Blocks),
}

/// An iterator over the segments of a ray whose bound is not zero, in order.
///
/// Space between two segments, before the first and after the last is empty. At a segment the
/// walk can [`turn`](Self::turn), as a path does at a collision, and go on from there without
/// looking for its place again.
#[derive(Clone, Debug)]
pub struct Traversal<'a> {
    grid: &'a DensityGrid,
    /// The cells of all lower nodes.
    lower: &'a [Cell],
    /// The blocks of cells that are crossed in one step.
    blocks: &'a Blocks,
    /// Where the cells' nodes are. The walk does not leave their table, but that of bricks may be
    /// missing.
    directory: &'a Directory,
    /// First and last cell of the box around all that is not empty.
    occupied: &'a Option<(IVec3, IVec3)>,
    /// The edge of a cell in voxels: base-2 logarithm, itself, and its reciprocal.
    cell_log2: u32,
    size: f64,
    scale: f64,
    /// Origin and direction in cells: exact, as their size is a power of two.
    origin: DVec3,
    direction: DVec3,
    /// −1 on the axes on which the ray goes down, 0 on the others: makes cells along the ray of
    /// cells, and the other way round.
    mirror: IVec3,
    /// The origin along the ray, and the absolute reciprocal of the direction. On axes that never
    /// cross a plane, where that overflows, −∞ and 1: crossings are at ∞.
    start: DVec3,
    inverse: DVec3,
    /// The cell at hand, along the ray, and where the ray leaves it, for each axis.
    cell: IVec3,
    exit: [f64; 3],
    /// Whether `exit` is not set: in a block, and after a leap, which another one may follow.
    is_exit_due: bool,
    /// The coordinate along the ray, for each axis, at which a step has left the box, and that at
    /// which it has left the node or the box.
    end: IVec3,
    stop: IVec3,
    node: Node,
    /// The cell's place along the curve of its lower node, along the ray, after the cells of the
    /// nodes before it; and what makes that the number of the cell.
    place: usize,
    mirrored: usize,
    /// Where the ray enters and leaves the cell, and over which axis.
    t0: f64,
    t1: f64,
    axis: usize,
    t_end: f64,
    /// Base-2 logarithm of the edge, in cells, of the segment at hand in a lower node.
    log2: u32,
    /// Whether everything is one segment.
    is_whole: bool,
}

/// What the cell at hand is stored in.
#[derive(Clone, Copy, Debug)]
enum Node {
    /// Not known: the start, or a step led out of the last one.
    Unknown,
    /// A lower node that is not empty: 16³ cells.
    Lower,
    /// One bound for `2^log2` cells an edge: a tile, or an empty node.
    Large { log2: u32, bound: Bound },
    /// One bound for everything.
    Whole,
}

/// 1.5·2⁵². Adding it to a number below 2³¹ rounds that to an integer, which is in the last bits then.
pub(super) const ROUND: f64 = 6_755_399_441_055_744.0;

/// In place of an axis: the cell at hand has not been visited yet.
const STAY: usize = 3;

impl<'a> Traversal<'a> {
    /// Starts the walk of `origin + t · direction`, in index space, for t from 0 to `t_max`.
    pub fn new(
        grid: &'a DensityGrid,
        origin: DVec3,
        direction: DVec3,
        t_max: f64,
        cells: Cells<'a>,
    ) -> Self {
        // Where root cells are missing there is no density, but a sampler reads the background.
        let has_no_background = grid.tree.background() == 0.0;
        let blocks = match cells {
            Cells::Blocks(blocks) if has_no_background => blocks,
            _ => &grid.empty_blocks,
        };
        let (lower, directory, occupied, cell_log2) = match &blocks.level {
            None => {
                let occupied = &grid.bounds.occupied;
                (&grid.cells[..], &grid.directory, occupied, BRICK_LOG2)
            }
            Some(of) => (&of.cells[..], &of.directory, &of.occupied, of.cell_log2),
        };
        let size = f64::from(1 << cell_log2);
        let scale = size.recip();
        let mut walk = Self {
            grid,
            lower,
            blocks,
            directory,
            occupied,
            cell_log2,
            size,
            scale,
            origin: origin * scale,
            direction: direction * scale,
            mirror: IVec3::ZERO,
            start: DVec3::NEG_INFINITY,
            inverse: DVec3::ONE,
            cell: IVec3::ZERO,
            exit: [f64::INFINITY; 3],
            is_exit_due: false,
            end: IVec3::ZERO,
            stop: IVec3::ZERO,
            node: Node::Unknown,
            place: 0,
            mirrored: 0,
            t0: 0.0,
            t1: 0.0,
            axis: STAY,
            t_end: t_max,
            log2: 0,
            is_whole: matches!(cells, Cells::Whole) && has_no_background,
        };
        walk.enter_box();
        walk
    }

    /// Finds the cell in which the ray starts, or where it enters the box.
    fn enter_box(&mut self) {
        let inverse = DVec3::ONE / self.direction;
        let Some((first, last)) = *self.occupied else {
            self.t_end = 0.0;
            return;
        };
        let domain = Aabb {
            min: first.as_dvec3(),
            max: last.as_dvec3() + DVec3::ONE,
        };
        let Some((t0, t1)) = domain.intersect_inverse(self.origin, inverse) else {
            self.t_end = 0.0;
            return;
        };
        self.t_end = self.t_end.min(t1);
        (self.t0, self.t1) = (t0, t0);
        let cell = floor_to_voxel(self.at(t0)).clamp(first, last);
        self.axis = STAY;
        self.node = if self.is_whole {
            Node::Whole
        } else {
            Node::Unknown
        };
        self.aim(inverse);
        self.cell = cell ^ self.mirror;
        self.is_exit_due = true;
    }

    /// Sets what follows from the direction, whose reciprocal is `inverse`.
    #[inline] // bench: frame
    fn aim(&mut self, inverse: DVec3) {
        for axis in 0..3 {
            let inverse = inverse[axis];
            let is_down = inverse.is_sign_negative();
            self.mirror[axis] = -i32::from(is_down);
            let origin = self.origin[axis];
            (self.start[axis], self.inverse[axis]) = if inverse.is_finite() {
                (if is_down { -origin } else { origin }, inverse.abs())
            } else {
                (f64::NEG_INFINITY, 1.0)
            };
        }
        let (first, last) = self.occupied.unwrap_or_default();
        self.mirrored = curve::mirrored(self.mirror);
        self.end = ((last & !self.mirror) | (!first & self.mirror)) + 1;
    }

    /// Goes on from the point at `t` of the segment at hand in another direction, given in index
    /// space, for distances from there up to `t_max`: the next segment starts at 0.
    #[inline] // bench: frame
    pub fn turn(&mut self, t: f64, direction: DVec3, t_max: f64) {
        self.origin = self.at(t);
        self.direction = direction * self.scale;
        self.t_end = t_max;
        if !matches!(self.node, Node::Lower) {
            self.enter_box();
            return;
        }
        // Rounding may have put the origin just outside of the cell, whose exit is then below 0:
        // an empty segment.
        (self.t0, self.t1) = (0.0, 0.0);
        self.axis = STAY;
        let (cell, place) = (self.cell ^ self.mirror, self.place ^ self.mirrored);
        self.aim(DVec3::ONE / self.direction);
        // Of a block any cell will do that the ray has not passed: the first one.
        self.cell = (cell ^ self.mirror) & -(1 << self.log2);
        self.place = place ^ self.mirrored;
        self.is_exit_due = self.log2 > 0;
        if !self.is_exit_due {
            self.exit = self.exits(1);
        }
        self.set_stops();
    }

    /// Returns the point at `t`, in cells.
    #[inline] // bench: traversal
    fn at(&self, t: f64) -> DVec3 {
        self.origin + self.direction * t
    }

    /// Returns origin and direction of the ray, in index space.
    #[inline] // bench: frame
    pub fn ray(&self) -> (DVec3, DVec3) {
        (self.origin * self.size, self.direction * self.size)
    }

    /// Returns the number of the cell at hand among those of all lower nodes.
    #[inline] // bench: traversal
    fn number(&self) -> usize {
        self.place ^ self.mirrored
    }

    /// Returns where the ray crosses, along `axis`, the plane at `plane` cells along the ray.
    #[inline] // bench: traversal
    fn plane_at(&self, axis: usize, plane: i32) -> f64 {
        (f64::from(plane) - self.start[axis]) * self.inverse[axis]
    }

    /// Returns where the ray leaves, along each axis, the block of `size` cells that holds the cell.
    #[inline] // bench: traversal
    fn exits(&self, size: i32) -> [f64; 3] {
        let plane = (self.cell & -size) + size;
        [
            self.plane_at(0, plane.x),
            self.plane_at(1, plane.y),
            self.plane_at(2, plane.z),
        ]
    }

    /// Moves to the next cell, over the plane of `axis`.
    #[inline] // bench: traversal
    fn advance(&mut self, axis: usize) {
        let cell = self.cell[axis] + 1;
        self.cell[axis] = cell;
        self.place = curve::up(self.place, axis);
        self.exit[axis] = self.plane_at(axis, cell + 1);
        if cell == self.stop[axis] {
            self.node = Node::Unknown;
        }
    }

    /// Moves past the block at hand, of several cells of a lower node.
    fn leap_block(&mut self) {
        self.leap(1 << self.log2);
        // On any axis: the block may reach out of the box.
        if self.cell.cmplt(self.stop).all() {
            self.node = Node::Lower;
            self.place = (self.place & !(LOWER_LEN - 1)) + curve::place(self.cell);
        }
    }

    /// Moves past the block of `size` cells that holds the cell.
    fn leap(&mut self, size: i32) {
        // Where the ray leaves, on the other axes: within the block, and never backwards.
        let block = self.cell & -size;
        let next = block + size;
        let inside = near_floor(self.at(self.t1)) ^ self.mirror;
        let inside = inside.min(next - 1).max(self.cell);
        // Not by index: reading what a part was just written to waits for the write. Nor by a
        // branch, which cannot be foreseen.
        let pick = |axis: usize, past: i32, inside: i32| {
            inside ^ ((past ^ inside) & -i32::from(self.axis == axis))
        };
        self.cell = IVec3::new(
            pick(0, next.x, inside.x),
            pick(1, next.y, inside.y),
            pick(2, next.z, inside.z),
        );
        self.is_exit_due = true;
        self.node = Node::Unknown;
    }

    /// Finds out what holds the cell, or ends the walk if it is outside of the box.
    fn enter_node(&mut self) {
        let DensityGrid { tree, bounds, .. } = self.grid;
        // It cannot be before the box, in which the walk began.
        if !self.cell.cmplt(self.end).all() {
            self.t_end = self.t1;
            return;
        }
        let cell = self.cell ^ self.mirror;
        let key = cell >> LOWER_LOG2;
        let directory::Node { bound, content } = self.directory.node(tree, bounds, key);
        self.node = match content {
            Content::Lower(base) if bound.max > 0.0 && !bound.is_constant() => {
                self.place = base + curve::place(self.cell);
                self.set_stops();
                Node::Lower
            }
            Content::Lower(_) => Node::Large {
                log2: LOWER_LOG2,
                bound,
            },
            Content::Tile { log2, .. } => Node::Large { log2, bound },
        };
    }

    /// Finds where steps will leave the lower node that holds the cell.
    #[inline] // bench: frame
    fn set_stops(&mut self) {
        const SIZE: i32 = 1 << LOWER_LOG2;
        self.stop = ((self.cell & -SIZE) + SIZE).min(self.end);
    }

    /// Goes on to the next cell whose bound is not zero; returns its bound, or `None` at the end.
    #[inline] // bench: traversal
    pub fn next_bound(&mut self) -> Option<Bound> {
        loop {
            let t0 = self.t1;
            if t0 >= self.t_end {
                return None;
            }
            if !matches!(self.node, Node::Lower) {
                if self.step_large() {
                    return Some(self.large_bound());
                }
                continue;
            }
            if self.axis != STAY {
                if self.log2 == 0 {
                    self.advance(self.axis);
                } else {
                    self.leap_block();
                }
                if !matches!(self.node, Node::Lower) {
                    self.axis = STAY;
                    continue;
                }
            }
            let number = self.number();
            let group = self.blocks.group(number);
            self.log2 = group.log2();
            let (bound, (axis, t1)) = if self.log2 == 0 {
                if self.is_exit_due {
                    self.exit = self.exits(1);
                    self.is_exit_due = false;
                }
                let [x, y, z] = self.exit;
                (self.lower[number].bound, smallest(x, y, z))
            } else {
                let bound = group.bound().unwrap_or_else(|| self.lower[number].bound);
                let [x, y, z] = self.exits(1 << self.log2);
                (bound, smallest(x, y, z))
            };
            let t1 = if t1 > t0 { t1 } else { t0 };
            self.axis = axis;
            self.t0 = t0;
            self.t1 = t1;
            if bound.max > 0.0 && t1 > t0 {
                return Some(bound);
            }
        }
    }

    /// A step where the cell is not known to lie in a lower node; returns whether it led to a
    /// segment that is not empty.
    #[cold]
    #[inline(never)]
    fn step_large(&mut self) -> bool {
        if let Node::Large { log2, .. } = self.node
            && self.axis != STAY
        {
            self.leap(1 << log2);
            self.axis = STAY;
        }
        if let Node::Unknown = self.node {
            self.enter_node();
        }
        let size = match self.node {
            Node::Unknown | Node::Lower => return false,
            Node::Large { log2, .. } => 1 << log2,
            Node::Whole => {
                (self.t0, self.t1) = (self.t1, self.t_end);
                return self.grid.bounds.whole.max > 0.0;
            }
        };
        let [x, y, z] = self.exits(size);
        let (axis, t1) = smallest(x, y, z);
        self.axis = axis;
        (self.t0, self.t1) = (self.t1, t1.max(self.t1));
        self.large_bound().max > 0.0 && self.t1 > self.t0
    }

    /// Returns the bound of a segment that is larger than a brick.
    fn large_bound(&self) -> Bound {
        match self.node {
            Node::Large { bound, .. } => bound,
            _ => self.grid.bounds.whole,
        }
    }

    /// Returns where the segment at hand starts and ends.
    #[inline] // bench: traversal
    pub fn interval(&self) -> (f64, f64) {
        (self.t0, self.t1.min(self.t_end))
    }

    /// Returns the number of the cell of the segment at hand, with the point at `t`
    /// relative to its first voxel; `None` in a larger cell.
    #[inline] // bench: frame
    pub(super) fn at_in_brick(&self, t: f64) -> Option<(usize, DVec3)> {
        let cell = self.cell ^ self.mirror;
        let p = (self.at(t) - cell.as_dvec3()) * self.size;
        self.is_brick().then_some((self.number(), p))
    }

    /// Returns whether the cell at hand is one of 8³ voxels, of a lower node.
    #[inline] // bench: frame
    pub(super) fn is_brick(&self) -> bool {
        matches!(self.node, Node::Lower) && self.log2 == 0 && self.cell_log2 == BRICK_LOG2
    }

    /// Returns the first voxel of the cell at hand and how many the cell has along each edge.
    #[inline] // bench: frame
    pub(super) fn voxels(&self) -> (IVec3, IVec3) {
        let size = match self.node {
            Node::Whole => {
                let (first, last) = self.occupied.unwrap_or_default();
                return (
                    first << self.cell_log2,
                    (last - first + 1) << self.cell_log2,
                );
            }
            Node::Large { log2, .. } => 1 << log2,
            Node::Unknown | Node::Lower => 1 << self.log2,
        };
        let first = (self.cell ^ self.mirror) & -size;
        (
            first << self.cell_log2,
            IVec3::splat(size << self.cell_log2),
        )
    }

    /// Returns the edge of the cell at hand in voxels; of the whole grid, along x.
    #[inline] // bench: frame
    pub fn edge(&self) -> f32 {
        if matches!(self.node, Node::Lower) {
            return (1 << (self.cell_log2 + self.log2)) as f32;
        }
        self.voxels().1.x as f32
    }

    /// Returns the point at `t`, in index space, clamped into the cell of the segment at hand.
    pub(super) fn clamped_at(&self, t: f64) -> DVec3 {
        let (first, size) = self.voxels();
        let p = self.at(t) * self.size;
        p.max(first.as_dvec3()).min((first + size).as_dvec3())
    }

    /// Returns the segment at hand, of this bound.
    #[inline] // bench: traversal
    pub(super) fn segment(&self, bound: Bound) -> Segment {
        let (t0, t1) = self.interval();
        let (first, size) = self.voxels();
        Segment {
            t0,
            t1,
            bound,
            first,
            last: first + (size - 1),
        }
    }
}

impl Iterator for Traversal<'_> {
    type Item = Segment;

    #[inline] // bench: traversal
    fn next(&mut self) -> Option<Segment> {
        let bound = self.next_bound()?;
        Some(self.segment(bound))
    }
}

/// Returns the integers below or, where `p` is one but for rounding, next to `p`.
///
/// For a point on its way between two cells, which may be said to be in either; a quarter of the
/// instructions of [`floor_to_voxel`]. Beyond the range of `i32` it is any number.
#[inline] // bench: frame
fn near_floor(p: DVec3) -> IVec3 {
    #[expect(clippy::cast_possible_truncation, reason = "the last bits are meant")]
    let near = |x: f64| ((x - 0.5) + ROUND).to_bits() as i32;
    IVec3::new(near(p.x), near(p.y), near(p.z))
}

/// Returns the axis of the smallest component, and that component.
///
/// Of three numbers and not of an array: indexing one that was just written, or reading two of its
/// numbers at once, waits for the writes. The axis is added up of truth values, since no branch
/// foresees it: with the choice in `leap`, a seventh of the comparison cloud's mispredictions.
#[inline] // bench: traversal
pub(super) fn smallest(x: f64, y: f64, z: f64) -> (usize, f64) {
    let xy = if x < y { x } else { y };
    let is_z = usize::from(z < xy);
    let axis = is_z << 1 | (usize::from(y < x) & !is_z);
    (axis, if z < xy { z } else { xy })
}

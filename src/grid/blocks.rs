//! Blocks of cells that a ray crosses in one step.
//!
//! Steps from brick to brick are wasted where nothing is, and where so little is that the ray will
//! hardly collide. In a node of 16³ cells, aligned blocks of 2³, 4³, 8³ and 16³ cells have bounds of
//! their own; a ray crosses the largest block that is expected to cost less than its parts. Expected
//! costs, in steps from brick to brick, are one a step, [`LEAP_COST`] a block, [`COLLISION_COST`] a
//! tentative collision, which there are in proportion to the bound, the length and the extinction
//! that a density stands for, and [`LOOKUP_COST`] more for those that need a lookup, which are not
//! below the minimum; a chord of a block crosses two of its eight parts. That makes the work
//! of a ray through a medium of given thickness almost independent of the resolution.
//!
//! Cells are bricks, or larger (see `level`) where that is expected to cost less in all: of the cloud of
//! `benches/growth.rs` cells have 8³ voxels at 128³ and 256³, 16³ at 512³ and 32³ at 1024³.
//!
//! Any choice is exact: a block's bound holds for all of its cells.

use glam::IVec3;
use rayon::prelude::*;

use super::bounds::{Bound, union};
use super::brick::{BRICK_DIM, BRICK_LOG2};
use super::cells::Cell;
use super::directory::Directory;
use super::level::Level;
use super::tree::{LOWER_LEN, LOWER_LOG2};

/// Cost of a lookup, most of it waiting for memory and for the branch that it decides, in steps
/// from brick to brick.
pub const LOOKUP_COST: f32 = 4.0;

/// Cost of a collision besides its lookup: two random numbers and a logarithm.
const COLLISION_COST: f32 = 1.0;

/// Cost of crossing a block: twice as many instructions as a step.
const LEAP_COST: f32 = 2.0;

/// Larger cells than bricks are tried up to this many doublings of the edge: 64³ voxels.
const MAX_DOUBLINGS: u32 = 3;

/// Base-2 logarithm of the cells of a group, the smallest block: 2³.
const GROUP_LEN_LOG2: u32 = 3;

/// The cells that rays through a grid walk, and blocks of them, chosen for one medium.
#[derive(Clone, Debug)]
pub struct Blocks {
    /// One for each 2³ cells, which follow each other in a node: what block holds them.
    groups: Vec<Group>,
    /// The cells, if they are larger than bricks.
    pub(super) level: Option<Level>,
    /// What it is expected to cost to cross all nodes, in steps from cell to cell, weighted by how many
    /// rays meet a node: by its face, in faces of 128² voxels.
    cost: f64,
}

/// The block that holds 2³ cells, all of them in the same or each in its own.
///
/// In 4 bytes: of 1024³ voxels the groups of all nodes take 840 KB. With a byte for each cell and
/// bounds of 12 bytes apart, two waits for memory were a tenth of the time.
///
/// ```text
/// bits  0 to 2    base-2 logarithm of the block's edge in cells; 0: the cells are on their own
///       3 to 9    mean of the block's bound, in parts of 128 of its maximum
///      10 to 16   minimum, likewise, rounded down
///      17 to 31   maximum: exponent and 7 digits of an f32, rounded up; all ones for a constant,
///                 which is that of any of its cells
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Group(u32);

impl Group {
    /// Of cells on their own.
    const SINGLE: Self = Self(0);
    /// The digits that stand for a constant: those of no finite number.
    const CONSTANT: u32 = 0x7fff;
    /// Parts of a maximum.
    const PARTS: f32 = 128.0;

    /// Returns the group of a block of edge `2^log2`; `None` if the maximum is too large to be rounded
    /// up.
    fn new(log2: u32, bound: Bound) -> Option<Self> {
        if bound.max > 0.0 && bound.is_constant() {
            return Some(Self(Self::CONSTANT << 17 | log2));
        }
        let digits = bound.max.to_bits().div_ceil(1 << 16);
        let max = f32::from_bits(digits << 16);
        let down = |value: f32| {
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "0 to 127; of nothing, 0"
            )]
            let part = (value / max * Self::PARTS).min(Self::PARTS - 1.0) as u32;
            // Where numbers have few digits, the quotient may have been rounded up.
            (0..=part)
                .rev()
                .find(|&part| Self::part(max, part) <= value)
        };
        let (min, mean) = (down(bound.min)?, down(bound.mean)?);
        max.is_finite()
            .then_some(Self(digits << 17 | min << 10 | mean << 3 | log2))
    }

    #[inline] // bench: traversal
    fn part(max: f32, part: u32) -> f32 {
        max * (part as f32 * (1.0 / Self::PARTS))
    }

    /// Returns the base-2 logarithm of the edge, in cells, of the block that holds each cell.
    #[inline] // bench: traversal
    pub(super) fn log2(self) -> u32 {
        self.0 & 7
    }

    /// Returns a bound of the block; `None` if it is constant.
    #[inline] // bench: traversal
    pub(super) fn bound(self) -> Option<Bound> {
        let digits = self.0 >> 17;
        if digits == Self::CONSTANT {
            return None;
        }
        let max = f32::from_bits(digits << 16);
        Some(Bound {
            min: Self::part(max, self.0 >> 10 & 127),
            max,
            mean: Self::part(max, self.0 >> 3 & 127),
        })
    }
}

impl Blocks {
    /// Chooses blocks for a medium whose optical depth is `depth_per_density` in one voxel of
    /// density 1; infinity chooses empty blocks only.
    ///
    /// `lower` are the cells of all lower nodes.
    pub(super) fn new(lower: &[Cell], depth_per_density: f32) -> Self {
        let nodes: Vec<_> = lower
            .par_chunks(LOWER_LEN)
            .map(|cells| choose(cells, depth_per_density))
            .collect();
        let (groups, costs): (Vec<_>, Vec<_>) = nodes.into_iter().unzip();
        Self {
            groups: groups.concat(),
            level: None,
            cost: costs.into_iter().map(f64::from).sum(),
        }
    }

    /// As [`new`](Self::new), of the bricks, whose nodes are in `directory`, and of each size of larger
    /// cells in turn.
    pub(super) fn of_all_sizes(
        bricks: &[Cell],
        directory: &Directory,
        occupied: (IVec3, IVec3),
        depth_per_density: f32,
    ) -> Vec<Self> {
        let tiles = |directory: &Directory| f64::from(LEAP_COST) * directory.tile_count() as f64;
        let mut first = Self::new(bricks, depth_per_density);
        first.cost += tiles(directory);
        let mut all = vec![first];
        for doublings in 1..=MAX_DOUBLINGS {
            let level = match all.last().and_then(|blocks| blocks.level.as_ref()) {
                None => Level::doubled(bricks, directory, occupied, BRICK_LOG2 + 1),
                Some(Level {
                    cell_log2,
                    occupied: of,
                    cells,
                    directory,
                }) => Level::doubled(cells, directory, of.unwrap_or(occupied), cell_log2 + 1),
            };
            let scale = (1 << doublings) as f32;
            let mut blocks = Self::new(&level.cells, depth_per_density * scale);
            blocks.cost = (blocks.cost + tiles(&level.directory)) * f64::from(scale * scale);
            blocks.level = Some(level);
            all.push(blocks);
        }
        all
    }

    /// Returns the cheapest of some blocks, the first of equals; `None` of none.
    pub(super) fn cheapest(all: Vec<Self>) -> Option<Self> {
        all.into_iter().min_by(|a, b| a.cost.total_cmp(&b.cost))
    }

    /// Returns the edge of the cells in voxels.
    pub fn cell_edge(&self) -> i32 {
        1 << self.level.as_ref().map_or(BRICK_LOG2, |l| l.cell_log2)
    }

    /// Returns the group of a cell.
    #[inline] // bench: traversal
    pub(super) fn group(&self, cell: usize) -> Group {
        self.groups[cell >> GROUP_LEN_LOG2]
    }

    /// Returns the bytes that the blocks occupy.
    pub fn memory_bytes(&self) -> usize {
        size_of_val(&self.groups[..]) + self.level.as_ref().map_or(0, Level::memory_bytes)
    }
}

/// Chooses the blocks of one node, by group; returns them with the expected cost of crossing it.
fn choose(cells: &[Cell], depth_per_density: f32) -> (Vec<Group>, f32) {
    let collisions = |bound: Bound, log2: u32| {
        // Zero: nothing to collide with, however dense. A cube's mean chord is 2/3 of its edge.
        if bound.max > 0.0 {
            let chord = 2.0 / 3.0 * (BRICK_DIM << log2) as f32;
            let lookups = LOOKUP_COST * (bound.max - bound.min);
            depth_per_density * chord * (lookups + COLLISION_COST * bound.max)
        } else {
            0.0
        }
    };
    let mut groups = vec![Group::SINGLE; cells.len() >> GROUP_LEN_LOG2];
    let mut costs: Vec<f32> = cells.iter().map(|c| 1.0 + collisions(c.bound, 0)).collect();
    let mut parts: Vec<Bound> = cells.iter().map(|c| c.bound).collect();
    for log2 in 1..=LOWER_LOG2 {
        let len = 1 << (3 * log2 - GROUP_LEN_LOG2);
        let blocks = costs.chunks_exact(8).zip(parts.chunks_exact(8));
        let next = blocks.zip(groups.chunks_exact_mut(len));
        (costs, parts) = next
            .map(|((costs, parts), groups)| {
                let bound = union(parts);
                let split = costs.iter().map(|cost| cost / 4.0).sum::<f32>();
                let merged = LEAP_COST + collisions(bound, log2);
                if merged < split
                    && let Some(group) = Group::new(log2, bound)
                {
                    groups.fill(group);
                }
                (merged.min(split), bound)
            })
            .unzip();
    }
    (groups, costs[0])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn groups_hold_what_they_bound() {
        let values = [
            0.0,
            1e-45,
            3e-39,
            1e-30,
            0.1,
            0.999_999_9,
            1.0,
            7.3,
            255.0,
            3e38,
        ];
        for (i, &min) in values.iter().enumerate() {
            for &max in &values[i..] {
                for mean in [min, min + (max - min) * 0.3, max] {
                    let exact = Bound { min, max, mean };
                    let group = Group::new(3, exact).expect("the maximum can be rounded up");
                    assert_eq!(group.log2(), 3);
                    let Some(got) = group.bound() else {
                        assert_eq!(min, max, "constant");
                        continue;
                    };
                    assert!(max == 0.0 || min < max, "a constant is not rounded");
                    assert!(got.min <= min && got.max >= max, "{got:?} around {exact:?}");
                    assert!((got.min..=got.max).contains(&got.mean), "{got:?}");
                    // Of numbers too small for 8 digits, one unit of those that are left.
                    let unit = 1e-40;
                    assert!(got.max <= max * (1.0 + 1.0 / 128.0) + unit, "{got:?}");
                    let part = got.max / 128.0 + unit;
                    assert!(got.min >= min - part, "{got:?} around {exact:?}");
                    assert!((got.mean - mean).abs() <= part, "{got:?} around {exact:?}");
                }
            }
        }
        let largest = Bound {
            min: 0.0,
            max: f32::MAX,
            mean: 1.0,
        };
        assert_eq!(Group::new(1, largest), None, "infinity is no bound");
    }
}

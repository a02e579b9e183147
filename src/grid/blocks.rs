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
//! Any choice is exact: a block's bound holds for all of its cells.

use rayon::prelude::*;

use super::bounds::Bound;
use super::brick::BRICK_DIM;
use super::cells::Cell;
use super::tree::{LOWER_LEN, LOWER_LOG2};

/// Cost of a lookup, most of it waiting for memory and for the branch that it decides, in steps
/// from brick to brick.
pub const LOOKUP_COST: f32 = 4.0;

/// Cost of a collision besides its lookup: two random numbers and a logarithm.
const COLLISION_COST: f32 = 1.0;

/// Cost of crossing a block: twice as many instructions as a step.
const LEAP_COST: f32 = 2.0;

/// Blocks of a node that are larger than a cell: 8³, 4³, 2³ and 1.
const BLOCKS_PER_NODE: usize = 512 + 64 + 8 + 1;

/// Where the blocks of edge `2^log2` of a node start.
const FIRST: [usize; 5] = [0, 0, 512, 512 + 64, 512 + 64 + 8];

const _: () = assert!(
    FIRST.len() == LOWER_LOG2 as usize + 1,
    "a start for each size"
);

/// The blocks of all lower nodes of a grid, chosen for one medium.
#[derive(Clone, Debug)]
pub struct Blocks {
    /// For each slot of the lower nodes, the base-2 logarithm of the edge of its block, in cells.
    log2: Vec<u8>,
    /// [`BLOCKS_PER_NODE`] for each node; none where only empty blocks are chosen.
    bounds: Vec<Bound>,
}

/// Returns the number of a block of edge `2^log2` among those of its size, from a slot in it.
#[inline] // bench: traversal
fn block_of(slot: usize, log2: u32) -> usize {
    let mask = (1 << LOWER_LOG2) - 1;
    let (x, y, z) = (
        slot >> (2 * LOWER_LOG2) & mask,
        slot >> LOWER_LOG2 & mask,
        slot & mask,
    );
    let edge = LOWER_LOG2 - log2;
    ((x >> log2) << edge | y >> log2) << edge | z >> log2
}

impl Blocks {
    /// Chooses blocks for a medium whose optical depth is `depth_per_density` in one voxel of
    /// density 1; infinity chooses empty blocks only.
    ///
    /// `lower` are the cells of all lower nodes.
    pub(super) fn new(lower: &[Cell], depth_per_density: f32) -> Self {
        let nodes: Vec<(Vec<u8>, Vec<Bound>)> = lower
            .par_chunks(LOWER_LEN)
            .map(|cells| choose(cells, depth_per_density))
            .collect();
        let only_empty = depth_per_density.is_infinite();
        let mut blocks = Self {
            log2: Vec::with_capacity(lower.len()),
            bounds: Vec::new(),
        };
        for (log2, bounds) in nodes {
            blocks.log2.extend(log2);
            if !only_empty {
                blocks.bounds.extend(bounds);
            }
        }
        blocks
    }

    /// Returns the base-2 logarithm of the edge, in cells, of the block that holds `slot`.
    #[inline] // bench: traversal
    pub(super) fn log2(&self, slot: usize) -> u32 {
        self.log2[slot].into()
    }

    /// Returns the bound of the block of edge `2^log2` that holds `slot`.
    #[inline] // bench: traversal
    pub(super) fn bound(&self, slot: usize, log2: u32) -> Bound {
        let node = slot / LOWER_LEN * BLOCKS_PER_NODE;
        let block = FIRST[log2 as usize] + block_of(slot % LOWER_LEN, log2);
        // Without bounds, all blocks are empty.
        self.bounds
            .get(node + block)
            .copied()
            .unwrap_or(Bound::EMPTY)
    }

    /// Returns the bytes that the blocks occupy.
    pub fn memory_bytes(&self) -> usize {
        size_of_val(&self.log2[..]) + size_of_val(&self.bounds[..])
    }
}

/// Chooses the blocks of one node: for each slot the size of its block, and all blocks' bounds.
fn choose(cells: &[Cell], depth_per_density: f32) -> (Vec<u8>, Vec<Bound>) {
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
    let mut log2_of = vec![0; LOWER_LEN];
    let mut bounds = vec![Bound::EMPTY; BLOCKS_PER_NODE];
    let mut costs: Vec<f32> = cells.iter().map(|c| 1.0 + collisions(c.bound, 0)).collect();
    let mut parts: Vec<Bound> = cells.iter().map(|c| c.bound).collect();
    for log2 in 1..=LOWER_LOG2 {
        let edge = 1_usize << (LOWER_LOG2 - log2);
        let mut chosen = Vec::with_capacity(edge * edge * edge);
        let mut next = (Vec::new(), Vec::new());
        for block in 0..edge * edge * edge {
            let (x, y, z) = (block / (edge * edge), block / edge % edge, block % edge);
            let part = |i: usize| {
                let (x, y, z) = (2 * x + (i >> 2), 2 * y + (i >> 1 & 1), 2 * z + (i & 1));
                (x * 2 * edge + y) * 2 * edge + z
            };
            let mut bound = parts[part(0)];
            bound.mean = 0.0;
            let mut split = 0.0;
            for i in 0..8 {
                let p = parts[part(i)];
                bound.min = bound.min.min(p.min);
                bound.max = bound.max.max(p.max);
                bound.mean += p.mean / 8.0;
                split += costs[part(i)] / 4.0;
            }
            bound.mean = bound.mean.clamp(bound.min, bound.max);
            let merged = LEAP_COST + collisions(bound, log2);
            chosen.push(merged < split);
            next.0.push(merged.min(split));
            next.1.push(bound);
        }
        for (slot, of) in log2_of.iter_mut().enumerate() {
            if chosen[block_of(slot, log2)] {
                #[expect(clippy::cast_possible_truncation, reason = "at most 4")]
                let log2 = log2 as u8;
                *of = log2;
            }
        }
        bounds[FIRST[log2 as usize]..][..next.1.len()].copy_from_slice(&next.1);
        (costs, parts) = next;
    }
    (log2_of, bounds)
}

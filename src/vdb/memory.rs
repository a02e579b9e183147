//! How much memory a grid will take, known before anything is decoded.
//!
//! The walk has counted every node. Loading allocates what is listed here and, while it runs,
//! a few megabytes a thread for shares in flight; nothing else grows with the file.

use super::topology::Topology;
use crate::grid::brick::{BRICK_LEN, BrickMask};
use crate::grid::tree::{LOWER_LEN, UPPER_LEN};

/// Bytes of a slot in an upper or lower node.
const SLOT: u64 = 4;
/// Minimum, maximum and mean that rendering adds to each slot and brick.
const BOUND: u64 = 12;
/// A node's or brick's origin.
const ORIGIN: u64 = 12;
/// A tile value and its entry in the table that recognises equal ones.
const TILE: u64 = 96;
/// Shares in flight: stream, decoded values and the decoder's own copies, 4 times 2 MiB.
const SHARE: u64 = 8 << 20;

/// Estimates the peak memory of loading a tree whose values take `value_size` bytes each.
pub(super) fn estimate(topology: &Topology, value_size: usize) -> u64 {
    let brick = (BRICK_LEN * value_size + size_of::<BrickMask>()) as u64 + ORIGIN + BOUND;
    let node = |slots: usize| slots as u64 * (SLOT + BOUND) + ORIGIN;
    let parts = [
        (topology.leaves.len(), brick),
        (topology.uppers.len(), node(UPPER_LEN)),
        (topology.lowers.len(), node(LOWER_LEN)),
    ];
    let tiles = topology.active_tile_count.saturating_mul(TILE);
    let bricks = (topology.leaves.len() as u64).saturating_mul(brick);
    let shares = (SHARE * rayon::current_num_threads() as u64).min(bricks.saturating_mul(4));
    parts
        .iter()
        .fold(tiles.saturating_add(shares), |sum, &(n, bytes)| {
            sum.saturating_add((n as u64).saturating_mul(bytes))
        })
}

/// Returns what is too numerous for the tree's 31-bit indices, if anything is.
pub(super) fn too_many_nodes(topology: &Topology) -> Option<String> {
    // Each node adds at most two inactive values that are not in its chunk.
    let nodes = (topology.uppers.len() + topology.lowers.len()) as u64;
    let tiles = topology.stored_tile_count + 2 * nodes;
    let most = tiles.max(topology.leaves.len() as u64);
    (most >= 1 << 31)
        .then(|| format!("the grid has {most} bricks or tiles, expected less than 2^31"))
}

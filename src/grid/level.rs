//! Cells larger than bricks, for rays to walk.
//!
//! Where a field is stored finely and light hardly collides within a brick, nearly all of a walk is over
//! blocks of the same few sizes. Cells of 16³, 32³ or 64³ voxels then do what bricks do on a coarser
//! grid: a step over one costs half of a leap over a block, their bounds are a fraction of the
//! memory, and fewer nodes are entered. The cloud of `benches/growth.rs` at 1024³ voxels takes 0.85 to 0.94
//! of the time with cells of 32³.
//!
//! Only what a walk asks for is here, bounds: values are looked up in bricks.

use glam::IVec3;

use super::bounds::{Bound, union};
use super::cells::Cell;
use super::directory::{Content, Directory, Node};
use super::tree::{LOWER_LEN, LOWER_LOG2, Slot};

/// Cells of one size, in nodes of 16³.
#[derive(Clone, Debug)]
pub(super) struct Level {
    /// Base-2 logarithm of the edge of a cell in voxels.
    pub(super) cell_log2: u32,
    /// First and last cell of a box around all that is not empty.
    pub(super) occupied: Option<(IVec3, IVec3)>,
    /// The cells of all nodes that are not empty, by their place in them. Slots say nothing.
    pub(super) cells: Vec<Cell>,
    /// All nodes of the box.
    pub(super) directory: Directory,
}

impl Level {
    /// Puts eight cells each of a table together, whose edge is `2^(cell_log2 − 1)` voxels.
    ///
    /// # Cost
    /// A look at each cell.
    pub(super) fn doubled(
        cells: &[Cell],
        directory: &Directory,
        (first, last): (IVec3, IVec3),
        cell_log2: u32,
    ) -> Self {
        let (first, last) = (first >> 1, last >> 1);
        let (first_node, last_node) = (first >> LOWER_LOG2, last >> LOWER_LOG2);
        let mut doubled = Vec::new();
        let directory = Directory::of((first_node, last_node), |key| {
            let base = doubled.len();
            // Along the curve, the cells of an eighth of the node follow each other.
            let eighths = [0, 1, 2, 3, 4, 5, 6, 7].map(|i: i32| {
                let part = IVec3::new(i >> 2, i >> 1 & 1, i & 1);
                directory.stored(key * 2 + part)
            });
            let bounds = eighths.map(|node| node.map_or(Bound::EMPTY, |node| node.bound));
            let is_lower = |node: &Node| matches!(node.content, Content::Lower(_));
            let content = if eighths.iter().flatten().any(is_lower) {
                for (node, bound) in eighths.into_iter().zip(bounds) {
                    add_eighth(&mut doubled, cells, node, bound);
                }
                Content::Lower(base)
            } else {
                // As a whole, so that there are never more nodes with cells than before: a tile may be
                // 4096³ voxels large.
                Content::Tile {
                    value: 0.0,
                    log2: LOWER_LOG2,
                }
            };
            Node {
                bound: union(&bounds),
                content,
            }
        });
        Self {
            cell_log2,
            occupied: Some((first, last)),
            cells: doubled,
            directory,
        }
    }

    /// Returns the bytes that cells and nodes occupy.
    pub(super) fn memory_bytes(&self) -> usize {
        size_of_val(&self.cells[..]) + self.directory.memory_bytes()
    }
}

/// Adds the doubled cells of a node of this bound; one outside of its table is empty.
fn add_eighth(doubled: &mut Vec<Cell>, cells: &[Cell], node: Option<Node>, bound: Bound) {
    let cell = |bound| Cell {
        bound,
        slot: Slot::BACKGROUND,
    };
    if let Some(Node {
        content: Content::Lower(base),
        ..
    }) = node
    {
        let eights = cells[base..base + LOWER_LEN].as_chunks::<8>().0;
        doubled.extend(eights.iter().map(|of| cell(union(&of.map(|c| c.bound)))));
    } else {
        doubled.extend([cell(bound); LOWER_LEN / 8]);
    }
}

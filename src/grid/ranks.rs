//! Which brick a cell is, in a sixty-fourth of the memory of the cells.
//!
//! Bricks are stored in the order of their cells, so counting those before a cell gives its brick. A
//! lookup in a block of cells has read no cell on its way: at 1024³ voxels, whose cells take 27 MB, it
//! waited for one, and then for the value. These take 0.4 MB, which a second cache holds: 0.95 of the
//! time of a sample.

use glam::IVec3;

use super::brick::BRICK_LOG2;
use super::tree::{LOWER_LEN, LOWER_LOG2, Slot};

/// Cells in a group.
const GROUP: usize = 64;

/// 64 cells that follow each other in a lower node, z fastest.
#[derive(Clone, Copy, Debug)]
struct Group {
    /// A bit for each cell that is a brick, the first cell's lowest.
    bricks: u64,
    /// The brick of the first of them.
    first: u32,
}

/// The bricks of all lower nodes.
#[derive(Clone, Debug)]
pub(super) struct Ranks {
    groups: Vec<Group>,
}

impl Ranks {
    /// Counts bricks. Those of a group from the first on that is out of order are left out.
    pub(super) fn new(slots: &[Slot]) -> Self {
        let group = |slots: &[Slot; GROUP]| {
            let bricks = slots.iter().enumerate();
            let mut bricks = bricks
                .filter_map(|(i, slot)| Some((i, slot.get().ok()?)))
                .peekable();
            let first = bricks.peek().map_or(0, |&(_, brick)| brick);
            let in_order = bricks.zip(first..).take_while(|((_, b), next)| b == next);
            Group {
                bricks: in_order.fold(0, |bits, ((i, _), _)| bits | 1 << i),
                first: u32::try_from(first).expect("a slot has 31 bits"),
            }
        };
        Self {
            groups: slots.as_chunks::<GROUP>().0.iter().map(group).collect(),
        }
    }

    /// Returns the brick that holds voxel `p`, of the node that holds `cell`; `None` if there is none
    /// or it is out of order.
    #[inline] // bench: frame
    pub(super) fn brick(&self, cell: usize, p: IVec3) -> Option<usize> {
        let c = (p >> BRICK_LOG2).as_uvec3() & ((1 << LOWER_LOG2) - 1);
        let slot = ((c.x << LOWER_LOG2 | c.y) << LOWER_LOG2 | c.z) as usize;
        let group = self.groups[(cell & !(LOWER_LEN - 1) | slot) / GROUP];
        let bit = 1 << (slot % GROUP);
        let before = (group.bricks & (bit - 1)).count_ones();
        (group.bricks & bit != 0).then(|| (group.first + before) as usize)
    }

    /// Returns the bytes that the groups occupy.
    pub(super) fn memory_bytes(&self) -> usize {
        size_of_val(&self.groups[..])
    }
}

#[cfg(test)]
mod tests {
    use super::super::curve;
    use super::super::tree::Tree;
    use super::*;

    /// Compares ranks with slots; returns how many bricks they know.
    fn known(slots: &[Slot]) -> usize {
        let ranks = Ranks::new(slots);
        let order = curve::slots();
        let cells = 0..slots.len();
        let is_known = cells.filter(|&cell| {
            let (node, place) = (cell / LOWER_LEN * LOWER_LEN, cell % LOWER_LEN);
            let voxel = ((curve::cell_at(place) - 32) << BRICK_LOG2) + 5;
            let brick = ranks.brick(cell, voxel);
            let slot = slots[node + order[place]].get();
            assert!(
                brick.is_none() || slot == brick.ok_or(0),
                "cell {cell}: {slot:?}"
            );
            brick.is_some()
        });
        is_known.count()
    }

    #[test]
    fn ranks_are_slots() {
        // Several nodes, groups of no brick and of many.
        let at = |i: i32| IVec3::new(i * i % 271, i * 7 % 60, i * 13 % 203) - 40;
        let mut voxels: Vec<IVec3> = (0..3000).map(at).collect();
        // As files have them.
        voxels.sort_by_key(|&p| [p >> 7, p >> BRICK_LOG2].map(|p| p.to_array()));
        let mut tree = Tree::from_voxels(0.0, voxels.into_iter().map(|p| (p, 1.0)));
        let slots = tree.take_lower();
        let bricks = slots.iter().filter(|slot| slot.get().is_ok()).count();
        assert!(bricks > 500 && slots.len() > 4 * LOWER_LEN);
        assert_eq!(known(&slots), bricks, "a tree's bricks are in order");
        let mut reversed = slots;
        for group in reversed.chunks_exact_mut(GROUP) {
            group.reverse();
        }
        let first_ones = known(&reversed);
        assert!(
            first_ones > 0 && first_ones < bricks,
            "{first_ones} of {bricks}"
        );
    }
}

//! The checked walk over one grid's tree: which nodes exist and where their values lie.
//!
//! ```text
//! topology  1 u32 │ background │ tiles n u32 │ children n u32 │ tiles … │ children …
//!   tile    origin 3 i32 │ value │ active u8
//!   child   origin 3 i32 │ upper node
//!   upper   child mask 4096 B │ value mask 4096 B │ record │ a lower node for each child bit
//!   lower   child mask  512 B │ value mask  512 B │ record │ a value mask for each child bit
//! buffers   for each leaf in the same order: value mask 64 B │ record
//! ```
//!
//! Masks are believed only where they agree with each other. Active counts and the bounding
//! box come from here, never from metadata. Memory is a few dozen bytes a node, each of which
//! takes more than that in the file.

use std::collections::HashSet;

use glam::{IVec3, UVec3};

use super::cursor::Cursor;
use super::error::Damage;
use super::record::{Encoding, Record, count_ones, words};
use crate::grid::brick::{BRICK_DIM, BrickMask};
use crate::grid::tree::{LOWER_LOG2, LOWER_TOTAL_LOG2, UPPER_LOG2, UPPER_TOTAL_LOG2};

/// Bytes of a node's mask.
pub(super) const UPPER_MASK: usize = 1 << (3 * UPPER_LOG2 - 3);
pub(super) const LOWER_MASK: usize = 1 << (3 * LOWER_LOG2 - 3);
pub(super) const LEAF_MASK: usize = size_of::<BrickMask>();

/// A tile of the root: one value for 4096³ voxels.
#[derive(Clone, Copy, Debug)]
pub(super) struct RootTile<'a> {
    pub(super) origin: IVec3,
    pub(super) value: &'a [u8],
    pub(super) active: bool,
}

/// A node and the position of what is stored about it: for upper and lower nodes the child
/// mask, for leaves the value mask in front of the record.
#[derive(Clone, Copy, Debug)]
pub(super) struct NodeAt {
    pub(super) origin: IVec3,
    pub(super) at: usize,
}

/// What the walk found.
#[derive(Clone, Debug, Default)]
pub(super) struct Topology {
    /// Position of the background value.
    pub(super) background_at: usize,
    /// Position of the first root tile.
    tiles_at: usize,
    root_tile_count: usize,
    pub(super) uppers: Vec<NodeAt>,
    pub(super) lowers: Vec<NodeAt>,
    /// In file order, which is also the order of bricks.
    pub(super) leaves: Vec<NodeAt>,
    pub(super) active_voxel_count: u64,
    /// Active tiles of all levels.
    pub(super) active_tile_count: u64,
    /// Tile values that are spelled out in upper and lower nodes.
    pub(super) stored_tile_count: u64,
    pub(super) active_box: Option<(IVec3, IVec3)>,
}

/// An upper or lower node's masks and values.
pub(super) struct Node<'a> {
    pub(super) child_mask: &'a [u8],
    pub(super) record: Record<'a>,
}

impl<'a> Node<'a> {
    /// Reads the node at the cursor, whose masks have `mask_len` bytes each.
    pub(super) fn read(
        c: &mut Cursor<'a>,
        encoding: Encoding,
        mask_len: usize,
    ) -> Result<Self, Damage> {
        let child_mask = c.take(mask_len, "a node's child mask")?;
        let value_mask = c.take(mask_len, "a node's value mask")?;
        let record = Record::read(c, encoding, value_mask)?;
        Ok(Self { child_mask, record })
    }
}

/// Reads the leaf at the cursor.
pub(super) fn read_leaf<'a>(c: &mut Cursor<'a>, encoding: Encoding) -> Result<Record<'a>, Damage> {
    let value_mask = c.take(LEAF_MASK, "a leaf's value mask")?;
    Record::read(c, encoding, value_mask)
}

/// Returns the indices of the bits that are set.
pub(super) fn ones(mask: &[u8]) -> impl Iterator<Item = usize> + '_ {
    words(mask).enumerate().flat_map(|(w, mut bits)| {
        std::iter::from_fn(move || {
            let low = bits.trailing_zeros() as usize;
            // Clears the lowest bit; stays 0 at the end.
            bits &= bits.wrapping_sub(1);
            (low < 64).then_some(w * 64 + low)
        })
    })
}

/// Returns the lowest voxel of slot `slot`, relative to its node: less than 4096 on each axis.
#[expect(
    clippy::cast_possible_truncation,
    reason = "twelve bits are left after the mask"
)]
pub(super) fn slot_origin(slot: usize, node_log2: u32, cell_log2: u32) -> IVec3 {
    let side = (1 << node_log2) - 1;
    let axis = |shift: u32| ((slot >> shift & side) << cell_log2) as u32;
    UVec3::new(axis(2 * node_log2), axis(node_log2), axis(0)).as_ivec3()
}

impl Topology {
    /// Walks the topology at the cursor and leaves the cursor behind it.
    ///
    /// [`Topology::walk_buffers`] has to follow before the leaves' positions are right.
    pub(super) fn walk(c: &mut Cursor<'_>, encoding: Encoding) -> Result<Self, Damage> {
        let start = c.at();
        let buffer_count = c.u32("a tree's buffer count")?;
        if buffer_count != 1 {
            let what = format!("a tree has {buffer_count} buffers, expected 1");
            return Err(Damage::new(start, what));
        }
        let mut walked = Self {
            background_at: c.at(),
            ..Self::default()
        };
        c.take(encoding.value.size(), "a background value")?;
        walked.root_tile_count = c.len32("the number of root tiles")?;
        let child_count = c.len32("the number of root children")?;
        walked.tiles_at = c.at();
        let mut cells = HashSet::new();
        for _ in 0..walked.root_tile_count {
            let at = c.at();
            let tile = read_root_tile(c, encoding)?;
            check_root_cell(&mut cells, at, tile.origin)?;
            if tile.active {
                walked.activate(tile.origin, UPPER_TOTAL_LOG2);
            }
        }
        for _ in 0..child_count {
            let at = c.at();
            let origin = c.ivec3("a root child's origin")?;
            check_root_cell(&mut cells, at, origin)?;
            walked.walk_upper(c, encoding, origin)?;
        }
        Ok(walked)
    }

    fn walk_upper(
        &mut self,
        c: &mut Cursor<'_>,
        encoding: Encoding,
        origin: IVec3,
    ) -> Result<(), Damage> {
        self.uppers.push(NodeAt { origin, at: c.at() });
        let at = c.at();
        let node = Node::read(c, encoding, UPPER_MASK)?;
        self.walk_tiles(at, &node, origin, UPPER_LOG2, LOWER_TOTAL_LOG2)?;
        for slot in ones(node.child_mask) {
            let origin = origin + slot_origin(slot, UPPER_LOG2, LOWER_TOTAL_LOG2);
            self.walk_lower(c, encoding, origin)?;
        }
        Ok(())
    }

    fn walk_lower(
        &mut self,
        c: &mut Cursor<'_>,
        encoding: Encoding,
        origin: IVec3,
    ) -> Result<(), Damage> {
        self.lowers.push(NodeAt { origin, at: c.at() });
        let at = c.at();
        let node = Node::read(c, encoding, LOWER_MASK)?;
        self.walk_tiles(at, &node, origin, LOWER_LOG2, BRICK_DIM.ilog2())?;
        for slot in ones(node.child_mask) {
            let at = c.at();
            let origin = origin + slot_origin(slot, LOWER_LOG2, BRICK_DIM.ilog2());
            let mask = c.take(LEAF_MASK, "a leaf's value mask")?;
            self.activate_voxels(origin, mask);
            self.leaves.push(NodeAt { origin, at });
        }
        Ok(())
    }

    fn walk_tiles(
        &mut self,
        at: usize,
        node: &Node<'_>,
        origin: IVec3,
        node_log2: u32,
        cell_log2: u32,
    ) -> Result<(), Damage> {
        let value_mask = node.record.value_mask;
        if words(node.child_mask)
            .zip(words(value_mask))
            .any(|(a, b)| a & b != 0)
        {
            let what = "a node's cell is both a child and an active tile";
            return Err(Damage::new(at, what));
        }
        self.stored_tile_count += node.record.count as u64;
        for slot in ones(value_mask) {
            self.activate(origin + slot_origin(slot, node_log2, cell_log2), cell_log2);
        }
        Ok(())
    }

    /// Walks the leaves' values and replaces each leaf's position by that of its values.
    pub(super) fn walk_buffers(
        &mut self,
        c: &mut Cursor<'_>,
        encoding: Encoding,
    ) -> Result<(), Damage> {
        for leaf in &mut self.leaves {
            let at = c.at();
            let record = read_leaf(c, encoding)?;
            if c.bytes().get(leaf.at..leaf.at + LEAF_MASK) != Some(record.value_mask) {
                let IVec3 { x, y, z } = leaf.origin;
                let what = format!(
                    "the leaf at [{x}, {y}, {z}] has another value mask than in the topology"
                );
                return Err(Damage::new(at, what));
            }
            leaf.at = at;
        }
        Ok(())
    }

    /// Returns the tiles of the root.
    pub(super) fn root_tiles<'a>(
        &self,
        bytes: &'a [u8],
        encoding: Encoding,
    ) -> impl Iterator<Item = Result<RootTile<'a>, Damage>> {
        let mut c = Cursor::new(bytes, self.tiles_at);
        (0..self.root_tile_count).map(move |_| read_root_tile(&mut c, encoding))
    }

    /// Counts a whole cell as active.
    fn activate(&mut self, origin: IVec3, cell_log2: u32) {
        self.active_tile_count += 1;
        // Saturates only for crafted files: the whole index space has 2^96 voxels.
        self.active_voxel_count = self.active_voxel_count.saturating_add(1 << (3 * cell_log2));
        self.enclose(origin, origin + ((1 << cell_log2) - 1));
    }

    /// Counts the voxels of a leaf whose bits are set, `x << 6 | y << 3 | z`.
    fn activate_voxels(&mut self, origin: IVec3, mask: &[u8]) {
        let count = count_ones(mask) as u64;
        self.active_voxel_count = self.active_voxel_count.saturating_add(count);
        // Most leaves lie inside the box already.
        if let Some((min, max)) = self.active_box
            && origin.cmpge(min).all()
            && (origin + (BRICK_DIM - 1)).cmple(max).all()
        {
            return;
        }
        for bit in ones(mask) {
            let p = origin + slot_origin(bit, BRICK_DIM.ilog2(), 0);
            self.enclose(p, p);
        }
    }

    fn enclose(&mut self, low: IVec3, high: IVec3) {
        let (min, max) = self.active_box.unwrap_or((low, high));
        self.active_box = Some((min.min(low), max.max(high)));
    }
}

fn read_root_tile<'a>(c: &mut Cursor<'a>, encoding: Encoding) -> Result<RootTile<'a>, Damage> {
    let origin = c.ivec3("a root tile's origin")?;
    let value = c.take(encoding.value.size(), "a root tile's value")?;
    let [active] = c.pod::<[u8; 1]>("a root tile's state")?;
    Ok(RootTile {
        origin,
        value,
        active: active != 0,
    })
}

/// Refuses cells off the 4096³ lattice, where coordinates could overflow, and repeated ones.
fn check_root_cell(cells: &mut HashSet<IVec3>, at: usize, origin: IVec3) -> Result<(), Damage> {
    let IVec3 { x, y, z } = origin;
    if origin & ((1 << UPPER_TOTAL_LOG2) - 1) != IVec3::ZERO {
        let what = format!("a root cell begins at [{x}, {y}, {z}], expected multiples of 4096");
        return Err(Damage::new(at, what));
    }
    if !cells.insert(origin) {
        let what = format!("the root cell at [{x}, {y}, {z}] occurs twice");
        return Err(Damage::new(at, what));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bits_come_in_order() {
        let mut mask = [0_u8; 64];
        mask[0] = 0b1000_0001;
        mask[63] = 0x80;
        assert_eq!(ones(&mask).collect::<Vec<_>>(), [0, 7, 511]);
        assert_eq!(slot_origin(511, 3, 0), IVec3::splat(7));
        assert_eq!(slot_origin(1 << 10 | 2, 5, 7), IVec3::new(128, 0, 256));
    }

    #[test]
    fn root_cells_are_aligned_and_unique() {
        let mut cells = HashSet::new();
        let lowest = IVec3::splat(i32::MIN);
        assert!(check_root_cell(&mut cells, 0, lowest).is_ok(), "aligned");
        assert!(check_root_cell(&mut cells, 0, lowest).is_err(), "twice");
        assert!(
            check_root_cell(&mut cells, 0, IVec3::new(0, 8, 0)).is_err(),
            "off the lattice"
        );
    }
}

//! Root → upper → lower → brick: four levels in flat arrays, and the builder.
//!
//! ```text
//! root    sorted list of cells of 4096³ voxels      (origin, slot), found by binary search
//! upper   32³ slots of 128³ voxels each             slot index  x << 10 | y << 5 | z
//! lower   16³ slots of 8³ voxels each               slot index  x <<  8 | y << 4 | z
//! brick   8³ values                                 see `brick`
//!
//! slot, 4 bytes      31   30 … 0
//!                  ┌────┬────────┐
//!                  │ 0  │ child  │  index of the node or brick one level down
//!                  │ 1  │ tile   │  index into `tiles`: one value for the whole cell
//!                  └────┴────────┘
//! ```
//!
//! Arrays refer to each other by index only, so the whole is position independent: it can be
//! moved, copied or mapped without fixing anything up. Equal tiles are stored once; tile 0 is
//! the inactive background. What is not stored reads as background.
//!
//! The tree holds exactly what the file held: inactive voxels keep their value, tiles stay
//! tiles. Only the halo of `bounds` changes its shape, and never a value.

use std::collections::{BTreeSet, HashMap};

use glam::IVec3;

use super::brick::{self, BRICK_LEN, BRICK_LOG2, BrickMask, Voxel};

/// Base-2 logarithm of the slots along an edge of a lower node.
pub const LOWER_LOG2: u32 = 4;
/// Base-2 logarithm of the slots along an edge of an upper node.
pub const UPPER_LOG2: u32 = 5;
/// Slots in a lower node.
pub const LOWER_LEN: usize = 1 << (3 * LOWER_LOG2);
/// Slots in an upper node.
pub const UPPER_LEN: usize = 1 << (3 * UPPER_LOG2);
/// Base-2 logarithm of the voxels along an edge of a lower node: 7.
pub const LOWER_TOTAL_LOG2: u32 = BRICK_LOG2 + LOWER_LOG2;
/// Base-2 logarithm of the voxels along an edge of an upper node: 12.
pub const UPPER_TOTAL_LOG2: u32 = LOWER_TOTAL_LOG2 + UPPER_LOG2;

const _: () = assert!(size_of::<Slot>() == 4, "as drawn");
const _: () = assert!(
    LOWER_TOTAL_LOG2 == 7 && UPPER_TOTAL_LOG2 == 12,
    "OpenVDB's 5-4-3"
);
const _: () = assert!(LOWER_LEN == 4096 && UPPER_LEN == 32768, "as drawn");

/// What a cell of a node holds: a child or a tile.
#[derive(Clone, Copy, PartialEq, Eq, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(transparent)]
pub struct Slot(u32);

impl Slot {
    const TILE_BIT: u32 = 1 << 31;
    /// The inactive background tile.
    pub const BACKGROUND: Self = Self(Self::TILE_BIT);

    fn child(index: usize) -> Self {
        let index = u32::try_from(index).expect("the loader refuses grids of 2^31 nodes");
        assert!(
            index < Self::TILE_BIT,
            "the loader refuses grids of 2^31 nodes"
        );
        Self(index)
    }

    fn tile(index: usize) -> Self {
        Self(Self::child(index).0 | Self::TILE_BIT)
    }

    /// Returns the index of the child, or else of the tile.
    ///
    /// # Errors
    /// None in the sense of a failure: the index of the tile comes as `Err`.
    #[inline] // bench: lookup
    pub fn get(self) -> Result<usize, usize> {
        let index = (self.0 & !Self::TILE_BIT) as usize;
        if self.0 & Self::TILE_BIT == 0 {
            Ok(index)
        } else {
            Err(index)
        }
    }
}

impl std::fmt::Debug for Slot {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self.get() {
            Ok(child) => write!(f, "child {child}"),
            Err(tile) => write!(f, "tile {tile}"),
        }
    }
}

/// One value for a whole cell.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tile<V> {
    /// The value of every voxel in the cell.
    pub value: V,
    /// Whether those voxels are active.
    pub active: bool,
}

/// One cell of 4096³ voxels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RootCell {
    /// Lowest voxel, a multiple of 4096 on each axis.
    pub origin: IVec3,
    /// An upper node or a tile.
    pub slot: Slot,
}

/// A sparse grid of voxel values in index space.
#[derive(Clone, Debug)]
pub struct Tree<V> {
    pub(super) root: Vec<RootCell>,
    /// `UPPER_LEN` slots for each upper node.
    pub(super) upper: Vec<Slot>,
    /// `LOWER_LEN` slots for each lower node.
    pub(super) lower: Vec<Slot>,
    pub(super) tiles: Vec<Tile<V>>,
    /// `BRICK_LEN` values for each brick.
    pub(super) values: Vec<V>,
    /// One mask for each brick, or none at all once dropped.
    active: Vec<BrickMask>,
    pub(super) upper_origins: Vec<IVec3>,
    pub(super) lower_origins: Vec<IVec3>,
    pub(super) brick_origins: Vec<IVec3>,
}

/// Returns the slot of voxel `p` within its upper node.
#[inline] // bench: lookup
pub(super) fn upper_slot(p: IVec3) -> usize {
    let q = (p >> LOWER_TOTAL_LOG2) & ((1 << UPPER_LOG2) - 1);
    ((q.x << (2 * UPPER_LOG2)) | (q.y << UPPER_LOG2) | q.z).cast_unsigned() as usize
}

/// Returns the slot of voxel `p` within its lower node.
#[inline] // bench: lookup
pub(super) fn lower_slot(p: IVec3) -> usize {
    let q = (p >> BRICK_LOG2) & ((1 << LOWER_LOG2) - 1);
    ((q.x << (2 * LOWER_LOG2)) | (q.y << LOWER_LOG2) | q.z).cast_unsigned() as usize
}

/// Returns the lowest voxel of the cell at `slot`, relative to its node's origin.
pub(super) fn slot_origin(slot: usize, node_log2: u32, cell_log2: u32) -> IVec3 {
    let mask = (1 << node_log2) - 1;
    let s = i32::try_from(slot).expect("a slot is below 2^15");
    IVec3::new(s >> (2 * node_log2), s >> node_log2 & mask, s & mask) << cell_log2
}

pub(super) fn root_origin(p: IVec3) -> IVec3 {
    p & !((1 << UPPER_TOTAL_LOG2) - 1)
}

fn root_key(origin: IVec3) -> (i32, i32, i32) {
    (origin.x, origin.y, origin.z)
}

impl<V: Voxel> Tree<V> {
    /// Returns the value of everything that is not stored.
    pub fn background(&self) -> V {
        self.tiles[0].value
    }

    /// Returns the index of the root cell at `origin`, if it is listed.
    pub(super) fn root_index(&self, origin: IVec3) -> Option<usize> {
        self.root
            .binary_search_by_key(&root_key(origin), |c| root_key(c.origin))
            .ok()
    }

    /// Returns the slot of the root cell that holds `p`.
    pub(super) fn root_slot(&self, p: IVec3) -> Slot {
        self.root_index(root_origin(p))
            .map_or(Slot::BACKGROUND, |i| self.root[i].slot)
    }

    /// Returns the stored value and active state of voxel `p`.
    ///
    /// # Cost
    /// A binary search and up to three dependent loads; use a sampler in loops.
    pub fn probe(&self, p: IVec3) -> Tile<V> {
        let leaf = self.root_slot(p).get();
        let leaf = leaf.and_then(|u| self.upper[u * UPPER_LEN + upper_slot(p)].get());
        let leaf = leaf.and_then(|l| self.lower[l * LOWER_LEN + lower_slot(p)].get());
        match leaf {
            Err(tile) => self.tiles[tile],
            Ok(b) => {
                let o = brick::offset(p);
                let active = self
                    .active
                    .get(b)
                    .is_some_and(|m| m[o >> 6] >> (o & 63) & 1 == 1);
                Tile {
                    value: self.values[b * BRICK_LEN + o],
                    active,
                }
            }
        }
    }

    /// Returns the number of bricks.
    pub fn brick_count(&self) -> usize {
        self.brick_origins.len()
    }

    /// Returns the values of brick `index`, `[x][y][z]`, z fastest.
    pub fn brick(&self, index: usize) -> &[V] {
        &self.values[index * BRICK_LEN..][..BRICK_LEN]
    }

    /// Returns the lowest voxel of each brick.
    pub fn brick_origins(&self) -> &[IVec3] {
        &self.brick_origins
    }

    /// Returns the active mask of each brick; empty after [`Tree::drop_active_masks`].
    pub fn active_masks(&self) -> &[BrickMask] {
        &self.active
    }

    /// Returns all tiles that are not the inactive background: origin, edge in voxels, tile.
    pub fn stored_tiles(&self) -> impl Iterator<Item = (IVec3, i32, Tile<V>)> + '_ {
        let of = |slot: Slot| slot.get().err().filter(|&t| t != 0).map(|t| self.tiles[t]);
        let root = self
            .root
            .iter()
            .filter_map(move |c| of(c.slot).map(|t| (c.origin, 1 << UPPER_TOTAL_LOG2, t)));
        let nodes =
            move |slots: &'_ [Slot], origins: &'_ [IVec3], node_log2: u32, cell_log2: u32| {
                let len = 1_usize << (3 * node_log2);
                let (slots, origins) = (slots.to_vec(), origins.to_vec());
                (0..slots.len()).filter_map(move |i| {
                    let tile = of(slots[i])?;
                    let o = origins[i / len] + slot_origin(i % len, node_log2, cell_log2);
                    Some((o, 1 << cell_log2, tile))
                })
            };
        root.chain(nodes(
            &self.upper,
            &self.upper_origins,
            UPPER_LOG2,
            LOWER_TOTAL_LOG2,
        ))
        .chain(nodes(
            &self.lower,
            &self.lower_origins,
            LOWER_LOG2,
            BRICK_LOG2,
        ))
    }

    /// Puts nodes together that were taken apart; where upper nodes and bricks lie stays unknown.
    pub(super) fn from_nodes(
        root: Vec<RootCell>,
        upper: Vec<Slot>,
        lower: Vec<Slot>,
        tiles: Vec<Tile<V>>,
        lower_origins: Vec<IVec3>,
    ) -> Self {
        Self {
            root,
            upper,
            lower,
            tiles,
            values: Vec::new(),
            active: Vec::new(),
            upper_origins: Vec::new(),
            lower_origins,
            brick_origins: Vec::new(),
        }
    }

    /// Takes the values of all bricks out of the tree.
    pub fn take_values(&mut self) -> Vec<V> {
        std::mem::take(&mut self.values)
    }

    /// Gives brick `order[i]` the index i, for all i; values must have been taken out.
    ///
    /// # Panics
    /// If `order` is no permutation of the bricks.
    pub(crate) fn renumber_bricks(&mut self, order: &[usize]) {
        assert!(self.values.is_empty(), "values would stay behind");
        let mut index_of = vec![usize::MAX; self.brick_origins.len()];
        for (new, &old) in order.iter().enumerate() {
            index_of[old] = new;
        }
        for slot in &mut self.lower {
            if let Ok(old) = slot.get() {
                *slot = Slot::child(index_of[old]);
            }
        }
        self.brick_origins = order.iter().map(|&old| self.brick_origins[old]).collect();
        self.active = Vec::new();
    }

    /// Forgets which voxels are active: rendering reads values only.
    pub fn drop_active_masks(&mut self) {
        self.active = Vec::new();
    }

    /// Takes the slots of the lower nodes.
    pub(super) fn take_lower(&mut self) -> Vec<Slot> {
        std::mem::take(&mut self.lower)
    }

    /// Forgets where each brick lies, which slots know.
    pub(super) fn drop_origins(&mut self) {
        self.brick_origins = Vec::new();
    }

    /// Makes what is not stored, and what is stored as tiles of the same value and inactive, read as
    /// `value`.
    pub fn set_background(&mut self, value: V) {
        if let Some(tile) = self.tiles.first_mut() {
            tile.value = value;
        }
    }

    /// Forgets everything above lower nodes: all that is asked of the tree reads as background.
    pub(super) fn drop_upper(&mut self) {
        self.root = Vec::new();
        self.upper = Vec::new();
        self.upper_origins = Vec::new();
    }

    /// Returns the bytes that the arrays occupy.
    pub fn memory_bytes(&self) -> usize {
        let Self {
            root,
            upper,
            lower,
            tiles,
            values,
            active,
            ..
        } = self;
        let origins = &[
            &self.upper_origins,
            &self.lower_origins,
            &self.brick_origins,
        ];
        size_of_val(&root[..])
            + size_of_val(&upper[..])
            + size_of_val(&lower[..])
            + size_of_val(&tiles[..])
            + size_of_val(&values[..])
            + size_of_val(&active[..])
            + origins.iter().map(|o| size_of_val(&o[..])).sum::<usize>()
    }
}

/// Builds a [`Tree`] top down: nodes and tiles first, brick values last.
#[derive(Debug)]
pub struct TreeBuilder<V: Voxel> {
    tree: Tree<V>,
    root_index: HashMap<IVec3, usize>,
    tile_index: HashMap<(V::Bits, bool), usize>,
}

impl<V: Voxel> TreeBuilder<V> {
    /// Starts a tree in which everything reads as `background`, inactive.
    pub fn new(background: V) -> Self {
        Self {
            tree: Tree {
                root: Vec::new(),
                upper: Vec::new(),
                lower: Vec::new(),
                tiles: vec![Tile {
                    value: background,
                    active: false,
                }],
                values: Vec::new(),
                active: Vec::new(),
                upper_origins: Vec::new(),
                lower_origins: Vec::new(),
                brick_origins: Vec::new(),
            },
            root_index: HashMap::new(),
            tile_index: HashMap::from([((background.bits(), false), 0)]),
        }
    }

    fn tile(&mut self, value: V, active: bool) -> Slot {
        let Self {
            tree, tile_index, ..
        } = self;
        Slot::tile(
            *tile_index.entry((value.bits(), active)).or_insert_with(|| {
                tree.tiles.push(Tile { value, active });
                tree.tiles.len() - 1
            }),
        )
    }

    fn root_cell(&mut self, p: IVec3) -> &mut Slot {
        let origin = root_origin(p);
        let Self {
            tree, root_index, ..
        } = self;
        let i = *root_index.entry(origin).or_insert_with(|| {
            tree.root.push(RootCell {
                origin,
                slot: Slot::BACKGROUND,
            });
            tree.root.len() - 1
        });
        &mut tree.root[i].slot
    }

    /// Makes the 4096³ cell that holds `p` a tile.
    pub fn set_root_tile(&mut self, p: IVec3, value: V, active: bool) {
        let slot = self.tile(value, active);
        *self.root_cell(p) = slot;
    }

    /// Returns the upper node that holds `p`, made on first use from the cell's tile.
    pub fn upper_node(&mut self, p: IVec3) -> usize {
        let slot = *self.root_cell(p);
        slot.get().unwrap_or_else(|_tile| {
            let t = &mut self.tree;
            let index = t.upper_origins.len();
            t.upper_origins.push(root_origin(p));
            t.upper.resize((index + 1) * UPPER_LEN, slot);
            *self.root_cell(p) = Slot::child(index);
            index
        })
    }

    /// Makes slot `slot` (128³ voxels) of upper node `node` a tile.
    pub fn set_upper_tile(&mut self, node: usize, slot: usize, value: V, active: bool) {
        self.tree.upper[node * UPPER_LEN + slot] = self.tile(value, active);
    }

    /// Returns the lower node that holds `p`, made on first use from the cell's tile.
    pub fn lower_node(&mut self, p: IVec3) -> usize {
        let cell = self.upper_node(p) * UPPER_LEN + upper_slot(p);
        let slot = self.tree.upper[cell];
        slot.get().unwrap_or_else(|_tile| {
            let t = &mut self.tree;
            let index = t.lower_origins.len();
            t.lower_origins.push(p & !((1 << LOWER_TOTAL_LOG2) - 1));
            t.lower.resize((index + 1) * LOWER_LEN, slot);
            t.upper[cell] = Slot::child(index);
            index
        })
    }

    /// Makes slot `slot` (8³ voxels) of lower node `node` a tile.
    pub fn set_lower_tile(&mut self, node: usize, slot: usize, value: V, active: bool) {
        self.tree.lower[node * LOWER_LEN + slot] = self.tile(value, active);
    }

    /// Declares a brick at the cell that holds `p` and returns its index.
    ///
    /// Values and masks come with [`TreeBuilder::finish`], in order of these indices; a cell
    /// that already has a brick keeps it.
    pub fn add_brick(&mut self, p: IVec3) -> usize {
        let cell = self.lower_node(p) * LOWER_LEN + lower_slot(p);
        let t = &mut self.tree;
        t.lower[cell].get().unwrap_or_else(|_tile| {
            let index = t.brick_origins.len();
            t.brick_origins.push(brick::origin(p));
            t.lower[cell] = Slot::child(index);
            index
        })
    }

    /// Returns the number of bricks declared so far.
    pub fn brick_count(&self) -> usize {
        self.tree.brick_origins.len()
    }

    /// Completes the nodes of a tree whose bricks' values are kept elsewhere.
    pub fn finish_nodes(self) -> Tree<V> {
        let mut tree = self.tree;
        tree.root.sort_by_key(|c| root_key(c.origin));
        tree
    }

    /// Completes the tree with the bricks' values (`[brick][x][y][z]`) and active masks.
    ///
    /// # Panics
    /// If `values` or `active` does not match the number of bricks.
    pub fn finish(self, values: Vec<V>, active: Vec<BrickMask>) -> Tree<V> {
        let mut tree = self.finish_nodes();
        assert_eq!(
            values.len(),
            tree.brick_origins.len() * BRICK_LEN,
            "512 values a brick"
        );
        assert_eq!(active.len(), tree.brick_origins.len(), "one mask a brick");
        tree.values = values;
        tree.active = active;
        tree
    }
}

impl<V: Voxel> Tree<V> {
    /// Lists the 4096³ cell at `origin` as a tile of the background, if it is not listed yet.
    pub(super) fn make_root_cell(&mut self, origin: IVec3) {
        let key = root_key(origin);
        if let Err(i) = self.root.binary_search_by_key(&key, |c| root_key(c.origin)) {
            self.root.insert(
                i,
                RootCell {
                    origin,
                    slot: Slot::BACKGROUND,
                },
            );
        }
    }

    /// Makes upper and lower nodes at the given origins, filled with the tiles they replace.
    ///
    /// The upper node of each lower one must exist or be among `upper`.
    pub(super) fn make_nodes(&mut self, upper: &BTreeSet<[i32; 3]>, lower: &BTreeSet<[i32; 3]>) {
        for &origin in upper {
            let origin = IVec3::from_array(origin);
            self.make_root_cell(origin);
            let i = self.root_index(origin).expect("the cell was made above");
            let slot = &mut self.root[i].slot;
            if slot.get().is_err() {
                self.upper.resize(self.upper.len() + UPPER_LEN, *slot);
                *slot = Slot::child(self.upper_origins.len());
                self.upper_origins.push(origin);
            }
        }
        for &origin in lower {
            let origin = IVec3::from_array(origin);
            let u = self
                .root_slot(origin)
                .get()
                .expect("the upper node was made above");
            let slot = &mut self.upper[u * UPPER_LEN + upper_slot(origin)];
            if slot.get().is_err() {
                self.lower.resize(self.lower.len() + LOWER_LEN, *slot);
                *slot = Slot::child(self.lower_origins.len());
                self.lower_origins.push(origin);
            }
        }
    }

    /// Builds a tree from single active voxels; later ones win. For tests and examples.
    pub fn from_voxels(background: V, voxels: impl IntoIterator<Item = (IVec3, V)>) -> Self {
        let mut builder = TreeBuilder::new(background);
        let (mut values, mut active) = (Vec::new(), Vec::new());
        for (p, v) in voxels {
            let b = builder.add_brick(p);
            values.resize(builder.brick_count() * BRICK_LEN, background);
            active.resize(builder.brick_count(), [0; BRICK_LEN / 64]);
            let o = brick::offset(p);
            values[b * BRICK_LEN + o] = v;
            active[b][o >> 6] |= 1 << (o & 63);
        }
        builder.finish(values, active)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tiles_of_all_levels_read_back() {
        let mut b = TreeBuilder::new(0.5_f32);
        b.set_root_tile(IVec3::new(5000, -1, 0), 2.0, true);
        let u = b.upper_node(IVec3::ZERO);
        b.set_upper_tile(u, upper_slot(IVec3::new(128, 256, 384)), 3.0, true);
        let l = b.lower_node(IVec3::new(1, 1, 1));
        b.set_lower_tile(l, lower_slot(IVec3::new(8, 16, 24)), 4.0, false);
        let brick = b.add_brick(IVec3::new(9, 1, 2));
        assert_eq!(
            b.add_brick(IVec3::new(8, 0, 0)),
            brick,
            "the same cell, the same brick"
        );
        let mut values = vec![0.5; BRICK_LEN];
        values[brick::offset(IVec3::new(9, 1, 2))] = 7.0;
        let mut mask = [0; 8];
        mask[1] = 1 << (1 << 3 | 2);
        let t = b.finish(values, vec![mask]);
        let at = |x, y, z| t.probe(IVec3::new(x, y, z));
        assert_eq!(
            at(4096, -4096, 4095),
            Tile {
                value: 2.0,
                active: true
            }
        );
        assert_eq!(
            at(255, 256, 511),
            Tile {
                value: 3.0,
                active: true
            }
        );
        assert_eq!(
            at(15, 23, 24),
            Tile {
                value: 4.0,
                active: false
            }
        );
        assert_eq!(
            at(9, 1, 2),
            Tile {
                value: 7.0,
                active: true
            }
        );
        assert_eq!(
            at(9, 1, 3),
            Tile {
                value: 0.5,
                active: false
            }
        );
        assert_eq!(
            at(-1, 0, 0),
            Tile {
                value: 0.5,
                active: false
            }
        );
        let tiles: Vec<_> = t
            .stored_tiles()
            .map(|(o, n, t)| (o.x, n, t.value))
            .collect();
        assert_eq!(tiles, [(4096, 4096, 2.0), (128, 128, 3.0), (8, 8, 4.0)]);
    }

    #[test]
    fn a_node_made_inside_a_tile_keeps_its_value() {
        let mut b = TreeBuilder::new(0_i64);
        b.set_root_tile(IVec3::ZERO, i64::MAX, true);
        b.add_brick(IVec3::new(100, 100, 100));
        let t = b.finish(vec![1; BRICK_LEN], vec![[0; 8]]);
        assert_eq!(t.probe(IVec3::new(100, 100, 100)).value, 1);
        assert_eq!(
            t.probe(IVec3::new(0, 0, 0)),
            Tile {
                value: i64::MAX,
                active: true
            }
        );
        assert_eq!(
            t.probe(IVec3::new(4000, 0, 0)),
            Tile {
                value: i64::MAX,
                active: true
            }
        );
    }
}

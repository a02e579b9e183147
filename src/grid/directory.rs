//! A dense table of the nodes of 128³ voxels in the box of what is not empty.
//!
//! Finding the node of a point through the tree takes a binary search and two dependent loads,
//! and each ray does it at least twice, for its walk and for its lookups: short rays inside a
//! cloud spent a third of their instructions there. A grid whose box has at most [`MAX_NODES`]
//! nodes, 8192³ voxels for a cube, has them in a table; others walk the tree.

use glam::IVec3;

use super::bounds::{Bound, Bounds};
use super::brick::BRICK_LOG2;
use super::tree::{LOWER_LEN, LOWER_LOG2, LOWER_TOTAL_LOG2, Tree, UPPER_LEN, UPPER_LOG2};
use super::tree::{root_origin, upper_slot};

/// Most nodes in a table: 8 MB.
const MAX_NODES: i64 = 1 << 18;

/// What a block of 128³ voxels is stored as.
#[derive(Clone, Copy, Debug)]
pub(super) struct Node {
    /// Of all values that a lookup in the node can return, or in the tile that covers it.
    pub(super) bound: Bound,
    pub(super) content: Content,
}

#[derive(Clone, Copy, Debug)]
pub(super) enum Content {
    /// First cell of a lower node.
    Lower(usize),
    /// The value of a tile of `2^log2` bricks an edge.
    Tile { value: f32, log2: u32 },
}

/// The nodes of a grid, by their place.
#[derive(Clone, Debug)]
pub(super) struct Directory {
    /// Lowest node of the table, in nodes.
    first: IVec3,
    /// Nodes along each axis; zero without a table.
    size: IVec3,
    /// x slowest, z fastest.
    nodes: Vec<Node>,
}

impl Directory {
    /// Makes the table, unless it would be too large.
    pub(super) fn new(tree: &Tree<f32>, bounds: &Bounds) -> Self {
        let none = Self {
            first: IVec3::ZERO,
            size: IVec3::ZERO,
            nodes: Vec::new(),
        };
        let Some((first, last)) = bounds.occupied else {
            return none;
        };
        let (first, last) = (first >> LOWER_LOG2, last >> LOWER_LOG2);
        let size = last - first + 1;
        if size.as_i64vec3().element_product() > MAX_NODES {
            return none;
        }
        Self::of((first, last), |key| find_node(tree, bounds, key))
    }

    /// Makes the table of all nodes of a box, given in nodes.
    pub(super) fn of((first, last): (IVec3, IVec3), mut node: impl FnMut(IVec3) -> Node) -> Self {
        let size = last - first + 1;
        let mut nodes = Vec::new();
        for x in 0..size.x {
            for y in 0..size.y {
                for z in 0..size.z {
                    nodes.push(node(first + IVec3::new(x, y, z)));
                }
            }
        }
        Self { first, size, nodes }
    }

    /// Returns how many nodes of the table are one tile each.
    pub(super) fn tile_count(&self) -> usize {
        let is_tile = |node: &&Node| matches!(node.content, Content::Tile { .. });
        self.nodes.iter().filter(is_tile).count()
    }

    /// Returns the node at `key`, its coordinates in nodes.
    #[inline] // bench: traversal
    pub(super) fn node(&self, tree: &Tree<f32>, bounds: &Bounds, key: IVec3) -> Node {
        self.stored(key)
            .unwrap_or_else(|| find_node(tree, bounds, key))
    }

    /// Returns the node at `key` of the table; `None` outside of it.
    #[inline] // bench: traversal
    pub(super) fn stored(&self, key: IVec3) -> Option<Node> {
        // Wrapping: a key below the first becomes large.
        let at = key.wrapping_sub(self.first).as_uvec3();
        let is_inside = at.cmplt(self.size.as_uvec3()).all();
        is_inside.then(|| {
            let i = (at.x * self.size.y.cast_unsigned() + at.y) * self.size.z.cast_unsigned();
            self.nodes[(i + at.z) as usize]
        })
    }

    /// Returns the bytes that the table occupies.
    pub(super) fn memory_bytes(&self) -> usize {
        size_of_val(&self.nodes[..])
    }
}

#[cold]
fn find_node(tree: &Tree<f32>, bounds: &Bounds, key: IVec3) -> Node {
    let voxel = key << LOWER_TOTAL_LOG2;
    let Some(r) = tree.root_index(root_origin(voxel)) else {
        // No root cell, no density, whatever the background.
        return Node {
            bound: Bound::EMPTY,
            content: Content::Tile {
                value: tree.background(),
                log2: LOWER_LOG2 + UPPER_LOG2,
            },
        };
    };
    let tile = |bound, tile: usize, log2| Node {
        bound,
        content: Content::Tile {
            value: tree.tiles[tile].value,
            log2,
        },
    };
    let u = match tree.root[r].slot.get() {
        Ok(u) => u,
        Err(t) => return tile(bounds.root[r], t, LOWER_LOG2 + UPPER_LOG2),
    };
    let slot = u * UPPER_LEN + upper_slot(voxel);
    match tree.upper[slot].get() {
        Ok(l) => Node {
            bound: bounds.upper[slot],
            content: Content::Lower(l * LOWER_LEN),
        },
        Err(t) => tile(bounds.upper[slot], t, LOWER_LOG2),
    }
}

const _: () = assert!(
    LOWER_TOTAL_LOG2 == LOWER_LOG2 + BRICK_LOG2,
    "a node is 16 bricks wide"
);

//! Conservative minimum, maximum and mean of every cell, from decoded values.
//!
//! A cell of `n`³ voxels at `o` covers the points `[o, o + n)` on each axis. The filter at such
//! a point reads the samples at its floor and one further, so the cell's bound is taken over
//! the samples `o ..= o + n`: its own and the first layer of its seven upper neighbours. Every
//! value any lookup can return in the cell is then inside the bound, bit for bit: a lookup
//! returns stored values or rounds between them with a clamp.
//!
//! Cost: values up to one layer beyond a brick make its bound looser. With it, the cloud in
//! `data/` has 1.69 tentative collisions for each unit of optical thickness (bench: traversal);
//! 1 would be perfect.
//!
//! # The halo
//! Empty space right below a brick reads that brick's first layer. Where it belongs to a
//! large tile, the tile's bound would rise to the brick's and 128³ or 4096³ voxels of empty
//! space would be walked as if they were full. `add_halo` therefore splits the large tile
//! below into a node, so that only the 8³ cells that touch the brick carry its bound.

use std::collections::BTreeSet;

use glam::{DVec3, IVec3};
use rayon::prelude::*;

use super::brick::{BRICK_DIM, BRICK_LEN, BRICK_LOG2, FOOTPRINT};
use super::tree::{
    LOWER_LEN, LOWER_LOG2, LOWER_TOTAL_LOG2, Slot, Tree, UPPER_LEN, UPPER_LOG2, UPPER_TOTAL_LOG2,
    lower_slot, slot_origin, upper_slot,
};
use super::values::{Values, Voxels};

// One layer of the upper neighbours completes a brick's own values to what its filter reads.
const _: () = assert!(
    BRICK_DIM + 1 == FOOTPRINT,
    "the layer is all that is missing"
);

/// What is known of the values that a filter can read within one cell.
#[derive(Clone, Copy, Debug, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(C)]
pub struct Bound {
    /// No value is below.
    pub min: f32,
    /// No value is above.
    pub max: f32,
    /// Mean of the cell's own voxels: an estimate, not a bound.
    pub mean: f32,
}

impl Bound {
    /// Nothing there.
    pub const EMPTY: Self = Self::constant(0.0);

    pub(super) const fn constant(value: f32) -> Self {
        Self {
            min: value,
            max: value,
            mean: value,
        }
    }

    #[inline] // bench: load
    fn include(&mut self, value: f32) {
        // Values are numbers: no need for what `f32::min` does about NaN, at three times the cost.
        self.min = if value < self.min { value } else { self.min };
        self.max = if value > self.max { value } else { self.max };
    }

    /// Returns whether every point of the cell has the same value.
    pub fn is_constant(&self) -> bool {
        self.min == self.max
    }
}

/// The bounds of all cells of a tree, in the order of its slots.
#[derive(Debug)]
pub struct Bounds {
    pub(super) root: Vec<Bound>,
    pub(super) upper: Vec<Bound>,
    /// Empty once a grid has them in its cells.
    pub(super) lower: Vec<Bound>,
    /// Lowest and highest brick, in brick coordinates, of those that are not zero; `None` if
    /// all is zero.
    pub(super) occupied: Option<(IVec3, IVec3)>,
    /// Of everything in the box of occupied bricks.
    pub(super) whole: Bound,
}

/// The seven neighbours that share a face, an edge or a corner on one side of a cell.
fn neighbours() -> impl Iterator<Item = IVec3> {
    (1..8).map(|i| IVec3::new(i >> 2 & 1, i >> 1 & 1, i & 1))
}

/// Adds `a · scale` to `p`; `None` past the ends of `i32`, where no voxel can be.
fn checked_offset(p: IVec3, a: IVec3, scale: i32) -> Option<IVec3> {
    Some(IVec3::new(
        p.x.checked_add(a.x * scale)?,
        p.y.checked_add(a.y * scale)?,
        p.z.checked_add(a.z * scale)?,
    ))
}

/// What stands in a cell, down to some level.
#[derive(Clone, Copy)]
enum Cell {
    /// Index of a tile; it may be larger than the cell asked for.
    Tile(usize),
    Upper(usize),
    Lower(usize),
    Brick(usize),
}

/// Returns what holds voxel `p`, at cells of edge `2^log2` or larger.
fn cell_at(tree: Voxels<'_>, p: IVec3, log2: u32) -> Cell {
    let u = match tree.root_slot(p).get() {
        Err(tile) => return Cell::Tile(tile),
        Ok(u) if log2 == UPPER_TOTAL_LOG2 => return Cell::Upper(u),
        Ok(u) => u,
    };
    let l = match tree.upper[u * UPPER_LEN + upper_slot(p)].get() {
        Err(tile) => return Cell::Tile(tile),
        Ok(l) if log2 == LOWER_TOTAL_LOG2 => return Cell::Lower(l),
        Ok(l) => l,
    };
    match tree.lower[l * LOWER_LEN + lower_slot(p)].get() {
        Err(tile) => Cell::Tile(tile),
        Ok(brick) => Cell::Brick(brick),
    }
}

/// Visits the offsets `x << 2·log2 | y << log2 | z` of a cube of `2^log2` entries an edge in the
/// layer that faces `side`: coordinate 0 on the axes where `side` is 1, all on the others.
fn layer(side: IVec3, log2: u32) -> impl Iterator<Item = usize> {
    let extent = move |s: i32| if s == 1 { 1 } else { 1_usize << log2 };
    let yz = move |x: usize| {
        (0..extent(side.y))
            .flat_map(move |y| (0..extent(side.z)).map(move |z| x << (2 * log2) | y << log2 | z))
    };
    (0..extent(side.x)).flat_map(yz)
}

/// Visits all values in the layer of a cell that faces `side`.
fn for_each_in_layer(tree: Voxels<'_>, cell: Cell, side: IVec3, visit: &mut dyn FnMut(f32)) {
    let of = |slot: Slot, child: fn(usize) -> Cell| slot.get().map_or_else(Cell::Tile, child);
    match cell {
        Cell::Tile(t) => visit(tree.tiles[t].value),
        Cell::Brick(b) => layer(side, BRICK_LOG2).for_each(|i| visit(tree.values.get(b, i))),
        Cell::Lower(l) => layer(side, LOWER_LOG2).for_each(|i| {
            let cell = of(tree.lower[l * LOWER_LEN + i], Cell::Brick);
            for_each_in_layer(tree, cell, side, visit);
        }),
        Cell::Upper(u) => layer(side, UPPER_LOG2).for_each(|i| {
            let cell = of(tree.upper[u * UPPER_LEN + i], Cell::Lower);
            for_each_in_layer(tree, cell, side, visit);
        }),
    }
}

/// The nodes that [`add_halo`] would make: origins of upper and of lower nodes.
struct Halo {
    upper: BTreeSet<[i32; 3]>,
    lower: BTreeSet<[i32; 3]>,
}

fn find_halo(tree: Voxels<'_>) -> Halo {
    let mut halo = Halo {
        upper: BTreeSet::new(),
        lower: BTreeSet::new(),
    };
    let node = |p: IVec3, log2: u32| (p & !((1 << log2) - 1)).to_array();
    // Visits the sides of a cell on which a larger tile of another value stands below.
    let below = |o: IVec3, log2: u32, cell: Cell, make: &mut dyn FnMut(IVec3)| {
        for side in neighbours() {
            let Some(p) = checked_offset(o, side, -(1 << log2)) else {
                continue;
            };
            // Asked one level up, only a tile larger than the cell is a tile.
            let step = if log2 == BRICK_LOG2 {
                LOWER_LOG2
            } else {
                UPPER_LOG2
            };
            let Cell::Tile(t) = cell_at(tree, p, log2 + step) else {
                continue;
            };
            let mut differs = false;
            for_each_in_layer(tree, cell, side, &mut |v| {
                differs |= v != tree.tiles[t].value;
            });
            if differs {
                make(p);
            }
        }
    };
    // Cells of 8³ voxels, bricks and tiles, need lower nodes below them. Only those on the
    // lower faces of their node can have a larger cell there.
    for (l, &origin) in tree.lower_origins.iter().enumerate() {
        for s in 0..LOWER_LEN {
            let o = slot_origin(s, LOWER_LOG2, BRICK_LOG2);
            let cell = tree.lower[l * LOWER_LEN + s]
                .get()
                .map_or_else(Cell::Tile, Cell::Brick);
            if o.min_element() == 0 {
                below(origin + o, BRICK_LOG2, cell, &mut |p| {
                    halo.lower.insert(node(p, LOWER_TOTAL_LOG2));
                    halo.upper.insert(node(p, UPPER_TOTAL_LOG2));
                });
            }
        }
    }
    // Tiles of 128³ voxels need upper nodes below them.
    for (u, &origin) in tree.upper_origins.iter().enumerate() {
        for s in 0..UPPER_LEN {
            let o = slot_origin(s, UPPER_LOG2, LOWER_TOTAL_LOG2);
            if let Err(t) = tree.upper[u * UPPER_LEN + s].get()
                && o.min_element() == 0
            {
                below(origin + o, LOWER_TOTAL_LOG2, Cell::Tile(t), &mut |p| {
                    halo.upper.insert(node(p, UPPER_TOTAL_LOG2));
                });
            }
        }
    }
    halo.upper
        .retain(|&o| tree.root_slot(IVec3::from_array(o)).get().is_err());
    halo
}

/// Bytes of one more upper or lower node with its bounds.
const UPPER_BYTES: usize = UPPER_LEN * (size_of::<Slot>() + size_of::<Bound>());
const LOWER_BYTES: usize = LOWER_LEN * (size_of::<Slot>() + size_of::<Bound>());

/// Makes the nodes below bricks and tiles that the bounds need; changes no value.
///
/// Returns the bytes that tree and bounds would take if that is more than `max_bytes`, and
/// leaves the tree as it is. At most seven nodes are made for each that exists.
pub(super) fn add_halo(
    tree: &mut Tree<f32>,
    values: &Values,
    max_bytes: usize,
) -> Result<(), usize> {
    let halo = find_halo(Voxels { tree, values });
    let bytes = tree.memory_bytes()
        + values.memory_bytes()
        + (tree.upper.len() + tree.lower.len()) * size_of::<Bound>()
        + halo.upper.len() * UPPER_BYTES
        + halo.lower.len() * LOWER_BYTES;
    if bytes > max_bytes {
        return Err(bytes);
    }
    tree.make_nodes(&halo.upper, &halo.lower);
    // Whatever a 4096³ cell holds needs a cell below it to carry a bound.
    let cells: Vec<IVec3> = tree.root.iter().map(|c| c.origin).collect();
    for origin in cells {
        for side in neighbours() {
            if let Some(below) = checked_offset(origin, side, -(1 << UPPER_TOTAL_LOG2)) {
                tree.make_root_cell(below);
            }
        }
    }
    Ok(())
}

impl Bounds {
    /// Computes the bounds of `tree`, which must have its halo.
    ///
    /// # Cost
    /// Reads every value once and 217 neighbours for each brick; parallel over nodes.
    pub(super) fn new(tree: Voxels<'_>) -> Self {
        let lower: Vec<Bound> = tree
            .lower_origins
            .par_iter()
            .zip(tree.lower.par_chunks(LOWER_LEN))
            .flat_map_iter(|(&origin, slots)| {
                slots
                    .iter()
                    .enumerate()
                    .map(move |(s, slot)| match slot.get() {
                        Err(t) if is_surrounded(slots, s, LOWER_LOG2) => {
                            Bound::constant(tree.tiles[t].value)
                        }
                        content => {
                            let o = origin + slot_origin(s, LOWER_LOG2, BRICK_LOG2);
                            let cell = content.map_or_else(Cell::Tile, Cell::Brick);
                            cell_bound(tree, o, BRICK_LOG2, cell)
                        }
                    })
            })
            .collect();
        let upper: Vec<Bound> = tree
            .upper_origins
            .par_iter()
            .zip(tree.upper.par_chunks(UPPER_LEN))
            .flat_map_iter(|(&origin, slots)| {
                let lower = &lower;
                slots
                    .iter()
                    .enumerate()
                    .map(move |(s, slot)| match slot.get() {
                        Ok(l) => union(&lower[l * LOWER_LEN..][..LOWER_LEN]),
                        Err(t) if is_surrounded(slots, s, UPPER_LOG2) => {
                            Bound::constant(tree.tiles[t].value)
                        }
                        Err(t) => {
                            let o = origin + slot_origin(s, UPPER_LOG2, LOWER_TOTAL_LOG2);
                            cell_bound(tree, o, LOWER_TOTAL_LOG2, Cell::Tile(t))
                        }
                    })
            })
            .collect();
        let root: Vec<Bound> = tree
            .root
            .iter()
            .map(|cell| match cell.slot.get() {
                Ok(u) => union(&upper[u * UPPER_LEN..][..UPPER_LEN]),
                Err(t) => cell_bound(tree, cell.origin, UPPER_TOTAL_LOG2, Cell::Tile(t)),
            })
            .collect();
        Self::from_cells(tree.tree, root, upper, lower)
    }

    /// Takes the bounds of all cells of `tree` and sums them up.
    pub(super) fn from_cells(
        tree: &Tree<f32>,
        root: Vec<Bound>,
        upper: Vec<Bound>,
        lower: Vec<Bound>,
    ) -> Self {
        let mut bounds = Self {
            root,
            upper,
            lower,
            occupied: None,
            whole: Bound::EMPTY,
        };
        bounds.occupied = bounds.find_occupied(tree);
        bounds.whole = bounds.unite_all(tree.background());
        bounds
    }

    /// Returns the bound of the box of occupied bricks, which may hold some of the background.
    fn unite_all(&self, background: f32) -> Bound {
        let Some((first, last)) = self.occupied else {
            return Bound::EMPTY;
        };
        let mut all = Bound::constant(background);
        let mut sum = 0.0;
        for b in self.root.iter().filter(|b| b.max > 0.0) {
            all.include(b.min);
            all.include(b.max);
            sum += f64::from(b.mean);
        }
        let bricks = (last.as_dvec3() - first.as_dvec3() + DVec3::ONE).element_product();
        let bricks_in_root = f64::from(1 << (UPPER_TOTAL_LOG2 - BRICK_LOG2)).powi(3);
        #[expect(clippy::cast_possible_truncation, reason = "an estimate")]
        let mean = (sum * bricks_in_root / bricks) as f32;
        Bound {
            mean: mean.clamp(all.min, all.max),
            ..all
        }
    }

    fn find_occupied(&self, tree: &Tree<f32>) -> Option<(IVec3, IVec3)> {
        let (mut lo, mut hi) = (IVec3::MAX, IVec3::MIN);
        let mut include = |origin: IVec3, log2: u32| {
            let first = origin >> BRICK_LOG2;
            lo = lo.min(first);
            hi = hi.max(first + ((1 << (log2 - BRICK_LOG2)) - 1));
        };
        for (cell, _) in tree
            .root
            .iter()
            .zip(&self.root)
            .filter(|(_, b)| b.max > 0.0)
        {
            let Ok(u) = cell.slot.get() else {
                include(cell.origin, UPPER_TOTAL_LOG2);
                continue;
            };
            for s in (0..UPPER_LEN).filter(|s| self.upper[u * UPPER_LEN + s].max > 0.0) {
                let o = cell.origin + slot_origin(s, UPPER_LOG2, LOWER_TOTAL_LOG2);
                let Ok(l) = tree.upper[u * UPPER_LEN + s].get() else {
                    include(o, LOWER_TOTAL_LOG2);
                    continue;
                };
                for s in (0..LOWER_LEN).filter(|s| self.lower[l * LOWER_LEN + s].max > 0.0) {
                    include(o + slot_origin(s, LOWER_LOG2, BRICK_LOG2), BRICK_LOG2);
                }
            }
        }
        (lo.x <= hi.x).then_some((lo, hi))
    }

    /// Returns the bytes that the bounds occupy.
    pub(super) fn memory_bytes(&self) -> usize {
        size_of_val(&self.root[..]) + size_of_val(&self.upper[..]) + size_of_val(&self.lower[..])
    }
}

/// Returns whether the upper neighbours of a tile are in its own node and the same tile: the
/// case of nearly all slots, decided by seven loads instead of seven walks from the root.
fn is_surrounded(slots: &[Slot], s: usize, log2: u32) -> bool {
    let mask = (1 << log2) - 1;
    let inside = [2 * log2, log2, 0]
        .iter()
        .all(|shift| s >> shift & mask != mask);
    let step = |d: IVec3| (d.x << (2 * log2) | d.y << log2 | d.z).cast_unsigned() as usize;
    inside && neighbours().all(|d| slots[s + step(d)] == slots[s])
}

/// Returns the bound of the cell of edge `2^log2` at `o` that holds a brick or a tile: its own
/// values and the first layer of its seven upper neighbours.
fn cell_bound(tree: Voxels<'_>, o: IVec3, log2: u32, cell: Cell) -> Bound {
    let mut bound = match cell {
        Cell::Brick(b) => {
            let values = tree.values.brick(b);
            let mut bound = Bound::constant(values[0]);
            let mut sum = 0.0_f64;
            for row in values.as_chunks::<8>().0 {
                for &v in row {
                    bound.include(v);
                }
                sum += f64::from(row.iter().sum::<f32>());
            }
            Bound {
                mean: mean(sum, BRICK_LEN),
                ..bound
            }
        }
        Cell::Tile(t) => Bound::constant(tree.tiles[t].value),
        Cell::Lower(_) | Cell::Upper(_) => unreachable!("nodes take the union of their cells"),
    };
    for side in neighbours() {
        if let Some(above) = checked_offset(o, side, 1 << log2) {
            let neighbour = cell_at(tree, above, log2);
            for_each_in_layer(tree, neighbour, side, &mut |v| bound.include(v));
        }
    }
    bound
}

#[expect(
    clippy::cast_possible_truncation,
    reason = "the mean of f32 values is in their range"
)]
fn mean(sum: f64, count: usize) -> f32 {
    (sum / count as f64) as f32
}

/// Returns the bound of several cells of the same size.
pub(super) fn union(bounds: &[Bound]) -> Bound {
    let mut all = bounds[0];
    let mut sum = 0.0_f64;
    for b in bounds {
        all.min = all.min.min(b.min);
        all.max = all.max.max(b.max);
        sum += f64::from(b.mean);
    }
    // Rounded sums may be past either end.
    Bound {
        mean: mean(sum, bounds.len()).clamp(all.min, all.max),
        ..all
    }
}

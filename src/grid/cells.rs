//! The cells of 8³ voxels as rays meet them: what is stored in each, and its bound, side by side.
//!
//! A step reads the bound, and the lookup that may follow the slot: apart they would be two waits
//! for memory where the cells of a grid do not fit in a cache. Cells of large grids lie in large
//! pages, if the system has them: 1024³ voxels have 27 MB of cells, far apart along a path.

use std::ops::Deref;

use memmap2::{Mmap, MmapMut};

use super::bounds::Bound;
use super::curve;
use super::tree::{LOWER_LEN, Slot};

/// Bytes from which cells are laid into pages of 2 MB.
const LARGE: usize = 1 << 22;

/// A cell of a lower node.
#[derive(Clone, Copy, Debug, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(C)]
pub(super) struct Cell {
    pub(super) bound: Bound,
    pub(super) slot: Slot,
}

/// What the bounds of cells are about, in 2 bytes each.
///
/// Most collisions in blocks of many cells are decided by it, and it is an eighth of a cell: that much
/// more of what a tile's paths meet is in the caches. A code `c` stands for `c² · unit`: steps are 0.8 %
/// of the highest value, 2.5 % of a tenth of it, and a cell far below a spike elsewhere is looked up.
#[derive(Clone, Debug)]
pub(super) struct Hints {
    /// Minimum, rounded down, and maximum, rounded up, of each cell.
    codes: Vec<[u8; 2]>,
    unit: f32,
}

impl Hints {
    fn new(cells: &[Cell]) -> Self {
        const MOST: f32 = 255.0 * 255.0;
        let highest = cells.iter().fold(0.0, |most: f32, c| most.max(c.bound.max));
        // Rounding up twice at most: the highest code is not below the highest value.
        let mut unit = highest / MOST;
        while MOST * unit < highest {
            unit = unit.next_up();
        }
        let codes = cells.iter().map(|c| encode(c.bound, unit)).collect();
        Self { codes, unit }
    }

    /// Returns what no value of a cell is below, and what none is above.
    #[inline] // bench: frame
    pub(super) fn range(&self, cell: usize) -> (f32, f32) {
        let [min, max] = self.codes[cell];
        (decode(min, self.unit), decode(max, self.unit))
    }

    /// Returns the bytes that the hints occupy.
    pub(super) fn memory_bytes(&self) -> usize {
        size_of_val(&self.codes[..])
    }
}

/// Returns the codes of a minimum and of a maximum, which is at most that of code 255.
fn encode(bound: Bound, unit: f32) -> [u8; 2] {
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "0 to 255; of nothing in a grid of nothing, 0"
    )]
    let near = |value: f32| (value / unit).sqrt() as u8;
    // The root may have been rounded up.
    let mut down = (0..=near(bound.min)).rev();
    let min = down.find(|&c| decode(c, unit) <= bound.min);
    let max = (near(bound.max)..=u8::MAX).find(|&c| decode(c, unit) >= bound.max);
    [min.unwrap_or(0), max.unwrap_or(u8::MAX)]
}

/// Returns the value that a code stands for; in the same order as codes.
#[inline] // bench: frame
fn decode(code: u8, unit: f32) -> f32 {
    (u32::from(code) * u32::from(code)) as f32 * unit
}

/// The cells of all lower nodes, those of each along a curve (see `curve`).
#[derive(Debug)]
pub(super) enum CellTable {
    Small(Vec<Cell>),
    Large(Mmap),
}

impl CellTable {
    /// Puts slots and bounds together, both of whole nodes in the order of a tree.
    pub(super) fn new(slots: &[Slot], bounds: &[Bound]) -> Self {
        let order = curve::slots();
        let cells = || {
            (0..slots.len()).map(|i| {
                let from = i - i % LOWER_LEN + order[i % LOWER_LEN];
                Cell {
                    bound: bounds[from],
                    slot: slots[from],
                }
            })
        };
        let size = slots.len() * size_of::<Cell>();
        let mapped = (size >= LARGE).then(|| map(size, cells())).flatten();
        mapped.map_or_else(|| Self::Small(cells().collect()), Self::Large)
    }

    /// Returns hints of the cells' bounds.
    pub(super) fn hints(&self) -> Hints {
        Hints::new(self)
    }
}

/// Lays cells into a mapping of large pages; `None` if the system refuses a mapping.
fn map(size: usize, cells: impl Iterator<Item = Cell>) -> Option<Mmap> {
    let mut bytes = MmapMut::map_anon(size).ok()?;
    // Refused, it is slower and no less right.
    #[cfg(target_os = "linux")]
    let _ = bytes.advise(memmap2::Advice::HugePage);
    // A mapping starts at a page.
    for (to, cell) in bytemuck::cast_slice_mut(&mut bytes).iter_mut().zip(cells) {
        *to = cell;
    }
    bytes.make_read_only().ok()
}

impl Deref for CellTable {
    type Target = [Cell];

    #[inline] // bench: frame
    fn deref(&self) -> &[Cell] {
        match self {
            Self::Small(cells) => cells,
            Self::Large(bytes) => bytemuck::cast_slice(bytes),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hints_hold_their_bounds() {
        let values = [0.0, 1e-45, 3e-39, 0.1, 1.0, 1.000_000_1, 7.3, 3e38];
        for highest in values.into_iter().chain([1e-37, f32::MAX]) {
            let below = |v: &f32| *v <= highest;
            let values: Vec<f32> = values.into_iter().filter(below).chain([highest]).collect();
            let bound = |min, max| Bound {
                min,
                max,
                mean: min,
            };
            let pairs = values.iter().enumerate();
            let cells: Vec<Cell> = pairs
                .flat_map(|(i, &min)| values[i..].iter().map(move |&max| bound(min, max)))
                .map(|bound| Cell {
                    bound,
                    slot: Slot::BACKGROUND,
                })
                .collect();
            let hints = Hints::new(&cells);
            for (i, Cell { bound, .. }) in cells.iter().enumerate() {
                let [min, max, low, high, highest] = {
                    let (min, max) = hints.range(i);
                    [min, max, bound.min, bound.max, highest].map(f64::from)
                };
                assert!(min <= low && max >= high, "{min} to {max}: {bound:?}");
                // A step of codes; where numbers have few digits, a unit of those for each of 255².
                let step = |value: f64| {
                    2.01 / 255.0 * (value * highest).sqrt().max(highest / 255.0) + 1e-40
                };
                assert!(min + step(low) >= low, "{min}: {bound:?}");
                // Infinity, where the highest code is rounded up to nothing less.
                let is_near = max <= high + step(high) || bound.max == f32::MAX;
                assert!(is_near, "{max}: {bound:?}");
            }
        }
    }
}

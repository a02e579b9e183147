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

/// What the bound of a cell is about: the upper halves of two `f32`, the maximum rounded up.
///
/// Most collisions in blocks of many cells are decided by it, and it is a quarter of a cell: that much
/// more of what a tile's paths meet is in the caches.
#[derive(Clone, Copy, Debug)]
pub(super) struct Hint {
    min: u16,
    max: u16,
}

impl Hint {
    fn new(bound: Bound) -> Self {
        let upper_half = |bits: u32| (bits >> 16) as u16;
        Self {
            min: upper_half(bound.min.to_bits()),
            // Infinity, above the largest number that has a half.
            max: upper_half(bound.max.to_bits() + 0xffff),
        }
    }

    /// Returns what no value of the cell is below.
    #[inline] // bench: frame
    pub(super) fn min(self) -> f32 {
        f32::from_bits(u32::from(self.min) << 16)
    }

    /// Returns what no value of the cell is above.
    #[inline] // bench: frame
    pub(super) fn max(self) -> f32 {
        f32::from_bits(u32::from(self.max) << 16)
    }
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

    /// Returns the hint of each cell.
    pub(super) fn hints(&self) -> Vec<Hint> {
        self.iter().map(|cell| Hint::new(cell.bound)).collect()
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
        let values = [
            0.0,
            1e-45,
            3e-39,
            0.1,
            1.0,
            1.000_000_1,
            7.3,
            3e38,
            f32::MAX,
        ];
        for (i, &min) in values.iter().enumerate() {
            for &max in &values[i..] {
                let hint = Hint::new(Bound {
                    min,
                    max,
                    mean: min,
                });
                assert!(hint.min() <= min && hint.max() >= max, "{hint:?}");
                let unit = 1e-40;
                assert!(hint.min() >= min * (1.0 - 1.0 / 128.0) - unit, "{hint:?}");
                let is_close = hint.max() <= max * (1.0 + 1.0 / 128.0) + unit;
                assert!(is_close || max == f32::MAX, "{hint:?} for {max}");
            }
        }
    }
}

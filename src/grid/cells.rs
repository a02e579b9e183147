//! The cells of 8³ voxels as rays meet them: what is stored in each, and its bound, side by side.
//!
//! A step reads the bound, and the lookup that may follow the slot: apart they would be two waits
//! for memory where the cells of a grid do not fit in a cache. Cells of large grids lie in large
//! pages, if the system has them: 1024³ voxels have 13 MB of cells, far apart along a path.

use std::ops::Deref;

use memmap2::{Mmap, MmapMut};

use super::bounds::Bound;
use super::tree::Slot;

/// Bytes from which cells are laid into pages of 2 MB.
const LARGE: usize = 1 << 22;

/// A cell of a lower node.
#[derive(Clone, Copy, Debug, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(C)]
pub(super) struct Cell {
    pub(super) bound: Bound,
    pub(super) slot: Slot,
}

/// The cells of all lower nodes, in the order of their slots.
#[derive(Debug)]
pub(super) enum CellTable {
    Small(Vec<Cell>),
    Large(Mmap),
}

impl CellTable {
    /// Puts slots and bounds together; both have the same length.
    pub(super) fn new(slots: &[Slot], bounds: &[Bound]) -> Self {
        let cells = || {
            let pairs = slots.iter().zip(bounds);
            pairs.map(|(&slot, &bound)| Cell { bound, slot })
        };
        let size = slots.len() * size_of::<Cell>();
        let mapped = (size >= LARGE).then(|| map(size, cells())).flatten();
        mapped.map_or_else(|| Self::Small(cells().collect()), Self::Large)
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

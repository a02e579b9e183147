//! The order of the cells of a lower node as rays meet them: along a Z-curve `[Morton1966]`.
//!
//! The digits of a place are those of x, y and z in turn, z the last. Any aligned block of 2³, 4³ or
//! 8³ cells is a run of 8, 64 or 512 places, so what is kept for blocks needs no arithmetic; and a line of
//! memory holds cells that are near each other on every axis, not along z alone.

use glam::IVec3;

use super::tree::{LOWER_LEN, LOWER_LOG2};

/// Cells along the edge of a node.
const DIM: usize = 1 << LOWER_LOG2;

/// The digits of a place that are an axis'.
const DIGITS: [usize; 3] = [spread(DIM - 1) << 2, spread(DIM - 1) << 1, spread(DIM - 1)];

/// Each number below [`DIM`] with two zeros before each of its digits: looked up, as that takes a
/// dozen instructions.
const SPREAD: [usize; DIM] = {
    let mut table = [0; DIM];
    let mut i = 0;
    while i < DIM {
        table[i] = spread(i);
        i += 1;
    }
    table
};

const fn spread(i: usize) -> usize {
    let mut spread = 0;
    let mut digit = 0;
    while digit < LOWER_LOG2 {
        spread |= (i >> digit & 1) << (3 * digit);
        digit += 1;
    }
    spread
}

/// Returns the place of a cell, given in cells, within its node.
#[inline] // bench: lookup
pub(super) fn place(cell: IVec3) -> usize {
    let digits = |x: i32| SPREAD[x.cast_unsigned() as usize % DIM];
    digits(cell.x) << 2 | digits(cell.y) << 1 | digits(cell.z)
}

/// Returns the cell at a place, in cells from the node's first.
pub(super) fn cell_at(place: usize) -> IVec3 {
    let mut cell = IVec3::ZERO;
    for digit in 0..3 * LOWER_LOG2 {
        let is_set = place >> digit & 1 == 1;
        cell[2 - digit as usize % 3] |= i32::from(is_set) << (digit / 3);
    }
    cell
}

/// Returns the place of the next cell up along `axis`, after the last one that of the first; digits
/// above those of a place stay.
#[inline] // bench: traversal
pub(super) fn up(place: usize, axis: usize) -> usize {
    let digits = DIGITS[axis];
    // Ones between the digits hand on the carry.
    ((place | !digits).wrapping_add(1) & digits) | (place & !digits)
}

/// Returns what turns a place around on the axes where `mirror` is −1 and not 0.
#[inline] // bench: frame
pub(super) fn mirrored(mirror: IVec3) -> usize {
    let digits = |axis: usize| DIGITS[axis] & (mirror[axis] as isize).cast_unsigned();
    digits(0) | digits(1) | digits(2)
}

/// Returns `[x][y][z]` slots of a node, z fastest, in the order of their places.
pub(super) fn slots() -> Vec<usize> {
    let slot = |place| {
        let c = cell_at(place).as_uvec3();
        ((c.x << LOWER_LOG2 | c.y) << LOWER_LOG2 | c.z) as usize
    };
    (0..LOWER_LEN).map(slot).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_and_cells_are_one_to_one() {
        for i in 0..LOWER_LEN {
            let cell = cell_at(i);
            assert!(cell.cmpge(IVec3::ZERO).all() && cell.cmplt(IVec3::splat(16)).all());
            assert_eq!(place(cell), i);
            assert_eq!(place(cell - 32), i, "of the node, wherever that is");
        }
        assert_eq!(cell_at(1), IVec3::Z);
        assert_eq!(cell_at(0b110_000), IVec3::new(2, 2, 0));
        let mut slots = slots();
        assert_eq!(slots[0b110_001], 2 << 8 | 2 << 4 | 1);
        slots.sort_unstable();
        assert!(slots.into_iter().eq(0..LOWER_LEN));
    }

    #[test]
    fn steps_go_up_by_one_cell_and_mirrors_around() {
        let node = 7 * LOWER_LEN;
        for i in 0..LOWER_LEN {
            let cell = cell_at(i);
            for (axis, step) in [IVec3::X, IVec3::Y, IVec3::Z].into_iter().enumerate() {
                assert_eq!(up(node + i, axis), node + place(cell + step));
                let around = cell ^ -step;
                assert_eq!(i ^ mirrored(-step), place(around));
            }
        }
    }
}

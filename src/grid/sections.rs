//! Nodes, tiles, bounds and ranges of a grid as bytes, for files that hold a grid ready to render.
//!
//! ```text
//! counts    roots, tiles, upper nodes, upper entries, lower nodes, ranges    6 u64
//! roots     origin 3 i32, slot u32, bound 3 f32
//! tiles     value f32
//! entries   index u64, slot u32, bound 3 f32     slots of upper nodes that are not background
//! lower     origin 3 i32 of each node; then 4096 slots u32 of each; then 4096 bounds
//! ranges    min f32, step f32 of each brick
//! ```
//!
//! Everything refers to everything by index, so the bytes mean the same wherever they lie. They are
//! not trusted: every length, index and number is checked when read. Values are not here, nor what
//! is quickly derived.

use bytemuck::{NoUninit, Pod, Zeroable};
use glam::IVec3;
use memmap2::Mmap;

use super::bounds::{Bound, Bounds};
use super::density::{DensityGrid, GridTooLarge};
use super::encoding::Encoding;
use super::tree::{
    LOWER_LEN, LOWER_TOTAL_LOG2, RootCell, Slot, Tile, Tree, UPPER_LEN, UPPER_TOTAL_LOG2,
};
use super::values::{Range, Values};
use crate::space::IndexTransform;

/// Most upper nodes: 4096³ voxels each. Their slots take 64 GB then.
const MAX_UPPERS: u64 = 1 << 17;

#[derive(Clone, Copy, Pod, Zeroable)]
#[repr(C)]
struct Counts {
    roots: u64,
    tiles: u64,
    uppers: u64,
    entries: u64,
    lowers: u64,
    ranges: u64,
}

#[derive(Clone, Copy, Pod, Zeroable)]
#[repr(C)]
struct Root {
    origin: [i32; 3],
    slot: Slot,
    bound: [f32; 3],
}

#[derive(Clone, Copy, Pod, Zeroable)]
#[repr(C)]
struct Entry {
    index: [u32; 2],
    slot: Slot,
    bound: [f32; 3],
}

fn bound_bytes(bound: &Bound) -> [f32; 3] {
    let Bound { min, max, mean } = *bound;
    [min, max, mean]
}

/// Prepares a tree whose bricks' values are apart from it, and writes what is not values.
pub(crate) fn write(
    tree: Tree<f32>,
    values: Values,
    max_bytes: usize,
) -> Result<Vec<u8>, GridTooLarge> {
    let (tree, values, bounds) = DensityGrid::prepare(tree, values, max_bytes)?;
    let Bounds {
        root, upper, lower, ..
    } = &bounds;
    let roots = tree.root.iter().zip(root).map(|(cell, bound)| Root {
        origin: cell.origin.to_array(),
        slot: cell.slot,
        bound: bound_bytes(bound),
    });
    let usual = (Slot::BACKGROUND, Bound::constant(tree.background()));
    let slots = (0_u64..).zip(tree.upper.iter().copied().zip(upper.iter().copied()));
    let entries: Vec<_> = slots
        .filter(|&(_, entry)| entry != usual)
        .map(|(i, (slot, bound))| Entry {
            index: bytemuck::cast(i.to_le_bytes()),
            slot,
            bound: bound_bytes(&bound),
        })
        .collect();
    let ranges = values.ranges();
    let counts = Counts {
        roots: tree.root.len() as u64,
        tiles: tree.tiles.len() as u64,
        uppers: (tree.upper.len() / UPPER_LEN) as u64,
        entries: entries.len() as u64,
        lowers: tree.lower_origins.len() as u64,
        ranges: ranges.len() as u64,
    };
    let mut out = Vec::new();
    push(&mut out, &[counts]);
    push(&mut out, &roots.collect::<Vec<_>>());
    let tiles = tree.tiles.iter().map(|t| t.value);
    push(&mut out, &tiles.collect::<Vec<_>>());
    push(&mut out, &entries);
    push(&mut out, &tree.lower_origins);
    push(&mut out, &tree.lower);
    for bound in lower {
        push(&mut out, &bound_bytes(bound));
    }
    push(&mut out, ranges);
    Ok(out)
}

fn push<T: NoUninit>(out: &mut Vec<u8>, items: &[T]) {
    out.extend_from_slice(bytemuck::cast_slice(items));
}

/// Reads what [`write`] wrote and puts it together with the values.
///
/// # Errors
/// In words, if anything in `bytes` is not as [`write`] writes it.
pub(crate) fn read(
    bytes: &[u8],
    encoding: Encoding,
    payload: Mmap,
    transform: IndexTransform,
) -> Result<DensityGrid, String> {
    let mut left = Sections(bytes);
    let [counts] = left.take::<Counts>(1)?[..] else {
        return Err("the counts are missing".to_owned());
    };
    let roots = left.take::<Root>(counts.roots)?;
    let tiles = left.take::<f32>(counts.tiles)?;
    let entries = left.take::<Entry>(counts.entries)?;
    let lower_origins = left.take::<IVec3>(counts.lowers)?;
    let slots = counts.lowers.saturating_mul(LOWER_LEN as u64);
    let lower = left.take::<Slot>(slots)?;
    let lower_bounds = left.take::<[f32; 3]>(slots)?;
    let ranges = left.take::<Range>(counts.ranges)?;
    if !left.0.is_empty() {
        return Err(format!("{} bytes too many", left.0.len()));
    }
    if counts.uppers > MAX_UPPERS {
        return Err(format!(
            "{} upper nodes, expected 131072 at most",
            counts.uppers
        ));
    }
    check_numbers(&tiles, &ranges)?;
    let values = Values::from_encoded(encoding, payload, ranges)
        .ok_or("the number of ranges is not that of the bricks")?;
    let background = *tiles.first().ok_or("there is no background")?;
    #[expect(
        clippy::cast_possible_truncation,
        reason = "at most 2^17 uppers, and u64 else"
    )]
    let (upper_len, lower_count) = (counts.uppers as usize * UPPER_LEN, counts.lowers as usize);

    let check = |slot: Slot, children: usize, what: &str| match slot.get() {
        Ok(child) if child >= children => Err(format!("{what} {child} of {children}")),
        Err(tile) if tile >= tiles.len() => Err(format!("tile {tile} of {}", tiles.len())),
        _ => Ok(slot),
    };
    let uppers = upper_len / UPPER_LEN;
    let mut root = Vec::with_capacity(roots.len());
    let mut root_bounds = Vec::with_capacity(roots.len());
    for Root {
        origin,
        slot,
        bound,
    } in roots
    {
        let origin = IVec3::from_array(origin);
        if origin & ((1 << UPPER_TOTAL_LOG2) - 1) != IVec3::ZERO {
            return Err(format!("a root cell at {origin}"));
        }
        let slot = check(slot, uppers, "upper node")?;
        root.push(RootCell { origin, slot });
        root_bounds.push(to_bound(bound)?);
    }
    if !root.is_sorted_by(|a, b| a.origin.to_array() < b.origin.to_array()) {
        return Err("root cells out of order".to_owned());
    }
    let mut upper = vec![Slot::BACKGROUND; upper_len];
    let mut upper_bounds = vec![Bound::constant(background); upper_len];
    for Entry { index, slot, bound } in entries {
        let index = u64::from_le_bytes(bytemuck::cast(index));
        let index = usize::try_from(index).ok().filter(|&i| i < upper_len);
        let index = index.ok_or("a slot that no upper node has")?;
        upper[index] = check(slot, lower_count, "lower node")?;
        upper_bounds[index] = to_bound(bound)?;
    }
    let aligned = |o: &IVec3| *o & ((1 << LOWER_TOTAL_LOG2) - 1) == IVec3::ZERO;
    if !lower_origins.iter().all(aligned) {
        return Err("a lower node between others".to_owned());
    }
    for &slot in &lower {
        check(slot, values.brick_count(), "brick")?;
    }
    let lower_bounds = lower_bounds.into_iter().map(to_bound);
    let lower_bounds = lower_bounds.collect::<Result<Vec<_>, _>>()?;
    let tiles = tiles.into_iter().map(|value| Tile {
        value,
        active: false,
    });
    let tree = Tree::from_nodes(root, upper, lower, tiles.collect(), lower_origins);
    let bounds = Bounds::from_cells(&tree, root_bounds, upper_bounds, lower_bounds);
    Ok(DensityGrid::from_parts(tree, values, bounds, transform))
}

fn check_numbers(tiles: &[f32], ranges: &[Range]) -> Result<(), String> {
    // The policy for values: finite and not negative.
    let fine = |v: f32| (0.0..f32::INFINITY).contains(&v);
    if let Some(value) = tiles.iter().find(|v| !fine(**v)) {
        return Err(format!("a tile of {value}"));
    }
    let range_fine = |r: &&Range| !(fine(r.min) && fine(r.step) && fine(r.min + 65535.0 * r.step));
    match ranges.iter().find(range_fine) {
        Some(Range { min, step }) => Err(format!("a range from {min} in steps of {step}")),
        None => Ok(()),
    }
}

fn to_bound([min, max, mean]: [f32; 3]) -> Result<Bound, String> {
    if 0.0 <= min && min <= mean && mean <= max && max.is_finite() {
        Ok(Bound { min, max, mean })
    } else {
        Err(format!("a bound from {min} to {max} with mean {mean}"))
    }
}

/// What is left to read.
struct Sections<'a>(&'a [u8]);

impl Sections<'_> {
    /// Copies the next `count` items; their bytes are there before anything is allocated.
    fn take<T: Pod>(&mut self, count: u64) -> Result<Vec<T>, String> {
        let size = usize::try_from(count)
            .ok()
            .and_then(|n| n.checked_mul(size_of::<T>()));
        let (bytes, rest) = size
            .and_then(|n| self.0.split_at_checked(n))
            .ok_or_else(|| format!("{count} items where {} bytes are left", self.0.len()))?;
        self.0 = rest;
        Ok(bytemuck::pod_collect_to_vec(bytes))
    }
}

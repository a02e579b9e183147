//! How often rays come back to the memory they have read: bricks and cache lines, by their places.
//!
//! Counted, not measured: no cache of any machine is asked. Whether a brick was among the last `N`
//! different ones is what decides, roughly, whether a cache of `N` bricks still holds it.

use glam::{DVec3, IVec3};
use serde::Serialize;

use majorant::grid::brick;
use majorant::space::floor_to_voxel;

/// Sizes of memory, in bricks, that are asked for.
pub(super) const MEMORIES: [usize; 6] = [1, 4, 16, 64, 256, 1024];

/// Bytes of a cache line.
const LINE: usize = 64;

/// Reads of voxel values, and what they touched.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub(super) struct Reuse {
    /// Single values read: those of cells that were integrated are not followed.
    pub(super) reads: u64,
    /// Paths that read any.
    pub(super) paths: u64,
    /// Tiles of the image.
    pub(super) tiles: u64,
    /// Different bricks, added up over paths.
    pub(super) bricks_of_paths: u64,
    /// Different cache lines of values, added up over paths.
    pub(super) lines_of_paths: u64,
    /// Different cells of the bounds, added up over paths.
    pub(super) cells_of_paths: u64,
    /// Different bricks, added up over tiles.
    pub(super) bricks_of_tiles: u64,
    /// Reads whose brick was among the last 1, 4, 16, 64, 256, 1024 different ones.
    pub(super) found: [u64; MEMORIES.len()],
}

/// A brick of a medium.
type Brick = (usize, [i32; 3]);

/// Follows reads.
#[derive(Debug, Default)]
pub(super) struct Follower {
    pub(super) reuse: Reuse,
    /// The last different bricks, the last one last.
    recent: Vec<Brick>,
    path: Touched,
    tile_bricks: Vec<Brick>,
}

#[derive(Debug, Default)]
struct Touched {
    bricks: Vec<Brick>,
    lines: Vec<(Brick, usize)>,
    cells: Vec<Brick>,
}

impl Follower {
    /// Takes the step of a ray onto the cell that holds `p`, in index space.
    pub(super) fn step(&mut self, medium: usize, p: DVec3) {
        let cell = brick::origin(floor_to_voxel(p));
        self.path.cells.push((medium, cell.to_array()));
    }

    /// Takes a read of a value of `value_bytes` bytes.
    pub(super) fn read(&mut self, medium: usize, voxel: IVec3, value_bytes: usize) {
        let at: Brick = (medium, brick::origin(voxel).to_array());
        self.reuse.reads += 1;
        let found = self.recent.iter().rposition(|&recent| recent == at);
        if let Some(place) = found {
            let distance = self.recent.len() - place;
            for (count, memory) in self.reuse.found.iter_mut().zip(MEMORIES) {
                *count += u64::from(distance <= memory);
            }
            self.recent.remove(place);
        } else if self.recent.len() == MEMORIES[MEMORIES.len() - 1] {
            self.recent.remove(0);
        }
        self.recent.push(at);
        self.path.bricks.push(at);
        let line = brick::offset(voxel) * value_bytes / LINE;
        self.path.lines.push((at, line));
    }

    /// Ends a path.
    pub(super) fn end_path(&mut self) {
        let Touched {
            bricks,
            lines,
            cells,
        } = &mut self.path;
        if !bricks.is_empty() {
            self.reuse.paths += 1;
        }
        self.reuse.bricks_of_paths += distinct(bricks);
        self.reuse.lines_of_paths += distinct(lines);
        self.reuse.cells_of_paths += distinct(cells);
        self.tile_bricks.append(bricks);
        lines.clear();
        cells.clear();
    }

    /// Ends a tile of the image.
    pub(super) fn end_tile(&mut self) {
        self.reuse.tiles += 1;
        self.reuse.bricks_of_tiles += distinct(&mut self.tile_bricks);
        self.tile_bricks.clear();
    }
}

/// Keeps one of each and counts them.
fn distinct<T: Ord>(all: &mut Vec<T>) -> u64 {
    all.sort_unstable();
    all.dedup();
    all.len() as u64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn distances_are_those_of_a_stack_of_bricks() {
        let mut follower = Follower::default();
        // Bricks A B A C B: A again after 2 different ones, B after 3.
        for x in [0, 8, 7, 16, 9] {
            follower.read(0, IVec3::new(x, 0, 0), 4);
        }
        // The same place in another medium is another brick.
        follower.read(1, IVec3::new(9, 0, 0), 4);
        follower.end_path();
        follower.end_tile();
        let Reuse {
            reads,
            bricks_of_paths,
            bricks_of_tiles,
            lines_of_paths,
            found,
            ..
        } = follower.reuse;
        assert_eq!((reads, bricks_of_paths, bricks_of_tiles), (6, 4, 4));
        assert_eq!(found, [0, 2, 2, 2, 2, 2]);
        // x is the slowest axis: 64 values of 4 bytes to the next, so each is a line of its own.
        assert_eq!(lines_of_paths, 6);
    }
}

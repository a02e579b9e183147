//! A rectangle of batches that grows pass by pass.
//!
//! Every pixel remembers which sample is its next. A pass that is broken off anywhere leaves a
//! state like any other: going on from it takes the samples that are missing, in order, so the
//! sums are the same bits as if nothing had happened.
//!
//! Stored tile by tile, so that threads fill their own tiles in place.

use std::ops::RangeInclusive;

use super::{Batch, Film, Pixel, PixelCost, Region};
use crate::aov::Planes;

/// Pixels along a tile's edge: small enough to balance two threads, large enough that the
/// rays of a tile read the same bricks.
const TILE: u32 = 16;

/// One pixel of an [`Accumulation`].
#[derive(Clone, Copy, Debug, Default)]
pub struct Cell {
    /// Sums over the samples so far.
    pub batch: Batch,
    /// Index of the next sample.
    pub next: u64,
    /// What the samples cost.
    pub cost: PixelCost,
}

/// A rectangle of pixels that one thread fills.
#[derive(Clone, Debug)]
pub struct Tile {
    region: Region,
    /// Of the whole image.
    columns: u32,
    cells: Vec<Cell>,
    /// Sums of output variables, `[cell][channel]`.
    sums: Vec<f64>,
    /// Where the pixels of half 0 and half 1 go on; `None`: not known since they were changed.
    going_on: Option<[GoingOn; 2]>,
}

/// Where the pixels of a half go on.
#[derive(Clone, Copy, Debug, Default)]
struct GoingOn {
    pixels: u64,
    /// Indices of their next samples.
    least: u64,
    largest: u64,
}

impl Tile {
    /// Returns each pixel's column and row in the image, with its cell and its sums of output
    /// variables. [`settle`](Self::settle) when done.
    pub fn cells_and_sums_mut(
        &mut self,
    ) -> impl Iterator<Item = (u32, u32, &mut Cell, &mut [f64])> {
        self.going_on = None;
        let channels = self.sums.len() / self.cells.len().max(1);
        let mut rest = &mut self.sums[..];
        let Region { min, max } = self.region;
        let places = (min[1]..max[1]).flat_map(move |y| (min[0]..max[0]).map(move |x| (x, y)));
        places.zip(&mut self.cells).map(move |((x, y), cell)| {
            let (sums, others) = std::mem::take(&mut rest).split_at_mut(channels);
            rest = others;
            (x, y, cell, sums)
        })
    }

    /// Looks once, while the cells are in a cache, at where they go on, for all that will ask: a pass
    /// over 129,600 pixels asks four times, which took 10 ms of one thread.
    pub fn settle(&mut self) {
        self.going_on = Some(self.going_on());
    }

    fn going_on(&self) -> [GoingOn; 2] {
        self.going_on.unwrap_or_else(|| {
            let mut halves = [GoingOn::default(); 2];
            for (half, next) in self.nexts() {
                let of = &mut halves[half];
                of.least = if of.pixels == 0 {
                    next
                } else {
                    of.least.min(next)
                };
                of.largest = of.largest.max(next);
                of.pixels += 1;
            }
            halves
        })
    }

    /// Returns each pixel's half, and the index of its next sample.
    fn nexts(&self) -> impl Iterator<Item = (usize, u64)> {
        let Region { min, max } = self.region;
        let places = (min[1]..max[1]).flat_map(move |y| (min[0]..max[0]).map(move |x| (x, y)));
        let columns = u64::from(self.columns);
        let halves = places.map(move |(x, y)| half_of(u64::from(y) * columns + u64::from(x)));
        halves.zip(self.cells.iter().map(|cell| cell.next))
    }
}

/// Sums over the samples of all pixels of a region, and where each goes on.
#[derive(Clone, Debug)]
pub struct Accumulation {
    full_size: [u32; 2],
    region: Region,
    first: u64,
    channels: Vec<String>,
    tiles: Vec<Tile>,
}

impl Accumulation {
    /// Bytes for a pixel.
    pub const BYTES_PER_PIXEL: u64 = size_of::<Cell>() as u64;

    /// Begins a region of an image of `full_size`, whose first sample is `first`.
    pub fn new(full_size: [u32; 2], region: Region, first: u64) -> Self {
        let empty = Cell {
            next: first,
            ..Cell::default()
        };
        let starts = |axis: usize| (region.min[axis]..region.max[axis]).step_by(TILE as usize);
        let tile = |x: u32, y: u32| {
            let end = |at: u32, axis: usize| region.max[axis].min(at.saturating_add(TILE));
            let region = Region {
                min: [x, y],
                max: [end(x, 0), end(y, 1)],
            };
            let count = region.width() as usize * region.height() as usize;
            let mut tile = Tile {
                region,
                columns: full_size[0],
                cells: vec![empty; count],
                sums: Vec::new(),
                going_on: None,
            };
            tile.settle();
            tile
        };
        Self {
            full_size,
            region,
            first,
            channels: Vec::new(),
            tiles: starts(1)
                .flat_map(|y| starts(0).map(move |x| tile(x, y)))
                .collect(),
        }
    }

    /// Makes room for the sums of `channels` of output variables.
    #[must_use]
    pub fn with_channels(mut self, channels: &[String]) -> Self {
        channels.clone_into(&mut self.channels);
        for tile in &mut self.tiles {
            tile.sums = vec![0.0; channels.len() * tile.cells.len()];
        }
        self
    }

    /// Returns which channels of output variables are summed.
    pub fn channels(&self) -> &[String] {
        &self.channels
    }

    /// Returns the sums of output variables of all pixels, row by row from the top.
    pub(super) fn sums(&self) -> impl Iterator<Item = &[f64]> {
        let Region { min, max } = self.region;
        let channels = self.channels.len();
        (min[1]..max[1]).flat_map(move |y| {
            self.row_of_tiles(y).iter().flat_map(move |tile| {
                let width = tile.region.width() as usize;
                let start = (y - tile.region.min[1]) as usize * width;
                (start..start + width).map(move |i| &tile.sums[i * channels..(i + 1) * channels])
            })
        })
    }

    /// Returns columns and rows of the whole image.
    pub fn full_size(&self) -> [u32; 2] {
        self.full_size
    }

    /// Returns which part of the image this is.
    pub fn region(&self) -> Region {
        self.region
    }

    /// Returns the index of the first sample.
    pub fn first(&self) -> u64 {
        self.first
    }

    /// Returns the tiles, to be filled.
    pub fn tiles_mut(&mut self) -> &mut [Tile] {
        &mut self.tiles
    }

    /// Returns all cells, row by row from the top.
    pub fn cells(&self) -> impl Iterator<Item = &Cell> {
        let Region { min, max } = self.region;
        (min[1]..max[1]).flat_map(move |y| {
            let row = self.row_of_tiles(y);
            row.iter().flat_map(move |tile| {
                let width = tile.region.width() as usize;
                let start = (y - tile.region.min[1]) as usize * width;
                &tile.cells[start..start + width]
            })
        })
    }

    /// Returns all cells for writing, tile by tile, each with column and row in the image, and with
    /// its sums.
    pub(super) fn cells_and_sums_mut(
        &mut self,
    ) -> impl Iterator<Item = (u32, u32, &mut Cell, &mut [f64])> {
        self.tiles.iter_mut().flat_map(Tile::cells_and_sums_mut)
    }

    fn row_of_tiles(&self, y: u32) -> &[Tile] {
        let across = self.region.width().div_ceil(TILE) as usize;
        let down = ((y - self.region.min[1]) / TILE) as usize;
        &self.tiles[down * across..(down + 1) * across]
    }

    /// Returns how many samples are missing until all pixels of half 0 and half 1 (see
    /// [`half_of`]) have those below `until`.
    pub fn missing(&self, until: [u64; 2]) -> u64 {
        let missing = |tile: &Tile, half: usize, of: GoingOn| {
            if of.least == of.largest {
                return of.pixels * until[half].saturating_sub(of.least);
            }
            // A pass was broken off here.
            let nexts = tile.nexts().filter(|&(other, _)| other == half);
            nexts
                .map(|(_, next)| until[half].saturating_sub(next))
                .sum()
        };
        let of_tile = |tile: &Tile| {
            let [a, b] = tile.going_on();
            missing(tile, 0, a) + missing(tile, 1, b)
        };
        self.tiles.iter().map(of_tile).sum()
    }

    /// Returns the indices that the next samples of pixels have, from the least to the largest, of
    /// half 0 and half 1 (see [`half_of`]). A half without pixels has the first of all.
    pub fn next(&self) -> [RangeInclusive<u64>; 2] {
        [0, 1].map(|half| {
            let tiles = self.tiles.iter().map(|tile| tile.going_on()[half]);
            let ends = tiles
                .filter(|of| of.pixels > 0)
                .map(|of| (of.least, of.largest))
                .reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)));
            let (least, largest) = ends.unwrap_or((self.first, self.first));
            least..=largest
        })
    }

    /// Returns the image so far.
    pub fn film(&self) -> Film {
        let pixels: Vec<Pixel> = self.cells().map(|cell| cell.batch.pixel()).collect();
        let mut planes = Planes::new(&self.channels, pixels.len());
        if !self.channels.is_empty() {
            for (i, (pixel, sums)) in pixels.iter().zip(self.sums()).enumerate() {
                let count = pixel.count.max(1) as f64;
                for (value, sum) in planes.pixel_mut(i).iter_mut().zip(sums) {
                    #[expect(clippy::cast_possible_truncation, reason = "planes are f32")]
                    let mean = (sum / count) as f32;
                    *value = mean;
                }
            }
        }
        Film::of(self.full_size, self.region, pixels).with_planes(planes)
    }

    /// Returns what each pixel cost so far, row by row from the top.
    pub fn costs(&self) -> Vec<PixelCost> {
        self.cells().map(|cell| cell.cost).collect()
    }
}

/// Returns the half, 0 or 1, that a pixel belongs to: as good as at random, and always the same.
///
/// How many samples one half takes may depend on the noise of the other: then no pixel's count
/// depends on its own samples, and its mean keeps its expectation.
pub fn half_of(pixel: u64) -> usize {
    // Multiplication mixes upwards: the top bit depends on all others.
    let mixed = (pixel ^ (pixel >> 32)).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    let mixed = (mixed ^ (mixed >> 29)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    usize::from(mixed >> 63 == 1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::film::Sample;
    use crate::spectrum::Rgb;

    #[test]
    fn cells_are_row_by_row_whatever_the_tiles() {
        let region = Region {
            min: [5, 3],
            max: [45, 40],
        };
        let mut state = Accumulation::new([50, 60], region, 7);
        assert_eq!(state.missing([9, 9]), 2 * 40 * 37);
        assert_eq!(state.missing([5, 5]), 0);
        for tile in state.tiles_mut() {
            for (x, y, cell, _) in tile.cells_and_sums_mut() {
                cell.batch.add(&Sample {
                    radiance: Rgb([x as f32, y as f32, 0.0]),
                    ..Sample::default()
                });
                cell.next += 1;
            }
        }
        assert_eq!(state.next(), [8..=8, 8..=8]);
        for tile in state.tiles_mut() {
            tile.settle();
        }
        assert_eq!(state.next(), [8..=8, 8..=8]);
        assert_eq!(state.missing([9, 9]), 40 * 37);
        let film = state.film();
        assert_eq!(
            (film.width(), film.height(), film.full_size()),
            (40, 37, [50, 60])
        );
        for (i, pixel) in (0_u32..).zip(film.pixels()) {
            let (x, y) = (5 + i % 40, 3 + i / 40);
            assert_eq!(pixel.mean, [f64::from(x), f64::from(y), 0.0], "pixel {i}");
        }
    }

    #[test]
    fn samples_are_counted_where_a_pass_was_broken_off() {
        let region = Region {
            min: [1, 2],
            max: [40, 21],
        };
        let mut state = Accumulation::new([50, 60], region, 7);
        let next = |x: u32, y: u32| u64::from(7 + (x * y) % 4 * u32::from(x < 20));
        for tile in state.tiles_mut() {
            for (x, y, cell, _) in tile.cells_and_sums_mut() {
                cell.next = next(x, y);
            }
            tile.settle();
        }
        let until = [9_u64, 11];
        let (mut missing, mut ends) = (0, [(u64::MAX, 0); 2]);
        for (y, x) in (2..21).flat_map(|y| (1..40).map(move |x| (y, x))) {
            let (half, next) = (half_of(u64::from(y * 50 + x)), next(x, y));
            missing += until[half].saturating_sub(next);
            ends[half] = (ends[half].0.min(next), ends[half].1.max(next));
        }
        assert_eq!(state.missing(until), missing);
        assert_eq!(state.next(), ends.map(|(least, largest)| least..=largest));
    }

    /// Half of 10⁶ pixels, give or take 5 standard deviations of 500; neighbours, across and down
    /// in an image of 1000 columns, are in one half as often as not.
    #[test]
    fn halves_are_halves_and_do_not_follow_rows() {
        let n = 1_000_000_u64;
        let ones = (0..n).filter(|&p| half_of(p) == 1).count();
        assert!(ones.abs_diff(500_000) < 2_500, "{ones}");
        for step in [1, 2, 16, 1000] {
            let same = (0..n).filter(|&p| half_of(p) == half_of(p + step)).count();
            assert!(
                same.abs_diff(500_000) < 5_000,
                "{same} at a distance of {step}"
            );
        }
    }
}

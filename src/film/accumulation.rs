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
    cells: Vec<Cell>,
    /// Sums of output variables, `[cell][channel]`.
    sums: Vec<f64>,
}

impl Tile {
    /// Returns each pixel's column and row in the image, with its cell and its sums of output
    /// variables.
    pub fn cells_and_sums_mut(
        &mut self,
    ) -> impl Iterator<Item = (u32, u32, &mut Cell, &mut [f64])> {
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
            Tile {
                region,
                cells: vec![empty; count],
                sums: Vec::new(),
            }
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
        let mut total = 0;
        for tile in &self.tiles {
            let Region { min, max } = tile.region;
            let places = (min[1]..max[1]).flat_map(|y| (min[0]..max[0]).map(move |x| (x, y)));
            for ((x, y), cell) in places.zip(&tile.cells) {
                total += until[self.half_at(x, y)].saturating_sub(cell.next);
            }
        }
        total
    }

    /// Returns the indices that the next samples of pixels have, from the least to the largest, of
    /// half 0 and half 1 (see [`half_of`]). A half without pixels has the first of all.
    pub fn next(&self) -> [RangeInclusive<u64>; 2] {
        let mut ends: [Option<(u64, u64)>; 2] = [None; 2];
        for tile in &self.tiles {
            let Region { min, max } = tile.region;
            let places = (min[1]..max[1]).flat_map(|y| (min[0]..max[0]).map(move |x| (x, y)));
            for ((x, y), Cell { next, .. }) in places.zip(&tile.cells) {
                let (least, largest) = ends[self.half_at(x, y)].get_or_insert((*next, *next));
                *least = (*least).min(*next);
                *largest = (*largest).max(*next);
            }
        }
        ends.map(|ends| {
            let (least, largest) = ends.unwrap_or((self.first, self.first));
            least..=largest
        })
    }

    fn half_at(&self, x: u32, y: u32) -> usize {
        half_of(u64::from(y) * u64::from(self.full_size[0]) + u64::from(x))
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

//! An accumulation as bytes, so that an interrupted frame goes on in another process.
//!
//! One line of JSON; then 112 bytes a pixel, little endian, row by row: the index of its next
//! sample and its [`Batch`], bit by bit, and 8 for each channel of output variables; then a checksum of the pixels. The batch and not the
//! mean: sums that were divided would not go on to the same bits.

use std::io::{self, BufRead, Read as _, Write};

use serde::{Deserialize, Serialize};

use super::{Accumulation, Batch, Region};
use crate::stats::Counts;

/// Numbers for a pixel, of eight bytes each.
const WORDS: usize = 1 + Batch::WORDS;

/// Longest first line: far above any, far below what would hurt.
const MAX_HEADER: u64 = 1 << 16;

/// A checkpoint that cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CheckpointError {
    /// It cannot be read to its end, or not be written.
    #[error("{0}")]
    Io(#[from] io::Error),
    /// The first line cannot be read, or written.
    #[error("the first line is not a checkpoint's")]
    Header(#[from] serde_json::Error),
    /// The image's size is none.
    #[error("a region of {0:?} in an image of {1:?} pixels")]
    Size([u32; 4], [u32; 2]),
    /// Its pixels are not those that were written.
    #[error("the checksum differs")]
    Checksum,
}

/// What is known of a frame in progress beside its samples.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Checkpoint {
    /// Whose it is: all that must be the same to go on.
    pub key: String,
    /// What the rays did so far.
    pub counts: Counts,
    /// Wall-clock seconds that it took.
    pub render_secs: f64,
    /// Samples that are enough in each half of the pixels, once that is known.
    pub enough: Option<[u64; 2]>,
}

#[derive(Serialize, Deserialize)]
struct Header<T> {
    about: T,
    full_size: [u32; 2],
    /// First column and row, and those after the last.
    region: [u32; 4],
    first: u64,
    /// Channels of output variables, whose sums follow those of each pixel.
    channels: Vec<String>,
}

impl Checkpoint {
    /// Writes this and the samples.
    ///
    /// # Errors
    /// If `out` cannot be written.
    pub fn write_to(
        &self,
        state: &Accumulation,
        out: &mut (impl Write + ?Sized),
    ) -> Result<(), CheckpointError> {
        let Region { min, max } = state.region();
        let header = Header {
            about: self,
            full_size: state.full_size(),
            region: [min[0], min[1], max[0], max[1]],
            first: state.first(),
            channels: state.channels().to_vec(),
        };
        serde_json::to_writer(&mut *out, &header)?;
        out.write_all(b"\n")?;
        let mut checksum = Checksum::new();
        let mut bytes = Vec::with_capacity(8 * WORDS);
        for (cell, sums) in state.cells().zip(state.sums()) {
            bytes.clear();
            let batch = std::iter::once(cell.next).chain(cell.batch.to_words());
            for word in batch.chain(sums.iter().map(|sum| sum.to_bits())) {
                checksum.add(word);
                bytes.extend(word.to_le_bytes());
            }
            out.write_all(&bytes)?;
        }
        out.write_all(&checksum.0.to_le_bytes())?;
        Ok(())
    }

    /// Reads what [`Self::write_to`] wrote, of at most `max_pixels`.
    ///
    /// # Errors
    /// If it is not whole, or says what cannot be.
    pub fn read_from(
        input: &mut impl BufRead,
        max_pixels: u64,
    ) -> Result<(Self, Accumulation), CheckpointError> {
        let mut line = Vec::new();
        input
            .by_ref()
            .take(MAX_HEADER)
            .read_until(b'\n', &mut line)?;
        let header: Header<Self> = serde_json::from_slice(&line)?;
        let [x0, y0, x1, y1] = header.region;
        let region = Region {
            min: [x0, y0],
            max: [x1, y1],
        };
        let [width, height] = header.full_size;
        let is_valid = region.within(width, height) == Some(region)
            && u64::from(region.width()) * u64::from(region.height()) <= max_pixels;
        if !is_valid {
            return Err(CheckpointError::Size(header.region, header.full_size));
        }
        let mut words = Vec::new();
        let mut checksum = Checksum::new();
        let count = region.width() as usize * region.height() as usize;
        let channels = header.channels.len();
        let mut bytes = vec![0; 8 * (WORDS + channels)];
        for _ in 0..count {
            // Grows as the file does: a short one takes no more than it has.
            input.read_exact(&mut bytes)?;
            for &bytes in bytes.as_chunks().0 {
                checksum.add(word(bytes));
                words.push(word(bytes));
            }
        }
        let mut last = [0; 8];
        input.read_exact(&mut last)?;
        if word(last) != checksum.0 {
            return Err(CheckpointError::Checksum);
        }
        let state = Accumulation::new(header.full_size, region, header.first);
        let mut state = state.with_channels(&header.channels);
        for (x, y, cell, sums) in state.cells_and_sums_mut() {
            let at = (y - y0) as usize * region.width() as usize + (x - x0) as usize;
            let pixel = &words[at * (WORDS + channels)..][..WORDS + channels];
            cell.next = pixel[0];
            cell.batch = Batch::from_words(std::array::from_fn(|i| pixel[1 + i]));
            for (sum, &word) in sums.iter_mut().zip(&pixel[WORDS..]) {
                *sum = f64::from_bits(word);
            }
        }
        Ok((header.about, state))
    }
}

fn word(bytes: [u8; 8]) -> u64 {
    u64::from_le_bytes(bytes)
}

/// A checksum of eight bytes at a time: finds damage, not malice.
///
/// # Reference
/// `[Fowler2019]`: FNV-1a, by words instead of bytes, with the state turned so that high bits
/// reach low ones.
struct Checksum(u64);

impl Checksum {
    fn new() -> Self {
        Self(0xcbf2_9ce4_8422_2325)
    }

    fn add(&mut self, word: u64) {
        self.0 = (self.0 ^ word)
            .wrapping_mul(0x0100_0000_01b3)
            .rotate_left(29);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::film::Sample;
    use crate::spectrum::Rgb;

    fn checkpoint() -> (Checkpoint, Accumulation) {
        let region = Region {
            min: [2, 1],
            max: [20, 4],
        };
        let state = Accumulation::new([21, 5], region, 8);
        let mut state = state.with_channels(&["a", "b", "c", "d"].map(str::to_owned));
        for (i, (_, _, cell, sums)) in state.cells_and_sums_mut().enumerate() {
            sums[i % 4] = (i as f64).sqrt();
            for sample in 0..i % 4 {
                let x = (i as f32 * 0.37 + sample as f32).sin();
                cell.batch.add(&Sample {
                    radiance: Rgb([x, x * x, 1e-30]),
                    opacity: 0.1 + 0.2,
                    depth: f64::from(x).exp(),
                    depth_weight: 1.0 / 3.0,
                });
                cell.next += 1;
            }
        }
        let counts = Counts {
            lookups: u64::MAX,
            ..Counts::default()
        };
        let about = Checkpoint {
            key: "two\n\"lines\"".to_owned(),
            counts,
            render_secs: 0.1 + 0.2,
            enough: Some([3, 4]),
        };
        (about, state)
    }

    fn bytes((about, state): &(Checkpoint, Accumulation)) -> Vec<u8> {
        let mut bytes = Vec::new();
        about.write_to(state, &mut bytes).unwrap();
        bytes
    }

    #[test]
    fn every_bit_survives() {
        let before = checkpoint();
        let written = bytes(&before);
        let after = Checkpoint::read_from(&mut &written[..], 1000).unwrap();
        assert_eq!(after.0, before.0);
        assert_eq!(after.1.region(), before.1.region());
        assert_eq!(bytes(&after), written);
        assert_eq!(after.1.film(), before.1.film());
    }

    #[test]
    fn damage_is_an_error() {
        let written = bytes(&checkpoint());
        let read = |bytes: &[u8]| Checkpoint::read_from(&mut &bytes[..], 1000);
        for len in 0..written.len() {
            assert!(read(&written[..len]).is_err(), "cut at {len}");
        }
        let start = written.iter().position(|&b| b == b'\n').unwrap() + 1;
        for at in start..written.len() {
            let mut damaged = written.clone();
            damaged[at] ^= 0x10;
            assert!(read(&damaged).is_err(), "changed at {at}");
        }
        let text = String::from_utf8_lossy(&written).replace("[21,5]", "[21,4294967295]");
        let huge = text.replace("[2,1,20,4]", "[0,0,21,4294967295]");
        assert!(read(huge.as_bytes()).is_err(), "a huge picture");
        assert!(read(b"").is_err(), "nothing");
    }
}

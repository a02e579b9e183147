//! A record as bytes, so that a run can be interrupted and go on.
//!
//! One line of JSON, then 88 bytes a pixel, little endian, row by row: number of samples; mean
//! and second moment of R, G and B; collisions and mean depth; values read and null collisions.
//! Numbers survive to the last bit, so that a run that was interrupted ends as one that was not.

use serde::{Deserialize, Serialize};

use super::ladder::{Measurement, Record};
use crate::film::{Pixel, PixelCost};

/// Numbers for a pixel, of eight bytes each.
const PIXEL_WORDS: usize = 12;

/// A checkpoint that cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CheckpointError {
    /// The first line cannot be read, or written.
    #[error("the first line is not a checkpoint's")]
    Header {
        /// What the reader said.
        source: serde_json::Error,
    },
    /// It is not as long as the first line says.
    #[error("{found} bytes of pixels, expected {expected}")]
    Length {
        /// Bytes after the first line.
        found: usize,
        /// Bytes that the pixels take.
        expected: u64,
    },
}

#[derive(Serialize, Deserialize)]
struct Header {
    /// Whose checkpoint it is: anything that must be the same to go on.
    key: String,
    width: u32,
    height: u32,
    measurements: Vec<Measurement>,
}

/// Writes a record under a key that tells what it belongs to.
///
/// # Errors
/// If the first line cannot be written, which no record is known to cause.
pub fn to_bytes(key: &str, record: &Record) -> Result<Vec<u8>, CheckpointError> {
    let header = Header {
        key: key.to_owned(),
        width: record.film.width(),
        height: record.film.height(),
        measurements: record.measurements.clone(),
    };
    let mut bytes =
        serde_json::to_vec(&header).map_err(|source| CheckpointError::Header { source })?;
    bytes.push(b'\n');
    for (pixel, cost) in record.film.pixels().iter().zip(&record.costs) {
        let Pixel {
            count,
            mean,
            m2,
            opacity,
            depth_weight,
            depth_mean,
        } = pixel;
        bytes.extend(count.to_le_bytes());
        for x in mean.iter().chain(m2) {
            bytes.extend(x.to_le_bytes());
        }
        bytes.extend(opacity.to_le_bytes());
        bytes.extend(depth_weight.to_le_bytes());
        bytes.extend(depth_mean.to_le_bytes());
        bytes.extend(cost.values_read.to_le_bytes());
        bytes.extend(cost.null_collisions.to_le_bytes());
    }
    Ok(bytes)
}

/// Reads a record and its key.
///
/// # Errors
/// If the bytes are not those of a whole checkpoint.
pub fn from_bytes(bytes: &[u8]) -> Result<(String, Record), CheckpointError> {
    let end = bytes.iter().position(|&b| b == b'\n');
    let (line, pixels) = bytes.split_at(end.unwrap_or(bytes.len()));
    let pixels = pixels.get(1..).unwrap_or_default();
    let header: Header =
        serde_json::from_slice(line).map_err(|source| CheckpointError::Header { source })?;
    let count = u64::from(header.width) * u64::from(header.height);
    let expected = count.saturating_mul(8 * PIXEL_WORDS as u64);
    if pixels.len() as u64 != expected {
        let found = pixels.len();
        return Err(CheckpointError::Length { found, expected });
    }
    let mut record = Record::new(header.width, header.height);
    record.measurements = header.measurements;
    let words: Vec<u64> = pixels
        .as_chunks()
        .0
        .iter()
        .map(|&bytes| u64::from_le_bytes(bytes))
        .collect();
    let targets = record.film.pixels_mut().iter_mut().zip(&mut record.costs);
    for ((pixel, cost), words) in targets.zip(words.as_chunks::<PIXEL_WORDS>().0) {
        let number = |i: usize| f64::from_bits(words[i]);
        *pixel = Pixel {
            count: words[0],
            mean: [1, 2, 3].map(number),
            m2: [4, 5, 6].map(number),
            opacity: number(7),
            depth_weight: number(8),
            depth_mean: number(9),
        };
        *cost = PixelCost {
            values_read: words[10],
            null_collisions: words[11],
        };
    }
    Ok((header.key, record))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::converge::ladder::Seconds;
    use crate::stats::Counts;

    fn record() -> Record {
        let mut record = Record::new(3, 2);
        for (i, pixel) in (1_u32..).zip(record.film.pixels_mut()) {
            pixel.count = u64::from(i);
            pixel.mean = [f64::from(i) / 3.0, 1e300, -0.0];
            pixel.m2 = [f64::MIN_POSITIVE, 0.1 + 0.2, f64::from(i)];
            pixel.opacity = 6.5;
            pixel.depth_weight = 0.75;
            pixel.depth_mean = f64::from(i).sqrt();
        }
        record.costs[5].values_read = u64::MAX;
        record.measurements.push(Measurement {
            spp: 1,
            repeat: 0,
            secs: Seconds {
                cpu: 0.1 + 0.2,
                wall: 1.0 / 3.0,
            },
            first_tile_secs: 5e-324,
            counts: Counts::default(),
            errors: None,
            flip: Some(0.123_456_789_012_345_67),
        });
        record
    }

    #[test]
    fn every_bit_survives() {
        let record = record();
        let (key, read) =
            from_bytes(&to_bytes("a \"key\"\nof two lines", &record).unwrap()).unwrap();
        assert_eq!(key, "a \"key\"\nof two lines");
        assert_eq!(read, record);
    }

    #[test]
    fn damage_is_an_error() {
        let whole = to_bytes("k", &record()).unwrap();
        for len in 0..whole.len() {
            assert!(from_bytes(&whole[..len]).is_err(), "cut at {len}");
        }
        let text = String::from_utf8_lossy(&whole).replace("\"width\":3", "\"width\":4294967295");
        assert!(from_bytes(text.as_bytes()).is_err(), "a huge picture");
    }
}

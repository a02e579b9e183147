//! The voxel values of all bricks, as rendering reads them: encoded, in one run of bytes.
//!
//! ```text
//! brick b    512 codes of 4, 2, 2 or 1 bytes, little endian, [x][y][z], z fastest
//! f32, f16   the code is the value
//! u16, u8    value = min + step · code, both of the brick: ranges[b]
//! ```
//!
//! In f32 arithmetic, so decoding is monotone; code 0 is the brick's minimum exactly, and a
//! brick of one value, zero above all, is exact. The highest code is at most 2⁻²² below the
//! brick's maximum, and never above. The bytes are a mapping: of anonymous memory, or of a cache
//! file whose bricks come in when they are first read. Which brick holds a voxel is the tree's
//! business; values must be finite, and not negative for `f16`.

use std::io;
use std::ops::Deref;

use half::f16;
use memmap2::{Mmap, MmapMut};
use rayon::prelude::*;

use super::brick::BRICK_LEN;
use super::encoding::Encoding;
use super::tree::Tree;

/// Bricks that are encoded before their originals are given back: 16 MB of `f32`.
const CHUNK: usize = 8192;

/// How the codes of a brick become values.
#[derive(Clone, Copy, Debug, Default, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(C)]
pub(crate) struct Range {
    pub(crate) min: f32,
    pub(crate) step: f32,
}

impl Range {
    #[inline] // bench: lookup
    fn decode(self, code: u16) -> f32 {
        self.min + self.step * f32::from(code)
    }

    /// Returns the range whose codes 0 to `most` reach from `min` to `max`.
    fn new(min: f32, max: f32, most: u16) -> Self {
        #[expect(clippy::cast_possible_truncation, reason = "rounding to f32 is meant")]
        let step = ((f64::from(max) - f64::from(min)) / f64::from(most)) as f32;
        // The largest step that does not lead above `max`; rounding is off by two at most.
        let mut range = Self {
            min,
            step: step.next_up(),
        };
        while range.decode(most) > max && range.step > 0.0 {
            range.step = range.step.next_down();
        }
        range
    }
}

/// Values of bricks.
#[derive(Debug)]
pub struct Values {
    encoding: Encoding,
    bytes: Mmap,
    /// One for each brick where the encoding has them, else none.
    ranges: Vec<Range>,
}

impl Values {
    /// Encodes the values of whole bricks, giving them back as it goes: the peak is the larger of
    /// the two and 16 MB, not their sum.
    ///
    /// # Errors
    /// If the system has no memory for the result.
    pub(super) fn encode(mut values: Vec<f32>, encoding: Encoding) -> io::Result<Self> {
        let brick_count = values.len() / BRICK_LEN;
        let size = encoding.brick_bytes();
        let mut bytes = MmapMut::map_anon(brick_count * size)?;
        // Lookups are far apart: in pages of 4 KB, a grid of 451 MB also waits for the page tables.
        // Refused, it is slower and no less right.
        #[cfg(target_os = "linux")]
        let _ = bytes.advise(memmap2::Advice::HugePage);
        let mut ranges = vec![Range::default(); encoding.range_count(brick_count)];
        let mut end = brick_count;
        while end > 0 {
            let first = end.saturating_sub(CHUNK);
            let bricks = values[first * BRICK_LEN..].par_chunks_exact(BRICK_LEN);
            let codes = bytes[first * size..end * size].par_chunks_exact_mut(size);
            let found: Vec<_> = bricks
                .zip(codes)
                .filter_map(|(brick, codes)| encode_brick(encoding, brick, codes))
                .collect();
            if let Some(ranges) = ranges.get_mut(first..end) {
                ranges.copy_from_slice(&found);
            }
            values.truncate(first * BRICK_LEN);
            values.shrink_to_fit();
            end = first;
        }
        Ok(Self {
            encoding,
            bytes: bytes.make_read_only()?,
            ranges,
        })
    }

    /// Takes bricks that are encoded already; `None` if the lengths do not match.
    pub(crate) fn from_encoded(
        encoding: Encoding,
        bytes: Mmap,
        ranges: Vec<Range>,
    ) -> Option<Self> {
        let brick_count = bytes.len() / encoding.brick_bytes();
        let whole = bytes.len() == brick_count * encoding.brick_bytes();
        (whole && ranges.len() == encoding.range_count(brick_count)).then_some(Self {
            encoding,
            bytes,
            ranges,
        })
    }

    /// Returns the value at `offset` (below 512) of brick `brick`.
    #[inline] // bench: lookup
    pub fn get(&self, brick: usize, offset: usize) -> f32 {
        let i = brick * BRICK_LEN + offset;
        // The same for all lookups of a frame: a branch that is always predicted.
        match self.encoding {
            Encoding::F32 => f32::from_le_bytes(self.bytes.as_chunks().0[i]),
            Encoding::F16 => from_half(u16::from_le_bytes(self.bytes.as_chunks().0[i])),
            Encoding::U16 => {
                self.ranges[brick].decode(u16::from_le_bytes(self.bytes.as_chunks().0[i]))
            }
            Encoding::U8 => self.ranges[brick].decode(self.bytes[i].into()),
        }
    }

    /// Returns all values of brick `brick`.
    pub(super) fn brick(&self, brick: usize) -> [f32; BRICK_LEN] {
        fn decoded<const N: usize>(
            codes: &[u8],
            value: impl Fn([u8; N]) -> f32,
        ) -> [f32; BRICK_LEN] {
            let mut values = [0.0; BRICK_LEN];
            for (value_of, &code) in values.iter_mut().zip(codes.as_chunks().0) {
                *value_of = value(code);
            }
            values
        }
        let size = self.encoding.brick_bytes();
        let codes = &self.bytes[brick * size..][..size];
        match self.encoding {
            Encoding::F32 => decoded(codes, f32::from_le_bytes),
            Encoding::F16 => decoded(codes, |c| from_half(u16::from_le_bytes(c))),
            Encoding::U16 => {
                let range = self.ranges[brick];
                decoded(codes, |c| range.decode(u16::from_le_bytes(c)))
            }
            Encoding::U8 => {
                let range = self.ranges[brick];
                decoded(codes, |[c]| range.decode(c.into()))
            }
        }
    }

    /// Returns how values are stored.
    pub fn encoding(&self) -> Encoding {
        self.encoding
    }

    /// Returns the ranges of the bricks, if the encoding has them.
    pub(super) fn ranges(&self) -> &[Range] {
        &self.ranges
    }

    /// Returns the number of bricks.
    pub fn brick_count(&self) -> usize {
        self.bytes.len() / self.encoding.brick_bytes()
    }

    /// Returns the bytes of the codes.
    pub fn payload_bytes(&self) -> usize {
        self.bytes.len()
    }

    /// Returns the bytes that the values occupy; of a mapped file, when all of it is in memory.
    pub fn memory_bytes(&self) -> usize {
        self.bytes.len() + size_of_val(&self.ranges[..])
    }
}

/// Encodes a brick into `codes`, `encoding.brick_bytes()` long; returns its range if it has one.
pub(crate) fn encode_brick(encoding: Encoding, values: &[f32], codes: &mut [u8]) -> Option<Range> {
    match encoding {
        Encoding::F32 => {
            for (code, value) in codes.as_chunks_mut().0.iter_mut().zip(values) {
                *code = value.to_le_bytes();
            }
            None
        }
        Encoding::F16 => {
            // Adding 0 makes 0 of −0.
            for (code, &value) in codes.as_chunks_mut().0.iter_mut().zip(values) {
                *code = f16::from_f32(value + 0.0).to_le_bytes();
            }
            None
        }
        Encoding::U16 => {
            let (range, code_of) = quantizer(values, u16::MAX);
            for (code, &value) in codes.as_chunks_mut().0.iter_mut().zip(values) {
                *code = code_of(value).to_le_bytes();
            }
            Some(range)
        }
        Encoding::U8 => {
            let (range, code_of) = quantizer(values, u8::MAX.into());
            for (code, &value) in codes.iter_mut().zip(values) {
                [*code, _] = code_of(value).to_le_bytes();
            }
            Some(range)
        }
    }
}

/// Returns the range of a brick with codes up to `most`, and the map from values to codes.
fn quantizer(values: &[f32], most: u16) -> (Range, impl Fn(f32) -> u16) {
    let (min, max) = extremes(values);
    let range = Range::new(min, max, most);
    // In f64 the reciprocal of no positive f32 overflows. Zero: one value, one code.
    let inverse = if range.step > 0.0 {
        f64::from(range.step).recip()
    } else {
        0.0
    };
    let code_of = move |value: f32| {
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "not negative, and cut at the highest code"
        )]
        let code = ((f64::from(value) - f64::from(min)) * inverse + 0.5) as u16;
        code.min(most)
    };
    (range, code_of)
}

/// Returns the lowest and the highest value of a brick.
pub(super) fn extremes(values: &[f32]) -> (f32, f32) {
    let start = (f32::INFINITY, f32::NEG_INFINITY);
    values
        .iter()
        .fold(start, |(min, max), &v| (min.min(v), max.max(v)))
}

/// Widens a half that is finite and not negative, by integers: the conversion of the `half` crate
/// asks the processor for its features each time, and calls a function.
#[inline] // bench: lookup
fn from_half(bits: u16) -> f32 {
    // Exponents are 112 apart. Below the first normal half the exponent is 0 where it should
    // count like 1; as a float in [2⁻¹⁴, 2⁻¹³) the mantissa is right, 2⁻¹⁴ above zero.
    const NORMAL: u32 = 112 << 23;
    const SUBNORMAL: u32 = 113 << 23;
    let shifted = u32::from(bits) << 13;
    if bits < 0x400 {
        f32::from_bits(shifted + SUBNORMAL) - f32::from_bits(SUBNORMAL)
    } else {
        f32::from_bits(shifted + NORMAL)
    }
}

/// A tree's nodes with the values of its bricks: all that a lookup can find.
#[derive(Clone, Copy)]
pub(super) struct Voxels<'a> {
    pub(super) tree: &'a Tree<f32>,
    pub(super) values: &'a Values,
}

impl Deref for Voxels<'_> {
    type Target = Tree<f32>;

    fn deref(&self) -> &Tree<f32> {
        self.tree
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn encoded(values: &[f32], encoding: Encoding) -> Vec<f32> {
        let coded = Values::encode(values.to_vec(), encoding).unwrap();
        let bricks = (0..coded.brick_count()).flat_map(|b| coded.brick(b));
        bricks.collect()
    }

    /// Bricks with awkward ranges, each from a number `seed` on.
    fn bricks() -> Vec<f32> {
        let ranges = [
            (0.0, 1.0),
            (0.0, 3.4e38),
            (0.1, 0.1),
            (1.0, 1.000_000_1),
            (0.0, 1e-44),
            (0.0, 1e-40),
            (1e-3, 7.3),
            (3.0, 3.5),
            (65_000.0, 65_504.0),
            (0.0, 0.0),
        ];
        let value = |(min, max): (f32, f32), i: usize| {
            let u = ((i * 7919) % 512) as f32 / 511.0;
            (min + (max - min) * u).clamp(min, max)
        };
        let brick = |&range: &(f32, f32)| (0..BRICK_LEN).map(move |i| value(range, i));
        ranges.iter().flat_map(brick).collect()
    }

    #[test]
    fn half_floats_widen_as_the_standard_says() {
        for bits in 0..0x7c00_u16 {
            assert_eq!(from_half(bits), f16::from_bits(bits).to_f32(), "{bits:#x}");
        }
    }

    #[test]
    fn f32_is_kept_bit_for_bit() {
        let values = bricks();
        assert_eq!(encoded(&values, Encoding::F32), values);
    }

    #[test]
    fn codes_are_half_a_step_off_at_most_and_exact_at_the_minimum() {
        let values = bricks();
        for (encoding, most) in [(Encoding::U8, 255.0), (Encoding::U16, 65535.0)] {
            let got = encoded(&values, encoding);
            for (was, is) in values.chunks(BRICK_LEN).zip(got.chunks(BRICK_LEN)) {
                let (min, max) = extremes(was);
                let (low, high) = extremes(is);
                assert_eq!(low, min, "the minimum is a code");
                assert!(high <= max, "{high} is above {max}");
                // The step is at most three ulps short, then two roundings; where steps have
                // few digits left, one unit of 1.4e-45 for each of 65535.
                let off = f64::from(max) - f64::from(high);
                assert!(off <= f64::from(max) * 5e-7 + 1e-40, "{high} for {max}");
                let step = (f64::from(max) - f64::from(min)) / most;
                for (&a, &b) in was.iter().zip(is) {
                    let error = (f64::from(a) - f64::from(b)).abs();
                    let bound = step * 0.5 + f64::from(max) * 5e-7 + 1e-40;
                    assert!(error <= bound, "{a} became {b}: {encoding:?}");
                }
            }
        }
    }

    #[test]
    fn decoding_is_monotone() {
        for (min, max) in [(0.0, 1.0), (3.0, 3.000_01), (1e-3, 7.3), (0.0, 3e38)] {
            let range = Range::new(min, max, u16::MAX);
            let all = (0..=u16::MAX).map(|code| range.decode(code));
            assert!(all.is_sorted(), "{min} to {max}");
        }
    }

    #[test]
    fn one_value_and_zero_are_exact() {
        for value in [0.0, 0.1, 3.3e38, 1e-45] {
            for encoding in [Encoding::U8, Encoding::U16] {
                assert!(
                    encoded(&[value; BRICK_LEN], encoding)
                        .iter()
                        .all(|&v| v == value),
                    "{value} as {encoding:?}"
                );
            }
        }
    }
}

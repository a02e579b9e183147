//! The header of a cache file, and checksums.

use std::io::{self, Read};

use bytemuck::{Pod, Zeroable};
use glam::DAffine3;

use crate::grid::Encoding;
use crate::space::IndexTransform;

/// The first bytes of a file.
pub(super) const MAGIC: [u8; 8] = *b"\x89MJCACHE";
/// Counts changes of the layout.
pub(super) const VERSION: u32 = 1;
/// Reads otherwise on a machine of the other byte order.
const BYTE_ORDER: u32 = 0x0102_0304;
/// The header's room, and what the payload's length is filled up to: a page.
pub(super) const PAGE: u64 = 4096;

/// What a cache file was made of.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Source {
    /// File name, without its folders.
    pub file: String,
    /// Length of that file in bytes.
    pub bytes: u64,
    /// Its [`Checksum`].
    pub checksum: u64,
    /// The grid's name.
    pub grid: String,
    /// The grid's metadata.
    pub metadata: Vec<(String, String)>,
}

/// The header, as it is in the file. All offsets and lengths are in bytes.
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[repr(C)]
pub(super) struct Header {
    pub(super) magic: [u8; 8],
    pub(super) version: u32,
    byte_order: u32,
    /// Position of the encoding in [`ENCODINGS`].
    encoding: u64,
    pub(super) brick_count: u64,
    pub(super) payload_checksum: u64,
    pub(super) resident_bytes: u64,
    pub(super) resident_checksum: u64,
    pub(super) source_bytes: u64,
    pub(super) source_checksum: u64,
    /// Error in optical depth, RMS and worst, where a density of one has extinction 1.
    pub(super) depth_error: [f64; 2],
    /// Columns of the matrix, translation last.
    world_from_index: [f64; 12],
    /// Of all before.
    checksum: u64,
}

const _: () = assert!(size_of::<Header>() == 8 * 24, "no padding");
const _: () = assert!((size_of::<Header>() as u64) < PAGE, "room to grow");

const ENCODINGS: [Encoding; 4] = [Encoding::F32, Encoding::F16, Encoding::U16, Encoding::U8];

impl Header {
    pub(super) fn new(encoding: Encoding, transform: &IndexTransform) -> Self {
        let position = ENCODINGS.iter().position(|&e| e == encoding);
        Self {
            magic: MAGIC,
            version: VERSION,
            byte_order: BYTE_ORDER,
            encoding: position.expect("all encodings are listed") as u64,
            world_from_index: transform.world_from_index().to_cols_array(),
            ..Self::zeroed()
        }
    }

    /// Returns the header with its own checksum.
    pub(super) fn sealed(mut self) -> Self {
        self.checksum = self.own_checksum();
        self
    }

    fn own_checksum(&self) -> u64 {
        let bytes = bytemuck::bytes_of(self);
        Checksum::of(&bytes[..bytes.len() - size_of::<u64>()])
    }

    pub(super) fn is_sealed(&self) -> bool {
        self.checksum == self.own_checksum()
    }

    pub(super) fn has_our_byte_order(&self) -> bool {
        self.byte_order == BYTE_ORDER
    }

    pub(super) fn encoding(&self) -> Option<Encoding> {
        let position = usize::try_from(self.encoding).ok()?;
        ENCODINGS.get(position).copied()
    }

    pub(super) fn transform(&self) -> Option<IndexTransform> {
        IndexTransform::from_world_from_index(DAffine3::from_cols_array(&self.world_from_index))
    }

    /// Returns the length of the payload and where the resident part begins.
    pub(super) fn extents(&self, encoding: Encoding) -> Option<(usize, u64)> {
        let payload = self
            .brick_count
            .checked_mul(encoding.brick_bytes() as u64)?;
        let end = payload.checked_next_multiple_of(PAGE)?.checked_add(PAGE)?;
        Some((usize::try_from(payload).ok()?, end))
    }
}

/// A sum over words of eight bytes, in which every single change of a word shows.
///
/// # Reference
/// The step is that of FNV-1a `[Fowler2019]`, taken by words instead of bytes: eight times as fast.
#[derive(Clone, Copy, Debug)]
pub struct Checksum(u64);

impl Checksum {
    /// Starts with no bytes.
    pub fn new() -> Self {
        Self(0xcbf2_9ce4_8422_2325)
    }

    /// Adds bytes; all calls but the last take a multiple of eight.
    pub fn update(&mut self, bytes: &[u8]) {
        let (words, rest) = bytes.as_chunks::<8>();
        for word in words {
            self.step(u64::from_le_bytes(*word));
        }
        if !rest.is_empty() {
            let mut last = [0; 8];
            last[..rest.len()].copy_from_slice(rest);
            self.step(u64::from_le_bytes(last));
            self.step(rest.len() as u64);
        }
    }

    fn step(&mut self, word: u64) {
        // An odd factor loses nothing. The shift brings high bits down, which it moves up only.
        self.0 = (self.0 ^ word).wrapping_mul(0x0100_0000_01b3);
        self.0 ^= self.0 >> 32;
    }

    /// Returns the sum.
    pub fn value(self) -> u64 {
        self.0
    }

    /// Returns the sum of `bytes`.
    pub fn of(bytes: &[u8]) -> u64 {
        let mut sum = Self::new();
        sum.update(bytes);
        sum.value()
    }

    /// Returns the number of bytes that `reader` gives, and their sum.
    ///
    /// # Errors
    /// If it cannot be read to its end.
    pub fn of_reader(mut reader: impl Read) -> io::Result<(u64, u64)> {
        let (mut sum, mut count) = (Self::new(), 0);
        let mut block = Vec::with_capacity(1 << 20);
        loop {
            block.clear();
            reader.by_ref().take(1 << 20).read_to_end(&mut block)?;
            if block.is_empty() {
                return Ok((count, sum.value()));
            }
            count += block.len() as u64;
            sum.update(&block);
        }
    }
}

impl Default for Checksum {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_single_bit_counts() {
        let bytes: Vec<u8> = (0..99).collect();
        let sum = Checksum::of(&bytes);
        for bit in 0..bytes.len() * 8 {
            let mut other = bytes.clone();
            other[bit / 8] ^= 1 << (bit % 8);
            assert_ne!(Checksum::of(&other), sum, "bit {bit}");
        }
        assert_ne!(Checksum::of(&bytes[..98]), sum, "shorter");
        let read = Checksum::of_reader(&bytes[..]).expect("memory can be read");
        assert_eq!(read, (99, sum));
    }
}

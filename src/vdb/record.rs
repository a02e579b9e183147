//! How the values of one node are stored, and the checked reading of such a record.
//!
//! ```text
//! record   kind u8 │ inactive value(s) │ selection mask │ chunk of `count` values
//!          kind  0  inactive voxels are the background          dense = false
//!                1  … minus the background                      dense = false
//!                2  … one value, spelled out                    dense = false
//!                3  … ± background, by selection mask           dense = false
//!                4  … background or one value, by mask          dense = false
//!                5  … one of two values, by mask                dense = false
//!                6  all values are in the chunk                 dense = true
//! chunk    plain   count · size bytes
//!          zip     n i64, then n bytes of zlib stream; n <= 0: -n plain bytes
//!          blosc   n i64, then n bytes of blosc frame; n <= 0: -n plain bytes
//! ```
//!
//! A chunk of no values is written as nothing by half grids, as a length by all others.
//! This file checks every size a decoder will later rely on; it decodes nothing.

use super::cursor::Cursor;
use super::error::Damage;

/// The value types that can be loaded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum ValueType {
    F32,
    F64,
    I32,
    I64,
    Vec3F,
    Vec3D,
    Vec3I,
}

impl ValueType {
    /// Parses OpenVDB's name of the type.
    pub(super) fn from_name(name: &str) -> Option<Self> {
        Some(match name {
            "float" => Self::F32,
            "double" => Self::F64,
            "int32" => Self::I32,
            "int64" => Self::I64,
            "vec3s" => Self::Vec3F,
            "vec3d" => Self::Vec3D,
            "vec3i" => Self::Vec3I,
            _ => return None,
        })
    }

    /// Bytes of a value in memory, and in the file where it is not halved.
    pub(super) fn size(self) -> usize {
        match self {
            Self::F32 | Self::I32 => 4,
            Self::F64 | Self::I64 => 8,
            Self::Vec3F | Self::Vec3I => 12,
            Self::Vec3D => 24,
        }
    }

    /// Bytes of a value saved as half; integers are never halved.
    fn half_size(self) -> Option<usize> {
        match self {
            Self::F32 | Self::F64 => Some(2),
            Self::Vec3F | Self::Vec3D => Some(6),
            Self::I32 | Self::I64 | Self::Vec3I => None,
        }
    }

    pub(super) fn is_vector(self) -> bool {
        matches!(self, Self::Vec3F | Self::Vec3D | Self::Vec3I)
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Codec {
    Plain,
    Zip,
    Blosc,
}

/// How the values of a whole grid are written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Encoding {
    pub(super) value: ValueType,
    pub(super) codec: Codec,
    /// Only active values are stored, unless a record says otherwise.
    pub(super) active_mask: bool,
    /// Values in chunks are half floats; never true for integers.
    pub(super) half: bool,
}

impl Encoding {
    /// Interprets a grid's compression flags; `None` where a bit is not defined.
    pub(super) fn new(flags: u32, half: bool, value: ValueType) -> Option<Self> {
        let codec = match flags & !FLAG_ACTIVE_MASK {
            0 => Codec::Plain,
            FLAG_ZIP => Codec::Zip,
            // With both bits set OpenVDB writes and reads blosc.
            FLAG_BLOSC | FLAG_BOTH => Codec::Blosc,
            _ => return None,
        };
        Some(Self {
            value,
            codec,
            active_mask: flags & FLAG_ACTIVE_MASK != 0,
            half: half && value.half_size().is_some(),
        })
    }

    /// Bytes of a value in a decoded chunk.
    pub(super) fn stored_size(self) -> usize {
        let halved = self.value.half_size().filter(|_| self.half);
        halved.unwrap_or_else(|| self.value.size())
    }
}

pub(super) const FLAG_ZIP: u32 = 1;
pub(super) const FLAG_ACTIVE_MASK: u32 = 2;
pub(super) const FLAG_BLOSC: u32 = 4;
const FLAG_BOTH: u32 = FLAG_ZIP | FLAG_BLOSC;

/// Names the compression flags as OpenVDB's own tools do.
pub(super) fn codec_name(flags: u32) -> String {
    let parts = [
        (FLAG_BLOSC, "blosc"),
        (FLAG_ZIP, "zip"),
        (FLAG_ACTIVE_MASK, "active mask"),
    ];
    let set: Vec<_> = parts.iter().filter(|(f, _)| flags & f != 0).collect();
    match &set[..] {
        [] => "none".to_owned(),
        set => set.iter().map(|(_, n)| *n).collect::<Vec<_>>().join(" + "),
    }
}

/// Which inactive value a record takes from where.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Inactive<'a> {
    Background,
    MinusBackground,
    /// Spelled out in full, even in half grids.
    Value(&'a [u8]),
}

/// One node's values, as they lie in the file.
#[derive(Clone, Debug)]
pub(super) struct Record<'a> {
    /// One bit a value, as bytes.
    pub(super) value_mask: &'a [u8],
    /// All values are in the chunk, not only the active ones.
    pub(super) dense: bool,
    /// Inactive value where the selection mask is clear, and where it is set.
    pub(super) inactive: [Inactive<'a>; 2],
    pub(super) selection: Option<&'a [u8]>,
    /// Values in the chunk.
    pub(super) count: usize,
    /// The chunk with its length prefix; not to be decoded where `count` is 0.
    pub(super) chunk: &'a [u8],
}

impl<'a> Record<'a> {
    /// Reads the record of a node whose value mask is given.
    pub(super) fn read(
        c: &mut Cursor<'a>,
        encoding: Encoding,
        value_mask: &'a [u8],
    ) -> Result<Self, Damage> {
        let start = c.at();
        let [kind] = c.pod::<[u8; 1]>("a node's value kind")?;
        if kind > 6 {
            let what = format!("a node's value kind is {kind}, expected 0 to 6");
            return Err(Damage::new(start, what));
        }
        let mut value = || {
            c.take(encoding.value.size(), "an inactive value")
                .map(Inactive::Value)
        };
        let inactive = match kind {
            0 => [Inactive::Background; 2],
            2 => [value()?; 2],
            4 => [value()?, Inactive::Background],
            5 => [value()?, value()?],
            _ => [Inactive::MinusBackground, Inactive::Background],
        };
        let selection = match kind {
            3..=5 => Some(c.take(value_mask.len(), "a selection mask")?),
            _ => None,
        };
        let dense = kind == 6 || !encoding.active_mask;
        let count = if dense {
            value_mask.len() * 8
        } else {
            count_ones(value_mask)
        };
        Ok(Self {
            value_mask,
            dense,
            inactive,
            selection,
            count,
            chunk: chunk(c, encoding, count)?,
        })
    }
}

pub(super) fn count_ones(mask: &[u8]) -> usize {
    words(mask).map(|w| w.count_ones() as usize).sum()
}

/// Iterates over the 64-bit words of a mask.
pub(super) fn words(mask: &[u8]) -> impl Iterator<Item = u64> + '_ {
    mask.chunks_exact(8).map(bytemuck::pod_read_unaligned)
}

/// Takes a chunk of `count` values after checking all sizes it states.
fn chunk<'a>(c: &mut Cursor<'a>, encoding: Encoding, count: usize) -> Result<&'a [u8], Damage> {
    let bytes = count * encoding.stored_size();
    if encoding.codec == Codec::Plain {
        return c.take(bytes, "a node's values");
    }
    if count == 0 && encoding.half {
        return Ok(&[]);
    }
    let (start, from) = (c.at(), *c);
    let stated = c.i64("a chunk's length")?;
    let fits = |n: &usize| *n <= c.left();
    let Some(len) = usize::try_from(stated.unsigned_abs()).ok().filter(fits) else {
        let what = format!("a chunk states {stated} bytes, {} are left", c.left());
        return Err(Damage::new(start, what));
    };
    let body = c.take(len, "a chunk")?;
    if stated <= 0 && len != bytes {
        let what = format!("a plain chunk states {len} bytes, expected {bytes}");
        return Err(Damage::new(start, what));
    }
    if stated > 0 && encoding.codec == Codec::Blosc {
        check_blosc_frame(start + 8, body, bytes)?;
    }
    let mut whole = from;
    whole.take(8 + len, "a chunk")
}

/// Compares a blosc frame's header with the truth: the decoder writes as much as it says.
///
/// ```text
/// byte 0 version │ 1 version of codec │ 2 flags │ 3 type size │ 4 nbytes │ 8 block size │ 12 cbytes
/// ```
fn check_blosc_frame(at: usize, frame: &[u8], bytes: usize) -> Result<(), Damage> {
    let mut c = Cursor::new(frame, 0);
    let header = c.pod::<[u8; 4]>("a blosc header");
    let header = header.and_then(|head| Ok((head, c.pod::<[u32; 3]>("a blosc header")?)));
    let ([_, _, _, type_size], sizes) = header.map_err(|d| Damage {
        offset: at as u64,
        ..d
    })?;
    let [nbytes, block_size, cbytes] = sizes.map(|n| n as usize);
    // A frame of no values has a block size of 0 and is never decoded.
    let block_fits = bytes == 0 || (1..=bytes).contains(&block_size);
    if nbytes == bytes && cbytes == frame.len() && block_fits && type_size != 0 {
        return Ok(());
    }
    Err(Damage::new(
        at,
        format!(
            "a blosc frame states {nbytes} bytes in blocks of {block_size}, {cbytes} compressed, \
             type size {type_size}; expected {bytes} bytes from {} compressed",
            frame.len()
        ),
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    const MASK: [u8; 64] = {
        let mut m = [0; 64];
        m[0] = 0b101;
        m
    };

    fn encoding(flags: u32, half: bool) -> Encoding {
        Encoding::new(flags, half, ValueType::F32).unwrap()
    }

    fn read(bytes: &[u8], e: Encoding) -> Result<(usize, usize, usize), Damage> {
        let mut c = Cursor::new(bytes, 0);
        let r = Record::read(&mut c, e, &MASK)?;
        Ok((r.count, r.chunk.len(), c.at()))
    }

    #[test]
    fn chunks_of_no_values_are_nothing_in_half_grids_and_a_length_in_others() {
        let none = [0; 64];
        for (half, used) in [(true, 1), (false, 9)] {
            let bytes = [0; 9];
            let mut c = Cursor::new(&bytes, 0);
            Record::read(&mut c, encoding(FLAG_ZIP | FLAG_ACTIVE_MASK, half), &none).unwrap();
            assert_eq!(c.at(), used, "half = {half}");
        }
    }

    #[test]
    fn active_values_only_or_all_of_them() {
        let bytes = [0; 1 + 2048];
        assert_eq!(read(&bytes, encoding(2, false)), Ok((2, 8, 9)));
        assert_eq!(read(&bytes, encoding(2, true)), Ok((2, 4, 5)));
        assert_eq!(read(&bytes, encoding(0, false)), Ok((512, 2048, 2049)));
    }

    #[test]
    fn lying_sizes_are_damage() {
        let with_len = |n: i64| [&[6][..], &n.to_le_bytes(), &[0; 32]].concat();
        for n in [i64::MIN, i64::MAX, 33, -2047, 0, 16] {
            assert!(read(&with_len(n), encoding(4, false)).is_err(), "blosc {n}");
        }
        for n in [i64::MIN, i64::MAX, 33, -2047, 0] {
            assert!(read(&with_len(n), encoding(1, false)).is_err(), "zip {n}");
        }
        assert!(read(&[7; 4096], encoding(0, false)).is_err(), "kind 7");
    }
}

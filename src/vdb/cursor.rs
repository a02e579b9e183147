//! A position in the file's bytes, from which little-endian values are taken with checks.
//!
//! Every read of the walk goes through [`Cursor::take`], so no length from a file reaches an
//! allocation or a slice before it has been compared with what is really there. Positions are
//! absolute; a cursor can be limited to one grid's bytes.

use bytemuck::Pod;
use glam::{DVec3, IVec3};

use super::error::Damage;

#[derive(Clone, Copy, Debug)]
pub(super) struct Cursor<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl<'a> Cursor<'a> {
    pub(super) fn new(bytes: &'a [u8], at: usize) -> Self {
        Self { bytes, at }
    }

    pub(super) fn at(&self) -> usize {
        self.at
    }

    pub(super) fn bytes(&self) -> &'a [u8] {
        self.bytes
    }

    /// Returns the bytes left before the end.
    pub(super) fn left(&self) -> usize {
        self.bytes.len().saturating_sub(self.at)
    }

    /// Takes the next `len` bytes, which hold `what`.
    pub(super) fn take(&mut self, len: usize, what: &str) -> Result<&'a [u8], Damage> {
        let taken = self.bytes.get(self.at..).and_then(|rest| rest.get(..len));
        let taken = taken.ok_or_else(|| {
            Damage::new(
                self.at,
                format!("{what}: {} bytes are left, expected {len}", self.left()),
            )
        })?;
        self.at += len;
        Ok(taken)
    }

    /// Takes a plain value: the format is little-endian, and so is every supported machine.
    pub(super) fn pod<T: Pod>(&mut self, what: &str) -> Result<T, Damage> {
        const {
            assert!(
                cfg!(target_endian = "little"),
                "values are copied as they are"
            );
        }
        Ok(bytemuck::pod_read_unaligned(
            self.take(size_of::<T>(), what)?,
        ))
    }

    pub(super) fn u32(&mut self, what: &str) -> Result<u32, Damage> {
        self.pod(what)
    }

    /// Takes an unsigned 32-bit length as an index.
    pub(super) fn len32(&mut self, what: &str) -> Result<usize, Damage> {
        Ok(self.u32(what)? as usize)
    }

    pub(super) fn i64(&mut self, what: &str) -> Result<i64, Damage> {
        self.pod(what)
    }

    pub(super) fn ivec3(&mut self, what: &str) -> Result<IVec3, Damage> {
        Ok(IVec3::from_array(self.pod(what)?))
    }

    pub(super) fn dvec3(&mut self, what: &str) -> Result<DVec3, Damage> {
        Ok(DVec3::from_array(self.pod(what)?))
    }

    /// Takes a string: its length in 32 bits, then that many bytes.
    pub(super) fn string(&mut self, what: &str) -> Result<&'a [u8], Damage> {
        let len = self.len32(what)?;
        self.take(len, what)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reads_stop_at_the_end_and_say_where() {
        let bytes = [3, 0, 0, 0, b'a', b'b', b'c', 255, 255, 255, 255];
        let mut c = Cursor::new(&bytes, 0);
        assert_eq!(c.string("a name").unwrap(), b"abc");
        let e = c.string("a name").unwrap_err();
        assert_eq!(
            e.to_string(),
            "at byte 11: a name: 0 bytes are left, expected 4294967295"
        );
        let mut beyond = Cursor::new(&bytes, usize::MAX);
        assert!(
            beyond.take(1, "x").is_err(),
            "no overflow at absurd positions"
        );
    }
}

//! The bytes of a file, mapped into memory rather than read.
//!
//! Mapping keeps peak memory near the grid's own size: a 171 MB file otherwise costs 0.1 s and
//! 171 MB before the first value is decoded. See `docs/adr/0006-memory-mapped-input.md`.
//! These are the only `unsafe` calls of the crate; nothing here knows a file format.

use std::fs::File;
use std::io;
use std::ops::Deref;
use std::path::Path;

use memmap2::{Mmap, MmapOptions};

/// The whole content of a file, or bytes that are already in memory.
#[derive(Debug)]
pub(super) enum Bytes {
    Mapped(Mmap),
    Owned(Vec<u8>),
}

impl Bytes {
    /// Maps the file at `path`; an empty file gives no bytes.
    #[expect(
        unsafe_code,
        reason = "a map is unsafe by nature; ADR 0006 has the measured gain and the terms"
    )]
    pub(super) fn map(path: &Path) -> io::Result<Self> {
        let file = File::open(path)?;
        if file.metadata()?.is_dir() {
            return Err(io::Error::from(io::ErrorKind::IsADirectory));
        }
        // SAFETY: the map is read-only and private to this value. What cannot be proven is that
        // no other process changes the file meanwhile. Every record is checked again when it is
        // decoded, so what changed since the walk is found out. A file cut short under us ends
        // the process with SIGBUS, as for every program that maps files; programs that replace
        // caches by rename, as most do, leave the mapped bytes alone.
        let map = unsafe { Mmap::map(&file)? };
        Ok(Self::Mapped(map))
    }
}

/// Maps `len` bytes of `file` from `offset` on, which must be there: bytes that are first read after
/// they were cut off end the process.
#[expect(
    unsafe_code,
    reason = "a map is unsafe by nature; ADR 0006 has the terms, ADR 0008 why here too"
)]
pub(crate) fn map_part(file: &File, offset: u64, len: usize) -> io::Result<Mmap> {
    // SAFETY: as above; the reader of these bytes takes any bits for values and trusts none for
    // an index, so that a change under it changes a picture and nothing else.
    unsafe { MmapOptions::new().offset(offset).len(len).map(file) }
}

/// Tells the system that pages of `map` are wanted one by one. It reads 32 or more for each else, which
/// is right until they push each other out of memory.
pub(crate) fn read_page_by_page(map: &Mmap) -> io::Result<()> {
    #[cfg(unix)]
    map.advise(memmap2::Advice::Random)?;
    Ok(())
}

impl Deref for Bytes {
    type Target = [u8];

    fn deref(&self) -> &[u8] {
        match self {
            Self::Mapped(map) => map,
            Self::Owned(bytes) => bytes,
        }
    }
}

//! Opening a cache file: everything is checked before anything is believed or allocated.

use std::fs::File;
use std::io::{self, Read as _, Seek as _, SeekFrom};
use std::path::{Path, PathBuf};

use bytemuck::Zeroable as _;

use super::error::CacheError;
use super::format::{Checksum, Header, MAGIC, PAGE, Source, VERSION};
use crate::grid::{DensityGrid, DepthError, Encoding, GridTooLarge, Reason, Stored, sections};
use crate::space::IndexTransform;
use crate::vdb::{map_part, read_page_by_page};

/// Resident bytes in memory for each in the file, at most: read, then taken apart.
const MEMORY_PER_BYTE: u64 = 3;

/// A cache file whose header has been checked.
#[derive(Debug)]
pub struct CacheFile {
    path: PathBuf,
    file: File,
    header: Header,
    encoding: Encoding,
    transform: IndexTransform,
    source: Source,
    /// Nodes and bounds, behind the names.
    sections: Vec<u8>,
    /// What may be in memory.
    max_bytes: usize,
}

/// Returns whether the file at `path` begins as cache files do; its name does not count.
pub fn is_cache(path: &Path) -> bool {
    let mut start = [0; MAGIC.len()];
    let read = File::open(path).and_then(|mut f| f.read_exact(&mut start));
    read.is_ok() && start == MAGIC
}

impl CacheFile {
    /// Opens the file at `path` and reads what is always in memory, if it takes no more than
    /// `max_bytes`.
    ///
    /// # Errors
    /// If the file cannot be read, is no cache file, is damaged, or takes too much.
    pub fn open(path: &Path, max_bytes: usize) -> Result<Self, CacheError> {
        let damaged = |what: &str| CacheError::Damaged {
            path: path.to_owned(),
            what: what.to_owned(),
        };
        let failed = |source| CacheError::Read {
            path: path.to_owned(),
            source,
        };
        let mut file = File::open(path).map_err(failed)?;
        let len = file.metadata().map_err(failed)?.len();
        let mut header = Header::zeroed();
        match file.read_exact(bytemuck::bytes_of_mut(&mut header)) {
            Err(e) if e.kind() != io::ErrorKind::UnexpectedEof => return Err(failed(e)),
            // Too short for a header: zeros where it ends, and so no magic number or checksum.
            _ => {}
        }
        if header.magic != MAGIC {
            return Err(CacheError::NotCache {
                path: path.to_owned(),
            });
        }
        if !header.has_our_byte_order() && header.version.swap_bytes() == VERSION {
            return Err(CacheError::ByteOrder {
                path: path.to_owned(),
            });
        }
        if header.version != VERSION {
            return Err(CacheError::Version {
                path: path.to_owned(),
                found: header.version,
                expected: VERSION,
            });
        }
        if !header.is_sealed() {
            return Err(damaged("the header does not match its checksum"));
        }
        let encoding = header.encoding().ok_or_else(|| damaged("no encoding"))?;
        let transform = header.transform().ok_or_else(|| damaged("no transform"))?;
        let (_, resident_at) = header
            .extents(encoding)
            .ok_or_else(|| damaged("a payload without end"))?;
        if resident_at.checked_add(header.resident_bytes) != Some(len) {
            let expected = resident_at.saturating_add(header.resident_bytes);
            return Err(damaged(&format!("{len} bytes, expected {expected}")));
        }
        let needed = header.resident_bytes.saturating_mul(MEMORY_PER_BYTE);
        let needed = usize::try_from(needed).unwrap_or(usize::MAX);
        if needed > max_bytes {
            return Err(CacheError::TooLarge {
                path: path.to_owned(),
                source: GridTooLarge {
                    needed,
                    limit: max_bytes,
                },
            });
        }
        let mut resident = Vec::new();
        file.seek(SeekFrom::Start(resident_at)).map_err(failed)?;
        file.read_to_end(&mut resident).map_err(failed)?;
        if resident.len() as u64 != header.resident_bytes
            || Checksum::of(&resident) != header.resident_checksum
        {
            return Err(damaged("nodes and bounds do not match their checksum"));
        }
        let mut sections = &resident[..];
        let source = take_source(&mut sections, &header).ok_or_else(|| damaged("no names"))?;
        Ok(Self {
            source,
            sections: sections.to_vec(),
            max_bytes,
            path: path.to_owned(),
            file,
            header,
            encoding,
            transform,
        })
    }

    /// Maps the bricks and returns the grid, ready to render. Where they do not all fit into memory,
    /// the system reads them page by page.
    ///
    /// # Errors
    /// If nodes and bounds contradict each other.
    pub fn grid(&self) -> Result<DensityGrid, CacheError> {
        let (payload, _) = self.extents();
        let map = || {
            let map = map_part(&self.file, PAGE, payload)?;
            if payload > self.max_bytes {
                read_page_by_page(&map)?;
            }
            Ok(map)
        };
        let map = map().map_err(|source| CacheError::Read {
            path: self.path.clone(),
            source,
        })?;
        sections::read(&self.sections, self.encoding, map, self.transform).map_err(|what| {
            CacheError::Damaged {
                path: self.path.clone(),
                what,
            }
        })
    }

    /// Reads all bricks and holds them against their checksum.
    ///
    /// # Errors
    /// If they cannot be read or do not match it.
    pub fn verify_payload(&self) -> Result<(), CacheError> {
        let (payload, _) = self.extents();
        let sum = || {
            let mut file = &self.file;
            file.seek(SeekFrom::Start(PAGE))?;
            Checksum::of_reader(file.take(payload as u64))
        };
        match sum() {
            Ok((_, sum)) if sum == self.header.payload_checksum => Ok(()),
            Ok(_) => Err(CacheError::Damaged {
                path: self.path.clone(),
                what: "bricks do not match their checksum".to_owned(),
            }),
            Err(source) => Err(CacheError::Read {
                path: self.path.clone(),
                source,
            }),
        }
    }

    fn extents(&self) -> (usize, u64) {
        let extents = self.header.extents(self.encoding);
        extents.expect("checked when the file was opened")
    }

    /// Returns where the grid comes from.
    pub fn source(&self) -> &Source {
        &self.source
    }

    /// Returns how values are stored.
    pub fn stored(&self) -> Stored {
        let [rms, worst] = self.header.depth_error;
        Stored {
            encoding: self.encoding,
            reason: Reason::Cached,
            error: DepthError { rms, worst },
        }
    }

    /// Returns the number of bricks.
    pub fn brick_count(&self) -> u64 {
        self.header.brick_count
    }

    /// Returns the map between index and world space.
    pub fn transform(&self) -> &IndexTransform {
        &self.transform
    }
}

/// Takes the names off the front of `bytes`.
fn take_source(bytes: &mut &[u8], header: &Header) -> Option<Source> {
    let count = take_number(bytes)?;
    let file = take_name(bytes)?;
    let grid = take_name(bytes)?;
    let mut metadata = Vec::new();
    for _ in 0..count.checked_sub(2)? / 2 {
        metadata.push((take_name(bytes)?, take_name(bytes)?));
    }
    Some(Source {
        file,
        bytes: header.source_bytes,
        checksum: header.source_checksum,
        grid,
        metadata,
    })
}

fn take_number(bytes: &mut &[u8]) -> Option<usize> {
    let (number, rest) = bytes.split_first_chunk()?;
    *bytes = rest;
    usize::try_from(u64::from_ne_bytes(*number)).ok()
}

/// Takes a name: its length, its letters, and zeros up to a multiple of eight.
fn take_name(bytes: &mut &[u8]) -> Option<String> {
    let len = take_number(bytes)?;
    let padded = len.checked_next_multiple_of(8)?;
    let (name, rest) = bytes.split_at_checked(padded)?;
    *bytes = rest;
    Some(String::from_utf8_lossy(&name[..len]).into_owned())
}

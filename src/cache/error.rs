//! What can be wrong with a cache file.

use std::io;
use std::path::PathBuf;

use crate::grid::GridTooLarge;

/// An error from writing or opening a cache file.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CacheError {
    /// The system could not give us the file.
    #[error("{}: cannot be read", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// The file could not be written.
    #[error("{}: cannot be written", path.display())]
    Write {
        /// The file, not the temporary one.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// The file does not begin as cache files do.
    #[error("{}: not a cache file of majorant", path.display())]
    NotCache {
        /// The file.
        path: PathBuf,
    },
    /// The file's version is another.
    #[error("{}: cache format version {found}, expected {expected}; write it again", path.display())]
    Version {
        /// The file.
        path: PathBuf,
        /// Its version.
        found: u32,
        /// The version that is read.
        expected: u32,
    },
    /// The file was written on a machine of the other byte order.
    #[error("{}: written on a machine of another byte order; write it again on this one", path.display())]
    ByteOrder {
        /// The file.
        path: PathBuf,
    },
    /// The file contradicts itself or its checksums, or ends too early.
    #[error("{}: {what}; the file is damaged or was cut short, write it again", path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// What was found and what was expected.
        what: String,
    },
    /// What is always in memory is too large for it.
    #[error("{}: {source}; allow more by --max-memory", path.display())]
    TooLarge {
        /// The file.
        path: PathBuf,
        /// How much it needs.
        source: GridTooLarge,
    },
}

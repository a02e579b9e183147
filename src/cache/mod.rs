//! Cache files: a grid ready to render, written once and mapped later.
//!
//! ```text
//! header      4096 bytes: magic, version, encoding, transform, lengths, checksums
//! payload     the codes of all bricks, along a Morton curve; mapped, read from disk on demand
//! resident    names, then nodes, bounds and ranges; read at once
//! ```
//!
//! A .vdb file has to be read, inflated and bounded before the first ray. A cache file has all that
//! done: opening it reads the resident part, about 3 to 6 % of an `f32` volume, and the system pages
//! bricks in as rays meet them and out as memory runs short. A volume larger than memory
//! renders, the slower the less of it fits.
//!
//! Nothing in the file is trusted but the payload, whose bits are values whatever they are; its
//! checksum takes reading all of it and is left to [`CacheFile::verify_payload`]. Files of the other
//! byte order are refused: caches are made where they are used. No optics here.

mod error;
mod format;
mod read;
mod write;

pub use error::CacheError;
pub use format::{Checksum, Source};
pub use read::{CacheFile, is_cache};
pub use write::{Contents, write};

//! Reading OpenVDB files.
//!
//! A file is opened and walked with checks ([`Archive::open`]), then grids are loaded one at a
//! time: [`Archive::load`] for exact values of any type, [`Archive::load_density`] for
//! rendering. What is read, what is refused and the voxel policy are in `docs/vdb.md`.
//!
//! ```text
//! file ─ mapped ─ archive (checked walk) ─ canonical (repaired shares) ─ decode (vdb-rs,
//!                 cursor, metadata,                                      parallel) ─ Tree
//!                 transform, record, topology
//! ```
//!
//! vdb-rs 0.6.0 decodes compressed values and nothing else: by itself it loses data, panics or
//! aborts on ordinary files (`docs/adr/0005-vdb-rs-behind-a-front-end.md`).
//!
//! This module knows no optics. It neither writes .vdb files nor reads points.
//!
//! ```
//! use majorant::vdb::{Archive, LoadOptions};
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! # let path = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/fixtures/vdb/tiles_root_zip.vdb");
//! let archive = Archive::open(path.as_ref())?;
//! for grid in archive.grids() {
//!     println!("{}: {}, {}", grid.name, grid.type_name, grid.class);
//! }
//! let density = archive.load_density(archive.find("density")?, &LoadOptions::default())?;
//! println!("{} bricks", density.tree.brick_count());
//! # Ok(())
//! # }
//! ```

mod archive;
mod canonical;
mod cursor;
mod decode;
mod error;
mod file;
mod listing;
mod load;
mod memory;
mod metadata;
mod record;
mod statistics;
mod topology;
mod transform;

pub use archive::Archive;
pub use error::{Damage, Place, Refusal, VdbError};
pub(crate) use file::{map_part, read_page_by_page};
pub use listing::GridInfo;
pub use load::{DensityData, Grid, LoadOptions, LoadReport};
pub use statistics::{Components, Statistics, TypedGrid};

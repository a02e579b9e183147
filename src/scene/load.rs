//! Loads a scene's volume: walks the file, decodes the density grid, builds its bounds. Or maps a
//! cache file, where all that is done.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::SceneError;
use crate::cache::CacheFile;
use crate::field::Field;
use crate::grid::{DensityGrid, Storage, Stored};
use crate::vdb::{Archive, DensityData, LoadReport};

pub use crate::vdb::LoadOptions;

/// Where loading is, told as each stage begins.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LoadStage {
    /// Walking the file and checking it.
    Read,
    /// Decompressing voxels into bricks.
    Decode,
    /// Computing bounds.
    Build,
}

/// A density grid, ready to render, and where it came from.
#[derive(Clone, Debug)]
pub struct LoadedVolume {
    /// The grid.
    pub grid: Arc<DensityGrid>,
    /// The file.
    pub path: PathBuf,
    /// The grid's name in it.
    pub name: String,
    /// The grid's metadata.
    pub metadata: Vec<(String, String)>,
    /// Active voxels, tiles counted by their volume, if the file says.
    pub active_voxel_count: Option<u64>,
    /// Other grids of the file, which were not read beyond the checks.
    pub unused_grids: Vec<String>,
    /// What the volume emits, or the temperatures that it does by, if the scene says so.
    pub emission: Option<Field>,
    /// The albedo, where the scene takes it from grids.
    pub colour: Option<Field>,
    /// Bricks of 8³ voxels.
    pub brick_count: usize,
    /// How values are stored, and why.
    pub stored: Stored,
    /// What was changed while loading.
    pub report: LoadReport,
}

impl LoadedVolume {
    /// Decodes grid `index` of `archive`, to be kept as `storage` says; `on_stage` hears of
    /// decoding and building.
    ///
    /// # Errors
    /// If the grid's type cannot be rendered, it needs too much memory, it is damaged, or the
    /// encoding asked for cannot hold it.
    pub fn decode(
        archive: &Archive,
        index: usize,
        options: &LoadOptions,
        storage: &Storage,
        on_stage: &mut dyn FnMut(LoadStage),
    ) -> Result<Self, SceneError> {
        on_stage(LoadStage::Decode);
        let DensityData {
            mut tree,
            transform,
            report,
        } = archive
            .load_density(index, options)
            .map_err(|source| SceneError::Volume { at: None, source })?;
        on_stage(LoadStage::Build);
        tree.drop_active_masks();
        let brick_count = tree.brick_count();
        let info = &archive.grids()[index];
        let max_bytes = usize::try_from(options.max_memory_bytes).unwrap_or(usize::MAX);
        let stored =
            storage
                .choose(&tree, &transform)
                .map_err(|source| SceneError::TooLargeForHalf {
                    path: archive.path().to_owned(),
                    grid: info.address.clone(),
                    source,
                })?;
        let grid = DensityGrid::encoded(tree, transform, stored.encoding, max_bytes);
        let grid = grid.map_err(|source| SceneError::TooLarge {
            path: archive.path().to_owned(),
            grid: info.address.clone(),
            source,
        })?;
        Ok(Self {
            grid: Arc::new(grid),
            path: archive.path().to_owned(),
            name: info.address.clone(),
            metadata: info.metadata.clone(),
            unused_grids: archive
                .grids()
                .iter()
                .filter(|g| g.address != info.address)
                .map(|g| g.address.clone())
                .collect(),
            active_voxel_count: info.active_voxel_count,
            emission: None,
            colour: None,
            brick_count,
            stored,
            report,
        })
    }

    /// Maps the grid of a cache file.
    ///
    /// # Errors
    /// If the file is no cache file, is damaged, or needs too much memory.
    pub fn map(path: &Path, options: &LoadOptions) -> Result<Self, SceneError> {
        let failed = |source| SceneError::Cache { at: None, source };
        let max_bytes = usize::try_from(options.max_memory_bytes).unwrap_or(usize::MAX);
        let file = CacheFile::open(path, max_bytes).map_err(failed)?;
        let grid = file.grid().map_err(failed)?;
        Ok(Self {
            brick_count: grid.brick_count(),
            grid: Arc::new(grid),
            path: path.to_owned(),
            name: file.source().grid.clone(),
            metadata: file.source().metadata.clone(),
            active_voxel_count: None,
            emission: None,
            colour: None,
            unused_grids: Vec::new(),
            stored: file.stored(),
            report: LoadReport::default(),
        })
    }
}

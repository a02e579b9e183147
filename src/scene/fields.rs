//! Loads the grids of a volume that are no density: light, temperatures, colours.
//!
//! Values are kept in 16 bit between the minimum and the maximum of each brick. What such a grid
//! does not store is zero, whatever its background: light cannot fill all of space.

use std::ops::Range;
use std::sync::Arc;

use toml::Spanned;

use super::error::SceneError;
use crate::field::Field;
use crate::grid::{DensityGrid, Encoding};
use crate::vdb::{Archive, DensityData, LoadOptions, LoadReport, VdbError};

/// One grid by name, or one for each channel.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct FieldNames {
    names: Vec<String>,
    /// In the scene file.
    at: Range<usize>,
}

impl FieldNames {
    /// Names a scalar grid, or one of vectors.
    pub(super) fn one(name: &Spanned<String>) -> Self {
        Self {
            names: vec![name.get_ref().clone()],
            at: name.span(),
        }
    }

    /// Names the grids of a table that stands at `at`: none if it names none, or both ways.
    pub(super) fn of(
        grid: Option<&String>,
        grids: Option<&[String; 3]>,
        at: Range<usize>,
    ) -> Option<Self> {
        let names = match (grid, grids) {
            (Some(name), None) => vec![name.clone()],
            (None, Some(three)) => three.to_vec(),
            _ => return None,
        };
        Some(Self { names, at })
    }

    /// Names whichever is given; `table` is where it is.
    pub(super) fn new<T>(
        grid: Option<&Spanned<String>>,
        grids: Option<&Spanned<[String; 3]>>,
        table: &Spanned<T>,
    ) -> Self {
        match (grid, grids) {
            (Some(name), _) => Self::one(name),
            (None, Some(three)) => Self {
                names: three.get_ref().to_vec(),
                at: three.span(),
            },
            (None, None) => Self {
                names: Vec::new(),
                at: table.span(),
            },
        }
    }

    /// Returns the place in the scene file.
    pub(super) fn at(&self) -> Range<usize> {
        self.at.clone()
    }

    /// Returns whether a grid of this name is among them.
    pub(super) fn contain(&self, name: &str) -> bool {
        self.names.iter().any(|n| n == name)
    }

    /// Loads the field from `archive`, and adds what happened on the way to `report`.
    pub(super) fn load(
        &self,
        archive: &Archive,
        options: &LoadOptions,
        report: &mut LoadReport,
    ) -> Result<Field, SceneError> {
        let at_file = |source: VdbError| SceneError::Volume { at: None, source };
        let mut grids = Vec::with_capacity(3);
        for name in &self.names {
            let index = archive.find(name).map_err(at_file)?;
            let address = &archive.grids()[index].address;
            let is_vector = archive.is_vector(index).map_err(at_file)?;
            // Of three names each is a channel, so none may be a vector.
            let components = if is_vector && self.names.len() == 1 {
                3
            } else {
                1
            };
            for component in 0..components {
                let data = if components == 3 {
                    archive.load_component(index, component, options)
                } else {
                    archive.load_density(index, options)
                };
                let data = data.map_err(at_file)?;
                grids.push(build(archive, address, data, options, report)?);
            }
        }
        match <[Arc<DensityGrid>; 3]>::try_from(grids) {
            Ok(three) => Ok(Field::colour(three)),
            Err(mut grids) => Ok(Field::scalar(grids.remove(0))),
        }
    }
}

fn build(
    archive: &Archive,
    grid: &str,
    data: DensityData,
    options: &LoadOptions,
    report: &mut LoadReport,
) -> Result<Arc<DensityGrid>, SceneError> {
    let DensityData {
        mut tree,
        transform,
        report: own,
    } = data;
    report.clamped_negative_count += own.clamped_negative_count;
    report.sanitized_count += own.sanitized_count;
    report.decode_seconds += own.decode_seconds;
    tree.set_background(0.0);
    let max_bytes = usize::try_from(options.max_memory_bytes).unwrap_or(usize::MAX);
    let built = DensityGrid::encoded(tree, transform, Encoding::U16, max_bytes);
    built.map(Arc::new).map_err(|source| SceneError::TooLarge {
        path: archive.path().to_owned(),
        grid: grid.to_owned(),
        source,
    })
}

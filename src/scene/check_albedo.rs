//! Checks the albedo of a volume: three numbers, or grids.

use toml::Spanned;

use super::desc::{AlbedoDesc, AlbedoGridDesc};
use super::error::{Check, Source};
use super::fields::FieldNames;
use super::value::{colour, non_negative_f32};
use crate::spectrum::Rgb;

/// An albedo, its grids not yet loaded.
#[derive(Clone, Debug)]
pub(super) enum CheckedAlbedo {
    Constant(Rgb),
    Grids { names: FieldNames, scale: f32 },
}

impl CheckedAlbedo {
    /// Checks the description.
    pub(super) fn new(source: &Source, albedo: &Spanned<AlbedoDesc>) -> Check<Self> {
        let wrong =
            |message: String, expected: &str| source.error(albedo.span(), message, expected);
        let AlbedoGridDesc { grid, grids, scale } = match albedo.get_ref() {
            AlbedoDesc::Grid(desc) => desc,
            AlbedoDesc::Constant(channels) => {
                if !channels.iter().all(|a| (0.0..=1.0).contains(a)) {
                    let message = format!("albedo is {channels:?}");
                    return Err(wrong(message, "three numbers from 0 to 1"));
                }
                let spanned = Spanned::new(albedo.span(), *channels);
                return Ok(Self::Constant(colour(source, "albedo", &spanned)?));
            }
        };
        let names = FieldNames::of(grid.as_ref(), grids.as_ref(), albedo.span());
        let names = names.ok_or_else(|| {
            let message = "albedo needs one of grid and grids".to_owned();
            wrong(
                message,
                "albedo = { grid = \"Cd\" } or { grids = [\"…\", \"…\", \"…\"] }",
            )
        })?;
        let scale = non_negative_f32(*scale).ok_or_else(|| {
            let message = format!("the albedo's scale is {scale}");
            wrong(message, "a number from 0 to 3e38")
        })?;
        Ok(Self::Grids { names, scale })
    }

    /// Returns the albedo where no grid says otherwise.
    pub(super) fn constant(&self) -> Rgb {
        match self {
            Self::Constant(albedo) => *albedo,
            Self::Grids { .. } => Rgb::WHITE,
        }
    }

    /// Returns the grids, if it comes from some.
    pub(super) fn names(&self) -> Option<&FieldNames> {
        match self {
            Self::Constant(_) => None,
            Self::Grids { names, .. } => Some(names),
        }
    }

    /// Returns what the grids are multiplied by.
    pub(super) fn scale(&self) -> Option<f32> {
        match self {
            Self::Constant(_) => None,
            Self::Grids { scale, .. } => Some(*scale),
        }
    }
}

//! A good first picture of a bare volume: which grid, which camera, which light.
//!
//! The density is found by name, then by class; the camera takes a three-quarter view that
//! just holds the occupied box; the density is scaled so that the view's mean column has a
//! stated optical thickness, whatever the file's units; a warm sun stands behind the camera's
//! shoulder in a blue sky. The choice is written as a scene file, so nothing here is beyond
//! what a person could have written.

use std::path::PathBuf;

use glam::DVec3;
use toml::Spanned;

use super::desc::{
    CameraDesc, DensityDesc, ImageDesc, LightDesc, LightKind, PhaseDesc, PhaseKind, RenderDesc,
    SceneDesc, VolumeDesc, unplaced,
};
use super::error::SceneError;
use super::framing::{Axes, FOV_DEGREES, Frame, visible_points};
use super::load::LoadedVolume;
use super::{SceneFile, write};
use crate::grid::{Reason, Storage, StorageKind};
use crate::vdb::{Archive, GridInfo};

/// Mean optical thickness of the view's columns: an opaque body with soft edges, as cumulus has.
const MEAN_OPTICAL_THICKNESS: f64 = 20.0;
/// A part of the volume is worth framing from this optical thickness on.
const VISIBLE_OPTICAL_THICKNESS: f64 = 0.02;
/// Direction to the sun, as multiples of the camera's right, up and backward axes.
const SUN: [f64; 3] = [-0.85, 0.55, 0.2];
/// Light of the sun: warm.
const SUN_IRRADIANCE: [f64; 3] = [4.8, 4.1, 3.2];
/// Light of the sky: blue.
const SKY_RADIANCE: [f64; 3] = [0.11, 0.18, 0.33];
/// Mean cosine of scattering. Droplets scatter by 0.85; that takes several times the samples
/// for a picture that differs little where the light has scattered often.
const G: f64 = 0.35;

/// Which axis of the world points up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum UpAxis {
    /// As in Houdini, Maya and `EmberGen`.
    Y,
    /// As in Blender and in most of science.
    Z,
}

/// Words in grid metadata that tell of a program whose world has y up. Houdini writes the key
/// `value_type`.
const Y_UP_MARKS: [&str; 6] = [
    "houdini",
    "value_type",
    "bifrost",
    "maya",
    "embergen",
    "jangafx",
];

impl UpAxis {
    /// Guesses the axis from who wrote the grid: y for programs known to use it, else z.
    fn of(metadata: &[(String, String)]) -> (Self, String) {
        for (key, value) in metadata {
            let text = format!("{key} {value}").to_lowercase();
            if let Some(mark) = Y_UP_MARKS.iter().find(|m| text.contains(*m)) {
                return (Self::Y, format!("the grid's metadata speaks of {mark}"));
            }
        }
        (Self::Z, "no sign of a program with y up".to_owned())
    }

    pub(super) fn up(self) -> DVec3 {
        match self {
            Self::Y => DVec3::Y,
            Self::Z => DVec3::Z,
        }
    }

    /// The direction from the volume to a viewer in front of it.
    pub(super) fn front(self) -> DVec3 {
        match self {
            Self::Y => DVec3::Z,
            Self::Z => DVec3::NEG_Y,
        }
    }
}

/// Words in the names of grids that are no density, whatever their class: Blender's `shadow`
/// is −1 over the whole domain.
const OTHER_QUANTITIES: [&str; 10] = [
    "shadow", "temp", "heat", "flame", "fire", "fuel", "vel", "emission", "color", "mask",
];

/// Chooses the density of `archive`: the grid called `requested`, else the best by name and
/// class. Returns its index and why.
///
/// # Errors
/// If there is no grid of the requested name, or none that looks like a density.
pub fn choose_grid(
    archive: &Archive,
    requested: Option<&str>,
) -> Result<(usize, String), SceneError> {
    if let Some(name) = requested {
        let index = archive
            .find(name)
            .map_err(|source| SceneError::Volume { at: None, source })?;
        return Ok((index, "named on the command line".to_owned()));
    }
    let ranked = archive
        .grids()
        .iter()
        .enumerate()
        .filter_map(|(index, info)| {
            let (rank, why) = rank(info).ok()?;
            Some((rank, std::cmp::Reverse(info.active_voxel_count), index, why))
        });
    match ranked.min() {
        Some((_, _, index, why)) => Ok((index, why.to_owned())),
        None => Err(SceneError::NoDensity {
            path: archive.path().to_owned(),
            found: describe_grids(archive),
        }),
    }
}

/// Returns how good a density `info` makes, 0 best, and why; or why it makes none.
fn rank(info: &GridInfo) -> Result<(u8, &'static str), String> {
    if let Some(reason) = &info.refused {
        return Err(reason.to_string());
    }
    if !["float", "double", "int32", "int64"].contains(&info.type_name.as_str()) {
        return Err(format!("holds {}", info.type_name));
    }
    if info.active_voxel_count == Some(0) {
        return Err("empty".to_owned());
    }
    if info.class == "level set" {
        return Err("a level set".to_owned());
    }
    let name = info.name.to_lowercase();
    if let Some(word) = OTHER_QUANTITIES.iter().find(|w| name.contains(*w)) {
        return Err(format!("{word} is no density"));
    }
    match name.as_str() {
        "density_noise" => return Ok((0, "a density at the higher resolution of the two")),
        "density" => return Ok((1, "called density")),
        _ => {}
    }
    if name.contains("density") {
        return Ok((2, "its name holds the word density"));
    }
    if ["smoke", "fog", "cloud"].iter().any(|w| name.contains(w)) {
        return Ok((3, "named like something one sees"));
    }
    if info.class == "fog volume" {
        return Ok((4, "of class fog volume"));
    }
    Err("neither named like a density nor a fog volume".to_owned())
}

fn describe_grids(archive: &Archive) -> String {
    let each = archive.grids().iter().map(|info| {
        let why = rank(info).map_or_else(|why| why, |(_, why)| why.to_owned());
        format!("{:?} ({why})", info.address)
    });
    match each.collect::<Vec<_>>().join(", ") {
        list if list.is_empty() => "the file is empty".to_owned(),
        list => format!("{list}; name one by --grid"),
    }
}

/// What a person may ask of the default look.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Wishes {
    /// Columns and rows.
    pub resolution: Option<[u32; 2]>,
    /// The axis that points up.
    pub up: Option<UpAxis>,
    /// How values are stored; lossless unless asked for, since the scale that `auto` needs is
    /// chosen after loading.
    pub encoding: Option<StorageKind>,
}

impl Wishes {
    /// Returns how a volume without a scene is stored.
    pub fn storage(&self) -> Storage {
        let lossless = Storage::lossless();
        Storage {
            kind: self.encoding.unwrap_or(lossless.kind),
            ..lossless
        }
    }
}

/// Writes the default look of a loaded volume; `why` says why this grid.
///
/// # Errors
/// If the grid is zero everywhere: there is nothing to look at.
pub fn describe(volume: &LoadedVolume, why: &str, wishes: Wishes) -> Result<SceneFile, SceneError> {
    let bounds = volume
        .grid
        .world_bounds()
        .ok_or_else(|| SceneError::NoDensity {
            path: volume.path.clone(),
            found: format!("{:?} is zero everywhere", volume.name),
        })?;
    let (up_axis, up_why) = match wishes.up {
        Some(axis) => (axis, "asked for".to_owned()),
        None => UpAxis::of(&volume.metadata),
    };
    let image = wishes
        .resolution
        .map_or_else(ImageDesc::default, |r| ImageDesc {
            resolution: unplaced(r),
            ..ImageDesc::default()
        });
    let [width, height] = image.resolution.get_ref().map(f64::from);
    let axes = Axes::new(up_axis);
    let column = volume.grid.mean_column_density(-axes.back);
    // Zero: no column holds anything; then no scale helps.
    let scale = if column > 0.0 {
        MEAN_OPTICAL_THICKNESS / column
    } else {
        1.0
    };
    let min_column = VISIBLE_OPTICAL_THICKNESS / scale;
    let points = visible_points(&volume.grid, &bounds, &axes, min_column);
    let frame = Frame::around(&points, &axes, width / height);
    let size = (bounds.max - bounds.min).length() / 2.0;
    let desc = SceneDesc {
        image,
        camera: CameraDesc {
            position: placed_vector(frame.position, size),
            look_at: placed_vector(frame.look_at, size),
            up: unplaced(up_axis.up().to_array()),
            vertical_fov_degrees: unplaced(FOV_DEGREES),
        },
        volume: vec![unplaced(volume_desc(volume, scale, wishes))],
        light: lights(&axes),
        render: RenderDesc::default(),
    };
    let file_name = volume
        .path
        .file_name()
        .unwrap_or_default()
        .to_string_lossy();
    let header = format!(
        "Default look of {file_name}. File names are relative to this file.\n\
         density: {why}\n\
         up: {up_why}\n\
         scale: mean optical thickness {MEAN_OPTICAL_THICKNESS} along the view"
    );
    let name = PathBuf::from(format!("default look of {file_name}"));
    SceneFile::parse(&name, write::to_toml(&desc, &header))
}

fn volume_desc(volume: &LoadedVolume, scale: f64, wishes: Wishes) -> VolumeDesc {
    VolumeDesc {
        density: DensityDesc {
            grid: unplaced(volume.name.clone()),
            scale: unplaced(three_digits(scale)),
        },
        phase: unplaced(PhaseDesc {
            kind: PhaseKind::HenyeyGreenstein,
            g: Some(unplaced(G)),
            ..PhaseDesc::default()
        }),
        encoding: unplaced(match volume.stored.reason {
            Reason::Cached => StorageKind::Auto,
            _ => wishes.storage().kind,
        }),
        ..VolumeDesc::of(volume.path.clone())
    }
}

fn lights(axes: &Axes) -> Vec<Spanned<LightDesc>> {
    let [right, up, back] = SUN;
    let to_sun = axes.right * right + axes.up * up + axes.back * back;
    let sun = LightDesc {
        direction_to_light: Some(placed_vector(to_sun, 1.0)),
        irradiance: Some(unplaced(SUN_IRRADIANCE)),
        angular_diameter_degrees: Some(unplaced(0.0)),
        ..LightDesc::new(LightKind::Distant)
    };
    let sky = LightDesc {
        radiance: Some(unplaced(SKY_RADIANCE)),
        ..LightDesc::new(LightKind::Constant)
    };
    vec![unplaced(sun), unplaced(sky)]
}

/// Rounds to a thousandth of `size`, so that the scene file is pleasant to read.
fn placed_vector(v: DVec3, size: f64) -> Spanned<[f64; 3]> {
    // In f64 there is no size whose logarithm leaves -324..=308.
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "in 0..=300; NaN becomes 0"
    )]
    let digits = (3.0 - size.log10().floor()).clamp(0.0, 300.0) as usize;
    unplaced(v.to_array().map(|x| {
        let rounded = format!("{x:.digits$}").parse().unwrap_or(x);
        // Not -0.
        rounded + 0.0
    }))
}

/// Rounds to three significant digits.
fn three_digits(x: f64) -> f64 {
    format!("{x:.2e}").parse().unwrap_or(x)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rounding_keeps_far_places_apart() {
        let v = placed_vector(DVec3::new(1e7 + 0.123_456, -0.000_01, 2.0), 1.0);
        assert_eq!(v.get_ref(), &[10_000_000.123, 0.0, 2.0]);
        assert_eq!(three_digits(83.96), 84.0);
    }
}

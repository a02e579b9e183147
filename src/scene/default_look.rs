//! A good first picture of a bare volume: which grid, which camera, which light.
//!
//! The density is found by name, then by class; the camera takes a three-quarter view that
//! just holds the occupied box; the density is scaled so that the view's mean column has a
//! stated optical thickness, whatever the file's units; a warm sun stands behind the camera's
//! shoulder in a blue sky. The choice is written as a scene file, so nothing here is beyond
//! what a person could have written.

use std::path::{Path, PathBuf};

use glam::DVec3;
use toml::Spanned;

use super::desc::{
    CameraDesc, DensityDesc, ImageDesc, LightDesc, LightKind, PhaseDesc, PhaseKind, RenderDesc,
    SceneDesc, VolumeDesc, unplaced,
};
use super::error::SceneError;
use super::load::LoadedVolume;
use super::{SceneFile, write};
use crate::space::Aabb;
use crate::vdb::{Archive, GridInfo};

/// Mean optical thickness of the view's columns: an opaque body with soft edges.
const MEAN_OPTICAL_THICKNESS: f64 = 8.0;
/// Vertical field of view of the camera.
const FOV_DEGREES: f64 = 30.0;
/// Turn of the camera from the volume's front to its right.
const AZIMUTH_DEGREES: f64 = 30.0;
/// Height of the camera above the volume's horizon.
const ELEVATION_DEGREES: f64 = 8.0;
/// Share of the image's half size that the box's corners may take.
const FILL: f64 = 0.94;
/// Direction to the sun, as multiples of the camera's right, up and backward axes.
const SUN: [f64; 3] = [-0.75, 0.62, 0.35];
/// Light of the sun: warm.
const SUN_IRRADIANCE: [f64; 3] = [6.0, 5.4, 4.6];
/// Light of the sky: blue.
const SKY_RADIANCE: [f64; 3] = [0.26, 0.38, 0.62];
/// Mean cosine of scattering.
const G: f64 = 0.7;

/// Which axis of the world points up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum UpAxis {
    /// As in Houdini, Maya and `EmberGen`.
    Y,
    /// As in Blender and in most of science.
    Z,
}

/// Names of programs and formats whose worlds have y up, as they occur in grid metadata.
const Y_UP_MARKS: [&str; 5] = ["houdini", "bifrost", "maya", "embergen", "jangafx"];

impl UpAxis {
    /// Guesses the axis from who wrote the grid: y for programs known to use it, else z.
    fn of(info: &GridInfo) -> (Self, String) {
        for (key, value) in &info.metadata {
            let text = format!("{key} {value}").to_lowercase();
            if let Some(mark) = Y_UP_MARKS.iter().find(|m| text.contains(*m)) {
                return (Self::Y, format!("the grid's metadata speaks of {mark}"));
            }
        }
        (Self::Z, "no sign of a program with y up".to_owned())
    }

    fn up(self) -> DVec3 {
        match self {
            Self::Y => DVec3::Y,
            Self::Z => DVec3::Z,
        }
    }

    /// The direction from the volume to a viewer in front of it.
    fn front(self) -> DVec3 {
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
    let ranked = archive.grids().iter().enumerate().filter_map(|(index, info)| {
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
}

/// Writes the default look of a loaded volume; `why` says why this grid.
///
/// # Errors
/// If the grid is zero everywhere: there is nothing to look at.
pub fn describe(
    volume: &LoadedVolume,
    info: &GridInfo,
    why: &str,
    wishes: Wishes,
) -> Result<SceneFile, SceneError> {
    let bounds = volume.grid.world_bounds().ok_or_else(|| SceneError::NoDensity {
        path: volume.path.clone(),
        found: format!("{:?} is zero everywhere", info.address),
    })?;
    let (up_axis, up_why) = match wishes.up {
        Some(axis) => (axis, "asked for".to_owned()),
        None => UpAxis::of(info),
    };
    let image = wishes.resolution.map_or_else(ImageDesc::default, |r| ImageDesc {
        resolution: unplaced(r),
    });
    let [width, height] = image.resolution.get_ref().map(f64::from);
    let view = View::new(up_axis, &bounds, width / height);
    let column = volume.grid.mean_column_density(view.forward);
    // Zero: no column holds anything; then no scale helps.
    let scale = if column > 0.0 { MEAN_OPTICAL_THICKNESS / column } else { 1.0 };
    let desc = SceneDesc {
        image,
        camera: CameraDesc {
            position: placed_vector(view.position, view.radius),
            look_at: placed_vector(bounds.center(), view.radius),
            up: unplaced(up_axis.up().to_array()),
            vertical_fov_degrees: unplaced(FOV_DEGREES),
        },
        volume: vec![unplaced(volume_desc(&volume.path, &info.address, scale))],
        light: lights(&view),
        render: RenderDesc::default(),
    };
    let file_name = volume.path.file_name().unwrap_or_default().to_string_lossy();
    let header = format!(
        "Default look of {file_name}. File names are relative to this file.\n\
         density: {why}\n\
         up: {}\n\
         scale: mean optical thickness {MEAN_OPTICAL_THICKNESS} along the view",
        up_why,
    );
    let name = PathBuf::from(format!("default look of {file_name}"));
    SceneFile::parse(&name, write::to_toml(&desc, &header))
}

fn volume_desc(path: &Path, grid: &str, scale: f64) -> VolumeDesc {
    VolumeDesc {
        file: unplaced(path.to_owned()),
        density: DensityDesc {
            grid: unplaced(grid.to_owned()),
            scale: unplaced(three_digits(scale)),
        },
        albedo: VolumeDesc::default_albedo(),
        phase: unplaced(PhaseDesc {
            kind: PhaseKind::HenyeyGreenstein,
            g: Some(unplaced(G)),
        }),
    }
}

fn lights(view: &View) -> Vec<Spanned<LightDesc>> {
    let [right, up, back] = SUN;
    let to_sun = view.right * right + view.up * up - view.forward * back;
    let sun = LightDesc {
        kind: LightKind::Distant,
        direction_to_light: Some(placed_vector(to_sun, 1.0)),
        irradiance: Some(unplaced(SUN_IRRADIANCE)),
        angular_diameter_degrees: Some(unplaced(0.0)),
        radiance: None,
    };
    let sky = LightDesc {
        kind: LightKind::Constant,
        direction_to_light: None,
        irradiance: None,
        angular_diameter_degrees: None,
        radiance: Some(unplaced(SKY_RADIANCE)),
    };
    vec![unplaced(sun), unplaced(sky)]
}

/// Where the camera stands and its axes.
struct View {
    position: DVec3,
    forward: DVec3,
    right: DVec3,
    up: DVec3,
    /// Half the box's diagonal: the size that digits are counted by.
    radius: f64,
}

impl View {
    /// Steps back from the box until all its corners are in the image.
    fn new(axis: UpAxis, bounds: &Aabb, aspect: f64) -> Self {
        let (azimuth, elevation) = (AZIMUTH_DEGREES.to_radians(), ELEVATION_DEGREES.to_radians());
        let (world_up, front) = (axis.up(), axis.front());
        let side = world_up.cross(front);
        let level = front * azimuth.cos() + side * azimuth.sin();
        let back = level * elevation.cos() + world_up * elevation.sin();
        // Unit vectors: level and world_up are orthonormal, and back is not vertical.
        let right = front * -azimuth.sin() + side * azimuth.cos();
        let up = back.cross(right);
        let half_height = (FOV_DEGREES.to_radians() / 2.0).tan() * FILL;
        let center = bounds.center();
        // A corner o is inside if |o · axis| <= (distance + o · forward) · half.
        let distance = bounds.corners().into_iter().fold(0.0_f64, |distance, corner| {
            let o = corner - center;
            let x = o.dot(right).abs() / (half_height * aspect);
            let y = o.dot(up).abs() / half_height;
            distance.max(x.max(y) + o.dot(back))
        });
        Self {
            position: center + back * distance,
            forward: -back,
            right,
            up,
            radius: (bounds.max - bounds.min).length() / 2.0,
        }
    }
}

/// Rounds to a thousandth of `size`, so that the scene file is pleasant to read.
fn placed_vector(v: DVec3, size: f64) -> Spanned<[f64; 3]> {
    // In f64 there is no size whose logarithm leaves -324..=308.
    #[expect(clippy::cast_possible_truncation, reason = "small")]
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
    use crate::camera::Camera;

    #[test]
    fn the_whole_box_is_in_the_image_and_touches_its_margin() {
        let bounds = Aabb {
            min: DVec3::new(-3.0, 10.0, 100.0),
            max: DVec3::new(5.0, 11.0, 104.0),
        };
        for axis in [UpAxis::Y, UpAxis::Z] {
            for aspect in [0.5, 16.0 / 9.0] {
                let view = View::new(axis, &bounds, aspect);
                let fov = FOV_DEGREES.to_radians();
                let camera =
                    Camera::look_at(view.position, bounds.center(), axis.up(), fov, aspect)
                        .unwrap();
                let largest = bounds.corners().into_iter().fold(0.0_f64, |m, corner| {
                    let p = camera.camera_from_world().transform_point3(corner);
                    let film = (p.truncate() / -p.z / camera.half_size()).abs();
                    m.max(film.max_element())
                });
                assert!((largest - FILL).abs() < 1e-9, "{axis:?} {aspect}: {largest}");
            }
        }
    }

    #[test]
    fn rounding_keeps_far_places_apart() {
        let v = placed_vector(DVec3::new(1e7 + 0.123_456, -0.000_01, 2.0), 1.0);
        assert_eq!(v.get_ref(), &[10_000_000.123, 0.0, 2.0]);
        assert_eq!(three_digits(83.96), 84.0);
    }
}

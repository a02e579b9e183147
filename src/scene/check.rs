//! Checks every number of a scene description and turns it into what renders.
//!
//! Runs before any volume file is opened, so a mistake in the scene is reported at once. An
//! infinite or absurdly large value is refused here: nothing later checks again.

use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use toml::Spanned;

use super::check_light::check_lights;
use super::check_tracking::{check_medium, check_tracking};
use super::desc::{PhaseDesc, PhaseKind, RenderDesc, SceneDesc, VolumeDesc};
use super::error::{Check, DescriptionError, SceneError, Source};
use super::load::{LoadOptions, LoadStage, LoadedVolume};
use super::value::{colour, direction, finite_vector, non_negative_f32, number};
use super::{Scene, SceneFile};
use crate::cache::is_cache;
use crate::camera::Camera;
use crate::film::Accumulation;
use crate::grid::{Reason, Storage, StorageKind, Stored};
use crate::integrator::{Levers, TransportSettings};
use crate::light::Lights;
use crate::medium::Medium;
use crate::phase::Phase;
use crate::spectrum::Rgb;
use crate::vdb::{Archive, VdbError};

/// Longest edge of an image in pixels.
pub const MAX_RESOLUTION: u32 = 65_536;

/// Bytes for a pixel: sums while it renders, 80 of statistics in the film, and twice the four half
/// and five float channels of the image, plain and compressed, while it is written.
pub const BYTES_PER_PIXEL: u64 = Accumulation::BYTES_PER_PIXEL + 80 + 2 * (4 * 2 + 5 * 4);

/// A checked scene, its volume not yet loaded.
#[derive(Clone, Debug)]
pub struct Checked {
    source: Source,
    resolution: [u32; 2],
    spp: u32,
    seed: u64,
    frame: i32,
    camera: Camera,
    volume: CheckedVolume,
    lights: Lights,
    transport: TransportSettings,
    render: RenderDesc,
}

#[derive(Clone, Debug)]
struct CheckedVolume {
    file: Spanned<PathBuf>,
    path: PathBuf,
    grid: Spanned<String>,
    scale: Range<usize>,
    sigma_t_per_density: f32,
    albedo: Rgb,
    phase: Phase,
    storage: Storage,
    encoding: Range<usize>,
}

impl SceneFile {
    /// Checks all values against each other and against the memory that may be used.
    ///
    /// # Errors
    /// At the first value that is out of range, not finite or contradicts another.
    pub fn check(&self, max_memory_bytes: u64) -> Result<Checked, SceneError> {
        let Self { source, desc } = self;
        check_all(source, desc, max_memory_bytes).map_err(SceneError::Description)
    }
}

fn check_all(source: &Source, desc: &SceneDesc, max_memory_bytes: u64) -> Check<Checked> {
    let resolution = check_resolution(source, &desc.image.resolution, max_memory_bytes)?;
    let spp = *desc.render.spp.get_ref();
    if spp == 0 {
        let span = desc.render.spp.span();
        return Err(source.error(span, "spp is 0", "at least 1 sample a pixel"));
    }
    let seed = *desc.render.seed.get_ref();
    let camera = check_camera(source, desc, resolution)?;
    let volume = check_volume(source, one_volume(source, desc)?)?;
    let lights = check_lights(source, desc)?;
    Ok(Checked {
        source: source.clone(),
        resolution,
        spp,
        seed,
        frame: desc.render.frame,
        camera,
        volume,
        lights,
        transport: TransportSettings {
            integrator: *desc.render.integrator.get_ref(),
            camera_ray: desc.render.camera_ray,
            sampler: desc.render.sampler,
            tracking: check_tracking(source, &desc.render)?,
            max_bounces: desc.render.max_bounces,
            levers: Levers::default(),
        },
        render: desc.render.clone(),
    })
}

fn check_resolution(
    source: &Source,
    resolution: &Spanned<[u32; 2]>,
    max_memory_bytes: u64,
) -> Check<[u32; 2]> {
    let [width, height] = *resolution.get_ref();
    if [width, height]
        .iter()
        .any(|n| !(1..=MAX_RESOLUTION).contains(n))
    {
        let expected = format!("columns and rows from 1 to {MAX_RESOLUTION}");
        let message = format!("resolution is [{width}, {height}]");
        return Err(source.error(resolution.span(), message, expected));
    }
    let bytes = u64::from(width) * u64::from(height) * BYTES_PER_PIXEL;
    if bytes > max_memory_bytes {
        let message = format!("an image of {width} by {height} pixels takes {bytes} bytes");
        let expected = format!("at most {max_memory_bytes} bytes of memory");
        return Err(source.error(resolution.span(), message, expected));
    }
    Ok([width, height])
}

fn check_camera(source: &Source, desc: &SceneDesc, [width, height]: [u32; 2]) -> Check<Camera> {
    let camera = &desc.camera;
    let position = finite_vector(source, "position", &camera.position)?;
    let look_at = finite_vector(source, "look_at", &camera.look_at)?;
    let up = direction(source, "up", &camera.up)?;
    let fov = number(source, "vertical_fov_degrees", &camera.vertical_fov_degrees)?;
    if fov <= 0.0 || fov >= 180.0 {
        let span = camera.vertical_fov_degrees.span();
        let message = format!("vertical_fov_degrees is {fov}");
        return Err(source.error(span, message, "an angle above 0 and below 180 degrees"));
    }
    if position == look_at {
        let message = "look_at is the camera's position";
        return Err(source.error(camera.look_at.span(), message, "another point"));
    }
    let aspect = f64::from(width) / f64::from(height);
    Camera::look_at(position, look_at, up, fov.to_radians(), aspect).ok_or_else(|| {
        // Every other reason has been excluded above.
        let message = "up is parallel to the view direction";
        source.error(
            place(&camera.up, &camera.look_at),
            message,
            "a direction across the view",
        )
    })
}

/// Returns where `value` stands, or where `instead` does if `value` is a default.
fn place<T, U>(value: &Spanned<T>, instead: &Spanned<U>) -> Range<usize> {
    if value.span().is_empty() {
        instead.span()
    } else {
        value.span()
    }
}

fn one_volume<'a>(source: &Source, desc: &'a SceneDesc) -> Check<&'a VolumeDesc> {
    match &desc.volume[..] {
        [volume] => Ok(volume.get_ref()),
        [] => Err(source.error(0..0, "the scene has no [[volume]]", "one volume")),
        [_, second, ..] => {
            let message = format!("the scene has {} volumes", desc.volume.len());
            Err(source.error(second.span(), message, "one volume a scene, for now"))
        }
    }
}

fn check_volume(source: &Source, volume: &VolumeDesc) -> Check<CheckedVolume> {
    let VolumeDesc {
        file,
        frame_offset: _,
        density,
        albedo,
        phase,
        encoding,
        storage_error,
    } = volume;
    let scale = number(source, "scale", &density.scale)?;
    let sigma_t_per_density = non_negative_f32(scale).ok_or_else(|| {
        let expected = "a number from 0 to 3e38, in 1 / world unit";
        source.error(density.scale.span(), format!("scale is {scale}"), expected)
    })?;
    if albedo.get_ref().iter().any(|a| !(0.0..=1.0).contains(a)) {
        let message = format!("albedo is {:?}", albedo.get_ref());
        return Err(source.error(albedo.span(), message, "three numbers from 0 to 1"));
    }
    let max_error = number(source, "storage_error", storage_error)?;
    if max_error < 0.0 {
        let message = format!("storage_error is {max_error}");
        let expected = "an optical depth, 0 or more";
        return Err(source.error(storage_error.span(), message, expected));
    }
    Ok(CheckedVolume {
        file: file.clone(),
        path: source.folder().join(file.get_ref()),
        grid: density.grid.clone(),
        scale: place(&density.scale, file),
        sigma_t_per_density,
        albedo: colour(source, "albedo", albedo)?,
        phase: check_phase(source, phase)?,
        storage: Storage {
            kind: *encoding.get_ref(),
            max_error,
            sigma_t_per_density: Some(sigma_t_per_density),
        },
        encoding: encoding.span(),
    })
}

fn check_phase(source: &Source, phase: &Spanned<PhaseDesc>) -> Check<Phase> {
    let PhaseDesc { kind, g } = phase.get_ref();
    match (kind, g) {
        (PhaseKind::Isotropic, None) => Ok(Phase::Isotropic),
        (PhaseKind::Isotropic, Some(g)) => {
            let mut error = source.error(g.span(), "an isotropic phase function has no g", "no g");
            error.help = Some("write type = \"henyey-greenstein\" to scatter by g".to_owned());
            Err(error)
        }
        (PhaseKind::HenyeyGreenstein, None) => {
            let message = "a henyey-greenstein phase function needs g";
            Err(source.error(
                phase.span(),
                message,
                "g = the mean cosine, say 0.85 for clouds",
            ))
        }
        (PhaseKind::HenyeyGreenstein, Some(spanned)) => {
            let g = number(source, "g", spanned)?;
            #[expect(clippy::cast_possible_truncation, reason = "checked after rounding")]
            let g = g as f32;
            // Rounding to f32 may reach 1, where the density has no limit.
            if g.abs() < 1.0 {
                Ok(Phase::HenyeyGreenstein { g })
            } else {
                let message = format!("g is {}", spanned.get_ref());
                Err(source.error(
                    spanned.span(),
                    message,
                    "a mean cosine above -1 and below 1",
                ))
            }
        }
    }
}

impl Checked {
    /// Returns a text that is the same for two scenes exactly if they load the same volume: file,
    /// its length and when it was written, grid and storage.
    pub fn volume_key(&self) -> String {
        let CheckedVolume {
            path,
            grid,
            storage,
            ..
        } = &self.volume;
        let file = std::fs::metadata(path).ok();
        let file = file.map(|m| (m.len(), m.modified().ok()));
        let (path, grid) = (path.display(), grid.get_ref());
        format!("{path} {file:?} {grid:?} {storage:?}")
    }

    /// Returns the path of the volume file.
    pub fn volume_path(&self) -> &Path {
        &self.volume.path
    }

    /// Reads and decodes the volume; `on_stage` hears where the time goes.
    ///
    /// # Errors
    /// If the file cannot be read, or has no such grid, or one that cannot be rendered.
    pub fn load_volume(
        &self,
        options: &LoadOptions,
        on_stage: &mut dyn FnMut(LoadStage),
    ) -> Result<LoadedVolume, SceneError> {
        let CheckedVolume {
            file,
            path,
            grid,
            storage,
            ..
        } = &self.volume;
        let at = |span: Range<usize>, source: VdbError| {
            let place = DescriptionError {
                expected: None,
                ..*self.source.error(span, source.to_string(), "")
            };
            SceneError::Volume {
                at: Some(Box::new(place)),
                source,
            }
        };
        on_stage(LoadStage::Read);
        if is_cache(path) {
            return self.map_volume(options);
        }
        let archive = Archive::open(path).map_err(|e| at(file.span(), e))?;
        let index = archive
            .find(grid.get_ref())
            .map_err(|e| at(place(grid, file), e))?;
        LoadedVolume::decode(&archive, index, options, storage, on_stage).map_err(|e| match e {
            SceneError::Volume { source, .. } => at(place(grid, file), source),
            other => other,
        })
    }

    /// Maps the cache file that the volume is in, which must hold what the scene asks for.
    fn map_volume(&self, options: &LoadOptions) -> Result<LoadedVolume, SceneError> {
        let CheckedVolume {
            file,
            path,
            grid,
            storage,
            encoding,
            ..
        } = &self.volume;
        let mut volume = LoadedVolume::map(path, options)?;
        let wrong = |span: Range<usize>, message: String, expected: String| {
            SceneError::Description(self.source.error(span, message, expected))
        };
        if volume.name != *grid.get_ref() {
            let message = format!("no grid {:?} in the cache file", grid.get_ref());
            let expected = format!("{:?}, the only one it holds", volume.name);
            return Err(wrong(place(grid, file), message, expected));
        }
        let Stored {
            encoding: held,
            error,
            ..
        } = volume.stored;
        let as_asked = match storage.kind {
            StorageKind::Auto => true,
            // Zero: exact.
            StorageKind::Lossless => error.rms == 0.0,
            kind => kind.fixed() == Some(held),
        };
        if !as_asked {
            let asked = storage.kind.name();
            let message = format!("the cache file holds {held}, which is not {asked}");
            let expected = format!("\"auto\", or a cache file written with --encoding {asked}");
            return Err(wrong(encoding.clone(), message, expected));
        }
        if error.scaled(self.volume.sigma_t_per_density).rms > storage.max_error {
            volume.stored.reason = Reason::CachedOverBudget(storage.max_error);
        }
        Ok(volume)
    }

    /// Puts the loaded volume into the scene.
    ///
    /// # Errors
    /// If the extinction is not finite, or the estimators asked for cannot track the volume.
    pub fn into_scene(self, volume: &LoadedVolume) -> Result<Scene, SceneError> {
        let CheckedVolume {
            scale,
            sigma_t_per_density,
            albedo,
            phase,
            ..
        } = self.volume;
        let [width, height] = self.resolution;
        let grid = Arc::clone(&volume.grid);
        let medium = Medium::new(grid, sigma_t_per_density, albedo, phase);
        // Nothing is drawn at a higher rate: `auto` raises it by 2 at most.
        let tracking = &self.transport.tracking;
        let rate = 4.0 * tracking.rate.max(tracking.flight_rate);
        if !(medium.majorant() * rate).is_finite() {
            let max = medium.grid().bound().max;
            let message = format!("a density of {max} times {sigma_t_per_density} is too large");
            let expected = format!("an extinction below {:.0e} per world unit", f32::MAX / rate);
            let error = self.source.error(scale, message, expected);
            return Err(SceneError::Description(error));
        }
        check_medium(&self.source, &self.render, &medium).map_err(SceneError::Description)?;
        Ok(Scene {
            width,
            height,
            spp: self.spp,
            seed: self.seed,
            frame: self.frame,
            camera: self.camera,
            medium: Some(medium),
            lights: self.lights,
            transport: self.transport,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_film_is_as_large_as_its_estimate() {
        let film = size_of::<crate::film::Pixel>() as u64;
        assert!(BYTES_PER_PIXEL >= Accumulation::BYTES_PER_PIXEL + film + 56);
    }
}

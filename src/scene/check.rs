//! Checks every number of a scene description and turns it into what renders.
//!
//! Runs before any volume file is opened, so a mistake in the scene is reported at once. An
//! infinite or absurdly large value is refused here: nothing later checks again.

use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use toml::Spanned;

use super::check_albedo::CheckedAlbedo;
use super::check_emission::CheckedEmission;
use super::check_light::check_lights;
use super::check_phase::check_phase;
use super::check_tracking::{check_medium, check_tracking};
use super::desc::{ImageDesc, RenderDesc, SceneDesc, VolumeDesc};
use super::error::{Check, DescriptionError, SceneError, Source};
use super::fields::FieldNames;
use super::load::{LoadOptions, LoadStage, LoadedVolume};
use super::placement::{Placement, check_placement};
use super::value::{colour, direction, finite_vector, non_negative_f32, number};
use super::{Scene, SceneFile};
use crate::aov::{self, Aov};
use crate::cache::is_cache;
use crate::camera::Camera;
use crate::field::Field;
use crate::film::Accumulation;
use crate::grid::{Reason, Storage, StorageKind, Stored};
use crate::integrator::{CameraRay, IntegratorKind, Levers, TransportSettings};
use crate::light::Lights;
use crate::medium::Medium;
use crate::phase::Phase;
use crate::spectrum::Rgb;
use crate::vdb::{Archive, LoadReport, VdbError};

/// Longest edge of an image in pixels.
pub const MAX_RESOLUTION: u32 = 65_536;

/// Bytes for a pixel: sums while it renders, 80 of statistics in the film, and twice the four half
/// and five float channels of the image, plain and compressed, while it is written.
pub const BYTES_PER_PIXEL: u64 = Accumulation::BYTES_PER_PIXEL + 80 + 2 * (4 * 2 + 5 * 4);

/// A checked scene, its volumes not yet loaded.
#[derive(Clone, Debug)]
pub struct Checked {
    source: Source,
    resolution: [u32; 2],
    spp: u32,
    seed: u64,
    frame: i32,
    camera: Camera,
    volumes: Vec<CheckedVolume>,
    lights: Lights,
    transport: TransportSettings,
    aovs: Vec<Aov>,
    render: RenderDesc,
}

#[derive(Clone, Debug)]
struct CheckedVolume {
    file: Spanned<PathBuf>,
    path: PathBuf,
    grid: Spanned<String>,
    scale: Range<usize>,
    /// Of the channel with the largest.
    sigma_t_per_density: f32,
    /// Of the others, over that.
    tint: Rgb,
    albedo: CheckedAlbedo,
    phase: Phase,
    emission: Option<CheckedEmission>,
    storage: Storage,
    encoding: Range<usize>,
    /// Of the place in the scene file.
    at: Range<usize>,
    placement: Placement,
}

impl CheckedVolume {
    /// Returns the extinction of a density of one, for each unit of length before the move.
    fn depth_per_density(&self) -> f32 {
        #[expect(clippy::cast_possible_truncation, reason = "a scale of errors")]
        let stretch = self.placement.stretch as f32;
        self.sigma_t_per_density * stretch
    }

    fn key(&self) -> String {
        let file = std::fs::metadata(&self.path).ok();
        let file = file.map(|m| (m.len(), m.modified().ok()));
        let (path, grid, storage) = (self.path.display(), self.grid.get_ref(), &self.storage);
        let fields = self.emission.as_ref().map(|emission| &emission.names);
        format!("{path} {file:?} {grid:?} {fields:?} {storage:?}")
    }

    /// Returns whether this volume has the same grid, kept in the same way.
    fn shares_grid_with(&self, other: &Self) -> bool {
        let kept = |v: &Self| (v.storage.kind, v.storage.max_error);
        self.path == other.path && self.grid == other.grid && kept(self) == kept(other)
    }
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
    let resolution = check_resolution(source, desc, max_memory_bytes)?;
    let spp = *desc.render.spp.get_ref();
    if spp == 0 {
        let span = desc.render.spp.span();
        return Err(source.error(span, "spp is 0", "at least 1 sample a pixel"));
    }
    let seed = *desc.render.seed.get_ref();
    let camera = check_camera(source, desc, resolution)?;
    let volumes = check_volumes(source, desc)?;
    let lights = check_lights(source, desc, max_memory_bytes)?;
    Ok(Checked {
        source: source.clone(),
        resolution,
        spp,
        seed,
        frame: desc.render.frame,
        camera,
        volumes,
        lights,
        transport: TransportSettings {
            integrator: *desc.render.integrator.get_ref(),
            camera_ray: desc.render.camera_ray,
            sampler: desc.render.sampler,
            tracking: check_tracking(source, &desc.render)?,
            max_bounces: desc.render.max_bounces,
            levers: Levers::default(),
        },
        aovs: check_aovs(source, desc)?,
        render: desc.render.clone(),
    })
}

/// Checks that output variables are named once, and that there is an integrator for them.
fn check_aovs(source: &Source, desc: &SceneDesc) -> Check<Vec<Aov>> {
    let (span, aovs) = (desc.image.aovs.span(), desc.image.aovs.get_ref());
    if let Some(twice) = (1..aovs.len()).find(|&i| aovs[..i].contains(&aovs[i])) {
        let message = format!("aovs has {:?} twice", aovs[twice].name());
        return Err(source.error(span, message, "each once"));
    }
    if !aovs.is_empty() && *desc.render.integrator.get_ref() == IntegratorKind::Analog {
        let message = "aovs beside the analog integrator, which does not tell light apart";
        return Err(source.error(span, message, "no aovs, or integrator = \"path\""));
    }
    Ok(aovs.clone())
}

fn check_resolution(source: &Source, desc: &SceneDesc, max_memory_bytes: u64) -> Check<[u32; 2]> {
    let ImageDesc { resolution, aovs } = &desc.image;
    let [width, height] = *resolution.get_ref();
    if [width, height]
        .iter()
        .any(|n| !(1..=MAX_RESOLUTION).contains(n))
    {
        let expected = format!("columns and rows from 1 to {MAX_RESOLUTION}");
        let message = format!("resolution is [{width}, {height}]");
        return Err(source.error(resolution.span(), message, expected));
    }
    // Sky and sun at most of each, the constant sky and emission.
    let lights = vec![String::new(); 2 * desc.light.len() + 2];
    // Sums, means, and twice the channel while it is written.
    let aov_bytes = (8 + 4 + 2 * 4) * aov::channels(aovs.get_ref(), &lights).len() as u64;
    let bytes = u64::from(width) * u64::from(height) * (BYTES_PER_PIXEL + aov_bytes);
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

fn check_volumes(source: &Source, desc: &SceneDesc) -> Check<Vec<CheckedVolume>> {
    if desc.volume.is_empty() {
        let message = "the scene has no [[volume]]";
        return Err(source.error(0..0, message, "one volume or more"));
    }
    if let [_, second, ..] = &desc.volume[..]
        && desc.render.camera_ray == CameraRay::Expected
    {
        let message = "a second volume beside camera_ray = \"expected\"";
        let expected = "camera_ray = \"auto\": several volumes collide by chance";
        return Err(source.error(second.span(), message, expected));
    }
    let volumes = desc.volume.iter();
    let mut volumes: Vec<_> = volumes
        .map(|volume| check_volume(source, volume))
        .collect::<Check<_>>()?;
    // What is shared is kept for the one that asks the most of it.
    for i in 0..volumes.len() {
        let sharing = volumes.iter().filter(|v| v.shares_grid_with(&volumes[i]));
        let depths = sharing.map(CheckedVolume::depth_per_density);
        volumes[i].storage.sigma_t_per_density = Some(depths.fold(0.0, f32::max));
    }
    Ok(volumes)
}

fn check_volume(source: &Source, spanned: &Spanned<VolumeDesc>) -> Check<CheckedVolume> {
    let volume = spanned.get_ref();
    let VolumeDesc {
        file,
        frame_offset: _,
        density,
        extinction_color,
        albedo,
        emission,
        phase,
        encoding,
        storage_error,
        translate: _,
        rotate: _,
        scale: _,
        matrix: _,
    } = volume;
    let scale = number(source, "scale", &density.scale)?;
    let sigma_t_per_density = non_negative_f32(scale).ok_or_else(|| {
        let expected = "a number from 0 to 3e38, in 1 / world unit";
        source.error(density.scale.span(), format!("scale is {scale}"), expected)
    })?;
    let color = colour(source, "extinction_color", extinction_color)?;
    let most = color.max_channel();
    let sigma_t_per_density = sigma_t_per_density * most;
    if !sigma_t_per_density.is_finite() {
        let message = format!("{scale} times {most} is too large an extinction");
        return Err(source.error(extinction_color.span(), message, "a product below 3e38"));
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
        // Zero: nothing is there, of whatever colour.
        tint: if most > 0.0 {
            Rgb(color.0.map(|c| c / most))
        } else {
            Rgb::WHITE
        },
        albedo: CheckedAlbedo::new(source, albedo)?,
        phase: check_phase(source, phase)?,
        emission: emission
            .as_ref()
            .map(|emission| CheckedEmission::new(source, emission))
            .transpose()?,
        storage: Storage {
            kind: *encoding.get_ref(),
            max_error,
            sigma_t_per_density: Some(sigma_t_per_density),
        },
        encoding: encoding.span(),
        at: spanned.span(),
        placement: check_placement(source, volume)?,
    })
}

impl Checked {
    /// Returns a text for each volume that is the same for two scenes exactly if they load the same:
    /// file, its length and when it was written, grids and storage.
    pub fn volume_keys(&self) -> impl Iterator<Item = String> {
        self.volumes.iter().map(CheckedVolume::key)
    }

    /// Returns the paths of the volumes' files.
    pub fn volume_paths(&self) -> impl Iterator<Item = &Path> {
        self.volumes.iter().map(|volume| &*volume.path)
    }

    /// Reads and decodes the volumes, one entry for each; a grid that occurs twice is loaded once.
    /// `on_stage` hears where the time goes.
    ///
    /// # Errors
    /// If a file cannot be read, or has no such grid, or one that cannot be rendered, or if they
    /// need too much memory together.
    pub fn load_volumes(
        &self,
        options: &LoadOptions,
        on_stage: &mut dyn FnMut(LoadStage),
    ) -> Result<Vec<LoadedVolume>, SceneError> {
        self.load_new_volumes(options, &[], on_stage)
    }

    /// Does the same, but takes volumes that are in `earlier` under their key (see
    /// [`Self::volume_keys`]) from there.
    ///
    /// # Errors
    /// As above.
    pub fn load_new_volumes(
        &self,
        options: &LoadOptions,
        earlier: &[(String, LoadedVolume)],
        on_stage: &mut dyn FnMut(LoadStage),
    ) -> Result<Vec<LoadedVolume>, SceneError> {
        let mut options = *options;
        let mut loaded: Vec<LoadedVolume> = Vec::with_capacity(self.volumes.len());
        for volume in &self.volumes {
            let before = self.volumes[..loaded.len()].iter();
            let shared = before.clone().position(|v| v.shares_grid_with(volume));
            let key = volume.key();
            if let Some((_, kept)) = earlier.iter().find(|(k, _)| *k == key) {
                let bytes = kept.grid.resident_bytes() as u64;
                options.max_memory_bytes = options.max_memory_bytes.saturating_sub(bytes);
                loaded.push(kept.clone());
                continue;
            }
            let grid = match shared {
                Some(first) => loaded[first].clone(),
                None => self.load_volume(volume, &options, on_stage)?,
            };
            if shared.is_none() {
                let bytes = grid.grid.resident_bytes() as u64;
                options.max_memory_bytes = options.max_memory_bytes.saturating_sub(bytes);
            }
            loaded.push(self.with_fields(volume, grid, &options)?);
        }
        Ok(loaded)
    }

    /// Loads the grids of `volume` that are no density.
    fn with_fields(
        &self,
        volume: &CheckedVolume,
        mut loaded: LoadedVolume,
        options: &LoadOptions,
    ) -> Result<LoadedVolume, SceneError> {
        let emission = volume.emission.as_ref().map(|emission| &emission.names);
        loaded.emission = self.field(volume, emission, &mut loaded.report, options)?;
        let colour = volume.albedo.names();
        loaded.colour = self.field(volume, colour, &mut loaded.report, options)?;
        let is_used = |name: &str| {
            let mut used = emission.into_iter().chain(colour);
            used.any(|names| names.contain(name))
        };
        loaded.unused_grids.retain(|name| !is_used(name));
        Ok(loaded)
    }

    /// Loads a field of `volume`, if it has one.
    fn field(
        &self,
        volume: &CheckedVolume,
        names: Option<&FieldNames>,
        report: &mut LoadReport,
        options: &LoadOptions,
    ) -> Result<Option<Field>, SceneError> {
        let Some(names) = names else {
            return Ok(None);
        };
        if is_cache(&volume.path) {
            let message = "a cache file holds one grid, the density";
            let error = self.source.error(names.at(), message, "the .vdb file");
            return Err(SceneError::Description(error));
        }
        let archive = Archive::open(&volume.path).map_err(|e| self.at(volume.file.span(), e))?;
        let field = names.load(&archive, options, report);
        field.map(Some).map_err(|e| self.placed(names.at(), e))
    }

    /// Says where in the scene the file or grid is named that cannot be loaded.
    fn placed(&self, span: Range<usize>, error: SceneError) -> SceneError {
        match error {
            SceneError::Volume { source, .. } => self.at(span, source),
            other => other,
        }
    }

    fn at(&self, span: Range<usize>, source: VdbError) -> SceneError {
        let place = DescriptionError {
            expected: None,
            ..*self.source.error(span, source.to_string(), "")
        };
        SceneError::Volume {
            at: Some(Box::new(place)),
            source,
        }
    }

    fn load_volume(
        &self,
        volume: &CheckedVolume,
        options: &LoadOptions,
        on_stage: &mut dyn FnMut(LoadStage),
    ) -> Result<LoadedVolume, SceneError> {
        let CheckedVolume {
            file,
            path,
            grid,
            storage,
            ..
        } = volume;
        on_stage(LoadStage::Read);
        if is_cache(path) {
            return self.map_volume(volume, options);
        }
        let archive = Archive::open(path).map_err(|e| self.at(file.span(), e))?;
        let index = archive
            .find(grid.get_ref())
            .map_err(|e| self.at(place(grid, file), e))?;
        LoadedVolume::decode(&archive, index, options, storage, on_stage)
            .map_err(|e| self.placed(place(grid, file), e))
    }

    /// Maps the cache file that the volume is in, which must hold what the scene asks for.
    fn map_volume(
        &self,
        checked: &CheckedVolume,
        options: &LoadOptions,
    ) -> Result<LoadedVolume, SceneError> {
        let CheckedVolume {
            file,
            path,
            grid,
            storage,
            encoding,
            ..
        } = checked;
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
        if error.scaled(checked.depth_per_density()).rms > storage.max_error {
            volume.stored.reason = Reason::CachedOverBudget(storage.max_error);
        }
        Ok(volume)
    }

    /// Puts the loaded volumes into the scene, one for each that it describes.
    ///
    /// # Errors
    /// If an extinction is not finite, or the estimators asked for cannot track a volume.
    pub fn into_scene(self, volumes: &[LoadedVolume]) -> Result<Scene, SceneError> {
        let pairs = self.volumes.iter().zip(volumes);
        let media: Vec<Medium> = pairs
            .map(|(checked, loaded)| self.medium(checked, loaded))
            .collect::<Check<_>>()
            .map_err(SceneError::Description)?;
        let [width, height] = self.resolution;
        Ok(Scene {
            width,
            height,
            spp: self.spp,
            seed: self.seed,
            frame: self.frame,
            camera: self.camera,
            media,
            lights: self.lights,
            transport: self.transport,
            aovs: self.aovs,
        })
    }

    fn medium(&self, checked: &CheckedVolume, loaded: &LoadedVolume) -> Check<Medium> {
        let CheckedVolume {
            ref scale,
            sigma_t_per_density,
            ref albedo,
            phase,
            tint,
            ref at,
            placement,
            ..
        } = *checked;
        let grid = Arc::clone(&loaded.grid);
        let mut medium = Medium::new(grid, sigma_t_per_density, albedo.constant(), phase);
        if let Some((field, scale)) = loaded.colour.clone().zip(albedo.scale()) {
            medium = medium.coloured(field, scale);
        }
        if tint != Rgb::WHITE {
            medium = medium.with_extinction_color(tint);
        }
        let flattened = || {
            let message = "the volume's own transform and this one flatten it";
            self.source
                .error(at.clone(), message, "voxels that have a volume")
        };
        if placement != Placement::UNMOVED {
            medium = medium.moved(placement.map).ok_or_else(flattened)?;
        }
        if let Some((emission, field)) = checked.emission.as_ref().zip(loaded.emission.clone()) {
            let glow = emission.glow(&self.source, field)?;
            // What moves a medium moves its light.
            let moved = glow.moved(placement.map);
            medium = medium.glowing(moved.ok_or_else(flattened)?);
        }
        // Nothing is drawn at a higher rate: `auto` raises it by 2 at most.
        let tracking = &self.transport.tracking;
        let rate = 4.0 * tracking.rate.max(tracking.flight_rate);
        if !(medium.majorant() * rate).is_finite() {
            let max = medium.grid().bound().max;
            let message = format!("a density of {max} times {sigma_t_per_density} is too large");
            let expected = format!("an extinction below {:.0e} per world unit", f32::MAX / rate);
            return Err(self.source.error(scale.clone(), message, expected));
        }
        check_medium(&self.source, &self.render, &medium)?;
        Ok(medium)
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

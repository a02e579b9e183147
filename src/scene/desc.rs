//! The scene file as written: one struct a table, one field a key.
//!
//! This is the only place where defaults live. Values that a later check may refuse are
//! [`Spanned`], so that the error can point at them; two descriptions are equal if their
//! values are, wherever they stand in the file. Keys that only some `type` of light or phase
//! function knows are optional here and checked against the type in `check`.
//!
//! The [schema](super::schema) is made from the same structs.
//!
//! Nothing here is validated beyond its TOML type. Angles are degrees and colours linear
//! Rec. 709, as people write them; lengths are world units.

use std::path::PathBuf;

use schemars::JsonSchema;
use serde::Deserialize;
use toml::Spanned;

use crate::aov::Aov;
use crate::grid::{Storage, StorageKind};
use crate::integrator::{CameraRay, IntegratorKind};
use crate::sampling::SamplerKind;
use crate::tracking::{BoundsKind, DistanceEstimator, Tracking, TransmittanceEstimator};

/// Makes a value that stands nowhere in a file, as defaults do.
pub fn unplaced<T>(value: T) -> Spanned<T> {
    Spanned::new(0..0, value)
}

/// A whole scene file.
#[derive(Clone, Debug, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SceneDesc {
    /// The image.
    #[serde(default)]
    pub image: ImageDesc,
    /// The camera.
    pub camera: CameraDesc,
    /// The volumes, at least one: they add up where they overlap.
    #[serde(default)]
    #[schemars(with = "Vec<VolumeDesc>")]
    pub volume: Vec<Spanned<VolumeDesc>>,
    /// The lights; none gives a black image.
    #[serde(default)]
    #[schemars(with = "Vec<LightDesc>")]
    pub light: Vec<Spanned<LightDesc>>,
    /// Sampling and light transport.
    #[serde(default)]
    pub render: RenderDesc,
}

/// `[image]`.
#[derive(Clone, Debug, PartialEq, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct ImageDesc {
    /// Columns and rows.
    #[schemars(with = "[u32; 2]")]
    pub resolution: Spanned<[u32; 2]>,
    /// What is written beside the colours.
    #[schemars(with = "Vec<Aov>")]
    pub aovs: Spanned<Vec<Aov>>,
}

impl Default for ImageDesc {
    fn default() -> Self {
        Self {
            resolution: unplaced([960, 540]),
            aovs: unplaced(Vec::new()),
        }
    }
}

/// `[camera]`.
#[derive(Clone, Debug, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct CameraDesc {
    /// Where the camera stands.
    #[schemars(with = "[f64; 3]")]
    pub position: Spanned<[f64; 3]>,
    /// The point in the centre of the image.
    #[schemars(with = "[f64; 3]")]
    pub look_at: Spanned<[f64; 3]>,
    /// The direction that is up in the image.
    #[serde(default = "CameraDesc::default_up")]
    #[schemars(with = "[f64; 3]")]
    pub up: Spanned<[f64; 3]>,
    /// Angle that the image's height spans.
    #[serde(default = "CameraDesc::default_vertical_fov_degrees")]
    #[schemars(with = "f64")]
    pub vertical_fov_degrees: Spanned<f64>,
}

impl CameraDesc {
    fn default_up() -> Spanned<[f64; 3]> {
        unplaced([0.0, 0.0, 1.0])
    }

    fn default_vertical_fov_degrees() -> Spanned<f64> {
        unplaced(30.0)
    }
}

/// `[[volume]]`.
#[derive(Clone, Debug, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct VolumeDesc {
    /// The `.vdb` or cache file, relative to the scene file; of a sequence, with the frame's
    /// number as in `smoke_####.vdb`.
    #[schemars(with = "PathBuf")]
    pub file: Spanned<PathBuf>,
    /// Added to the frame's number in `file`.
    #[serde(default)]
    pub frame_offset: i32,
    /// Which grid is the density, and what a density of one means.
    #[serde(default)]
    pub density: DensityDesc,
    /// What the extinction of each channel is multiplied by.
    #[serde(default = "VolumeDesc::default_extinction_color")]
    #[schemars(with = "[f64; 3]")]
    pub extinction_color: Spanned<[f64; 3]>,
    /// Single-scattering albedo.
    #[serde(default = "VolumeDesc::default_albedo")]
    #[schemars(with = "AlbedoDesc")]
    pub albedo: Spanned<AlbedoDesc>,
    /// What the volume emits; unset: nothing.
    #[schemars(with = "Option<EmissionDesc>")]
    pub emission: Option<Spanned<EmissionDesc>>,
    /// Phase function.
    #[serde(default = "VolumeDesc::default_phase")]
    #[schemars(with = "PhaseDesc")]
    pub phase: Spanned<PhaseDesc>,
    /// How values are stored in memory. A cache file has decided that already.
    #[serde(default = "VolumeDesc::default_encoding")]
    #[schemars(with = "StorageKind")]
    pub encoding: Spanned<StorageKind>,
    /// Of `encoding = "auto"`: largest RMS error in optical depth of any ray.
    #[serde(default = "VolumeDesc::default_storage_error")]
    #[schemars(with = "f64")]
    pub storage_error: Spanned<f64>,
    /// Where the file's origin is moved to.
    #[serde(default = "VolumeDesc::default_translate")]
    #[schemars(with = "[f64; 3]")]
    pub translate: Spanned<[f64; 3]>,
    /// Degrees about the world's axes: first x, then y, then z.
    #[serde(default = "VolumeDesc::default_rotate")]
    #[schemars(with = "[f64; 3]")]
    pub rotate: Spanned<[f64; 3]>,
    /// Size, before the rotation.
    #[serde(default = "VolumeDesc::default_scale")]
    #[schemars(with = "ScaleDesc")]
    pub scale: Spanned<ScaleDesc>,
    /// In place of the three above: rows of the map from the file's world to the scene's.
    #[schemars(with = "Option<[[f64; 4]; 4]>")]
    pub matrix: Option<Spanned<[[f64; 4]; 4]>>,
}

/// `albedo` of a volume.
#[derive(Clone, Debug, PartialEq, Deserialize, JsonSchema)]
#[serde(
    untagged,
    expecting = "expected three numbers, or { grid = \"…\", scale = … }"
)]
pub enum AlbedoDesc {
    /// The same everywhere, one a channel.
    Constant([f64; 3]),
    /// From grids.
    Grid(AlbedoGridDesc),
}

/// `albedo = { … }` of a volume: by one of `grid` and `grids`.
#[derive(Clone, Debug, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct AlbedoGridDesc {
    /// A grid of vectors, or a scalar one for all channels.
    pub grid: Option<String>,
    /// Three scalar grids, one a channel.
    pub grids: Option<[String; 3]>,
    /// What the values are multiplied by.
    #[serde(default = "AlbedoGridDesc::default_scale")]
    pub scale: f64,
}

impl AlbedoGridDesc {
    fn default_scale() -> f64 {
        1.0
    }
}

/// A size of all axes, or of each.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, JsonSchema)]
#[serde(untagged, expecting = "expected a number, or three")]
pub enum ScaleDesc {
    /// The same for all axes.
    Uniform(f64),
    /// One an axis.
    Axes([f64; 3]),
}

impl VolumeDesc {
    /// Returns the description of a file of which nothing else is said.
    pub fn of(file: PathBuf) -> Self {
        Self {
            file: unplaced(file),
            frame_offset: 0,
            density: DensityDesc::default(),
            extinction_color: Self::default_extinction_color(),
            albedo: Self::default_albedo(),
            emission: None,
            phase: Self::default_phase(),
            encoding: Self::default_encoding(),
            storage_error: Self::default_storage_error(),
            translate: Self::default_translate(),
            rotate: Self::default_rotate(),
            scale: Self::default_scale(),
            matrix: None,
        }
    }

    pub(super) fn default_extinction_color() -> Spanned<[f64; 3]> {
        unplaced([1.0, 1.0, 1.0])
    }

    fn default_albedo() -> Spanned<AlbedoDesc> {
        unplaced(AlbedoDesc::Constant([0.99, 0.99, 0.99]))
    }

    fn default_phase() -> Spanned<PhaseDesc> {
        unplaced(PhaseDesc::default())
    }

    fn default_encoding() -> Spanned<StorageKind> {
        unplaced(StorageKind::default())
    }

    pub(super) fn default_storage_error() -> Spanned<f64> {
        unplaced(Storage::DEFAULT_ERROR)
    }

    pub(super) fn default_translate() -> Spanned<[f64; 3]> {
        unplaced([0.0; 3])
    }

    pub(super) fn default_rotate() -> Spanned<[f64; 3]> {
        unplaced([0.0; 3])
    }

    pub(super) fn default_scale() -> Spanned<ScaleDesc> {
        unplaced(ScaleDesc::Uniform(1.0))
    }
}

/// `density = { … }` of a volume.
#[derive(Clone, Debug, PartialEq, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct DensityDesc {
    /// Name of the grid.
    #[schemars(with = "String")]
    pub grid: Spanned<String>,
    /// Extinction of a density of one: `sigma_t = scale · density`, per world unit.
    #[schemars(with = "f64")]
    pub scale: Spanned<f64>,
}

impl Default for DensityDesc {
    fn default() -> Self {
        Self {
            grid: unplaced("density".to_owned()),
            scale: unplaced(1.0),
        }
    }
}

/// `emission = { … }` of a volume: by one of `grid`, `grids` and `temperature`.
#[derive(Clone, Debug, PartialEq, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct EmissionDesc {
    /// A grid of emitted radiance per unit length, scalar or of vectors.
    #[schemars(with = "Option<String>")]
    pub grid: Option<Spanned<String>>,
    /// Three scalar grids of it, one a channel.
    #[schemars(with = "Option<[String; 3]>")]
    pub grids: Option<Spanned<[String; 3]>>,
    /// A grid of temperatures.
    #[schemars(with = "Option<String>")]
    pub temperature: Option<Spanned<String>>,
    /// What the values are multiplied by; of temperatures, kelvin for each unit.
    #[schemars(with = "f64")]
    pub scale: Spanned<f64>,
    /// Of `grid` and `grids`: what each channel is multiplied by as well.
    #[schemars(with = "Option<[f64; 3]>")]
    pub color: Option<Spanned<[f64; 3]>>,
    /// Of `temperature`: kelvin of a value of zero.
    #[schemars(with = "Option<f64>")]
    pub offset: Option<Spanned<f64>>,
    /// Of `temperature`: what the black body's radiance is multiplied by.
    #[schemars(with = "Option<f64>")]
    pub intensity: Option<Spanned<f64>>,
    /// Of `temperature`: what is 1 before that.
    #[schemars(with = "Option<PeakDesc>")]
    pub peak: Option<Spanned<PeakDesc>>,
    /// Of `temperature`: radiance in W m⁻² sr⁻¹, in place of a peak of 1.
    #[schemars(with = "Option<bool>")]
    pub physical: Option<Spanned<bool>>,
}

impl Default for EmissionDesc {
    fn default() -> Self {
        Self {
            grid: None,
            grids: None,
            temperature: None,
            scale: unplaced(1.0),
            color: None,
            offset: None,
            intensity: None,
            peak: None,
            physical: None,
        }
    }
}

/// Which peak of a black body is 1, by name.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum PeakDesc {
    /// That of its spectrum: what is hotter is brighter.
    Spectrum,
    /// The brightest channel: colour alone.
    Channel,
}

/// `phase = { … }` of a volume.
#[derive(Clone, Debug, Default, PartialEq, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct PhaseDesc {
    /// Which phase function.
    #[serde(rename = "type")]
    pub kind: PhaseKind,
    /// Mean cosine, of `henyey-greenstein` only.
    #[schemars(with = "Option<f64>")]
    pub g: Option<Spanned<f64>>,
    /// Mean cosines of the two lobes, of `double-henyey-greenstein` only.
    #[schemars(with = "Option<[f64; 2]>")]
    pub gs: Option<Spanned<[f64; 2]>>,
    /// Share of the first lobe, of `double-henyey-greenstein` only.
    #[schemars(with = "Option<f64>")]
    pub first_weight: Option<Spanned<f64>>,
    /// Diameter of droplets, of `droplets` only.
    #[schemars(with = "Option<f64>")]
    pub diameter_micrometres: Option<Spanned<f64>>,
}

/// Phase functions by name.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum PhaseKind {
    /// Every direction alike.
    #[default]
    Isotropic,
    /// Henyey–Greenstein with mean cosine `g`.
    HenyeyGreenstein,
    /// Two lobes.
    DoubleHenyeyGreenstein,
    /// Particles much smaller than the wavelength.
    Rayleigh,
    /// Water droplets of one size.
    Droplets,
}

impl PhaseKind {
    /// Returns its name in scene files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Isotropic => "isotropic",
            Self::HenyeyGreenstein => "henyey-greenstein",
            Self::DoubleHenyeyGreenstein => "double-henyey-greenstein",
            Self::Rayleigh => "rayleigh",
            Self::Droplets => "droplets",
        }
    }
}

/// `[[light]]`.
#[derive(Clone, Debug, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct LightDesc {
    /// Which light.
    #[serde(rename = "type")]
    pub kind: LightKind,
    /// Of `distant`, required: points from the scene to the light, of any length but zero.
    #[schemars(with = "Option<[f64; 3]>")]
    pub direction_to_light: Option<Spanned<[f64; 3]>>,
    /// Of `distant`, required: irradiance on a plane that faces the light.
    #[schemars(with = "Option<[f64; 3]>")]
    pub irradiance: Option<Spanned<[f64; 3]>>,
    /// Of `distant`: angle that the disk spans; 0 is parallel light.
    #[schemars(with = "Option<f64>")]
    pub angular_diameter_degrees: Option<Spanned<f64>>,
    /// Of `constant` and `sphere`, required: radiance from every direction, or of the surface.
    #[schemars(with = "Option<[f64; 3]>")]
    pub radiance: Option<Spanned<[f64; 3]>>,
    /// Of `environment`, required: a latitude–longitude image, relative to the scene file.
    #[schemars(with = "Option<PathBuf>")]
    pub file: Option<Spanned<PathBuf>>,
    /// Of `environment` and `sun-sky`: what its light is multiplied by.
    #[schemars(with = "Option<f64>")]
    pub scale: Option<Spanned<f64>>,
    /// Of `environment` and `sun-sky`: turn about the vertical, counter-clockwise from above.
    #[schemars(with = "Option<f64>")]
    pub rotate_degrees: Option<Spanned<f64>>,
    /// Of `environment` and `sun-sky`: where the zenith is.
    #[schemars(with = "Option<[f64; 3]>")]
    pub up: Option<Spanned<[f64; 3]>>,
    /// Of `sun-sky`: haze.
    #[schemars(with = "Option<f64>")]
    pub turbidity: Option<Spanned<f64>>,
    /// Of `sun-sky`, required: height of the sun above the horizon.
    #[schemars(with = "Option<f64>")]
    pub sun_elevation_degrees: Option<Spanned<f64>>,
    /// Of `sun-sky`: direction of the sun around the zenith.
    #[schemars(with = "Option<f64>")]
    pub sun_azimuth_degrees: Option<Spanned<f64>>,
    /// Of `sun-sky`: how much the ground below the horizon reflects.
    #[schemars(with = "Option<[f64; 3]>")]
    pub ground_albedo: Option<Spanned<[f64; 3]>>,
    /// Of `point` and `sphere`, required: where it is.
    #[schemars(with = "Option<[f64; 3]>")]
    pub position: Option<Spanned<[f64; 3]>>,
    /// Of `point`, required: power per steradian.
    #[schemars(with = "Option<[f64; 3]>")]
    pub intensity: Option<Spanned<[f64; 3]>>,
    /// Of `sphere`, required.
    #[schemars(with = "Option<f64>")]
    pub radius: Option<Spanned<f64>>,
}

impl LightDesc {
    /// A light of a kind, with nothing said of it.
    pub fn new(kind: LightKind) -> Self {
        Self {
            kind,
            direction_to_light: None,
            irradiance: None,
            angular_diameter_degrees: None,
            radiance: None,
            file: None,
            scale: None,
            rotate_degrees: None,
            up: None,
            turbidity: None,
            sun_elevation_degrees: None,
            sun_azimuth_degrees: None,
            ground_albedo: None,
            position: None,
            intensity: None,
            radius: None,
        }
    }

    /// Default of `scale` where it multiplies an image.
    pub const ENVIRONMENT_SCALE: f64 = 1.0;
    /// Default of `scale` where it multiplies kcd/m² and klx: a high sun of about 5.
    pub const SUN_SKY_SCALE: f64 = 0.05;
    /// Default of `rotate_degrees`.
    pub const ROTATE_DEGREES: f64 = 0.0;
    /// Default of `up`.
    pub const UP: [f64; 3] = [0.0, 0.0, 1.0];
    /// Default of `turbidity`: a clear day.
    pub const TURBIDITY: f64 = 3.0;
    /// Default of `sun_azimuth_degrees`.
    pub const SUN_AZIMUTH_DEGREES: f64 = 0.0;
    /// Default of `ground_albedo`: soil and grass.
    pub const GROUND_ALBEDO: [f64; 3] = [0.2, 0.2, 0.2];
}

/// Lights by name.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum LightKind {
    /// A sun.
    Distant,
    /// A sky of one colour.
    Constant,
    /// A sky from an image.
    Environment,
    /// A clear sky and its sun, by formula.
    SunSky,
    /// A point in the scene.
    Point,
    /// A sphere in the scene.
    Sphere,
}

impl LightKind {
    /// Returns its name in scene files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Distant => "distant",
            Self::Constant => "constant",
            Self::Environment => "environment",
            Self::SunSky => "sun-sky",
            Self::Point => "point",
            Self::Sphere => "sphere",
        }
    }
}

/// `[render]`.
#[derive(Clone, Debug, PartialEq, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct RenderDesc {
    /// Samples a pixel.
    #[schemars(with = "u32")]
    pub spp: Spanned<u32>,
    /// Seed of all random streams, all 64 bits of it: the reader takes more than TOML promises.
    #[schemars(with = "u64")]
    pub seed: Spanned<u64>,
    /// Frame number: other frames get other noise.
    pub frame: i32,
    /// Which integrator renders.
    #[schemars(with = "IntegratorKind")]
    pub integrator: Spanned<IntegratorKind>,
    /// How the path integrator finds a camera ray's collision.
    pub camera_ray: CameraRay,
    /// Where the first numbers of a path come from.
    pub sampler: SamplerKind,
    /// Paths end after this many scattering events. Unset: never, by roulette only.
    ///
    /// BIAS: a cap darkens the image.
    pub max_bounces: Option<u32>,
    /// How the distance to the next collision is drawn.
    #[schemars(with = "DistanceEstimator")]
    pub distance: Spanned<DistanceEstimator>,
    /// How the transmittance of a shadow ray is estimated.
    #[schemars(with = "TransmittanceEstimator")]
    pub transmittance: Spanned<TransmittanceEstimator>,
    /// Which bounds both use.
    pub bounds: BoundsKind,
    /// Tentative collisions for each unit of the bound, of shadow rays.
    #[schemars(with = "f64")]
    pub collision_rate: Spanned<f64>,
    /// The same of free flight.
    #[schemars(with = "f64")]
    pub flight_rate: Spanned<f64>,
    /// Of `approx-ray-marching`: step in voxels.
    #[schemars(with = "f64")]
    pub march_step: Spanned<f64>,
}

impl Default for RenderDesc {
    fn default() -> Self {
        let tracking = Tracking::default();
        Self {
            spp: unplaced(64),
            seed: unplaced(0),
            frame: 0,
            integrator: unplaced(IntegratorKind::Path),
            camera_ray: CameraRay::default(),
            sampler: SamplerKind::default(),
            max_bounces: None,
            distance: unplaced(tracking.distance),
            transmittance: unplaced(tracking.transmittance),
            bounds: tracking.bounds,
            collision_rate: unplaced(tracking.rate.into()),
            flight_rate: unplaced(tracking.flight_rate.into()),
            march_step: unplaced(tracking.march_step),
        }
    }
}

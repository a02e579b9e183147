//! Estimators of the radiance along a camera ray.
//!
//! * `analog`: plain delta tracking, the short reference.
//! * `chromatic`: the production choice where the extinction has a colour.
//! * `emission`: light that the media emit.
//! * `media`: several media in one scene, for both.
//! * `guide`: importance of points and directions for the latter.
//! * `primary`: the camera ray of the latter, up to the collision from which it goes on.
//! * `parts`: radiance by how often light was scattered and where it comes from.
//! * `path`: next-event estimation and roulette, the production choice.
//! * `surroundings`: what skies from images, points and spheres add to it.
//!
//! Both have the same expectation; a test compares their images. Neither sees a voxel.

mod analog;
mod chromatic;
mod emission;
mod guide;
mod media;
mod parts;
mod path;
mod primary;
mod steering;
mod surroundings;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use self::emission::Emitters;
use self::guide::Guide;
use self::media::{Media, Tracked};
pub use self::parts::{Parts, Source};
pub use self::primary::{Kernel, absorbing_tracking, absorbs_only};
use self::surroundings::Lamps;
use crate::light::Lights;
use crate::medium::Medium;
use crate::phase::Phase;
use crate::sampling::{SamplerKind, Stream};
use crate::space::Ray;
use crate::spectrum::Rgb;
use crate::stats::Counts;
use crate::tracking::{Survey, Tracking};

/// Which integrator renders.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum IntegratorKind {
    /// Next-event estimation, absorption as weight, Russian roulette: the production choice.
    #[default]
    Path,
    /// Plain delta tracking without light sampling: the short reference. Cannot see a sun of
    /// zero diameter.
    Analog,
}

/// How the camera ray's collision is found. The expectation is the same.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum CameraRay {
    /// By expectation where the medium is thin along camera rays, else analog; transmittances
    /// alone where nothing scatters.
    #[default]
    Auto,
    /// By free flight: a camera ray either collides or escapes.
    Analog,
    /// Every camera ray escapes and collides, each with its weight.
    Expected,
}

impl CameraRay {
    /// All of them, in the order of the documentation.
    pub const ALL: &'static [Self] = &[Self::Auto, Self::Analog, Self::Expected];

    /// Returns its name in scene files and on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Auto => "auto",
            Self::Analog => "analog",
            Self::Expected => "expected",
        }
    }
}

/// What the image is, as far as light transport is concerned.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TransportSettings {
    /// Which integrator renders.
    pub integrator: IntegratorKind,
    /// How the path integrator finds a camera ray's collision.
    pub camera_ray: CameraRay,
    /// Where the first numbers of a path come from.
    pub sampler: SamplerKind,
    /// Which estimators track its rays.
    pub tracking: Tracking,
    /// Paths end after this many scattering events. `None`: never, by roulette only.
    ///
    /// BIAS: a cap darkens the image; it is off unless asked for.
    pub max_bounces: Option<u32>,
    /// What makes the path integrator fast.
    pub levers: Levers,
}

/// What makes the path integrator fast. None changes the expectation; each can be taken away, to
/// be tested and measured.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[expect(clippy::struct_excessive_bools, reason = "a switch for each of them")]
pub struct Levers {
    /// Directions are chosen from several, with the suns in mind.
    pub guide: bool,
    /// Shadow rays that are expected to bring little are traced rarely, and end early.
    pub light_roulette: bool,
    /// Paths of little weight are ended.
    pub path_roulette: bool,
    /// Light of points and spheres is also looked for where a segment passes near them.
    pub equiangular: bool,
    /// Points of media that emit are sampled as a light is, and paths sent there, and not by chance alone.
    pub emission_light: bool,
}

impl Default for Levers {
    fn default() -> Self {
        Self {
            guide: true,
            light_roulette: true,
            path_roulette: true,
            equiangular: true,
            emission_light: true,
        }
    }
}

/// Returns whether the path integrator chooses among directions of scattering by `phase`, where
/// there are suns: with a broad phase function that costs more than it gains.
pub fn steers(phase: Phase) -> bool {
    Guide::steers(phase)
}

/// What a path meets: borrowed from the scene for one frame.
#[derive(Debug)]
pub struct Context<'a> {
    media: Media<'a>,
    lights: &'a Lights,
    settings: TransportSettings,
    emitters: Emitters<'a>,
    guide: Option<Guide>,
    lamps: Option<Lamps<'a>>,
    /// Of the path integrator.
    kernel: Kernel,
    /// Tentative collisions of camera rays for each unit of the bound, where they are expectations.
    camera_rate: f32,
}

impl<'a> Context<'a> {
    /// Prepares what the chosen integrator needs to know of the scene.
    ///
    /// # Cost
    /// The path integrator fills a lattice of up to 2¹⁸ cells for each sun.
    pub fn new(media: &'a [Medium], lights: &'a Lights, settings: TransportSettings) -> Self {
        // Where nothing scatters there is no path to survey for, and no light to find.
        let scatters = !absorbs_only(&settings, media);
        let surveys: Vec<Survey> = if scatters {
            media.iter().map(Survey::new).collect()
        } else {
            Vec::new()
        };
        let tracked = media.iter().enumerate().map(|(i, medium)| Tracked {
            medium,
            tracking: match surveys.get(i) {
                Some(survey) => settings.tracking.fitted(survey),
                None => absorbing_tracking(settings.tracking),
            },
        });
        let guided = settings.integrator == IntegratorKind::Path
            && lights.beacons().any(|b| b.typical_radiance > 0.0);
        Self {
            media: Media::new(tracked.collect()),
            lights,
            settings,
            emitters: Emitters::new(
                media,
                lights.typical_radiance(),
                settings.levers.emission_light,
            ),
            guide: (guided && scatters).then(|| Guide::new(media, lights)),
            lamps: Lamps::new(media, lights, settings.levers.equiangular),
            kernel: if media.iter().any(Medium::is_chromatic) {
                Kernel::Chromatic
            } else {
                Kernel::new(&settings, &surveys)
            },
            camera_rate: primary::rate(&surveys),
        }
    }
}

/// What one path brings home.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PathSample<R = Rgb> {
    /// Radiance towards the camera, or its parts.
    pub radiance: R,
    /// Opacity along the camera ray, estimated.
    pub opacity: f32,
    /// World distance to the camera ray's collision, with its weight in the mean of such
    /// distances; `None` if it left without one.
    pub first_collision: Option<(f64, f32)>,
}

impl PathSample<Parts> {
    /// Returns the sample without its parts.
    pub fn whole(&self) -> PathSample {
        PathSample {
            radiance: self.radiance.radiance,
            opacity: self.opacity,
            first_collision: self.first_collision,
        }
    }
}

impl Context<'_> {
    /// Returns an unbiased sample of the radiance that arrives along the camera ray `ray`.
    pub fn sample_radiance(&self, ray: Ray, stream: &mut Stream) -> PathSample {
        stream.counts.camera_rays += 1;
        match self.settings.integrator {
            IntegratorKind::Path => primary::sample_radiance(self, ray, stream),
            IntegratorKind::Analog => analog::sample_radiance(self, ray, stream),
        }
    }

    /// As [`sample_radiance`](Self::sample_radiance), the same radiance in parts; of the analog
    /// integrator, which does not tell them apart, the sum alone.
    pub fn sample_parts(&self, ray: Ray, stream: &mut Stream) -> PathSample<Parts> {
        stream.counts.camera_rays += 1;
        match self.settings.integrator {
            IntegratorKind::Path => primary::sample_radiance(self, ray, stream),
            IntegratorKind::Analog => {
                let PathSample {
                    radiance,
                    opacity,
                    first_collision,
                } = analog::sample_radiance(self, ray, stream);
                PathSample {
                    radiance: Parts::unsorted(radiance),
                    opacity,
                    first_collision,
                }
            }
        }
    }

    /// Returns where the media begin and end along `ray`: where the optical depth from the one end,
    /// and from the other, reaches `depth`. `None` if it does not.
    pub fn extent(&self, ray: &Ray, depth: f64, counts: &mut Counts) -> Option<(f64, f64)> {
        let media = self.media.all().iter();
        let extents = media.filter_map(|one| one.medium.extent(ray, depth, counts));
        extents.reduce(|(a0, a1), (b0, b1)| (a0.min(b0), a1.max(b1)))
    }
}

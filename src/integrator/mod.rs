//! Estimators of the radiance along a camera ray.
//!
//! * `analog`: plain delta tracking, the short reference.
//! * `path`: next-event estimation and roulette, the production choice.
//!
//! Both have the same expectation; a test compares their images. Neither sees a voxel.

mod analog;
mod path;

use serde::{Deserialize, Serialize};

use crate::light::Lights;
use crate::medium::Medium;
use crate::sampling::Stream;
use crate::space::Ray;
use crate::spectrum::Rgb;
use crate::stats::Counts;

/// Which integrator renders.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum IntegratorKind {
    /// Next-event estimation, absorption as weight, Russian roulette: the production choice.
    #[default]
    Path,
    /// Plain delta tracking without light sampling: the short reference. Cannot see a sun of
    /// zero diameter.
    Analog,
}

/// What the image is, as far as light transport is concerned.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TransportSettings {
    /// Which integrator renders.
    pub integrator: IntegratorKind,
    /// Paths end after this many scattering events. `None`: never, by roulette only.
    ///
    /// BIAS: a cap darkens the image; it is off unless asked for.
    pub max_bounces: Option<u32>,
}

/// What a path meets: borrowed from the scene for one frame.
#[derive(Clone, Copy, Debug)]
pub struct Context<'a> {
    /// The medium, if there is one.
    pub medium: Option<&'a Medium>,
    /// The lights.
    pub lights: &'a Lights,
    /// Light transport.
    pub settings: TransportSettings,
}

/// What one path brings home.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PathSample {
    /// Radiance towards the camera.
    pub radiance: Rgb,
    /// World distance to the camera ray's collision; `None` if it left without one.
    pub first_collision: Option<f64>,
}

impl Context<'_> {
    /// Returns an unbiased sample of the radiance that arrives along the camera ray `ray`.
    pub fn sample_radiance(
        &self,
        ray: Ray,
        stream: &mut Stream,
        counts: &mut Counts,
    ) -> PathSample {
        counts.camera_rays += 1;
        match self.settings.integrator {
            IntegratorKind::Path => path::sample_radiance(self, ray, stream, counts),
            IntegratorKind::Analog => analog::sample_radiance(self, ray, stream, counts),
        }
    }
}

//! Radiance through the production integrators, for lights and rays of the suite's choosing.

use std::f64::consts::{PI, TAU};

use glam::DVec3;

use super::measure::{Measured, measure};
use crate::integrator::{Context, IntegratorKind, TransportSettings};
use crate::light::{DistantLight, Lights};
use crate::medium::Medium;
use crate::phase::Phase;
use crate::sampling::Stream;
use crate::space::{Ray, orthonormal_frame};
use crate::spectrum::Rgb;

/// Both integrators, with their names.
pub(super) const INTEGRATORS: [(&str, IntegratorKind); 2] = [
    ("path", IntegratorKind::Path),
    ("analog", IntegratorKind::Analog),
];

/// Henyey–Greenstein, or isotropic at exactly 0.
pub(super) fn phase(g: f32) -> Phase {
    if g == 0.0 {
        Phase::Isotropic
    } else {
        Phase::HenyeyGreenstein { g }
    }
}

pub(super) fn transport(integrator: IntegratorKind, max_bounces: Option<u32>) -> TransportSettings {
    TransportSettings {
        integrator,
        max_bounces,
        ..TransportSettings::default()
    }
}

/// A sky of one radiance and nothing else.
pub(super) fn sky(radiance: Rgb) -> Lights {
    Lights {
        distant: Vec::new(),
        environment: radiance,
        ..Lights::default()
    }
}

/// Parallel light of unit irradiance across its beam.
pub(super) fn sun(direction_to_light: DVec3) -> DistantLight {
    DistantLight::new(direction_to_light, Rgb::WHITE, 0.0)
        .expect("the suite's directions are not zero")
}

/// Light of one radiance from the half of the sky around `zenith`: a sun whose disk misses the
/// horizon by 2e-9 radians.
pub(super) fn half_sky(zenith: DVec3, radiance: Rgb) -> DistantLight {
    // The disk's radiance is its irradiance over π sin²(radius), and the sine is 1.
    let irradiance = radiance * std::f32::consts::PI;
    DistantLight::new(zenith, irradiance, PI * (1.0 - 1e-9))
        .expect("the diameter is below half a turn")
}

/// Only these lights.
pub(super) fn only(distant: impl Into<Vec<DistantLight>>) -> Lights {
    Lights {
        distant: distant.into(),
        environment: Rgb::BLACK,
        ..Lights::default()
    }
}

/// Draws a direction with the density cos θ / π around `normal`: what diffuse light has.
pub(super) fn cosine_direction(normal: DVec3, stream: &mut Stream) -> DVec3 {
    let cos_square = f64::from(stream.uniform_positive());
    let (sin_phi, cos_phi) = (TAU * f64::from(stream.uniform())).sin_cos();
    let sin = (1.0 - cos_square).sqrt();
    let (s, t) = orthonormal_frame(normal);
    let v = s * (sin * cos_phi) + t * (sin * sin_phi) + normal * cos_square.sqrt();
    v / v.length()
}

/// Measures the mean radiance along rays that `camera` draws, channel by channel.
pub(super) fn radiance(
    medium: &Medium,
    lights: &Lights,
    settings: TransportSettings,
    (seed, n): (u64, u64),
    mut camera: impl FnMut(&mut Stream) -> Ray,
) -> Measured<3> {
    let context = Context::new(std::slice::from_ref(medium), lights, settings);
    measure(seed, n, |stream| {
        let ray = camera(stream);
        let sample = context.sample_radiance(ray, stream);
        sample.radiance.0.map(f64::from)
    })
}

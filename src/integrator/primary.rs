//! The camera ray of the path integrator: what shines through, and where it scatters.

use super::{Context, PathSample, path};
use crate::sampling::{Number, Stream};
use crate::space::Ray;
use crate::stats::Counts;

#[derive(Clone, Copy, Debug)]
pub(super) struct Plan {
    analog_below: f32,
    boost: f32,
}

impl Plan {
    pub(super) fn from_env() -> Self {
        let get = |k: &str, d: f32| {
            std::env::var(k)
                .ok()
                .and_then(|s| s.parse().ok())
                .unwrap_or(d)
        };
        Self {
            analog_below: get("AB", 0.1),
            boost: get("BOOST", 2.0),
        }
    }
}

/// Returns an unbiased sample of the radiance that arrives along `ray`.
pub(super) fn sample_radiance(
    context: &Context<'_>,
    ray: Ray,
    stream: &mut Stream,
    counts: &mut Counts,
) -> PathSample {
    let Context {
        medium,
        lights,
        settings,
        camera_ray,
        ..
    } = *context;
    let behind = lights.radiance(ray.direction);
    let Some(medium) = medium else {
        return PathSample {
            radiance: behind,
            first_collision: None,
            opacity: 0.0,
        };
    };
    let number = stream.number(Number::Collision);
    let flight = settings.tracking.expected_flight(
        medium,
        &ray,
        (camera_ray.analog_below, number),
        stream,
        counts,
    );
    let through = behind * flight.transmittance;
    let opacity = 1.0 - flight.transmittance;
    let Some(t) = flight.collision else {
        return PathSample {
            radiance: through,
            first_collision: None,
            opacity,
        };
    };
    // Roulette about the sky.
    let survival = (camera_ray.boost * opacity).min(1.0);
    let mut radiance = through + lights.environment * opacity;
    if survival >= 1.0 || stream.number(Number::Roulette) < survival {
        let weight = opacity / survival;
        radiance = through + lights.environment * (opacity - weight);
        radiance += path::scattered_radiance(context, medium, (ray, t), weight, stream, counts);
    }
    PathSample {
        radiance,
        first_collision: Some(t),
        opacity,
    }
}

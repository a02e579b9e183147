//! The camera ray of the path integrator: what shines through, and where its path goes on.
//!
//! A camera ray that either collides or escapes is noise: in a thin medium, where both are likely
//! and worth different radiances, most of the noise there is. So where it pays, one walk estimates
//! the transmittance `T` and finds a collision that stands for `1 − T` (see `ExpectedFlight`), and
//! the radiance is
//!
//! ```text
//! T · behind + (1 − T) · scattered
//! ```
//!
//! Few paths go on from pixels that are nearly empty: roulette keeps one with probability `q`, and
//! what it adds or leaves out is the difference to the sky, not to black, so that the radiance is
//!
//! ```text
//! T · behind + (1 − T) · sky + (kept ? (1 − T) / q · (scattered − sky) : 0)
//! ```
//!
//! With `q = 1 − T` that is the analog camera ray; `q` is [`SURVIVAL`] times as much. All weights
//! are positive.
//!
//! Where nothing scatters there are no paths, and camera rays are estimates of the transmittance.
//!
//! What media emit towards the camera is added to all of them.

use super::media::{Met, Tracked};
use super::parts::{Gather, Source, gathered};
use super::surroundings::see_spheres;
use super::{CameraRay, Context, IntegratorKind, PathSample, TransportSettings, chromatic, path};
use crate::medium::Medium;
use crate::sampling::{Number, Stream};
use crate::space::Ray;
use crate::spectrum::Rgb;
use crate::tracking::{ExpectedChoice, Survey, Tracking, TransmittanceEstimator};

/// Probability for a path to go on, for each unit of opacity.
pub(super) const SURVIVAL: f32 = 3.0;

/// Weight below which what is left of a camera ray collides or escapes.
pub(super) const ANALOG_BELOW: f32 = 0.1;

/// A medium is thin if a ray from inside meets on its way out, in the survey, less than this optical
/// depth, and fewer collisions. Variance times cost, measured with expected in place of analog
/// camera rays: 0.59 and 0.45 of it in two thin fogs (0.14 and 0.26 collisions), 0.95 in a smoke
/// (1.0), 1.05 in a tower (80), 1.06 in a cloud (15). Depth and collisions differ where bounds are
/// tight: in a cloud of depth 15 resolved by 512³ voxels, rays meet 3 collisions that need a
/// lookup, and expected camera rays took 2.7 µs a sample in place of 2.2.
const THIN: f32 = 3.0;

/// Most tentative collisions of a camera ray for each unit of the bound, where it is an expectation, and
/// the optical depth above which there is one.
///
/// Efficiency at a rate of 1, 1.5 and 2, shadow rays at 2, relative to 2 with shadow rays at 1: depth
/// 0.04: 0.94, 1.08, 1.05; 0.33: 1.20, 1.17, 1.18; 0.54: 1.03, 0.99, 1.01; 1.16: 1.21, 1.10, 1.07;
/// 2.4: 1.19, 1.08, 1.01. The first three depths are of the sequence: more collisions need more.
const MAX_RATE: f32 = 2.0;
const RATE_1_DEPTH: f32 = 0.5;

/// In absorbing media, transmittances below this play roulette: too little to be seen, and most of
/// the voxels along a ray.
const LEAST_TRANSMITTANCE: f32 = 0.01;

/// In absorbing media, one camera ray in this many also looks for its first collision, for the
/// depth of the image alone.
const DEPTH_EVERY: f32 = 16.0;

/// What is done for each camera ray.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kernel {
    /// It collides or escapes.
    Analog,
    /// Both, each with its weight.
    Expected,
    /// Both, with a weight for each channel, since the extinction has a colour (see `chromatic`).
    Chromatic,
    /// Nothing scatters: its transmittance is all.
    Transmittance,
}

impl Kernel {
    /// Returns what the settings ask for, or what suits the media; `surveys` are those of media
    /// that scatter, none where only transmittances are wanted (see [`absorbs_only`]).
    ///
    /// Several media collide by chance: the weight of a collision by expectation would have to be
    /// multiplied by estimates of what the others let through.
    pub fn new(settings: &TransportSettings, surveys: &[Survey]) -> Self {
        match (settings.camera_ray, surveys) {
            (_, []) => Self::Transmittance,
            (CameraRay::Expected, [_]) => Self::Expected,
            (CameraRay::Auto, [one]) if one.collisions_per_ray.max(one.optical_depth) < THIN => {
                Self::Expected
            }
            _ => Self::Analog,
        }
    }
}

/// Returns how many tentative collisions camera rays make for each unit of the bound of a medium, where
/// they are expectations.
pub(super) fn rate(surveys: &[Survey]) -> f32 {
    let depth = surveys.first().map_or(0.0, |survey| survey.optical_depth);
    (RATE_1_DEPTH / depth).clamp(1.0, MAX_RATE)
}

/// Returns whether nothing of the light in `media` is scattered and the settings leave it at that:
/// camera rays are estimates of the transmittance, and there are no paths.
pub fn absorbs_only(settings: &TransportSettings, media: &[Medium]) -> bool {
    settings.integrator == IntegratorKind::Path
        && settings.camera_ray == CameraRay::Auto
        && media.iter().all(|m| m.albedo().is_black())
}

/// Returns how transmittances are estimated where they are the image: exactly, unless asked for
/// otherwise. What noise is left is that of the pixel's area.
pub fn absorbing_tracking(tracking: Tracking) -> Tracking {
    let transmittance = match tracking.transmittance {
        TransmittanceEstimator::Auto => TransmittanceEstimator::Exact,
        asked => asked,
    };
    Tracking {
        transmittance,
        ..tracking
    }
}

/// Returns an unbiased sample of the radiance that arrives along `ray`.
pub(super) fn sample_radiance<G: Gather>(
    context: &Context<'_>,
    ray: Ray,
    stream: &mut Stream,
) -> PathSample<G> {
    let mut sample: PathSample<G> = match (context.kernel, context.media.all()) {
        (Kernel::Analog, _) => analog(context, ray, stream),
        (Kernel::Chromatic, _) => chromatic::sample_radiance(context, ray, stream),
        (Kernel::Expected, [one, ..]) => expected(context, one, ray, stream),
        (Kernel::Transmittance | Kernel::Expected, _) => transmittance(context, ray, stream),
    };
    let Context {
        media,
        emitters,
        lights,
        ..
    } = context;
    if !emitters.is_empty() {
        let light = emitters.seen(media, &ray, stream);
        sample.radiance.add(light, 0, Source::Emission);
    }
    if !lights.local.is_empty() {
        lamplight(context, &ray, &mut sample.radiance, stream);
    }
    sample
}

/// Adds an unbiased estimate of the spheres that a camera ray sees, and of what local lights scatter
/// along it, in its share (see `surroundings`).
fn lamplight<G: Gather>(context: &Context<'_>, ray: &Ray, radiance: &mut G, stream: &mut Stream) {
    let Context {
        media,
        lights,
        lamps,
        settings,
        kernel,
        ..
    } = context;
    see_spheres(lights, media, ray, radiance, stream);
    if let Some(lamps) = lamps
        && *kernel != Kernel::Transmittance
        && settings.max_bounces != Some(0)
    {
        let worth = path::usual_worth(context);
        let (lamp, light) = lamps.along(media, ray, Rgb::WHITE, worth, stream);
        radiance.add(light, 1, Source::Lamp(lamp));
    }
}

fn analog<G: Gather>(context: &Context<'_>, ray: Ray, stream: &mut Stream) -> PathSample<G> {
    let Some(met) = context.media.first_collision(&ray, stream) else {
        return PathSample {
            radiance: gathered(context.lights, ray.direction, Rgb::WHITE),
            opacity: 0.0,
            first_collision: None,
        };
    };
    let t = met.t;
    PathSample {
        radiance: path::scattered_radiance(context, met, &ray, 1.0, stream),
        opacity: 1.0,
        first_collision: Some((t, 1.0)),
    }
}

fn expected<G: Gather>(
    context: &Context<'_>,
    &Tracked { medium, tracking }: &Tracked<'_>,
    ray: Ray,
    stream: &mut Stream,
) -> PathSample<G> {
    let lights = context.lights;
    let choice = ExpectedChoice {
        rate: context.camera_rate,
        analog_below: ANALOG_BELOW,
        number: stream.number(Number::Collision),
    };
    let flight = tracking.expected_flight(medium, &ray, choice, stream);
    let opacity = 1.0 - flight.transmittance;
    let through = Rgb::splat(flight.transmittance);
    // What is scattered is near the usual sky: that much of it is added without a path.
    let sky = |weight: f32| {
        let mut radiance: G = gathered(lights, ray.direction, through);
        radiance.add_usual(lights, Rgb::splat(weight));
        radiance
    };
    let Some(t) = flight.collision else {
        return PathSample {
            radiance: sky(opacity),
            opacity,
            first_collision: None,
        };
    };
    let survival = (SURVIVAL * opacity).min(1.0);
    let radiance = if stream.number(Number::Roulette) < survival {
        let weight = opacity / survival;
        let from = Ray {
            origin: ray.at(t),
            ..ray
        };
        let met = Met {
            index: 0,
            walk: tracking.start_path(medium, &from, f64::INFINITY),
            t: 0.0,
        };
        let scattered: G = path::scattered_radiance(context, met, &ray, weight, stream);
        let mut radiance = sky(opacity - weight);
        radiance.merge(scattered);
        radiance
    } else {
        stream.counts.roulette_kills += 1;
        sky(opacity)
    };
    PathSample {
        radiance,
        opacity,
        first_collision: Some((t, opacity)),
    }
}

fn transmittance<G: Gather>(context: &Context<'_>, ray: Ray, stream: &mut Stream) -> PathSample<G> {
    let media = &context.media;
    let weights = (1.0, LEAST_TRANSMITTANCE);
    let transmittance = media.transmittance(None, (&ray, f64::INFINITY), weights, stream);
    let first_collision = if stream.uniform() * DEPTH_EVERY < 1.0 {
        let met = media.first_collision(&ray, stream);
        met.map(|met| (met.t, 1.0))
    } else {
        None
    };
    PathSample {
        radiance: gathered(context.lights, ray.direction, Rgb::splat(transmittance)),
        opacity: 1.0 - transmittance,
        first_collision,
    }
}

//! The analog integrator: delta tracking, no light sampling, nothing clever.
//!
//! A photon path run backwards, as nature does it: fly to the next collision, die there with
//! probability `1 − albedo`, scatter otherwise, and bring home what shines where the path
//! leaves. What media emit is added up along the way. It is short enough to be checked by eye and
//! serves as the reference for the path integrator.
//!
//! Do not use it for pictures with a small sun: a disk of half a degree is hit by one path in
//! 50,000, and parallel light by none, which the scene loader refuses. Where the extinction has a
//! colour, a path is of one channel, and an image three colours of noise.

use super::{Context, PathSample};
use crate::sampling::Stream;
use crate::space::Ray;
use crate::spectrum::Rgb;

/// Returns an unbiased sample of the radiance that arrives along `ray`.
///
/// RGB albedo: the channel with the largest albedo decides survival, the others follow by
/// weight, so that no channel's weight exceeds 1.
pub(super) fn sample_radiance(
    context: &Context<'_>,
    mut ray: Ray,
    stream: &mut Stream,
) -> PathSample {
    let Context {
        ref media,
        lights,
        settings,
        ref emitters,
        ..
    } = *context;
    let mut radiance = Rgb::BLACK;
    let mut first_collision = None;
    let mut weight = Rgb::WHITE;
    let is_chromatic = media.are_chromatic();
    if is_chromatic {
        // One channel at random, and nothing of the others.
        let third = stream.uniform() * 3.0;
        weight = Rgb(std::array::from_fn(|c| {
            let chosen = (c as f32..c as f32 + 1.0).contains(&third);
            if chosen { 3.0 } else { 0.0 }
        }));
    }
    let mut bounces = 0;
    loop {
        let met = if is_chromatic {
            media.chromatic_collision(&ray, &mut weight, None, stream)
        } else {
            let met = media.first_collision(&ray, stream);
            met.map(|met| (met.t, met.walk.medium()))
        };
        let end = met.as_ref().map_or(f64::INFINITY, |met| met.0);
        if !emitters.is_empty() {
            radiance += weight * emitters.at_random(&ray, end, stream);
        }
        for (seen, t) in lights.local.iter().filter_map(|lamp| lamp.meet(&ray)) {
            if t < end {
                radiance += weight * seen;
            }
        }
        let Some((t, medium)) = met else {
            return PathSample {
                radiance: radiance + weight * lights.radiance(ray.direction),
                first_collision,
                opacity: if first_collision.is_some() { 1.0 } else { 0.0 },
            };
        };
        first_collision.get_or_insert((t, 1.0));
        let albedo = medium.albedo_at(ray.at(t));
        let survival = albedo.max_channel();
        if stream.uniform() >= survival || settings.max_bounces == Some(bounces) {
            return PathSample {
                radiance,
                first_collision,
                opacity: 1.0,
            };
        }
        weight *= albedo * survival.recip();
        bounces += 1;
        stream.counts.scattered_rays += 1;
        ray = Ray {
            origin: ray.at(t),
            direction: medium.phase().sample(ray.direction, stream),
        };
    }
}

//! The analog integrator: delta tracking, no light sampling, nothing clever.
//!
//! A photon path run backwards, as nature does it: fly to the next collision, die there with
//! probability `1 − albedo`, scatter otherwise, and bring home what shines where the path
//! leaves. It is short enough to be checked by eye and serves as the reference for the
//! path integrator.
//!
//! Do not use it for pictures with a small sun: a disk of half a degree is hit by one path in
//! 50,000, and parallel light by none, which the scene loader refuses.

use super::media::Met;
use super::{Context, PathSample};
use crate::sampling::Stream;
use crate::space::Ray;
use crate::spectrum::Rgb;
use crate::stats::Counts;

/// Returns an unbiased sample of the radiance that arrives along `ray`.
///
/// RGB albedo: the channel with the largest albedo decides survival, the others follow by
/// weight, so that no channel's weight exceeds 1.
pub(super) fn sample_radiance(
    context: &Context<'_>,
    mut ray: Ray,
    stream: &mut Stream,
    counts: &mut Counts,
) -> PathSample {
    let Context {
        ref media,
        lights,
        settings,
        ..
    } = *context;
    let mut first_collision = None;
    let mut weight = Rgb::WHITE;
    let mut bounces = 0;
    loop {
        let Some(Met { walk, t, .. }) = media.first_collision(&ray, stream, counts) else {
            return PathSample {
                radiance: weight * lights.radiance(ray.direction),
                first_collision,
                opacity: if first_collision.is_some() { 1.0 } else { 0.0 },
            };
        };
        first_collision.get_or_insert((t, 1.0));
        let medium = walk.medium();
        let albedo = medium.albedo();
        let survival = albedo.max_channel();
        if stream.uniform() >= survival || settings.max_bounces == Some(bounces) {
            return PathSample {
                radiance: Rgb::BLACK,
                first_collision,
                opacity: 1.0,
            };
        }
        weight *= albedo * survival.recip();
        bounces += 1;
        counts.scattered_rays += 1;
        ray = Ray {
            origin: ray.at(t),
            direction: medium.phase().sample(ray.direction, stream),
        };
    }
}

//! The path integrator: next-event estimation, absorption as weight, Russian roulette.
//!
//! At each collision the path collects every sun's light through an estimate of the
//! transmittance, and goes on in a direction drawn from the phase function. Where it leaves
//! the medium it collects the sky, which is the same from everywhere: there the phase function
//! is already the best density. A sun's disk is seen by camera rays only, since scattered
//! paths have it from their last collision.
//!
//! Absorption multiplies the weight by the albedo; nothing else ends a path but leaving and
//! roulette below [`ROULETTE_WEIGHT`]. There is no cap on the number of bounces unless the
//! scene asks for one: a cap of 8 loses 13 % of the light of a cloud of optical thickness 9.
//!
//! Do not use it where the only light is a small bright part of an image-like sky; for a
//! constant sky it has no equal here, and for suns little variance is left but that of the
//! phase function.

use super::Context;
use crate::film::Sample;
use crate::light::DistantLight;
use crate::medium::Medium;
use crate::sampling::Stream;
use crate::space::Ray;
use crate::spectrum::Rgb;
use crate::stats::Counts;
use crate::tracking::{estimate_transmittance, sample_collision};
use glam::DVec3;

/// Paths of less weight are raised to it or ended, by their ratio.
const ROULETTE_WEIGHT: f32 = 0.03;

/// Transmittances of shadow rays below are raised to it or dropped.
///
/// On the comparison cloud, 0.1 cuts the lookups of shadow rays from 136 to 8.5 a camera sample
/// for no visible rise of the image's error.
const SHADOW_ROULETTE_WEIGHT: f32 = 0.1;

/// Returns an unbiased sample of the radiance that arrives along `ray`.
pub(super) fn sample_radiance(
    context: &Context<'_>,
    mut ray: Ray,
    stream: &mut Stream,
    counts: &mut Counts,
) -> Sample {
    let Context {
        camera,
        medium,
        lights,
        settings,
    } = *context;
    let mut radiance = Rgb::BLACK;
    let mut throughput = Rgb::WHITE;
    let mut first_depth = None;
    let mut bounces = 0;
    loop {
        let hit = medium.and_then(|m| {
            let t = sample_collision(m.ray(&ray, f64::INFINITY), stream, counts)?;
            Some((m, ray.at(t)))
        });
        let Some((medium, p)) = hit else {
            let sky = if bounces == 0 {
                lights.radiance(ray.direction)
            } else {
                lights.environment
            };
            return Sample {
                radiance: radiance + throughput * sky,
                first_depth,
            };
        };
        first_depth.get_or_insert_with(|| camera.depth(p));
        if settings.max_bounces == Some(bounces) {
            return Sample {
                radiance,
                first_depth,
            };
        }
        throughput *= medium.albedo();
        bounces += 1;

        let weight = throughput.max_channel();
        if weight < ROULETTE_WEIGHT {
            if stream.uniform() * ROULETTE_WEIGHT >= weight {
                counts.roulette_kills += 1;
                return Sample {
                    radiance,
                    first_depth,
                };
            }
            throughput *= ROULETTE_WEIGHT / weight;
        }

        for sun in &lights.distant {
            radiance += throughput * direct_light(medium, sun, p, ray.direction, stream, counts);
        }
        counts.scattered_rays += 1;
        ray = Ray {
            origin: p,
            direction: medium.phase().sample(ray.direction, stream),
        };
    }
}

/// Returns an unbiased estimate of a sun's light scattered at `p` against `direction`, the
/// direction in which the path arrives, for an albedo of 1.
fn direct_light(
    medium: &Medium,
    sun: &DistantLight,
    p: DVec3,
    direction: DVec3,
    stream: &mut Stream,
    counts: &mut Counts,
) -> Rgb {
    let light = sun.sample(stream);
    // The path runs from the camera, so light travels the other way on both legs; the cosine
    // between the directions of propagation is the same.
    let phase = medium.phase().eval(direction.dot(light.direction));
    counts.shadow_rays += 1;
    let ray = Ray {
        origin: p,
        direction: light.direction,
    };
    let ray = medium.ray(&ray, f64::INFINITY);
    let transmittance = estimate_transmittance(ray, SHADOW_ROULETTE_WEIGHT, stream, counts);
    light.weight * (phase * transmittance)
}

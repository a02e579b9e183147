//! The path integrator where the extinction has a colour.
//!
//! The same path for all channels, with a weight for each: `tracking::chromatic` says how it flies.
//! Free flight decides by the weights themselves, albedo included, so their sum never grows on the
//! way, and a channel of no extinction meets nothing and is exact on camera rays. Otherwise as
//! `path` and `primary`, which gray media keep.
//!
//! Several media fly one after the other, each up to the nearest collision so far. Where a later one
//! is nearer, the null collisions of the earlier beyond it have not happened: their factors are taken
//! back.
//!
//! Not here: media that emit, which the scene loader refuses beside a coloured extinction.

use glam::DVec3;

use super::media::{Media, Tracked};
use super::parts::{Gather, Source, gathered};
use super::path::{LEAST_BELIEF, ROULETTE_WEIGHT, least_contribution, usual_worth};
use super::primary::{ANALOG_BELOW, SURVIVAL};
use super::surroundings::{Event, met_maps};
use super::{Context, PathSample};
use crate::medium::Medium;
use crate::sampling::Stream;
use crate::space::Ray;
use crate::spectrum::Rgb;
use crate::stats::Counts;
use crate::tracking::Null;

impl<'a> Media<'a> {
    /// Returns whether the extinction of any has a colour.
    pub(super) fn are_chromatic(&self) -> bool {
        self.all().iter().any(|one| one.medium.is_chromatic())
    }

    /// Estimates the transmittance of all media along `ray` up to `t_max`, of each channel.
    ///
    /// Where the largest is below `roulette_weight`, all play roulette together.
    pub(super) fn spectral_transmittance(
        &self,
        (ray, t_max): (&Ray, f64),
        roulette_weight: f32,
        stream: &mut Stream,
        counts: &mut Counts,
    ) -> Rgb {
        if !self.are_chromatic() {
            let weights = (1.0, roulette_weight);
            return Rgb::splat(self.transmittance(None, (ray, t_max), weights, stream, counts));
        }
        let mut through = Rgb::WHITE;
        for Tracked { medium, tracking } in self.all() {
            let most = through.max_channel();
            // Zero: nothing is left to attenuate.
            if most > 0.0 {
                let least = (roulette_weight / most).min(1.0);
                let place = (*medium, ray, t_max);
                through *= tracking.chromatic_transmittance(place, least, stream, counts);
            }
        }
        through
    }

    /// Draws the first collision along `ray` and the medium it is with; `weights` decide, and
    /// become those of what has happened.
    pub(super) fn chromatic_collision(
        &self,
        ray: &Ray,
        weights: &mut Rgb,
        stream: &mut Stream,
        counts: &mut Counts,
    ) -> Option<(f64, &'a Medium)> {
        if let [Tracked { medium, tracking }] = self.all() {
            let place = (*medium, ray, f64::INFINITY);
            let t = tracking.chromatic_collision(place, weights, None, stream, counts)?;
            return Some((t, medium));
        }
        let at_first = *weights;
        // Factors of null collisions of all, and those of the nearest real one.
        let mut nulls: Vec<Null> = Vec::new();
        let mut nearest: Option<(f64, &'a Medium, Rgb)> = None;
        for Tracked { medium, tracking } in self.all() {
            let t_max = nearest.map_or(f64::INFINITY, |(t, ..)| t);
            let before = nulls.len();
            let mut own = at_first;
            let place = (*medium, ray, t_max);
            let met =
                tracking.chromatic_collision(place, &mut own, Some(&mut nulls), stream, counts);
            if let Some(t) = met {
                // What the real collision itself has done to the weights.
                let passed = nulls[before..]
                    .iter()
                    .fold(at_first, |w, (_, null)| w * *null);
                let real = Rgb(std::array::from_fn(|c| {
                    // Zero: a channel without weight stays so.
                    if passed.0[c] > 0.0 {
                        own.0[c] / passed.0[c]
                    } else {
                        0.0
                    }
                }));
                nearest = Some((t, medium, real));
            }
        }
        let end = nearest.map_or(f64::INFINITY, |(t, ..)| t);
        for (_, null) in nulls.iter().filter(|(t, _)| *t < end) {
            *weights *= *null;
        }
        let (t, medium, real) = nearest?;
        *weights *= real;
        Some((t, medium))
    }
}

fn mean(weights: Rgb) -> f32 {
    (weights.0[0] + weights.0[1] + weights.0[2]) / 3.0
}

/// Returns an unbiased sample of the radiance that arrives along the camera ray `ray`.
///
/// A single medium is crossed by expectation: transmittances, and one collision for the rest, whose
/// path plays roulette about the usual sky. Several are met by chance.
pub(super) fn sample_radiance<G: Gather>(
    context: &Context<'_>,
    ray: Ray,
    stream: &mut Stream,
    counts: &mut Counts,
) -> PathSample<G> {
    let Context { media, lights, .. } = context;
    let behind = lights.radiance(ray.direction);
    let [Tracked { medium, tracking }] = media.all() else {
        let mut weights = Rgb::WHITE;
        return match media.chromatic_collision(&ray, &mut weights, stream, counts) {
            None => PathSample {
                radiance: gathered(behind * weights),
                opacity: 0.0,
                first_collision: None,
            },
            Some((t, medium)) => PathSample {
                radiance: scattered_radiance(context, (t, medium), ray, weights, stream, counts),
                opacity: 1.0,
                first_collision: Some((t, 1.0)),
            },
        };
    };
    let flight = tracking.chromatic_flight(medium, &ray, ANALOG_BELOW, stream, counts);
    let mut radiance: G = gathered(behind * flight.transmittance);
    let Some((t, weights)) = flight.collision else {
        return PathSample {
            radiance,
            opacity: 0.0,
            first_collision: None,
        };
    };
    let opacity = mean(weights);
    let survival = (SURVIVAL * opacity).min(1.0);
    let usual = lights.usual_radiance();
    if stream.uniform() < survival {
        let kept = weights * survival.recip();
        let scattered: G = scattered_radiance(context, (t, medium), ray, kept, stream, counts);
        radiance.add(usual * weights + usual * kept * -1.0, 1, Source::Sky);
        radiance.merge(scattered);
    } else {
        radiance.add(usual * weights, 1, Source::Sky);
        counts.roulette_kills += 1;
    }
    PathSample {
        radiance,
        opacity: opacity.min(1.0),
        first_collision: Some((t, opacity)),
    }
}

/// Returns an unbiased sample of the radiance that a collision of the camera ray `ray` at `t` with a
/// medium sends along it, times `throughput`.
fn scattered_radiance<G: Gather>(
    context: &Context<'_>,
    (mut t, mut medium): (f64, &Medium),
    mut ray: Ray,
    mut throughput: Rgb,
    stream: &mut Stream,
    counts: &mut Counts,
) -> G {
    let Context {
        ref media,
        lights,
        settings,
        ref guide,
        ref lamps,
        ..
    } = *context;
    let levers = settings.levers;
    let roulette_weight = if levers.path_roulette {
        ROULETTE_WEIGHT
    } else {
        // Only paths without any weight end.
        f32::MIN_POSITIVE
    };
    let least = least_contribution(context);
    let mut radiance = G::default();
    radiance.meet(medium, ray.at(t), mean(throughput));
    let mut importance = 1.0;
    let mut bounces = 0;
    loop {
        if settings.max_bounces == Some(bounces) {
            return radiance;
        }
        throughput *= medium.albedo_at(ray.at(t));
        bounces += 1;
        let worth = throughput.max_channel() * importance;
        if worth < roulette_weight {
            if stream.uniform() * roulette_weight >= worth {
                counts.roulette_kills += 1;
                return radiance;
            }
            throughput *= roulette_weight / worth;
        }
        let event = Event {
            media,
            p: ray.at(t),
            arrived: ray.direction,
            phase: medium.phase(),
            throughput,
        };
        event.surroundings(context, &ray, (&mut radiance, bounces), stream, counts);
        let mut next: Option<DVec3> = None;
        if let Some(guide) = guide {
            let beliefs = guide.beliefs(guide.position_of(media, event.p));
            for (i, sun) in lights.distant.iter().enumerate() {
                let worth = if levers.light_roulette {
                    guide.believed_root(i, &beliefs).max(LEAST_BELIEF) / least
                } else {
                    f32::MAX
                };
                let light = event.sun(sun, worth, stream, counts);
                radiance.add(light, bounces, Source::Sun);
            }
            if levers.guide {
                let (guided, weight, guided_importance) =
                    guide.sample(medium.phase(), &beliefs, ray.direction, stream);
                throughput *= weight;
                importance = guided_importance;
                next = Some(guided);
            }
        }
        counts.scattered_rays += 1;
        let previous = ray;
        ray = Ray {
            origin: event.p,
            direction: next.unwrap_or_else(|| medium.phase().sample(ray.direction, stream)),
        };
        if let Some(lamps) = lamps
            && settings.max_bounces != Some(bounces)
        {
            let worth = usual_worth(context);
            let light = lamps.along(media, &ray, throughput, worth, stream, counts);
            radiance.add(light, bounces + 1, Source::Lamp);
        }
        let further = media.chromatic_collision(&ray, &mut throughput, stream, counts);
        let phase = medium.phase().eval(event.arrived.dot(ray.direction));
        if let Some(lamps) = lamps {
            // What the flight has made of the weights beyond a sphere is 1 on average.
            let end = further.map_or(f64::INFINITY, |(t, _)| t);
            let light = throughput * lamps.met(media, (&previous, &ray), phase, end);
            radiance.add(light, bounces, Source::Lamp);
        }
        let Some(further) = further else {
            let sky = lights.environment + met_maps(lights, ray.direction, phase);
            radiance.add(throughput * sky, bounces, Source::Sky);
            return radiance;
        };
        (t, medium) = further;
    }
}

//! The path integrator where the extinction has a colour.
//!
//! The same path for all channels, with a weight for each: `tracking::chromatic` says how it flies.
//! Free flight decides by the weights themselves, albedo included, so their sum never grows on the
//! way, and a channel of no extinction meets nothing and is exact on camera rays. Otherwise as
//! `path` and `primary`, which gray media keep.
//!
//! Several media fly one after the other, each up to the nearest collision so far. Where a later one
//! is nearer, what the earlier have met beyond it has not happened: those factors do not count.
//!
//! Light that media emit along a flight has the weights that the flight has where it is, so the
//! flight keeps a list of what it multiplies them by; nothing is listed where nothing emits.

use super::media::{Media, Tracked};
use super::parts::{Gather, Source, gathered};
use super::path::{LEAST_BELIEF, LEAST_EMITTED, ROULETTE_WEIGHT, least_contribution, usual_worth};
use super::primary::{ANALOG_BELOW, SURVIVAL};
use super::steering::Onward;
use super::surroundings::{Event, Flight, meet_maps};
use super::{Context, PathSample};
use crate::medium::Medium;
use crate::sampling::Stream;
use crate::space::Ray;
use crate::spectrum::Rgb;
use crate::tracking::Factor;

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
    ) -> Rgb {
        if !self.are_chromatic() {
            let weights = (1.0, roulette_weight);
            return Rgb::splat(self.transmittance(None, (ray, t_max), weights, stream));
        }
        let mut through = Rgb::WHITE;
        for Tracked { medium, tracking } in self.all() {
            let most = through.max_channel();
            // Zero: nothing is left to attenuate.
            if most > 0.0 {
                let least = (roulette_weight / most).min(1.0);
                let place = (*medium, ray, t_max);
                through *= tracking.chromatic_transmittance(place, least, stream);
            }
        }
        through
    }

    /// Draws the first collision along `ray` and the medium it is with; `weights` decide, and
    /// become those of what has happened. `factors` becomes all that they are multiplied by up to
    /// there, in order.
    pub(super) fn chromatic_collision(
        &self,
        ray: &Ray,
        weights: &mut Rgb,
        mut factors: Option<&mut Vec<Factor>>,
        stream: &mut Stream,
    ) -> Option<(f64, &'a Medium)> {
        if let Some(factors) = &mut factors {
            factors.clear();
        }
        if let [Tracked { medium, tracking }] = self.all() {
            let place = (*medium, ray, f64::INFINITY);
            let t = tracking.chromatic_collision(place, weights, factors, stream)?;
            return Some((t, medium));
        }
        let mut own = Vec::new();
        let factors = factors.unwrap_or(&mut own);
        let mut nearest: Option<(f64, &'a Medium)> = None;
        for Tracked { medium, tracking } in self.all() {
            let t_max = nearest.map_or(f64::INFINITY, |(t, _)| t);
            let place = (*medium, ray, t_max);
            let mut alone = *weights;
            let met = tracking.chromatic_collision(place, &mut alone, Some(factors), stream);
            nearest = met.map(|t| (t, *medium)).or(nearest);
        }
        let end = nearest.map_or(f64::INFINITY, |(t, _)| t);
        factors.retain(|(t, _)| *t <= end);
        factors.sort_by(|(a, _), (b, _)| a.total_cmp(b));
        for (_, factor) in factors {
            *weights *= *factor;
        }
        nearest
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
) -> PathSample<G> {
    let Context { media, lights, .. } = context;
    let [Tracked { medium, tracking }] = media.all() else {
        let mut weights = Rgb::WHITE;
        return match media.chromatic_collision(&ray, &mut weights, None, stream) {
            None => PathSample {
                radiance: gathered(lights, ray.direction, weights),
                opacity: 0.0,
                first_collision: None,
            },
            Some((t, medium)) => PathSample {
                radiance: scattered_radiance(context, (t, medium), ray, weights, stream),
                opacity: 1.0,
                first_collision: Some((t, 1.0)),
            },
        };
    };
    let flight = tracking.chromatic_flight(medium, &ray, ANALOG_BELOW, stream);
    let mut radiance: G = gathered(lights, ray.direction, flight.transmittance);
    let Some((t, weights)) = flight.collision else {
        return PathSample {
            radiance,
            opacity: 0.0,
            first_collision: None,
        };
    };
    let opacity = mean(weights);
    let survival = (SURVIVAL * opacity).min(1.0);
    if stream.uniform() < survival {
        let kept = weights * survival.recip();
        let scattered: G = scattered_radiance(context, (t, medium), ray, kept, stream);
        radiance.add_usual(lights, weights + kept * -1.0);
        radiance.merge(scattered);
    } else {
        radiance.add_usual(lights, weights);
        stream.counts.roulette_kills += 1;
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
) -> G {
    let Context {
        ref media,
        lights,
        settings,
        ref emitters,
        ref lamps,
        ..
    } = *context;
    let roulette_weight = if settings.levers.path_roulette {
        ROULETTE_WEIGHT
    } else {
        // Only paths without any weight end.
        f32::MIN_POSITIVE
    };
    let mut radiance = G::of(lights);
    radiance.meet(medium, ray.at(t), mean(throughput));
    // What the throughput is worth: for the next event, and from there on.
    let (mut importance, mut steering) = (1.0, 1.0);
    let mut bounces = 0;
    let mut factors = Vec::new();
    loop {
        if settings.max_bounces == Some(bounces) {
            return radiance;
        }
        throughput *= medium.albedo_at(ray.at(t));
        bounces += 1;
        let worth = throughput.max_channel() * importance * steering;
        if worth < roulette_weight {
            if stream.uniform() * roulette_weight >= worth {
                stream.counts.roulette_kills += 1;
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
        let found = (&mut radiance, bounces);
        let onward = collect(context, (&event, &mut steering), &ray, found, stream);
        throughput *= onward.weight;
        importance = onward.importance;
        stream.counts.scattered_rays += 1;
        let previous = ray;
        ray = Ray {
            origin: event.p,
            direction: onward.direction,
        };
        if let Some(lamps) = lamps
            && settings.max_bounces != Some(bounces)
        {
            let worth = usual_worth(context);
            let (lamp, light) = lamps.along(media, &ray, throughput, worth, stream);
            radiance.add(light, bounces + 1, Source::Lamp(lamp));
        }
        let phase = medium.phase().eval(event.arrived.dot(ray.direction));
        let before = throughput;
        let list = (!emitters.is_empty()).then_some(&mut factors);
        let further = media.chromatic_collision(&ray, &mut throughput, list, stream);
        let end = further.map_or(f64::INFINITY, |(t, _)| t);
        if !emitters.is_empty() {
            let worth = (phase, before.max_channel() * steering);
            let light = emitters.along(&ray, (end, &factors), worth, stream);
            radiance.add(before * light, bounces, Source::Emission);
        }
        if let Some(lamps) = lamps {
            // What the flight has made of the weights beyond a sphere is 1 on average.
            let flight = Flight {
                previous: &previous,
                segment: &ray,
                phase,
                end,
            };
            lamps.meet(media, &flight, throughput, (&mut radiance, bounces));
        }
        let Some(further) = further else {
            radiance.add(throughput * lights.environment, bounces, Source::Constant);
            let met = (ray.direction, phase);
            meet_maps(lights, met, throughput, (&mut radiance, bounces));
            return radiance;
        };
        (t, medium) = further;
    }
}

/// Adds what arrives at `event`, which `segment` has led to, and is scattered towards the camera;
/// returns how the path goes on.
fn collect(
    context: &Context<'_>,
    (event, steering): (&Event<'_, '_>, &mut f32),
    segment: &Ray,
    (radiance, order): (&mut impl Gather, u32),
    stream: &mut Stream,
) -> Onward {
    let Context {
        media,
        lights,
        settings,
        emitters,
        guide,
        ..
    } = context;
    let levers = settings.levers;
    event.surroundings(context, segment, (radiance, order), stream);
    if !emitters.is_empty() {
        let least = if levers.light_roulette {
            LEAST_EMITTED
        } else {
            0.0
        };
        let light = emitters.at_event(event, (least, *steering), stream);
        radiance.add(light, order, Source::Emission);
    }
    let mut guided = None;
    if let Some(guide) = guide {
        let beliefs = guide.beliefs(guide.position_of(media, event.p));
        let least = least_contribution(context);
        let worth = |i| {
            if levers.light_roulette {
                guide.believed_root(i, &beliefs).max(LEAST_BELIEF) / least
            } else {
                f32::MAX
            }
        };
        event.suns(lights, worth, (radiance, order), stream);
        if levers.guide {
            guided = Some(guide.sample(event.phase, &beliefs, event.arrived, stream));
        }
    }
    let usual = |stream: &mut Stream| {
        guided.unwrap_or_else(|| Onward::usual(event.phase.sample(event.arrived, stream)))
    };
    if emitters.is_empty() {
        usual(stream)
    } else {
        emitters.steer(
            event.p,
            |direction| event.phase(direction),
            usual,
            steering,
            stream,
        )
    }
}

//! Light that the media emit: along rays, and sampled as a light.
//!
//! A path meets emission in two ways, which share the light between them `[Veach1995]`:
//!
//! * *Along its rays.* Up to the sampled collision at `t_c`, the integral of the emission is an
//!   unbiased estimate of that of transmittance times emission. It is estimated in turn by points in
//!   proportion to what the lattice expects, so it does not matter whether there is anything to
//!   collide with.
//! * *As a light.* From a collision, a point `y` is drawn by emitted power, and its light arrives
//!   through an estimate of the transmittance: phase · T · emission / (d² · density).
//!
//! A point that both can find has the weights of the balance heuristic, with the densities
//!
//! ```text
//! along the ray    phase(cos) / (d² · length)        as a light    the lattice's density at y
//! ```
//!
//! where `length` is how long the emission is along a typical line. The first is not the exact
//! density, since rays are steered towards suns and emission and points lie along them in proportion to
//! weights; it is a function of vertex and point alone, and so any such weights add up to the whole.
//! Paths that `steering` sends towards the emission are there for what its own medium scatters.
//!
//! A camera ray has the first only, with an estimate of the transmittance in place of a collision.

use std::ops::ControlFlow;

use glam::DVec3;

use super::media::Media;
use super::surroundings::Event;
use crate::emission::{Emission, Spread};
use crate::medium::Medium;
use crate::sampling::Stream;
use crate::space::Ray;
use crate::spectrum::Rgb;
use crate::tracking::Factor;

/// Points along a camera ray that crosses as much as a typical line through much emission.
const CAMERA_POINTS: f32 = 32.0;

/// Points along a scattered ray, likewise.
const PATH_POINTS: f32 = 2.0;

/// Weights of paths below which points along them become fewer.
const LEAST_WEIGHT: f32 = 0.05;

/// Distance, in radii of an emission, at which it is half as remote as from afar.
const HALF_DISTANCE: f64 = 3.0;

/// Transmittances of camera rays below which roulette is played.
const LEAST_TRANSMITTANCE: f32 = 0.01;

/// The media that emit.
#[derive(Debug)]
pub(super) struct Emitters<'a> {
    all: Vec<Emitter<'a>>,
    /// Whether points are drawn as of a light, and paths sent there.
    pub(super) are_lights: bool,
    /// Typical radiance of all other lights.
    pub(super) other_radiance: f32,
}

#[derive(Clone, Copy, Debug)]
pub(super) struct Emitter<'a> {
    medium: &'a Medium,
    pub(super) emission: &'a Emission,
    /// Probability of being drawn from as a light.
    share: f32,
}

/// A point drawn as of a light.
#[derive(Clone, Copy, Debug)]
pub(super) struct LightPoint {
    /// Unit vector towards it, and how far it is.
    pub(super) direction: DVec3,
    pub(super) distance: f64,
    /// What scatters towards the camera if nothing is in between, for a throughput of 1.
    pub(super) unoccluded: Rgb,
}

impl<'a> Emitters<'a> {
    pub(super) fn new(media: &'a [Medium], other_radiance: f32, are_lights: bool) -> Self {
        let emitting = media.iter().filter_map(|m| Some((m, m.emission()?)));
        let power: f64 = emitting.clone().map(|(_, e)| e.power()).sum();
        #[expect(clippy::cast_possible_truncation, reason = "a probability")]
        let all = emitting.map(|(medium, emission)| Emitter {
            medium,
            emission,
            share: (emission.power() / power) as f32,
        });
        Self {
            all: all.collect(),
            are_lights,
            other_radiance,
        }
    }

    /// Returns the sum of what `of` says of each.
    #[inline] // bench: frame
    pub(super) fn sum(&self, of: impl FnMut(&Emitter<'a>) -> f32) -> f32 {
        self.all.iter().map(of).sum()
    }

    /// Picks one of them by the uniform number `u`; `None` beyond the sum of their chances.
    pub(super) fn pick(
        &self,
        mut u: f32,
        chance: impl Fn(&Emitter<'a>) -> f32,
    ) -> Option<&Emitter<'a>> {
        self.all.iter().find(|emitter| {
            let chance = chance(emitter);
            let is_it = u < chance;
            u -= chance;
            is_it
        })
    }

    #[inline] // bench: frame
    pub(super) fn is_empty(&self) -> bool {
        self.all.is_empty()
    }

    /// Returns an unbiased estimate of the emission that arrives along a camera ray.
    pub(super) fn seen(&self, media: &Media<'_>, ray: &Ray, stream: &mut Stream) -> Rgb {
        let mut radiance = Rgb::BLACK;
        for Emitter {
            medium, emission, ..
        } in &self.all
        {
            let spacing = emission.typical_radiance() / CAMERA_POINTS;
            let mut reached = 0.0;
            let mut through = Rgb::WHITE;
            let start = (spacing, stream.uniform());
            emission.for_each_point(ray, f64::INFINITY, start, |t, length| {
                let stretch = Ray {
                    origin: ray.at(reached),
                    direction: ray.direction,
                };
                let end = (&stretch, t - reached);
                let least = (LEAST_TRANSMITTANCE / through.max_channel()).min(1.0);
                through *= media.spectral_transmittance(end, least, stream);
                reached = t;
                // Zero: lost in roulette, or nothing comes through.
                if through.is_black() {
                    return ControlFlow::Break(());
                }
                stream.counts.emission_lookups += 1;
                radiance += medium.emitted(ray.at(t)) * through * length;
                ControlFlow::Continue(())
            });
        }
        radiance
    }

    /// Returns an unbiased estimate of the emission along a scattered ray up to its collision at
    /// `t_c`, less what is found as a light from where it starts, where it has the density
    /// `phase`. `throughput` is what it will be multiplied by: little is worth little effort.
    /// `factors` are those of the flight, where the extinction has a colour.
    pub(super) fn along(
        &self,
        ray: &Ray,
        (t_c, factors): (f64, &[Factor]),
        (phase, throughput): (f32, f32),
        stream: &mut Stream,
    ) -> Rgb {
        let mut radiance = Rgb::BLACK;
        for emitter in &self.all {
            let Emitter {
                medium, emission, ..
            } = *emitter;
            let spacing = emission.typical_radiance() / PATH_POINTS;
            let spacing = spacing / throughput.clamp(LEAST_WEIGHT, 1.0);
            let start = (spacing, stream.uniform());
            let mut factors = factors.iter().peekable();
            let mut through = Rgb::WHITE;
            emission.for_each_point(ray, t_c, start, |t, length| {
                while let Some((_, factor)) = factors.next_if(|(from, _)| *from <= t) {
                    through *= *factor;
                }
                let p = ray.at(t);
                stream.counts.emission_lookups += 1;
                let weight = if self.are_lights {
                    1.0 - emitter.light_weight(p, (t, phase))
                } else {
                    1.0
                };
                radiance += medium.emitted(p) * through * (length * weight);
                ControlFlow::Continue(())
            });
        }
        radiance
    }

    /// Returns an unbiased estimate of the emission along a ray up to its collision at `t_c`, from
    /// one point of each medium that is as likely anywhere in its box.
    pub(super) fn at_random(&self, ray: &Ray, t_c: f64, stream: &mut Stream) -> Rgb {
        let mut radiance = Rgb::BLACK;
        for Emitter {
            medium, emission, ..
        } in &self.all
        {
            let Some((t0, t1)) = emission.interval(ray) else {
                continue;
            };
            let t1 = t1.min(t_c);
            if t0 < t1 {
                let t = t0 + (t1 - t0) * f64::from(stream.uniform());
                stream.counts.emission_lookups += 1;
                #[expect(clippy::cast_possible_truncation, reason = "a length")]
                let length = (t1 - t0) as f32;
                radiance += medium.emitted(ray.at(t)) * length;
            }
        }
        radiance
    }

    /// Returns an unbiased estimate of emitted light that scatters at `event` towards the camera, from
    /// a point drawn as of a light. Throughputs times `steering`, and what is left of them on the way,
    /// play roulette below `least`.
    pub(super) fn at_event(
        &self,
        event: &Event<'_, '_>,
        (least, steering): (f32, f32),
        stream: &mut Stream,
    ) -> Rgb {
        let towards = |direction| event.phase(direction);
        let Some(point) = self.sample_light(event.p, towards, stream) else {
            return Rgb::BLACK;
        };
        let unoccluded = event.throughput * point.unoccluded;
        // Zero: nothing is left.
        if unoccluded.is_black() {
            return Rgb::BLACK;
        }
        // What a contribution of 1 is worth such that roulette goes by the throughput alone.
        let worth = event.throughput.max_channel() * steering / (least * unoccluded.max_channel());
        let to = (point.direction, point.distance);
        event.collect(to, unoccluded, worth, stream)
    }

    /// Draws a point as of a light, for a vertex at `origin` from which `phase` tells the density of
    /// scattering in a direction. `None` if points are not drawn, or it is dark.
    pub(super) fn sample_light(
        &self,
        origin: DVec3,
        phase: impl FnOnce(DVec3) -> f32,
        stream: &mut Stream,
    ) -> Option<LightPoint> {
        if !self.are_lights {
            return None;
        }
        let last = self.all.last()?;
        let chosen = if self.all.len() > 1 {
            // None: the shares' sum is rounded below 1.
            self.pick(stream.uniform(), |e| e.share).unwrap_or(last)
        } else {
            last
        };
        let (p, density) = chosen.emission.sample_point(stream);
        stream.counts.emission_lookups += 1;
        let emitted = chosen.medium.emitted(p);
        let to = p - origin;
        let distance = to.length();
        // Not zero but by accident: there the other way has all the weight.
        if emitted.is_black() || distance <= 0.0 {
            return None;
        }
        let direction = to / distance;
        let phase = phase(direction);
        let weight = chosen.light_weight(p, (distance, phase));
        #[expect(clippy::cast_possible_truncation, reason = "a factor of radiance")]
        let scale = (f64::from(phase * weight)
            / (distance * distance * f64::from(density * chosen.share))) as f32;
        let unoccluded = emitted * scale;
        unoccluded.is_finite().then_some(LightPoint {
            direction,
            distance,
            unoccluded,
        })
    }
}

impl Emitter<'_> {
    /// Returns a radiance that is typical of what this makes of a white medium at a point, with
    /// nothing in between.
    #[inline] // bench: frame
    pub(super) fn radiance_at(&self, p: DVec3) -> f32 {
        let Spread { centre, radius2 } = self.emission.spread();
        let sphere = 4.0 * std::f64::consts::PI * ((p - centre).length_squared() + radius2);
        #[expect(clippy::cast_possible_truncation, reason = "an importance")]
        let radiance = (self.emission.power() / sphere) as f32;
        radiance
    }

    /// Returns 0 in the middle of the emission, 1/2 at `HALF_DISTANCE` of its radii and 1 from afar.
    #[inline] // bench: frame
    pub(super) fn remoteness(&self, p: DVec3) -> f32 {
        let Spread { centre, radius2 } = self.emission.spread();
        let distance2 = (p - centre).length_squared();
        #[expect(clippy::cast_possible_truncation, reason = "a number in [0, 1]")]
        let remoteness = (distance2 / (distance2 + HALF_DISTANCE * HALF_DISTANCE * radius2)) as f32;
        remoteness
    }

    /// Returns the share of a point's light that is found by drawing it as of a light, from
    /// `distance` away where `phase` is the density of scattering towards it.
    #[inline] // bench: frame
    fn light_weight(&self, p: DVec3, (distance, phase): (f64, f32)) -> f32 {
        let as_light = f64::from(self.emission.pdf_point(p) * self.share) * distance * distance;
        let by_chance = f64::from(phase / self.emission.typical_length());
        #[expect(clippy::cast_possible_truncation, reason = "a number in [0, 1]")]
        let weight = (as_light / (as_light + by_chance)) as f32;
        // Both zero: no one goes there.
        if weight.is_nan() { 0.0 } else { weight }
    }
}

//! Light that scatters at a vertex from all that is no sun: skies from images, points and spheres.
//!
//! * *Maps*: their light is found in two ways, by a shadow ray in a direction drawn from the map and
//!   by the path itself where it leaves. Each weighs what it finds by its share `p / (p + q)` of the
//!   two densities of the direction, that of the map and that of the phase function: the balance
//!   heuristic `[Veach1995]`. The weights are a function of the directions in and out alone and add
//!   up to 1, which is all that it takes: that the path's direction may have been chosen by the
//!   guide among several does not enter.
//! * *Local lights*: one of them is chosen for a vertex, by its intensity over the distance squared,
//!   and sampled. Spheres are also met by the path itself where it goes on from there: a narrow phase
//!   function finds them better than their own cone does.
//! * *Between vertices*: the light of a point scatters along a segment as the inverse square of the
//!   distance, and free flight, which knows nothing of that, collides near it rarely: in thin media
//!   that is most of the noise. So a distance is also drawn equiangularly, the extinction looked up
//!   there, and the transmittances estimated.
//!
//! The three techniques of a local light share a distance `t` and a direction by their densities
//!
//! ```text
//! flight(t) / angle : p_eq(t) / angle : flight(t) · phase,   flight(t) = sigma_t(t) exp(−sigma_t(t) (t − t0))
//! ```
//!
//! with the solid angle of the light and the density of a free flight if all of the medium before were
//! as it is there. That too is a function of ray, distance and direction alone, and all look up the
//! same trilinear extinction for it.

use glam::DVec3;

use super::Context;
use super::media::Media;
use super::parts::{Gather, Source};
use super::path::{LEAST_BELIEF, usual_worth};
use crate::light::{EnvironmentMap, Equiangular, Lights, LocalLight};
use crate::medium::Medium;
use crate::phase::Phase;
use crate::sampling::Stream;
use crate::space::{Aabb, Ray};
use crate::spectrum::Rgb;

/// A scattering event, as far as light that arrives there is concerned.
#[derive(Clone, Copy, Debug)]
pub(super) struct Event<'e, 'm> {
    pub(super) media: &'e Media<'m>,
    /// In world space.
    pub(super) p: DVec3,
    /// Direction of propagation in which the path arrives.
    pub(super) arrived: DVec3,
    pub(super) phase: Phase,
    /// Albedo included.
    pub(super) throughput: Rgb,
}

impl Event<'_, '_> {
    pub(super) fn phase(&self, direction: DVec3) -> f32 {
        self.phase.eval(self.arrived.dot(direction))
    }

    /// Adds an unbiased estimate of the suns' light that scatters here; for `worth` of each see
    /// [`collect`](Self::collect).
    pub(super) fn suns(
        &self,
        lights: &Lights,
        worth: impl Fn(usize) -> f32,
        (radiance, order): (&mut impl Gather, u32),
        stream: &mut Stream,
    ) {
        for (i, sun) in lights.distant.iter().enumerate() {
            let light = sun.sample(stream);
            let unoccluded = self.throughput * light.weight * self.phase(light.direction);
            let to = (light.direction, f64::INFINITY);
            let light = self.collect(to, unoccluded, worth(i), stream);
            radiance.add(light, order, Source::Sun(i));
        }
    }

    /// Returns an unbiased estimate of the light that scatters here of a map, in its share.
    ///
    /// `worth` says what a contribution of 1 from a direction is worth in shadow rays: see
    /// [`collect`](Self::collect).
    fn map(
        &self,
        map: &EnvironmentMap,
        worth: impl FnOnce(DVec3) -> f32,
        stream: &mut Stream,
    ) -> Rgb {
        let Some(sample) = map.sample(stream) else {
            return Rgb::BLACK;
        };
        let phase = self.phase(sample.direction);
        // phase / pdf, times the share pdf / (pdf + phase).
        let unoccluded = self.throughput * sample.radiance * (phase / (sample.pdf + phase));
        let to = (sample.direction, f64::INFINITY);
        self.collect(to, unoccluded, worth(sample.direction), stream)
    }

    /// Adds an unbiased estimate of the light of maps, in their share, and of a local light that
    /// scatters here towards the camera; `segment` is what has led here.
    #[cold] // bench: frame
    pub(super) fn surroundings(
        &self,
        context: &Context<'_>,
        segment: &Ray,
        (radiance, order): (&mut impl Gather, u32),
        stream: &mut Stream,
    ) {
        let Context {
            lights,
            settings,
            guide,
            lamps,
            ..
        } = context;
        let usual = usual_worth(context);
        for (i, map) in lights.maps.iter().enumerate() {
            let worth = |towards| match guide {
                Some(guide) if settings.levers.light_roulette && map.is_towards_beacon(towards) => {
                    let p = guide.position_of(self.media, self.p);
                    let through = guide.root_transmittance(lights.distant.len() + i, p);
                    through.max(LEAST_BELIEF) * usual
                }
                _ => usual,
            };
            let light = self.map(map, worth, stream);
            radiance.add(light, order, Source::Map(i));
        }
        if let Some(lamps) = lamps {
            let (lamp, light) = lamps.at_vertex(segment, self, usual, stream);
            radiance.add(light, order, Source::Lamp(lamp));
        }
    }

    /// Returns what arrives from a direction and a distance: `unoccluded`, as far as it gets
    /// through.
    ///
    /// `worth` is what a contribution of 1 is worth in shadow rays: below 1 in all, the ray is
    /// traced with that probability. On its way, roulette goes on by the same measure.
    pub(super) fn collect(
        &self,
        (direction, distance): (DVec3, f64),
        unoccluded: Rgb,
        worth: f32,
        stream: &mut Stream,
    ) -> Rgb {
        let worth = unoccluded.max_channel() * worth;
        if worth < 1.0 && stream.uniform() >= worth {
            return Rgb::BLACK;
        }
        // At least the probability of having come here: zero cannot.
        let probability = worth.min(1.0);
        stream.counts.shadow_rays += 1;
        let least = worth.recip().min(1.0);
        let ray = Ray {
            origin: self.p,
            direction,
        };
        let to = (&ray, distance);
        let through = self.media.spectral_transmittance(to, least, stream);
        unoccluded * through * probability.recip()
    }
}

/// Adds the light of all maps that a path of `throughput` finds where it leaves towards `direction`,
/// in its share; `phase` is the density of the direction by the phase function.
pub(super) fn meet_maps(
    lights: &Lights,
    (direction, phase): (DVec3, f32),
    throughput: Rgb,
    (sum, order): (&mut impl Gather, u32),
) {
    for (i, map) in lights.maps.iter().enumerate() {
        let (radiance, pdf) = map.radiance_and_pdf(direction);
        let light = throughput * radiance * (phase / (phase + pdf));
        sum.add(light, order, Source::Map(i));
    }
}

/// Adds the radiance of the spheres that a camera ray sees, as far as it gets through.
pub(super) fn see_spheres(
    lights: &Lights,
    media: &Media<'_>,
    ray: &Ray,
    sum: &mut impl Gather,
    stream: &mut Stream,
) {
    for (i, lamp) in lights.local.iter().enumerate() {
        if let Some((radiance, t)) = lamp.meet(ray) {
            let through = media.spectral_transmittance((ray, t), 0.0, stream);
            sum.add(radiance * through, 0, Source::Lamp(i));
        }
    }
}

/// A free flight, as far as it may meet spheres.
#[derive(Clone, Copy, Debug)]
pub(super) struct Flight<'f> {
    /// By which the path has come to where this one starts.
    pub(super) previous: &'f Ray,
    pub(super) segment: &'f Ray,
    /// Density of its direction by the phase function.
    pub(super) phase: f32,
    pub(super) end: f64,
}

/// The local lights of a scene, as seen from its media.
#[derive(Debug)]
pub(super) struct Lamps<'a> {
    all: &'a [LocalLight],
    /// Outside of which nothing scatters.
    bounds: Aabb,
    /// Length of its diagonal.
    size: f64,
    /// Whether distances are drawn equiangularly, too.
    equiangular: bool,
    /// See [`Lights::typical_radiance`].
    typical_radiance: f32,
}

impl<'a> Lamps<'a> {
    /// `None` where there is no local light, or nothing that would scatter its light.
    pub(super) fn new(media: &[Medium], lights: &'a Lights, equiangular: bool) -> Option<Self> {
        let all = &lights.local[..];
        if all.is_empty() {
            return None;
        }
        let mut bounds = Aabb::EMPTY;
        for medium in media {
            medium.for_each_occupied(|corners| {
                for p in corners {
                    bounds = bounds.including(p);
                }
            });
        }
        if bounds.min.x > bounds.max.x {
            return None;
        }
        let size = (bounds.max - bounds.min).length();
        let typical = all.iter().map(|lamp| {
            let (position, radius) = lamp.place();
            let away = (position - bounds.center()).length();
            // From within, as from a quarter of the size.
            let distance = away.max(0.25 * size).max(radius);
            #[expect(clippy::cast_possible_truncation, reason = "a scale")]
            let factor = (1.0 / (4.0 * std::f64::consts::PI * distance * distance)) as f32;
            lamp.typical_intensity() * factor
        });
        Some(Self {
            all,
            bounds,
            size,
            equiangular,
            typical_radiance: typical.sum(),
        })
    }

    /// Returns a radiance that is typical of what the lights make of the media.
    pub(super) fn typical_radiance(&self) -> f32 {
        self.typical_radiance
    }

    /// Returns an unbiased estimate of a local light's light that scatters at `event`, which a free
    /// flight along `segment` has met; in its share, with the light's number.
    pub(super) fn at_vertex(
        &self,
        segment: &Ray,
        event: &Event<'_, '_>,
        worth: f32,
        stream: &mut Stream,
    ) -> (usize, Rgb) {
        let near = |lamp: &LocalLight| {
            let (position, radius) = lamp.place();
            let distance2 = (position - event.p).length_squared();
            importance(lamp, distance2.max(radius * radius))
        };
        let Some((number, lamp, probability)) = self.choose(near, stream) else {
            return (0, Rgb::BLACK);
        };
        let Some(light) = lamp.sample(event.p, stream) else {
            return (number, Rgb::BLACK);
        };
        let phase = event.phase(light.direction);
        let densities = self.densities(event.media, segment, lamp, event.p);
        let share = densities.flight / densities.sum(phase * light.solid_angle);
        #[expect(clippy::cast_possible_truncation, reason = "a weight")]
        let weight = (share / probability) as f32 * phase;
        let unoccluded = event.throughput * light.weight * weight;
        let to = (light.direction, light.distance);
        let light = event.collect(to, unoccluded, worth, stream);
        (number, light)
    }

    /// Returns an unbiased estimate of a local light's light that scatters once along `segment`,
    /// of `throughput`, at a distance drawn equiangularly; in its share, with the light's number.
    #[cold] // bench: frame
    pub(super) fn along(
        &self,
        media: &Media<'_>,
        segment: &Ray,
        throughput: Rgb,
        worth: f32,
        stream: &mut Stream,
    ) -> (usize, Rgb) {
        let seen = |lamp: &LocalLight| {
            let (position, radius) = lamp.place();
            let to = position - segment.origin;
            let along = to.dot(segment.direction).max(0.0);
            let beside2 = (to - segment.direction * along).length_squared();
            importance(lamp, beside2.max(radius * radius)).sqrt()
        };
        let Some((number, lamp, probability)) = self.choose(seen, stream) else {
            return (0, Rgb::BLACK);
        };
        let nothing = (number, Rgb::BLACK);
        let Some((equiangular, t0)) = self.equiangular(segment, lamp) else {
            return nothing;
        };
        let t = equiangular.sample(f64::from(stream.uniform_positive()));
        let p = segment.at(t);
        stream.counts.lookups += 8;
        let Some((medium, sigma_t)) = media.choose(p, stream) else {
            return nothing;
        };
        let Some(light) = lamp.sample(p, stream) else {
            return nothing;
        };
        let densities = Densities {
            flight: flight_density(sigma_t, t - t0),
            equiangular: equiangular.pdf(t),
        };
        let event = Event {
            media,
            p,
            arrived: segment.direction,
            phase: medium.phase(),
            throughput: throughput * medium.tint() * medium.albedo_at(p),
        };
        let phase = event.phase(light.direction);
        let density = probability * densities.sum(phase * light.solid_angle);
        #[expect(clippy::cast_possible_truncation, reason = "a weight")]
        let weight = (f64::from(sigma_t) / density) as f32 * phase;
        let unoccluded = event.throughput * light.weight * weight;
        // First the shadow ray, whose roulette knows what is at stake.
        let to = (light.direction, light.distance);
        let scattered = event.collect(to, unoccluded, worth, stream);
        if scattered.is_black() {
            return nothing;
        }
        let least = (scattered.max_channel() * worth).recip().min(1.0);
        let through = media.spectral_transmittance((segment, t), least, stream);
        (number, scattered * through)
    }

    /// Adds the radiance of the spheres that a path of `throughput` meets on its flight, in its share.
    #[cold] // bench: frame
    pub(super) fn meet(
        &self,
        media: &Media<'_>,
        flight: &Flight<'_>,
        throughput: Rgb,
        (sum, order): (&mut impl Gather, u32),
    ) {
        let Flight {
            previous,
            segment,
            phase,
            end,
        } = *flight;
        for (i, lamp) in self.all.iter().enumerate() {
            if let Some((radiance, t)) = lamp.meet(segment)
                && t < end
            {
                let p = segment.origin;
                let densities = self.densities(media, previous, lamp, p);
                let ratio = phase * lamp.solid_angle(p);
                let share = densities.flight * f64::from(ratio) / densities.sum(ratio);
                #[expect(clippy::cast_possible_truncation, reason = "a share")]
                let share = share as f32;
                sum.add(throughput * radiance * share, order, Source::Lamp(i));
            }
        }
    }

    /// Returns the densities of the distance of `p` along `segment`.
    fn densities(
        &self,
        media: &Media<'_>,
        segment: &Ray,
        lamp: &LocalLight,
        p: DVec3,
    ) -> Densities {
        match self.equiangular(segment, lamp) {
            Some((equiangular, t0)) => {
                let t = (p - segment.origin).dot(segment.direction);
                Densities {
                    flight: flight_density(media.sigma_t(p), t - t0),
                    equiangular: equiangular.pdf(t),
                }
            }
            // Flights alone.
            None => Densities {
                flight: 1.0,
                equiangular: 0.0,
            },
        }
    }

    /// Returns the density of distances over the part of `segment` that is in the media, and where
    /// that starts; `None` where none are drawn.
    fn equiangular(&self, segment: &Ray, lamp: &LocalLight) -> Option<(Equiangular, f64)> {
        if !self.equiangular {
            return None;
        }
        let (t0, t1) = self.bounds.intersect(segment.origin, segment.direction)?;
        let (position, radius) = lamp.place();
        // A ray through a point: 1e-9 of the size is nearer than any that will be drawn.
        let least = radius.max(1e-9 * self.size);
        Some((Equiangular::new(segment, (t0, t1), position, least)?, t0))
    }

    /// Chooses a light in proportion to what `of` says of it; returns its number, it and its probability.
    fn choose(
        &self,
        of: impl Fn(&LocalLight) -> f32,
        stream: &mut Stream,
    ) -> Option<(usize, &'a LocalLight, f64)> {
        if let [only] = self.all {
            return Some((0, only, 1.0));
        }
        let total: f32 = self.all.iter().map(&of).sum();
        let mut left = stream.uniform() * total;
        let mut last = None;
        for (i, lamp) in self.all.iter().enumerate() {
            let part = of(lamp);
            // Zero: a light that is out.
            if part > 0.0 {
                last = Some((i, lamp, f64::from(part / total)));
                if left < part {
                    break;
                }
                left -= part;
            }
        }
        last
    }
}

/// The densities of a distance by the two ways to find one.
#[derive(Clone, Copy, Debug)]
struct Densities {
    flight: f64,
    equiangular: f64,
}

impl Densities {
    /// Returns the sum of the densities of all techniques, times the light's solid angle; `ratio` is
    /// that times the phase function.
    fn sum(self, ratio: f32) -> f64 {
        // Not zero: what is shared has been found by one of them. But it may be too small for f64.
        let sum = self.equiangular + self.flight * (1.0 + f64::from(ratio));
        sum.max(f64::MIN_POSITIVE)
    }
}

/// Returns what a light is worth at a distance.
#[expect(clippy::cast_possible_truncation, reason = "an importance")]
fn importance(lamp: &LocalLight, distance2: f64) -> f32 {
    (f64::from(lamp.typical_intensity()) / distance2.max(1e-30)).min(1e30) as f32
}

/// Returns the density of a free flight of length `t` where the extinction is `sigma_t` throughout.
fn flight_density(sigma_t: f32, t: f64) -> f64 {
    let sigma_t = f64::from(sigma_t);
    sigma_t * (-sigma_t * t.max(0.0)).exp()
}

//! The path integrator: next-event estimation, absorption as weight, Russian roulette.
//!
//! At each collision the path collects every sun's light through an estimate of the
//! transmittance, and goes on in a direction drawn from the phase function or, near a sun, from
//! a choice of several (see `guide`), or towards what media emit (see `steering`). Where it leaves
//! the medium it collects the sky: all of what is the same from everywhere, and its share of an
//! image's (see `surroundings`). A sun's disk is seen by camera rays only, since scattered paths have
//! it from their last collision. What media emit is found in both ways (see `emission`).
//!
//! Absorption multiplies the weight by the albedo; nothing else ends a path but leaving and
//! roulette below [`ROULETTE_WEIGHT`]. There is no cap on the number of bounces unless the
//! scene asks for one.
//!
//! The expectation is the radiance, for any guide and any threshold; what raises the variance
//! is a medium whose light comes through holes that the coarse lattice of the guide misses.

use super::emission::Emitters;
use super::media::{Media, Met, ray_from};
use super::parts::{Gather, Source};
use super::primary::Kernel;
use super::steering::Onward;
use super::surroundings::{Event, Flight, Lamps, meet_maps};
use super::{Context, Levers};
use crate::light::DistantLight;
use crate::medium::MediumRay;
use crate::sampling::{Number, Stream};
use crate::space::Ray;
use crate::spectrum::Rgb;
use glam::DVec3;

/// Paths of less weight times importance are raised to it or ended, by their ratio.
///
/// The guide gives less weight to paths that it sends towards a sun, where they will collect the
/// more: by weight alone, roulette would take those. At g = 0.95 and the sun 30, 90 and 150 degrees
/// from the view, relMSE · samples by weight alone 2.84, 2.33 and 1.97, and 2.64, 2.11 and 1.76.
pub(super) const ROULETTE_WEIGHT: f32 = 0.03;

/// Contributions of a sun that are expected below this fraction of the scene's typical radiance
/// play roulette, most of them before a shadow ray is traced.
///
/// Efficiency 1/(relMSE · CPU s) on the comparison cloud at 0.02, 0.03, 0.05, 0.1 and 0.2, relative:
/// 0.86, 0.94, 1, 0.99, 0.91.
const LEAST_CONTRIBUTION: f32 = 0.05;

/// The same where camera rays are expectations: the less noise there is, the less roulette may add.
/// On the thin smoke at 0.003, 0.01, 0.02, 0.05 and 0.1: 1.26, 1.14, 1.18, 1, 0.67, of which 0.06
/// are noise of timing; the relMSE of a sample 0.0279, 0.0282, 0.0295, 0.0373, 0.06.
const LEAST_CONTRIBUTION_THIN: f32 = 0.01;

/// Throughputs and transmittances below this play roulette where media emit. It does not depend on
/// how much light there is: a fire is bright beside itself and lights the dark far from it.
pub(super) const LEAST_EMITTED: f32 = 0.05;

/// The guide's root of the transmittance counts for at least this.
///
/// Where its lattice misses a gap, a shadow ray is traced rarely and then weighs much. Measured
/// at 0, 0.05, 0.15 and 1, variance of the image's mean in 1e-8 at the cost in CPU s: a torn
/// smoke 23 (3.0), 3.8 (3.4), 3.5 (3.8), 3.4 (5.2); a simulated tower 4.7 (4.1), 4.6 (4.8),
/// 4.7 (5.7), 4.5 (7.2); two clouds lie between.
pub(super) const LEAST_BELIEF: f32 = 0.05;

/// Returns the contribution below which light plays roulette.
pub(super) fn least_contribution(context: &Context<'_>) -> f32 {
    let share = match context.kernel {
        Kernel::Expected => LEAST_CONTRIBUTION_THIN,
        Kernel::Analog | Kernel::Chromatic | Kernel::Transmittance => LEAST_CONTRIBUTION,
    };
    let lamplight = context.lamps.as_ref().map_or(0.0, Lamps::typical_radiance);
    share * (context.lights.typical_radiance() + lamplight)
}

/// Returns what a contribution of 1 is worth in shadow rays, where no more is known of it.
pub(super) fn usual_worth(context: &Context<'_>) -> f32 {
    if context.settings.levers.light_roulette {
        least_contribution(context).max(f32::MIN_POSITIVE).recip()
    } else {
        f32::MAX
    }
}

/// Returns an unbiased sample of the radiance that a collision of the camera ray `ray` sends along
/// it, times `weight`, gathered as the caller wants it.
#[expect(
    clippy::too_many_lines,
    reason = "one event of a path, from its light to its end"
)]
pub(super) fn scattered_radiance<'a, G: Gather>(
    context: &Context<'a>,
    met: Met<'a>,
    ray: &Ray,
    weight: f32,
    stream: &mut Stream,
) -> G {
    let Context {
        ref media,
        lights,
        settings,
        ref emitters,
        ref guide,
        ref lamps,
        ..
    } = *context;
    let Levers {
        guide: steer,
        light_roulette,
        path_roulette,
        ..
    } = settings.levers;
    let roulette_weight = if path_roulette {
        ROULETTE_WEIGHT
    } else {
        // Only paths without any weight end.
        f32::MIN_POSITIVE
    };
    let least = least_contribution(context);
    let has_surroundings = lamps.is_some() || !lights.maps.is_empty();
    let mut direction = ray.direction;
    // Only lamps look back at it.
    let mut segment = *ray;
    let mut radiance = G::of(lights);
    let mut throughput = Rgb::splat(weight);
    // What the throughput is worth: for the next event, and from there on.
    let (mut importance, mut steering) = (1.0, 1.0);
    let mut bounces = 0;
    let Met {
        mut index,
        mut walk,
        mut t,
    } = met;
    radiance.meet(walk.medium(), walk.world_position(t), weight);
    loop {
        let medium = walk.medium();
        if settings.max_bounces == Some(bounces) {
            return radiance;
        }
        throughput *= walk.albedo(t);
        bounces += 1;

        let worth = throughput.max_channel() * importance * steering;
        if worth < roulette_weight {
            if stream.uniform() * roulette_weight >= worth {
                stream.counts.roulette_kills += 1;
                return radiance;
            }
            throughput *= roulette_weight / worth;
        }

        let vertex = Vertex {
            media,
            index,
            walk: &walk,
            t,
            direction,
            throughput,
        };
        let mut guided = None;
        if let Some(guide) = guide {
            let beliefs = guide.beliefs(guide.position(&walk, t));
            for (i, sun) in lights.distant.iter().enumerate() {
                let worth = if light_roulette {
                    guide.believed_root(i, &beliefs).max(LEAST_BELIEF) / least
                } else {
                    f32::MAX
                };
                let light = vertex.direct_light(sun, worth, stream);
                radiance.add(light, bounces, Source::Sun(i));
            }
            if steer {
                guided = Some(guide.sample(medium.phase(), &beliefs, direction, stream));
            }
        }
        if has_surroundings {
            let event = Event {
                media,
                p: walk.world_position(t),
                arrived: direction,
                phase: medium.phase(),
                throughput: vertex.throughput,
            };
            event.surroundings(context, &segment, (&mut radiance, bounces), stream);
        }
        if !emitters.is_empty() {
            let least = if light_roulette { LEAST_EMITTED } else { 0.0 };
            let light = vertex.emitted_light(emitters, (least, steering), stream);
            radiance.add(light, bounces, Source::Emission);
        }
        stream.counts.scattered_rays += 1;
        let arrived = direction;
        let usual = |stream: &mut Stream| {
            guided.unwrap_or_else(|| Onward::usual(medium.phase().sample(arrived, stream)))
        };
        let onward = if emitters.is_empty() {
            usual(stream)
        } else {
            let phase = |direction| medium.phase().eval(arrived.dot(direction));
            emitters.steer(walk.world_position(t), phase, usual, &mut steering, stream)
        };
        direction = onward.direction;
        throughput *= onward.weight;
        importance = onward.importance;
        walk.turn(t, direction, f64::INFINITY);
        let previous = segment;
        if let Some(lamps) = lamps {
            segment = ray_from(&walk, 0.0, direction);
            if settings.max_bounces != Some(bounces) {
                let worth = usual_worth(context);
                let (lamp, light) = lamps.along(media, &segment, throughput, worth, stream);
                radiance.add(light, bounces + 1, Source::Lamp(lamp));
            }
        }
        let depth = if bounces == 1 {
            stream.exponential_of(Number::ScatteredDepth)
        } else {
            stream.exponential()
        };
        let further = media
            .tracking(index)
            .next_collision(&mut walk, depth, stream);
        if media.are_several() || !emitters.is_empty() || lamps.is_some() {
            let ray = ray_from(&walk, 0.0, direction);
            let mut end = further.unwrap_or(f64::INFINITY);
            let nearer = if media.are_several() {
                media.nearer(Some(index), &ray, end, stream)
            } else {
                None
            };
            end = nearer.as_ref().map_or(end, |met| met.t);
            if !emitters.is_empty() {
                let phase = medium.phase().eval(arrived.dot(direction));
                let worth = (phase, throughput.max_channel() * steering);
                let light = throughput * emitters.along(&ray, (end, &[]), worth, stream);
                radiance.add(light, bounces, Source::Emission);
            }
            if let Some(lamps) = lamps {
                let phase = medium.phase().eval(arrived.dot(direction));
                let flight = Flight {
                    previous: &previous,
                    segment: &ray,
                    phase,
                    end,
                };
                lamps.meet(media, &flight, throughput, (&mut radiance, bounces));
            }
            if let Some(nearer) = nearer {
                Met { index, walk, t } = nearer;
                continue;
            }
        }
        let Some(further) = further else {
            radiance.add(throughput * lights.environment, bounces, Source::Constant);
            if !lights.maps.is_empty() {
                let phase = medium.phase().eval(arrived.dot(direction));
                let met = (direction, phase);
                meet_maps(lights, met, throughput, (&mut radiance, bounces));
            }
            return radiance;
        };
        t = further;
    }
}

/// A scattering event.
struct Vertex<'w, 'm> {
    media: &'w Media<'m>,
    /// Which medium it is in.
    index: usize,
    /// The walk that met it, at `t`.
    walk: &'w MediumRay<'m>,
    t: f64,
    /// In which the path arrives, coming from the camera.
    direction: DVec3,
    /// Albedo included.
    throughput: Rgb,
}

impl Vertex<'_, '_> {
    /// Returns an unbiased estimate of a sun's light that scatters here towards the camera.
    ///
    /// `worth` is what a contribution of 1 is expected to be worth in shadow rays: below 1, the
    /// ray is traced with that probability. On its way, roulette goes on by the same measure.
    #[inline] // bench: frame
    fn direct_light(&self, sun: &DistantLight, worth: f32, stream: &mut Stream) -> Rgb {
        let light = sun.sample(stream);
        // The path runs from the camera, so light travels the other way on both legs; the
        // cosine between the directions of propagation is the same.
        let phase = self
            .walk
            .medium()
            .phase()
            .eval(self.direction.dot(light.direction));
        let unoccluded = self.throughput * light.weight * phase;
        let worth = unoccluded.max_channel() * worth;
        if worth < 1.0 && stream.uniform() >= worth {
            return Rgb::BLACK;
        }
        // At least the probability of having come here: zero cannot.
        let probability = worth.min(1.0);
        stream.counts.shadow_rays += 1;
        let least = worth.recip().min(1.0);
        let transmittance = self.transmittance((light.direction, f64::INFINITY), least, stream);
        unoccluded * (transmittance / probability)
    }

    /// Returns an unbiased estimate of emitted light that scatters here towards the camera, from a
    /// point drawn as of a light. Throughputs times `steering`, and transmittances, play roulette
    /// below `least`.
    fn emitted_light(
        &self,
        emitters: &Emitters<'_>,
        (least, steering): (f32, f32),
        stream: &mut Stream,
    ) -> Rgb {
        let worth = self.throughput.max_channel() * steering;
        if worth < least && stream.uniform() * least >= worth {
            return Rgb::BLACK;
        }
        let origin = self.walk.world_position(self.t);
        let phase = self.walk.medium().phase();
        let towards = |direction| phase.eval(self.direction.dot(direction));
        let Some(point) = emitters.sample_light(origin, towards, stream) else {
            return Rgb::BLACK;
        };
        stream.counts.shadow_rays += 1;
        let to = (point.direction, point.distance);
        let transmittance = self.transmittance(to, least, stream);
        let probability = if worth < least { worth / least } else { 1.0 };
        self.throughput * point.unoccluded * (transmittance / probability)
    }

    /// Estimates the transmittance towards a direction, up to a distance.
    #[inline] // bench: frame
    fn transmittance(
        &self,
        (direction, t_max): (DVec3, f64),
        least: f32,
        stream: &mut Stream,
    ) -> f32 {
        let Self {
            media,
            index,
            walk,
            t,
            ..
        } = *self;
        let through =
            media
                .tracking(index)
                .transmittance_from((walk, t), (direction, t_max), least, stream);
        if media.are_several() {
            let ray = ray_from(walk, t, direction);
            let weights = (through, least);
            return media.transmittance(Some(index), (&ray, t_max), weights, stream);
        }
        through
    }
}

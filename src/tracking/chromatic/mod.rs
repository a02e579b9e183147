//! Flights and transmittances of three channels at once, where the extinction has a colour.
//!
//! The extinction of channel `c` is `tint_c · sigma_t`, with a largest tint of 1: bounds and rates
//! are those of the channel that meets the most. All channels share a walk and its lookups, and a
//! weight for each says how much of the channel goes on.
//!
//! * `flight`: the next collision, of all channels.
//! * `ratio`: transmittances: ratio tracking with a control, as of gray media, with a factor for each
//!   channel.
//! * `expected`: both, as of gray media: the transmittance of each channel, exactly 1 where the
//!   channel has no extinction, and a collision, chosen by the mean of the channels' weights.
//!
//! Segments that are homogeneous take closed forms, and those in which collisions would be denser
//! than cell by cell their exact depth: the number of steps is bounded by that of the voxels,
//! whatever the file says.
//!
//! Do not use it for gray media: it is their code with three times the arithmetic. Flights choose
//! between the two by themselves whatever the scene says of distances.

mod expected;
mod flight;
mod ratio;

use super::collision::optical_depth;
use super::settings::Tracking;
use crate::medium::{BoundSegment, Medium, MediumRay};
use crate::sampling::Stream;
use crate::space::Ray;
use crate::spectrum::Rgb;
use crate::stats::Counts;

/// Tentative collisions of expected flights for each unit of the bound, at least.
const LEAST_RATE: f32 = 2.0;

/// What a flight multiplies its weights by from a distance on.
///
/// In a segment that is settled as a whole this is known at its start: on average it is what is known
/// at any point of it, so whoever ends there may count it.
pub type Factor = (f64, Rgb);

/// What becomes of a ray, by expectation, in each channel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ChromaticFlight {
    /// Unbiased estimates of the transmittances.
    pub transmittance: Rgb,
    /// World distance of a collision that stands for all, and its weight in each channel; `None` if
    /// nothing was met.
    pub collision: Option<(f64, Rgb)>,
}

/// What light meets, and how often it is asked.
#[derive(Clone, Copy, Debug)]
struct Optics {
    tint: Rgb,
    /// Tentative collisions for each unit of the bound.
    rate: f32,
}

/// Returns `e^(−tint_c · depth)`; `depth` is finite.
fn attenuate(tint: Rgb, depth: f32) -> Rgb {
    Rgb(tint.0.map(|tint| (-tint * depth).exp()))
}

fn sum(weights: Rgb) -> f32 {
    weights.0[0] + weights.0[1] + weights.0[2]
}

/// Draws a channel in proportion to `weights`, whose sum is `total` and not zero.
fn choose(weights: Rgb, total: f32, stream: &mut Stream) -> usize {
    let mut left = stream.uniform() * total;
    let mut last = 0;
    for (c, weight) in weights.0.into_iter().enumerate() {
        // Zero: never, even where rounding leaves something beyond the last.
        if weight > 0.0 {
            last = c;
            left -= weight;
            if left < 0.0 {
                break;
            }
        }
    }
    last
}

/// Returns the optical depth of a segment that takes no collisions: because it is homogeneous, or
/// because at `rate` they would be more than `exact_above`.
fn settled_depth(
    ray: &mut MediumRay<'_>,
    segment: &BoundSegment,
    (rate, exact_above): (f32, f64),
    counts: &mut Counts,
) -> Option<f32> {
    let depth = if segment.is_homogeneous() {
        optical_depth(segment.sigma_maj, segment.t1 - segment.t0)
    } else if f64::from(rate) > exact_above {
        #[expect(
            clippy::cast_possible_truncation,
            reason = "relative precision matters"
        )]
        let depth = ray.optical_depth(counts) as f32;
        depth
    } else {
        return None;
    };
    // Finite: a channel without extinction gets through whatever the others meet.
    Some(depth.min(f32::MAX))
}

/// Returns where a segment that takes no collisions reaches `depth`.
fn settled_at(
    ray: &mut MediumRay<'_>,
    segment: &BoundSegment,
    depth: f32,
    counts: &mut Counts,
) -> f64 {
    let BoundSegment {
        t0, t1, sigma_maj, ..
    } = *segment;
    let t = if segment.is_homogeneous() {
        t0 + f64::from(depth / sigma_maj)
    } else {
        // Rounding may put the depth beyond the last cell.
        ray.reach_depth(&mut f64::from(depth), counts).unwrap_or(t1)
    };
    t.min(t1)
}

impl Tracking {
    /// As [`sample_collision`](Self::sample_collision), where `weights`, of which one is above zero,
    /// decide together what is real, and become those of what has happened: their sum stays.
    ///
    /// `factors` hears, in order, of all that they are multiplied by.
    pub fn chromatic_collision(
        &self,
        (medium, ray, t_max): (&Medium, &Ray, f64),
        weights: &mut Rgb,
        factors: Option<&mut Vec<Factor>>,
        stream: &mut Stream,
    ) -> Option<f64> {
        let walk = self.start_path(medium, ray, t_max);
        let optics = Optics {
            tint: medium.tint(),
            rate: self.flight_rate,
        };
        flight::sample(walk, optics, (weights, factors), stream)
    }

    /// As [`estimate_transmittance`](Self::estimate_transmittance), of each channel; roulette goes by
    /// the largest.
    pub fn chromatic_transmittance(
        &self,
        (medium, ray, t_max): (&Medium, &Ray, f64),
        roulette_weight: f32,
        stream: &mut Stream,
    ) -> Rgb {
        let walk = self.start_path(medium, ray, t_max);
        let optics = Optics {
            tint: medium.tint(),
            rate: self.rate,
        };
        ratio::estimate(walk, optics, roulette_weight, stream)
    }

    /// As [`expected_flight`](Self::expected_flight), of each channel.
    ///
    /// What is left below a mean weight of `analog_below` goes on by
    /// [`chromatic_collision`](Self::chromatic_collision).
    pub fn chromatic_flight(
        &self,
        medium: &Medium,
        ray: &Ray,
        analog_below: f32,
        stream: &mut Stream,
    ) -> ChromaticFlight {
        let optics = Optics {
            tint: medium.tint(),
            rate: self.rate.max(LEAST_RATE),
        };
        let walk = self.start_path(medium, ray, f64::INFINITY);
        let rest = |t, weights: &mut Rgb, stream: &mut Stream| {
            let ray = Ray {
                origin: ray.at(t),
                ..*ray
            };
            let place = (medium, &ray, f64::INFINITY);
            self.chromatic_collision(place, weights, None, stream)
        };
        expected::flight(walk, optics, (analog_below, rest), stream)
    }
}

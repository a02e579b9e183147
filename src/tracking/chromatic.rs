//! Flights and transmittances of three channels at once, where the extinction has a colour.
//!
//! The extinction of channel `c` is `tint_c · sigma_t`, with a largest tint of 1: bounds and rates
//! are those of the channel that meets the most. All channels share a walk and its lookups, and a
//! weight for each says how much of the channel goes on.
//!
//! * *Flight*: with weights `β` and `a = sigma_t / rate`, a tentative collision is real with
//!   probability `P = Σ β_c tint_c a / Σ β_c`, after which `β_c` is multiplied by `tint_c a / P`, else
//!   by `(1 − tint_c a) / (1 − P)`. Either way `Σ β` stays what it was: no weight can grow beyond
//!   it, however far the channels' extinctions are apart. It is the balance heuristic over flights
//!   that follow one channel each, with all but the last decision already made
//!   `[Kutz2017]` `[Wilkie2014]` `[Miller2019]`; following one channel alone and dividing by its
//!   probability gives weights of `tint_c / tint_h` for each collision, without limit.
//! * *Transmittance*: ratio tracking with a control, as of gray media, with a factor for each channel.
//! * *Expected flight*: both, as of gray media: the transmittance of each channel, exactly 1 where
//!   the channel has no extinction, and a collision, chosen by the mean of the channels' weights.
//!
//! Do not use it for gray media: it is their code with three times the arithmetic. Flights are by
//! tentative collisions whatever the scene says of distances, so a bound far above the extinction
//! costs null collisions.

use std::ops::ControlFlow;

use super::collision::{Collision, Visitor, look_up, optical_depth, walk};
use super::expected::LEAST_RATE;
use super::settings::Tracking;
use super::transmittance::{EXACT_COLLISIONS_PER_VOXEL, residual};
use crate::medium::{BoundSegment, Medium, MediumRay};
use crate::sampling::Stream;
use crate::space::Ray;
use crate::spectrum::Rgb;
use crate::stats::Counts;

/// What becomes of a ray, by expectation, in each channel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ChromaticFlight {
    /// Unbiased estimates of the transmittances.
    pub transmittance: Rgb,
    /// World distance of a collision that stands for all, and its weight in each channel; `None` if
    /// nothing was met.
    pub collision: Option<(f64, Rgb)>,
}

/// Returns `e^(−tint_c · depth)`.
fn attenuate(tint: Rgb, depth: f32) -> Rgb {
    Rgb(tint.0.map(|tint| (-tint * depth).exp()))
}

fn sum(weights: Rgb) -> f32 {
    weights.0[0] + weights.0[1] + weights.0[2]
}

/// What a null collision at a distance multiplies the weights by.
pub type Null = (f64, Rgb);

/// A flight whose weights decide what is real.
struct Flight<'n> {
    rate: f32,
    tint: Rgb,
    weights: Rgb,
    accepted: Option<f64>,
    /// Null collisions, for who may have to take them back.
    nulls: Option<&'n mut Vec<Null>>,
}

impl Visitor for Flight<'_> {
    fn enter(
        &mut self,
        _ray: &mut MediumRay<'_>,
        segment: &BoundSegment,
        _depth: &mut f32,
        _stream: &mut Stream,
        _counts: &mut Counts,
    ) -> ControlFlow<(), f32> {
        ControlFlow::Continue(if segment.is_homogeneous() {
            segment.sigma_maj
        } else {
            segment.sigma_maj * self.rate
        })
    }

    fn collide(
        &mut self,
        ray: &mut MediumRay<'_>,
        segment: &BoundSegment,
        collision: &Collision,
        stream: &mut Stream,
        counts: &mut Counts,
    ) -> ControlFlow<()> {
        let sigma_t = if segment.is_homogeneous() {
            segment.sigma_maj
        } else {
            look_up(ray, segment, collision.t, stream, counts)
        };
        let real = self.weights * self.tint * (sigma_t / collision.rate);
        // Not zero: a path without weight has ended.
        let probability = sum(real) / sum(self.weights);
        if stream.uniform_positive() <= probability {
            self.weights = real * probability.recip();
            self.accepted = Some(collision.t);
            counts.real_collisions += 1;
            return ControlFlow::Break(());
        }
        let part = sigma_t / collision.rate;
        let scale = (1.0 - probability).recip();
        let null = Rgb(self.tint.0.map(|tint| (1.0 - tint * part) * scale));
        self.weights *= null;
        if let Some(nulls) = &mut self.nulls {
            nulls.push((collision.t, null));
        }
        counts.null_collisions += 1;
        ControlFlow::Continue(())
    }
}

/// Draws the world distance of the next collision, or leaves; `weights`, of which one is above
/// zero, become those of what has happened. `nulls` hears of the null collisions on the way.
fn sample_flight(
    mut ray: MediumRay<'_>,
    (tint, rate): (Rgb, f32),
    weights: &mut Rgb,
    nulls: Option<&mut Vec<Null>>,
    stream: &mut Stream,
    counts: &mut Counts,
) -> Option<f64> {
    let mut visitor = Flight {
        rate,
        tint,
        weights: *weights,
        accepted: None,
        nulls,
    };
    walk(&mut ray, stream, counts, &mut visitor);
    *weights = visitor.weights;
    visitor.accepted
}

struct Ratio {
    rate: f32,
    tint: Rgb,
    weights: Rgb,
    roulette_weight: f32,
    /// Rate above which a segment is integrated exactly.
    exact_above: f64,
    /// Of the current segment.
    control: f32,
}

impl Ratio {
    /// Multiplies by factors that are not negative; plays roulette by the largest weight.
    fn take(&mut self, factors: Rgb, stream: &mut Stream, counts: &mut Counts) -> ControlFlow<()> {
        self.weights *= factors;
        let most = self.weights.max_channel();
        if most < self.roulette_weight {
            if stream.uniform() * self.roulette_weight >= most {
                self.weights = Rgb::BLACK;
                counts.roulette_kills += 1;
                return ControlFlow::Break(());
            }
            // Not zero: nothing is below zero.
            self.weights *= self.roulette_weight / most;
        }
        ControlFlow::Continue(())
    }
}

impl Visitor for Ratio {
    fn enter(
        &mut self,
        ray: &mut MediumRay<'_>,
        segment: &BoundSegment,
        _depth: &mut f32,
        stream: &mut Stream,
        counts: &mut Counts,
    ) -> ControlFlow<(), f32> {
        let length = segment.t1 - segment.t0;
        if segment.is_homogeneous() {
            let depth = optical_depth(segment.sigma_maj, length);
            self.take(attenuate(self.tint, depth), stream, counts)?;
            return ControlFlow::Continue(0.0);
        }
        let (control, bound) = residual(segment);
        let rate = bound * self.rate;
        if f64::from(rate) > self.exact_above {
            #[expect(
                clippy::cast_possible_truncation,
                reason = "relative precision matters"
            )]
            let depth = ray.optical_depth(counts) as f32;
            self.take(attenuate(self.tint, depth), stream, counts)?;
            return ControlFlow::Continue(0.0);
        }
        self.control = control;
        // Zero: nothing to subtract.
        if control > 0.0 {
            let depth = optical_depth(control, length);
            self.take(attenuate(self.tint, depth), stream, counts)?;
        }
        ControlFlow::Continue(rate)
    }

    fn collide(
        &mut self,
        ray: &mut MediumRay<'_>,
        segment: &BoundSegment,
        collision: &Collision,
        stream: &mut Stream,
        counts: &mut Counts,
    ) -> ControlFlow<()> {
        let sigma_t = look_up(ray, segment, collision.t, stream, counts);
        // Not negative: a tint is at most 1, and the rate at least sigma_maj − control.
        let part = (sigma_t - self.control) / collision.rate;
        let factors = Rgb(self.tint.0.map(|tint| 1.0 - tint * part));
        self.take(factors, stream, counts)
    }
}

/// Returns an unbiased estimate of the transmittance of the whole ray in each channel.
///
/// Where the largest is below `roulette_weight`, all are raised by what raises it to that, or lost.
fn estimate_transmittance(
    mut ray: MediumRay<'_>,
    (tint, rate): (Rgb, f32),
    roulette_weight: f32,
    stream: &mut Stream,
    counts: &mut Counts,
) -> Rgb {
    let mut visitor = Ratio {
        rate,
        tint,
        weights: Rgb::WHITE,
        roulette_weight,
        exact_above: EXACT_COLLISIONS_PER_VOXEL * ray.voxels_per_length(),
        control: 0.0,
    };
    if visitor.take(Rgb::WHITE, stream, counts).is_continue() {
        walk(&mut ray, stream, counts, &mut visitor);
    }
    visitor.weights
}

/// The walk, and one of its collisions so far.
struct Expected {
    rate: f32,
    tint: Rgb,
    /// Probability, in each channel, of having met nothing.
    weights: Rgb,
    analog_below: f32,
    rest_from: Option<f64>,
    /// Sum over collisions so far of the sums of their channels' weights.
    met: f32,
    /// One of them, with its weights over their sum.
    chosen: Option<(f64, Rgb)>,
}

impl Expected {
    /// Takes a collision of weights `w` at `t`.
    fn meet(&mut self, t: f64, w: Rgb, stream: &mut Stream) {
        let total = sum(w);
        self.met += total;
        if stream.uniform() * self.met < total {
            self.chosen = Some((t, w * total.recip()));
        }
    }

    fn goes_on(&mut self, t: f64) -> ControlFlow<()> {
        if sum(self.weights) <= 3.0 * self.analog_below {
            self.rest_from = Some(t);
            return ControlFlow::Break(());
        }
        ControlFlow::Continue(())
    }

    /// Takes a collision somewhere in a homogeneous segment.
    ///
    /// The distance is drawn from the mixture of the channels' exponentials, each in proportion to
    /// what it loses there; the weights over the mixture's density are bounded by the losses' sum.
    fn cross(&mut self, segment: &BoundSegment, stream: &mut Stream) {
        let BoundSegment {
            t0, t1, sigma_maj, ..
        } = *segment;
        let depth = optical_depth(sigma_maj, t1 - t0);
        let lost = Rgb(std::array::from_fn(|c| {
            self.weights.0[c] * -(-self.tint.0[c] * depth).exp_m1()
        }));
        let total = sum(lost);
        // Zero: nothing is met.
        if total > 0.0 {
            let mut left = stream.uniform() * total;
            let channel = (0..3).find(|&c| {
                left -= lost.0[c];
                left < 0.0
            });
            // Rounded up to the total, it would pass all three; the widest is never empty.
            let tint = self.tint.0[channel.unwrap_or(0)].max(f32::MIN_POSITIVE);
            let p = -(-tint * depth).exp_m1();
            let u = stream.uniform_positive();
            let met_at = if p < 0.5 {
                -(-u * p).ln_1p()
            } else {
                -((-tint * depth).exp() + u * p).ln()
            };
            let met_at = (met_at.max(0.0) / tint).min(depth);
            let density = Rgb(std::array::from_fn(|c| {
                self.weights.0[c] * self.tint.0[c] * (-self.tint.0[c] * met_at).exp()
            }));
            // Not zero: the channel that was drawn has a density.
            let scale = total / sum(density);
            let t = t0 + f64::from(met_at / sigma_maj);
            self.meet(t.min(t1), density * scale, stream);
        }
        self.weights *= attenuate(self.tint, depth);
    }
}

impl Visitor for Expected {
    fn enter(
        &mut self,
        _ray: &mut MediumRay<'_>,
        segment: &BoundSegment,
        _depth: &mut f32,
        stream: &mut Stream,
        _counts: &mut Counts,
    ) -> ControlFlow<(), f32> {
        if segment.is_homogeneous() {
            self.cross(segment, stream);
            self.goes_on(segment.t1)?;
            return ControlFlow::Continue(0.0);
        }
        ControlFlow::Continue(segment.sigma_maj * self.rate)
    }

    fn collide(
        &mut self,
        ray: &mut MediumRay<'_>,
        segment: &BoundSegment,
        collision: &Collision,
        stream: &mut Stream,
        counts: &mut Counts,
    ) -> ControlFlow<()> {
        let sigma_t = look_up(ray, segment, collision.t, stream, counts);
        // Zero: as empty as it looks.
        if sigma_t > 0.0 {
            let w = self.weights * self.tint * (sigma_t / collision.rate);
            self.meet(collision.t, w, stream);
            self.weights = Rgb(std::array::from_fn(|c| self.weights.0[c] - w.0[c]));
            self.goes_on(collision.t)?;
        }
        ControlFlow::Continue(())
    }
}

/// Returns the transmittances of the whole ray, estimated, and a collision that stands for the rest.
///
/// What is left below a mean of `analog_below` goes on as a flight of `rest`, from a distance on.
fn expected_flight<'a>(
    mut ray: MediumRay<'_>,
    (tint, rate): (Rgb, f32),
    analog_below: f32,
    rest: impl FnOnce(f64) -> MediumRay<'a>,
    stream: &mut Stream,
    counts: &mut Counts,
) -> ChromaticFlight {
    let mut visitor = Expected {
        rate,
        tint,
        weights: Rgb::WHITE,
        analog_below,
        rest_from: None,
        met: 0.0,
        chosen: None,
    };
    walk(&mut ray, stream, counts, &mut visitor);
    // Zero: no rest is left.
    if let Some(t) = visitor.rest_from.filter(|_| sum(visitor.weights) > 0.0) {
        let weights = &mut visitor.weights;
        let hit = sample_flight(rest(t), (tint, 1.0), weights, None, stream, counts);
        if let Some(further) = hit {
            let w = visitor.weights;
            visitor.meet(t + further, w, stream);
            visitor.weights = Rgb::BLACK;
        }
    }
    ChromaticFlight {
        transmittance: visitor.weights,
        collision: visitor.chosen.map(|(t, w)| (t, w * visitor.met)),
    }
}

impl Tracking {
    /// As [`sample_collision`](Self::sample_collision), where `weights`, of which one is above zero,
    /// decide together what is real, and become those of what has happened: their sum stays.
    ///
    /// `nulls` hears of the null collisions on the way.
    pub fn chromatic_collision(
        &self,
        (medium, ray, t_max): (&Medium, &Ray, f64),
        weights: &mut Rgb,
        nulls: Option<&mut Vec<Null>>,
        stream: &mut Stream,
        counts: &mut Counts,
    ) -> Option<f64> {
        let walk = self.start_path(medium, ray, t_max);
        let optics = (medium.tint(), self.flight_rate);
        sample_flight(walk, optics, weights, nulls, stream, counts)
    }

    /// As [`estimate_transmittance`](Self::estimate_transmittance), of each channel; roulette goes by
    /// the largest.
    pub fn chromatic_transmittance(
        &self,
        (medium, ray, t_max): (&Medium, &Ray, f64),
        roulette_weight: f32,
        stream: &mut Stream,
        counts: &mut Counts,
    ) -> Rgb {
        let walk = self.start_path(medium, ray, t_max);
        let optics = (medium.tint(), self.rate);
        estimate_transmittance(walk, optics, roulette_weight, stream, counts)
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
        counts: &mut Counts,
    ) -> ChromaticFlight {
        let optics = (medium.tint(), self.rate.max(LEAST_RATE));
        let walk = self.start_path(medium, ray, f64::INFINITY);
        let rest = |t| {
            let ray = Ray {
                origin: ray.at(t),
                ..*ray
            };
            self.start_path(medium, &ray, f64::INFINITY)
        };
        expected_flight(walk, optics, analog_below, rest, stream, counts)
    }
}

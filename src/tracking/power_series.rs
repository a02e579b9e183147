//! The power series of the exponential about a ray-marched optical depth: unbiased, and nearly
//! free of variance where the medium is smooth on the scale of its collisions.
//!
//! A comb of equidistant points with one random offset gives an unbiased estimate `X` of the
//! optical depth. Its exponential is biased, which is what is wrong with ray marching. But about
//! any pivot `p`, `exp(−τ) = exp(−p) Σ_k (p − τ)^k / k!`, and the power `(p − τ)^k` has the
//! unbiased estimate `Π (p − X_i)` over `k` independent combs `[Kettunen2021]`:
//!
//! ```text
//! estimate = mean over j of  exp(−X_j) Σ_{k ≤ N} e_k(X_j − X_i, i ≠ j) / (k! P(N ≥ k))
//! ```
//!
//! of `N + 1` combs, each once the pivot; `e_k` is the mean of all products of `k` of the others
//! (the smallest variance of a symmetric estimate of the power). The order `N` is drawn:
//! [`LEAST_ORDER`] of the rays go beyond ray marching, to order 2 at least, then with probability
//! `2 / k` to order `k`. It has the mean 0.32.
//!
//! The combs are not equidistant in length but in the *range*, the integral of
//! `max(sigma_maj − c, c − sigma_min)` of the segments, whose mean extinction `c` is the control
//! and integrated in closed form. So nothing is looked up where the bounds already tell all.
//!
//! * Expectation: `T`, for any control and any number of teeth, by one tap or eight: every `X` is
//!   linear in the values, and the combs of a product are independent.
//! * Variance: about `T² Var(X)`, no closed form. A comb's variance falls faster than with
//!   independent points: with the square of their number where the extinction is smooth.
//! * Cost: one step a segment and `1.32 · 2 · rate ·` range lookups, in place of the collisions
//!   of residual ratio tracking.
//! * When to use it: for shadow rays through thin, smooth media. A ray by itself varies 5 to 100
//!   times less for its time than by ratio or residual ratio tracking; of that, an image keeps
//!   what shadow rays had to do with its noise: 5 to 15 % on a thin smoke, nothing on thick clouds.
//! * When not: where every estimate must lie in [0, 1]. It can exceed 1, and be negative (of 10⁵
//!   estimates some tens in torn smoke). And where single voxels decide: few teeth miss them,
//!   and then the higher orders are heavy.
//!
//! # Reference
//! `[Kettunen2021]`, with local controls, and combs in range in place of length.

use std::ops::ControlFlow;

use super::collision::{Collision, Visitor, look_up, walk};
use super::transmittance::EXACT_COLLISIONS_PER_VOXEL;
use crate::medium::{BoundSegment, MediumRay};
use crate::sampling::Stream;

/// The probability to go beyond order zero.
const LEAST_ORDER: f32 = 0.1;

/// Teeth of a comb for each unit of the range, at a rate of one.
const TEETH: f64 = 2.0;

/// One estimate of the optical depth that the control leaves.
struct Comb {
    /// Range to the next tooth.
    next: f64,
    /// Sum so far.
    depth: f64,
}

struct Series {
    combs: Vec<Comb>,
    /// Range between two teeth.
    gap: f64,
    /// Teeth per length above which a segment is integrated exactly.
    exact_above: f64,
    /// Optical depth in closed form.
    control: f64,
    /// The largest optical depth so far, by the mean of the combs.
    deepest: f64,
    /// That at which roulette ends the ray.
    last_depth: f64,
}

impl Visitor for Series {
    #[inline] // bench: frame
    fn enter(
        &mut self,
        ray: &mut MediumRay<'_>,
        segment: &BoundSegment,
        _depth: &mut f32,
        stream: &mut Stream,
    ) -> ControlFlow<(), f32> {
        let BoundSegment {
            t0,
            t1,
            sigma_min,
            sigma_maj,
            ..
        } = *segment;
        // The mean may be rounded out of the range.
        let control = segment.sigma_mean.clamp(sigma_min, sigma_maj);
        let range = f64::from((sigma_maj - control).max(control - sigma_min));
        if range > self.exact_above * self.gap {
            self.control += ray.optical_depth(&mut stream.counts);
        } else {
            self.control += f64::from(control) * (t1 - t0);
            let end = range * (t1 - t0);
            for comb in &mut self.combs {
                while comb.next < end {
                    // The range is not zero: there is some to go.
                    let t = (t0 + comb.next / range).min(t1);
                    let sigma_t = look_up(ray, segment, t, stream);
                    comb.depth += f64::from(sigma_t - control) / range * self.gap;
                    comb.next += self.gap;
                }
                comb.next -= end;
            }
        }
        let sum: f64 = self.combs.iter().map(|comb| comb.depth).sum();
        let depth = self.control + sum / self.combs.len() as f64;
        self.deepest = self.deepest.max(depth);
        if self.deepest >= self.last_depth {
            stream.counts.roulette_kills += 1;
            return ControlFlow::Break(());
        }
        ControlFlow::Continue(0.0)
    }

    fn collide(
        &mut self,
        _ray: &mut MediumRay<'_>,
        _segment: &BoundSegment,
        _collision: &Collision,
        _stream: &mut Stream,
    ) -> ControlFlow<()> {
        ControlFlow::Continue(())
    }
}

/// Returns an unbiased estimate of the transmittance of the whole ray.
///
/// Where the exponential of the combs' mean, so far and at its deepest, is below
/// `roulette_weight`, a ray goes on with the probability that is their ratio, and weighs as much
/// more.
#[inline] // bench: frame
pub(super) fn power_series(
    mut ray: MediumRay<'_>,
    rate: f32,
    roulette_weight: f32,
    stream: &mut Stream,
) -> f32 {
    let gap = 1.0 / (TEETH * f64::from(rate));
    let order = draw_order(stream);
    let combs = (0..=order).map(|_| Comb {
        next: f64::from(stream.uniform()) * gap,
        depth: 0.0,
    });
    let least_depth = -f64::from(roulette_weight).ln();
    let mut visitor = Series {
        combs: combs.collect(),
        gap,
        exact_above: EXACT_COLLISIONS_PER_VOXEL * ray.voxels_per_length(),
        control: 0.0,
        deepest: 0.0,
        last_depth: least_depth + f64::from(stream.exponential()),
    };
    walk(&mut ray, stream, &mut visitor);
    let Series {
        combs,
        control,
        deepest,
        last_depth,
        ..
    } = visitor;
    if deepest >= last_depth {
        return 0.0;
    }
    let survival = (least_depth - deepest).min(0.0).exp();
    let sum: f64 = (0..combs.len())
        .map(|pivot| {
            let p = combs[pivot].depth;
            let others = combs.iter().enumerate().filter(|&(i, _)| i != pivot);
            let differences = others.map(|(_, comb)| p - comb.depth);
            (-control - p).exp() * series(differences, order)
        })
        .sum();
    #[expect(clippy::cast_possible_truncation, reason = "near [0, 1]")]
    let estimate = (sum / combs.len() as f64 / survival) as f32;
    estimate
}

/// Returns the probability to go from order `k` to the next.
fn continuation(k: usize) -> f32 {
    if k == 0 {
        LEAST_ORDER
    } else {
        (2.0 / (k + 1) as f32).min(1.0)
    }
}

/// Draws the order at which the series ends.
fn draw_order(stream: &mut Stream) -> usize {
    let mut order = 0;
    while stream.uniform() < continuation(order) {
        order += 1;
    }
    order
}

/// Returns `Σ_k e_k / (k! P(N ≥ k))` of as many differences as the order.
fn series(differences: impl Iterator<Item = f64>, order: usize) -> f64 {
    if order == 0 {
        return 1.0;
    }
    // The mean of all products of k of the differences so far.
    let mut means = vec![0.0; order + 1];
    means[0] = 1.0;
    for (i, difference) in differences.enumerate() {
        for k in (1..=i + 1).rev() {
            let share = k as f64 / (i + 1) as f64;
            means[k] += share * (means[k - 1] * difference - means[k]);
        }
    }
    let mut weight = 1.0;
    let terms = means.iter().enumerate().map(|(k, mean)| {
        let term = mean * weight;
        weight /= (k + 1) as f64 * f64::from(continuation(k));
        term
    });
    terms.sum()
}

//! The next collision of three channels.
//!
//! With weights `β` and `a = sigma_t / rate`, a tentative collision is real with probability
//! `P = Σ β_c tint_c a / Σ β_c`, after which `β_c` is multiplied by `tint_c a / P`, else by
//! `(1 − tint_c a) / (1 − P)`. Either way `Σ β` stays what it was: no weight can grow beyond it,
//! however far the channels' extinctions are apart. It is the balance heuristic over flights that
//! follow one channel each, with all but the last decision already made `[Kutz2017]` `[Wilkie2014]`
//! `[Miller2019]`; following one channel alone and dividing by its probability gives weights of
//! `tint_c / tint_h` for each collision, without limit.
//!
//! Where the optical depth is known, in closed form or cell by cell, that heuristic is a mixture of
//! exponential distributions: a channel is drawn by `β`, and from it a depth `x`. With
//! `q_c = tint_c e^(−tint_c x)` for a collision, or `e^(−tint_c x)` for passing a depth of `x`, the
//! weight is multiplied by `q_c Σ β / Σ β q`. That is the limit of infinitely many tentative
//! collisions.

use std::ops::ControlFlow;

use super::super::collision::{Collision, Visitor, look_up, walk};
use super::super::distance::EXACT_COLLISIONS_PER_VOXEL;
use super::{Factor, Optics, attenuate, choose, settled_at, settled_depth, sum};
use crate::medium::{BoundSegment, MediumRay};
use crate::sampling::Stream;
use crate::spectrum::Rgb;

/// A flight whose weights decide what is real.
struct Flight<'n> {
    optics: Optics,
    weights: Rgb,
    accepted: Option<f64>,
    /// Rate above which a segment is settled cell by cell.
    exact_above: f64,
    /// All that weights are multiplied by, for who wants to know.
    factors: Option<&'n mut Vec<Factor>>,
}

impl Flight<'_> {
    fn multiply(&mut self, t: f64, factor: Rgb) {
        self.weights *= factor;
        if let Some(factors) = &mut self.factors {
            factors.push((t, factor));
        }
    }

    /// Flies through `depth` from `t0` on; returns the depth of a collision.
    fn settle(&mut self, t0: f64, depth: f32, stream: &mut Stream) -> Option<f32> {
        let tint = self.optics.tint;
        let total = sum(self.weights);
        let channel = choose(self.weights, total, stream);
        // A tint of zero flies on forever.
        let x = stream.exponential() / tint.0[channel];
        let met_at = (x < depth).then_some(x);
        let density = match met_at {
            Some(x) => attenuate(tint, x) * tint,
            None => attenuate(tint, depth),
        };
        // Not zero: the channel that was drawn has a density, of e^−44 at least.
        let scale = total / sum(self.weights * density).max(f32::MIN_POSITIVE);
        self.multiply(t0, density * scale);
        met_at
    }
}

impl Visitor for Flight<'_> {
    fn enter(
        &mut self,
        ray: &mut MediumRay<'_>,
        segment: &BoundSegment,
        _depth: &mut f32,
        stream: &mut Stream,
    ) -> ControlFlow<(), f32> {
        let rate = segment.sigma_maj * self.optics.rate;
        let Some(depth) = settled_depth(ray, segment, (rate, self.exact_above), &mut stream.counts)
        else {
            return ControlFlow::Continue(rate);
        };
        let Some(met_at) = self.settle(segment.t0, depth, stream) else {
            return ControlFlow::Continue(0.0);
        };
        self.accepted = Some(settled_at(ray, segment, met_at, &mut stream.counts));
        stream.counts.real_collisions += 1;
        ControlFlow::Break(())
    }

    fn collide(
        &mut self,
        ray: &mut MediumRay<'_>,
        segment: &BoundSegment,
        collision: &Collision,
        stream: &mut Stream,
    ) -> ControlFlow<()> {
        let Collision { t, rate } = *collision;
        let part = look_up(ray, segment, t, stream) / rate;
        let tint = self.optics.tint;
        // Not zero: a path without weight has ended.
        let probability = sum(self.weights * tint * part) / sum(self.weights);
        if stream.uniform_positive() <= probability {
            self.multiply(t, tint * (part / probability));
            self.accepted = Some(t);
            stream.counts.real_collisions += 1;
            return ControlFlow::Break(());
        }
        let scale = (1.0 - probability).recip();
        self.multiply(t, Rgb(tint.0.map(|tint| (1.0 - tint * part) * scale)));
        stream.counts.null_collisions += 1;
        ControlFlow::Continue(())
    }
}

/// Draws the world distance of the next collision, or leaves; `weights`, of which one is above
/// zero, become those of what has happened.
pub(super) fn sample(
    mut ray: MediumRay<'_>,
    optics: Optics,
    (weights, factors): (&mut Rgb, Option<&mut Vec<Factor>>),
    stream: &mut Stream,
) -> Option<f64> {
    let mut visitor = Flight {
        optics,
        weights: *weights,
        accepted: None,
        exact_above: EXACT_COLLISIONS_PER_VOXEL * ray.voxels_per_length(),
        factors,
    };
    walk(&mut ray, stream, &mut visitor);
    *weights = visitor.weights;
    visitor.accepted
}

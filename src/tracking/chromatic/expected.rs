//! Free flight by expectation of three channels: transmittances, and one collision for the rest.
//!
//! As `tracking::expected`, with two differences. One collision is chosen by the sum of its
//! channels' weights. And what is settled cell by cell is settled here rather than left to a
//! flight, which would be noise in a channel of no extinction.

use std::ops::ControlFlow;

use super::super::collision::{Collision, Visitor, look_up, walk};
use super::super::distance::EXACT_COLLISIONS_PER_VOXEL;
use super::{ChromaticFlight, Optics, attenuate, choose, settled_at, settled_depth, sum};
use crate::medium::{BoundSegment, MediumRay};
use crate::sampling::Stream;
use crate::spectrum::Rgb;

/// The walk, and one of its collisions so far.
struct Expected {
    optics: Optics,
    /// Probability, in each channel, of having met nothing.
    weights: Rgb,
    analog_below: f32,
    /// Rate above which a segment is settled cell by cell.
    exact_above: f64,
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

    /// Passes through `depth`; returns the depth of a collision in it, and its weights.
    ///
    /// The depth is drawn from the mixture of the channels' exponentials, each in proportion to
    /// what it loses there; the weights over the mixture's density are bounded by the losses' sum.
    fn cross(&mut self, depth: f32, stream: &mut Stream) -> Option<(f32, Rgb)> {
        let tint = self.optics.tint;
        let lost = Rgb(std::array::from_fn(|c| {
            self.weights.0[c] * -(-tint.0[c] * depth).exp_m1()
        }));
        let before = self.weights;
        self.weights *= attenuate(tint, depth);
        let total = sum(lost);
        // Zero: nothing is met.
        if total <= 0.0 {
            return None;
        }
        let tint_met = tint.0[choose(lost, total, stream)];
        let p = -(-tint_met * depth).exp_m1();
        let u = stream.uniform_positive();
        let x = if p < 0.5 {
            -(-u * p).ln_1p()
        } else {
            -((-tint_met * depth).exp() + u * p).ln()
        };
        // Not zero: the channel that was drawn has lost something.
        let met_at = (x.max(0.0) / tint_met).min(depth);
        let density = before * tint * attenuate(tint, met_at);
        // Nor is its density.
        Some((met_at, density * (total / sum(density))))
    }
}

impl Visitor for Expected {
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
        if let Some((met_at, weights)) = self.cross(depth, stream) {
            let t = settled_at(ray, segment, met_at, &mut stream.counts);
            self.meet(t, weights, stream);
        }
        self.goes_on(segment.t1)?;
        ControlFlow::Continue(0.0)
    }

    fn collide(
        &mut self,
        ray: &mut MediumRay<'_>,
        segment: &BoundSegment,
        collision: &Collision,
        stream: &mut Stream,
    ) -> ControlFlow<()> {
        let Collision { t, rate } = *collision;
        let sigma_t = look_up(ray, segment, t, stream);
        // Zero: as empty as it looks.
        if sigma_t > 0.0 {
            let w = self.weights * self.optics.tint * (sigma_t / rate);
            self.meet(t, w, stream);
            self.weights = Rgb(std::array::from_fn(|c| self.weights.0[c] - w.0[c]));
            self.goes_on(t)?;
        }
        ControlFlow::Continue(())
    }
}

/// Returns the transmittances of the whole ray, estimated, and a collision that stands for the rest.
///
/// What is left below a mean of `analog_below` goes on as a flight, from a distance on: `rest` draws
/// where it collides, further on, and changes its weights.
pub(super) fn flight(
    mut ray: MediumRay<'_>,
    optics: Optics,
    (analog_below, rest): (f32, impl FnOnce(f64, &mut Rgb, &mut Stream) -> Option<f64>),
    stream: &mut Stream,
) -> ChromaticFlight {
    let mut visitor = Expected {
        optics,
        weights: Rgb::WHITE,
        analog_below,
        exact_above: EXACT_COLLISIONS_PER_VOXEL * ray.voxels_per_length(),
        rest_from: None,
        met: 0.0,
        chosen: None,
    };
    walk(&mut ray, stream, &mut visitor);
    // Zero: no rest is left.
    if let Some(t) = visitor.rest_from.filter(|_| sum(visitor.weights) > 0.0)
        && let Some(further) = rest(t, &mut visitor.weights, stream)
    {
        let weights = visitor.weights;
        visitor.meet(t + further, weights, stream);
        visitor.weights = Rgb::BLACK;
    }
    ChromaticFlight {
        transmittance: visitor.weights,
        collision: visitor.chosen.map(|(t, w)| (t, w * visitor.met)),
    }
}

//! Free flight by expectation: how much of a ray's light gets through, and one collision that
//! stands for the rest.
//!
//! A tentative collision of delta tracking is real with probability `p = sigma_t / rate`. Here the
//! walk does not end at one: with `W` the probability of having come so far, the collision takes
//! the weight `W p` and `W (1 − p)` goes on. What is left at the end is the ratio-tracking estimate
//! of the transmittance, and the weights of the collisions are exactly the rest. One of them is
//! kept with probability proportional to its weight, so it stands for `1 − T`.
//!
//! Given the walk, this is the expectation of delta tracking over its accept-or-reject decisions:
//! it has the same mean and no more variance, for any use of the collision and of the escape.
//!
//! * Cost: the lookups of a ray that meets nothing, where delta tracking ends at the first
//!   collision. Where the medium is thick they would buy nothing, so below a weight that the caller
//!   names what is left goes on as one ray of the distance estimator: the memory of a free flight is
//!   none, so that is exact. At 1 all is delta tracking.
//! * When to use it: for rays whose escape and collision are worth something different and whose
//!   path costs more than some lookups: camera rays through thin media. Not for thick media, and
//!   not deep in a path.
//!
//! Segments where collisions would be too dense are left to the distance estimator as well.
//!
//! # Reference
//! The weights are those of ratio tracking `[Novak2014]`.

use std::ops::ControlFlow;

use super::collision::{Collision, Visitor, look_up, optical_depth, walk};
use super::distance::EXACT_COLLISIONS_PER_VOXEL;
use crate::medium::{BoundSegment, MediumRay};
use crate::sampling::{Number, Stream};

/// What becomes of a ray, by expectation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ExpectedFlight {
    /// Unbiased estimate of the transmittance, in [0, 1].
    pub transmittance: f32,
    /// World distance of a collision that stands for all, with the weight `1 − transmittance`;
    /// `None` if that is zero.
    pub collision: Option<f64>,
}

/// How the expectation is taken.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ExpectedChoice {
    /// Tentative collisions for each unit of the majorant, at least 1.
    pub rate: f32,
    /// Weight, in [0, 1], below which the rest is left to the distance estimator.
    pub analog_below: f32,
    /// Chooses the collision: uniform in [0, 1).
    pub number: f32,
}

/// The walk, and one of its collisions so far.
pub(super) struct Expected {
    /// Tentative collisions for each unit of the majorant.
    pub(super) rate: f32,
    /// Weight below which the rest is left to the distance estimator.
    pub(super) analog_below: f32,
    /// Rate above which a segment is.
    pub(super) exact_above: f64,
    /// Probability of having met nothing.
    pub(super) weight: f32,
    /// Sum of the weights of the collisions so far.
    pub(super) met: f32,
    pub(super) chosen: Option<f64>,
    /// A uniform number: what choices have left of it is one again.
    pub(super) number: f32,
    /// Where the distance estimator takes over.
    pub(super) rest_from: Option<f64>,
    /// Depths that have been drawn.
    pub(super) depth_count: usize,
}

/// The first depths have numbers of their own: with them and that of the first scattered flight, the
/// relMSE of 16 samples of a smoke's image is 18 % less.
const DEPTHS: [Number; 3] = [Number::FirstDepth, Number::SecondDepth, Number::ThirdDepth];

impl Expected {
    /// Takes a collision of weight `w` at `t`.
    #[inline] // bench: frame
    pub(super) fn meet(&mut self, t: f64, w: f32) {
        self.met += w;
        let left = self.number * self.met;
        // Zero: nothing is there, and no number is below.
        if left < w {
            self.chosen = Some(t);
            self.number = left / w;
        } else if w > 0.0 {
            // Not zero: `left` is at least `w`, and below `met` or rounded to it.
            let others = self.met - w;
            self.number = if others > 0.0 {
                ((left - w) / others).min(1.0)
            } else {
                0.0
            };
        }
    }

    /// Moves weight `w` to a collision at `t`; breaks at `next` if too little is left.
    #[inline] // bench: frame
    fn take(&mut self, t: f64, w: f32, next: f64) -> ControlFlow<()> {
        self.meet(t, w);
        self.weight -= w;
        if self.weight <= self.analog_below {
            self.rest_from = Some(next);
            return ControlFlow::Break(());
        }
        ControlFlow::Continue(())
    }

    /// Walks `ray` to its end, or to where the distance estimator takes over.
    #[inline] // bench: frame
    pub(super) fn walk(&mut self, mut ray: MediumRay<'_>, stream: &mut Stream) {
        self.exact_above = EXACT_COLLISIONS_PER_VOXEL * ray.voxels_per_length();
        walk(&mut ray, stream, self);
    }
}

impl Visitor for Expected {
    #[inline] // bench: frame
    fn depth(&mut self, stream: &mut Stream) -> f32 {
        let Some(&number) = DEPTHS.get(self.depth_count) else {
            return stream.exponential();
        };
        self.depth_count += 1;
        stream.exponential_of(number)
    }

    #[inline] // bench: frame
    fn enter(
        &mut self,
        _ray: &mut MediumRay<'_>,
        segment: &BoundSegment,
        _depth: &mut f32,
        stream: &mut Stream,
    ) -> ControlFlow<(), f32> {
        let BoundSegment {
            t0, t1, sigma_maj, ..
        } = *segment;
        if segment.is_homogeneous() {
            let depth = optical_depth(sigma_maj, t1 - t0);
            let p = -(-depth).exp_m1();
            let w = self.weight * p;
            // Where in the segment: the exponential distribution, cut off at its end. The number
            // is precise near 0, which is the near end of thin segments and the far end of thick
            // ones.
            let u = stream.uniform_positive();
            let met_at = if p < 0.5 {
                -(-u * p).ln_1p()
            } else {
                -((-depth).exp() + u * p).ln()
            };
            let t = t0 + f64::from(met_at.max(0.0) / sigma_maj);
            self.take(t.min(t1), w, t1)?;
            return ControlFlow::Continue(0.0);
        }
        let rate = sigma_maj * self.rate;
        if f64::from(rate) > self.exact_above {
            self.rest_from = Some(t0);
            return ControlFlow::Break(());
        }
        ControlFlow::Continue(rate)
    }

    #[inline] // bench: frame
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
            return self.take(t, self.weight * (sigma_t / rate), t);
        }
        ControlFlow::Continue(())
    }
}

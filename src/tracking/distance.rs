//! Free flight: the distance to the next real collision.
//!
//! All estimators here draw from the same distribution, of density `sigma_t(t) · T(t)`, exactly;
//! the probability of leaving is the transmittance of the whole ray. They differ in cost alone,
//! so there is one visitor, with two switches decided for each segment:
//!
//! | estimator | in a heterogeneous segment | expected cost |
//! |---|---|---|
//! | delta tracking `[Woodcock1965]` `[Raab2006]` | a tentative collision is real with probability `sigma_t / sigma_maj` | a lookup for each of `∫ rate · T dt` collisions |
//! | decomposition `[Kutz2017]` | the segment's minimum collides without a lookup, the rest by delta tracking | saves the share `sigma_min / sigma_maj` of the lookups |
//! | regular tracking | the optical depth is added up cell by cell, and the cubic in which it runs out is inverted | eight values and 60 operations for each voxel cell |
//!
//! Where a segment is homogeneous, all of them take the closed form: every collision at its own
//! extinction is real.
//!
//! * *Delta*: needs the least of a voxel. Not for a bound far above the extinction, as one spike
//!   of 1e9 in a brick of 1: 1e9 null collisions.
//! * *Decomposition*: free where the minimum is zero. Drawing the control component by itself
//!   and the residual by delta tracking, as published, and taking the nearer gives the same
//!   distribution and the same number of lookups as one stream of collisions that is thinned in
//!   two steps; that is what runs.
//! * *Regular*: a fixed number of steps, whatever the extinction. Not for thin media with many
//!   voxels along a ray: it pays for each voxel whether or not light meets anything.
//! * *Auto*: decomposition, but regular tracking in each segment where collisions would be closer
//!   together than [`EXACT_COLLISIONS_PER_VOXEL`] to a voxel. That bounds the number of steps of
//!   a ray by the number of voxels along it, whatever the file says.
//!
//! The lookup may be an unbiased estimate bounded by the majorant, since the probability to
//! accept is linear in it.

use std::ops::ControlFlow;

use super::collision::{Collision, Visitor, reaches, walk_from};
use crate::medium::{BoundSegment, MediumRay};
use crate::sampling::Stream;

/// Tentative collisions for each voxel cell above which integrating the cell exactly is cheaper.
pub const EXACT_COLLISIONS_PER_VOXEL: f64 = 16.0;

/// What the distance estimators share, and where they differ.
#[derive(Clone, Copy, Debug)]
pub(super) struct FreeFlight {
    /// Tentative collisions for each unit of the majorant, at least 1.
    pub(super) rate: f32,
    /// Whether the segment's minimum collides without a lookup.
    pub(super) decompose: bool,
    /// Tentative collisions for each voxel cell above which a segment is tracked regularly: 0
    /// always, infinity never.
    pub(super) exact_above: f64,
}

struct Flight {
    rate: f32,
    decompose: bool,
    /// The extinction that is the limit between collisions and regular tracking.
    exact_above: f64,
    accepted: Option<f64>,
}

impl Visitor for Flight {
    #[inline] // bench: frame
    fn enter(
        &mut self,
        ray: &mut MediumRay<'_>,
        segment: &BoundSegment,
        depth: &mut f32,
        stream: &mut Stream,
    ) -> ControlFlow<(), f32> {
        if segment.is_homogeneous() {
            return ControlFlow::Continue(segment.sigma_maj);
        }
        let rate = segment.sigma_maj * self.rate;
        if f64::from(rate) <= self.exact_above {
            return ControlFlow::Continue(rate);
        }
        // What is left of an exponential number is one: here it is an optical depth.
        let mut left = f64::from(*depth);
        self.accepted = ray.reach_depth(&mut left, &mut stream.counts);
        if self.accepted.is_some() {
            stream.counts.real_collisions += 1;
            return ControlFlow::Break(());
        }
        #[expect(clippy::cast_possible_truncation, reason = "as precise as it came")]
        {
            *depth = left as f32;
        }
        ControlFlow::Continue(0.0)
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
        // A homogeneous segment collides at its own extinction, and always: the uniform number
        // is at most 1. It is precise near 0, where a spike elsewhere in the brick puts the rare
        // real collision: 24 bits would accept one in 17 million at least.
        let threshold = stream.uniform_positive() * rate;
        let known = self.decompose || segment.is_homogeneous();
        if (known && threshold <= segment.sigma_min)
            || reaches(ray, segment, (t, threshold), stream)
        {
            self.accepted = Some(t);
            stream.counts.real_collisions += 1;
            return ControlFlow::Break(());
        }
        stream.counts.null_collisions += 1;
        ControlFlow::Continue(())
    }
}

impl FreeFlight {
    /// Draws the world distance of the next collision; `None` if the ray leaves the medium.
    /// `depth` is an exponential number, to be used up by the first tentative collision.
    #[inline] // bench: frame
    pub(super) fn sample(
        self,
        depth: f32,
        ray: &mut MediumRay<'_>,
        stream: &mut Stream,
    ) -> Option<f64> {
        let mut visitor = Flight {
            rate: self.rate,
            decompose: self.decompose,
            exact_above: self.exact_above * ray.voxels_per_length(),
            accepted: None,
        };
        walk_from(depth, ray, stream, &mut visitor);
        visitor.accepted
    }
}

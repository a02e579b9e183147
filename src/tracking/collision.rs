//! The free-flight loop: tentative collisions along a ray, at a rate for each segment.
//!
//! The distance to the next tentative collision is an exponential number, drawn as an optical
//! depth `[Woodcock1965]`; crossing from one segment to the next uses it up at the segment's own
//! rate. That is exact, since the exponential distribution has no memory, and it saves drawing
//! anew at each border.
//!
//! This is the only place that draws free flights. At which rate, and what a collision means, is
//! the visitor's: delta tracking collides at the majorant and accepts or rejects, ratio tracking
//! weighs, decomposition accepts some without looking, exact methods settle a segment without
//! collisions. Bound and rate are two numbers.

use std::ops::ControlFlow;

use crate::medium::{BoundSegment, MediumRay};
use crate::sampling::Stream;
use crate::stats::Counts;

/// A tentative collision.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Collision {
    /// World distance.
    pub t: f64,
    /// The rate at which collisions are drawn here. Never zero.
    pub rate: f32,
}

/// What an estimator does along the way.
pub trait Visitor {
    /// Draws the optical depth to the next tentative collision, an exponential number of mean 1.
    #[inline] // bench: frame
    fn depth(&mut self, stream: &mut Stream) -> f32 {
        stream.exponential()
    }

    /// Enters a segment and returns the rate at which to draw collisions in it.
    ///
    /// A visitor that settles the segment by itself, in closed form or cell by cell, returns 0.
    /// It may use up some of `depth`, the exponential number that is left, as an optical depth
    /// of its own; or break, to end the walk.
    fn enter(
        &mut self,
        ray: &mut MediumRay<'_>,
        segment: &BoundSegment,
        depth: &mut f32,
        stream: &mut Stream,
    ) -> ControlFlow<(), f32>;

    /// Takes a collision in the segment entered last; breaks to end the walk.
    fn collide(
        &mut self,
        ray: &mut MediumRay<'_>,
        segment: &BoundSegment,
        collision: &Collision,
        stream: &mut Stream,
    ) -> ControlFlow<()>;
}

/// Visits the tentative collisions of a ray in order until the visitor breaks or the ray ends.
///
/// # Cost
/// One exponential number for each collision, and one step of the walk for each segment. The
/// expected number of collisions is the integral of the rate.
#[inline] // bench: frame
pub fn walk<V: Visitor>(ray: &mut MediumRay<'_>, stream: &mut Stream, visitor: &mut V) {
    let depth = visitor.depth(stream);
    walk_from(depth, ray, stream, visitor);
}

/// As [`walk`], where `depth` is the optical depth, at the segments' rates, to the first collision.
#[inline] // bench: frame
pub(super) fn walk_from<V: Visitor>(
    mut depth: f32,
    ray: &mut MediumRay<'_>,
    stream: &mut Stream,
    visitor: &mut V,
) {
    while let Some(segment) = ray.next_segment() {
        stream.counts.segments += 1;
        let ControlFlow::Continue(rate) = visitor.enter(ray, &segment, &mut depth, stream) else {
            return;
        };
        let mut t = segment.t0;
        loop {
            let left = optical_depth(rate, segment.t1 - t);
            if depth >= left {
                depth -= left;
                break;
            }
            // Rounding may carry the sum past the end, where another bound holds.
            t = (t + f64::from(depth / rate)).min(segment.t1);
            stream.counts.tentative_collisions += 1;
            let collision = Collision { t, rate };
            if visitor
                .collide(ray, &segment, &collision, stream)
                .is_break()
            {
                return;
            }
            depth = visitor.depth(stream);
        }
    }
}

/// Looks up the extinction at a collision: an unbiased estimate between the segment's bounds,
/// linear in the voxels' values.
#[inline] // bench: frame
pub(super) fn look_up(
    ray: &mut MediumRay<'_>,
    segment: &BoundSegment,
    t: f64,
    stream: &mut Stream,
) -> f32 {
    let sigma_t = ray.estimate_sigma_t(t, stream.bits());
    looked_up(sigma_t, segment, &mut stream.counts)
}

/// Returns whether what [`look_up`] returns is `threshold` or more; looks only where the bounds of
/// the voxel's own cell leave that open.
#[inline] // bench: frame
pub(super) fn reaches(
    ray: &mut MediumRay<'_>,
    segment: &BoundSegment,
    (t, threshold): (f64, f32),
    stream: &mut Stream,
) -> bool {
    match ray.decide_by_sigma_t(t, stream.bits(), |sigma_t| threshold <= sigma_t) {
        ControlFlow::Break(accepted) => accepted,
        ControlFlow::Continue(sigma_t) => {
            threshold <= looked_up(sigma_t, segment, &mut stream.counts)
        }
    }
}

/// Counts a lookup, and a value that is not within its bounds.
#[inline] // bench: frame
fn looked_up(sigma_t: f32, segment: &BoundSegment, counts: &mut Counts) -> f32 {
    counts.lookups += 1;
    let BoundSegment {
        sigma_min,
        sigma_maj,
        ..
    } = *segment;
    debug_assert!(
        (sigma_min..=sigma_maj).contains(&sigma_t),
        "extinction {sigma_t} outside of its bounds [{sigma_min}, {sigma_maj}]"
    );
    // A branch that is never taken: a sum of comparisons is as many instructions as all other
    // counters together.
    if sigma_t > sigma_maj || sigma_t < sigma_min {
        count_violation(counts);
    }
    sigma_t
}

/// Not inlined: past a call that may change them, counters are not held in registers, of which the
/// loops have too few. That saves 1.2 % of a cloud's instructions.
#[cold]
#[inline(never)]
fn count_violation(counts: &mut Counts) {
    counts.bound_violations += 1;
}

/// Returns the optical depth of `length` at a constant extinction.
#[expect(
    clippy::cast_possible_truncation,
    reason = "relative precision is what matters"
)]
#[inline] // bench: frame
pub(super) fn optical_depth(sigma: f32, length: f64) -> f32 {
    // In f64: an extinction of 1e-30 over 1e40 units is a depth of 1e10, not of infinity.
    (f64::from(sigma) * length) as f32
}

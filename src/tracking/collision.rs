//! The free-flight loop: tentative collisions at the majorant rate along a ray.
//!
//! Null matter of extinction `sigma_n = sigma_maj − sigma_t` is added in thought, so that the
//! total is constant on each segment and a free path is an exponential number `[Woodcock1965]`.
//! The number is an optical depth; crossing from one segment to the next uses it up at the
//! segment's own rate. That is exact, since the exponential distribution has no memory, and it
//! saves drawing anew at each border. A segment whose extinction is constant needs no null
//! matter and no lookup: there the visitor may use the closed form.
//!
//! This is the only place that draws free flights. What a collision means is the visitor's.

use std::ops::ControlFlow;

use crate::medium::{BoundSegment, MediumRay};
use crate::sampling::Stream;
use crate::stats::Counts;

/// A tentative collision.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Collision {
    /// World distance.
    pub t: f64,
    /// Unbiased estimate of the extinction there, at most `sigma_maj`.
    pub sigma_t: f32,
    /// The majorant: the rate at which collisions were drawn. Never zero.
    pub sigma_maj: f32,
}

/// What an estimator does along the way.
pub trait Visitor {
    /// Decides a homogeneous segment in closed form, without collisions, if it returns `true`.
    fn cross(&mut self, segment: &BoundSegment) -> bool;

    /// Takes a collision; breaks to end the walk.
    fn collide(
        &mut self,
        collision: &Collision,
        stream: &mut Stream,
        counts: &mut Counts,
    ) -> ControlFlow<()>;
}

/// Visits the tentative collisions of a ray in order until the visitor breaks or the ray ends.
///
/// # Cost
/// One exponential number and one voxel for each collision, and one step of the walk for each
/// cell. The expected number of collisions is the integral of the majorant.
#[inline] // bench: frame
pub fn walk<V: Visitor>(
    ray: &mut MediumRay<'_>,
    stream: &mut Stream,
    counts: &mut Counts,
    visitor: &mut V,
) {
    // Optical depth, at the majorant rate, to the next collision.
    let mut depth = stream.exponential();
    while let Some(segment) = ray.next_segment() {
        counts.segments += 1;
        let homogeneous = segment.is_homogeneous();
        if homogeneous && visitor.cross(&segment) {
            continue;
        }
        // Not zero: the walk leaves out segments whose bound is.
        let sigma_maj = segment.sigma_maj;
        let mut t = segment.t0;
        loop {
            let left = optical_depth(sigma_maj, segment.t1 - t);
            if depth >= left {
                depth -= left;
                break;
            }
            // Rounding may carry the sum past the end, where another bound holds.
            t = (t + f64::from(depth / sigma_maj)).min(segment.t1);
            depth = stream.exponential();
            counts.tentative_collisions += 1;
            let sigma_t = if homogeneous {
                sigma_maj
            } else {
                counts.lookups += 1;
                ray.estimate_sigma_t(t, stream.bits())
            };
            debug_assert!(
                sigma_t <= sigma_maj,
                "extinction {sigma_t} above bound {sigma_maj}"
            );
            counts.bound_violations += u64::from(sigma_t > sigma_maj);
            let collision = Collision {
                t,
                sigma_t,
                sigma_maj,
            };
            if visitor.collide(&collision, stream, counts).is_break() {
                return;
            }
        }
    }
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

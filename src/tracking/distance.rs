//! Delta tracking: the distance to the next real collision.
//!
//! A tentative collision is real with probability `sigma_t / sigma_maj`; otherwise the walk goes
//! on. The accepted distance has the density `sigma_t(t) · T(t)` exactly, for any bound that is
//! nowhere below the extinction `[Woodcock1965]`, `[Raab2006]`. A looser bound costs collisions,
//! never correctness. The extinction may be an unbiased estimate bounded by the majorant: the
//! probability to accept is linear in it.
//!
//! Homogeneous segments accept every collision, which is the closed form.

use std::ops::ControlFlow;

use super::collision::{Collision, Visitor, walk};
use crate::medium::{BoundSegment, MediumRay};
use crate::sampling::Stream;
use crate::stats::Counts;

struct Delta {
    accepted: Option<f64>,
}

impl Visitor for Delta {
    #[inline] // bench: frame
    fn cross(&mut self, _segment: &BoundSegment) -> bool {
        false
    }

    #[inline] // bench: frame
    fn collide(
        &mut self,
        collision: &Collision,
        stream: &mut Stream,
        counts: &mut Counts,
    ) -> ControlFlow<()> {
        let Collision {
            t,
            sigma_t,
            sigma_maj,
        } = *collision;
        // A homogeneous segment always accepts: the uniform number is below 1.
        if stream.uniform() * sigma_maj < sigma_t {
            self.accepted = Some(t);
            counts.real_collisions += 1;
            return ControlFlow::Break(());
        }
        counts.null_collisions += 1;
        ControlFlow::Continue(())
    }
}

/// Draws the world distance of the next collision; `None` if the ray leaves the medium.
///
/// The probability of `None` is the transmittance of the whole ray.
#[inline] // bench: frame
pub fn sample_collision(
    mut ray: MediumRay<'_>,
    stream: &mut Stream,
    counts: &mut Counts,
) -> Option<f64> {
    let mut visitor = Delta { accepted: None };
    walk(&mut ray, stream, counts, &mut visitor);
    visitor.accepted
}

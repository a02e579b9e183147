//! Ratio tracking: an unbiased estimate of the transmittance of a ray.
//!
//! Instead of deciding each tentative collision, the weight takes the probability of a null
//! collision, `1 − sigma_t / sigma_maj` `[Novak2014]`. Its expectation is `exp(−∫ sigma_t dt)`,
//! its variance `T² (exp(∫ E[sigma_t²] / sigma_maj dt) − 1)`: smaller for a looser bound, which
//! costs more collisions. `E[sigma_t²]` is the mean square of the estimate at a point: that of
//! one tap exceeds the square of the trilinear value where neighbouring voxels differ. Homogeneous segments take the closed form `exp(−sigma_t · length)`
//! and add no variance.
//!
//! Below a weight that the caller names, Russian roulette ends most walks: deep in a cloud the
//! remaining light is not worth the lookups. The estimate stays unbiased; none exceeds 1 or
//! that weight.

use std::ops::ControlFlow;

use super::collision::{Collision, Visitor, optical_depth, walk};
use crate::medium::{BoundSegment, MediumRay};
use crate::sampling::Stream;
use crate::stats::Counts;

struct Ratio {
    weight: f32,
    roulette_weight: f32,
}

impl Ratio {
    /// Plays roulette if the weight is low; sets it to zero and breaks if it is lost.
    #[inline] // bench: frame
    fn play_roulette(&mut self, stream: &mut Stream, counts: &mut Counts) -> ControlFlow<()> {
        if self.weight < self.roulette_weight {
            if stream.uniform() * self.roulette_weight >= self.weight {
                self.weight = 0.0;
                counts.roulette_kills += 1;
                return ControlFlow::Break(());
            }
            self.weight = self.roulette_weight;
        }
        ControlFlow::Continue(())
    }
}

impl Visitor for Ratio {
    #[inline] // bench: frame
    fn cross(&mut self, segment: &BoundSegment) -> bool {
        self.weight *= (-optical_depth(segment.sigma_min, segment.t1 - segment.t0)).exp();
        true
    }

    #[inline] // bench: frame
    fn collide(
        &mut self,
        collision: &Collision,
        stream: &mut Stream,
        counts: &mut Counts,
    ) -> ControlFlow<()> {
        // The bound is not zero: segments of bound zero have no collisions.
        self.weight *= 1.0 - collision.sigma_t / collision.sigma_maj;
        self.play_roulette(stream, counts)
    }
}

/// Returns an unbiased estimate of the transmittance of the whole ray.
///
/// Weights below `roulette_weight` are raised to it or dropped to zero, by their ratio: 0 turns
/// roulette off; 1 makes every estimate 0 or 1; above 1 most rays end before they start, for a
/// caller who knows how little a whole one would matter.
#[inline] // bench: frame
pub fn estimate_transmittance(
    mut ray: MediumRay<'_>,
    roulette_weight: f32,
    stream: &mut Stream,
    counts: &mut Counts,
) -> f32 {
    let mut visitor = Ratio {
        weight: 1.0,
        roulette_weight,
    };
    if visitor.play_roulette(stream, counts).is_continue() {
        walk(&mut ray, stream, counts, &mut visitor);
    }
    visitor.weight
}

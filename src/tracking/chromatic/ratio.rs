//! Transmittances of three channels: residual ratio tracking with a factor for each.
//!
//! As `transmittance`, whose control and whose limit of exact integration these are.

use std::ops::ControlFlow;

use super::super::collision::{Collision, Visitor, look_up, optical_depth, walk};
use super::super::transmittance::{EXACT_COLLISIONS_PER_VOXEL, residual};
use super::{Optics, attenuate, settled_depth};
use crate::medium::{BoundSegment, MediumRay};
use crate::sampling::Stream;
use crate::spectrum::Rgb;

struct Ratio {
    optics: Optics,
    weights: Rgb,
    roulette_weight: f32,
    /// Rate above which a segment is integrated exactly.
    exact_above: f64,
    /// Of the current segment.
    control: f32,
}

impl Ratio {
    /// Multiplies by factors that are not negative; plays roulette by the largest weight.
    fn take(&mut self, factors: Rgb, stream: &mut Stream) -> ControlFlow<()> {
        self.weights *= factors;
        let most = self.weights.max_channel();
        if most < self.roulette_weight {
            if stream.uniform() * self.roulette_weight >= most {
                self.weights = Rgb::BLACK;
                stream.counts.roulette_kills += 1;
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
    ) -> ControlFlow<(), f32> {
        let Optics { tint, rate } = self.optics;
        let (control, bound) = residual(segment);
        let rate = bound * rate;
        if let Some(depth) =
            settled_depth(ray, segment, (rate, self.exact_above), &mut stream.counts)
        {
            self.take(attenuate(tint, depth), stream)?;
            return ControlFlow::Continue(0.0);
        }
        self.control = control;
        // Zero: nothing to subtract.
        if control > 0.0 {
            let depth = optical_depth(control, segment.t1 - segment.t0);
            self.take(attenuate(tint, depth), stream)?;
        }
        ControlFlow::Continue(rate)
    }

    fn collide(
        &mut self,
        ray: &mut MediumRay<'_>,
        segment: &BoundSegment,
        collision: &Collision,
        stream: &mut Stream,
    ) -> ControlFlow<()> {
        let sigma_t = look_up(ray, segment, collision.t, stream);
        // Not negative: a tint is at most 1, and the rate at least sigma_maj − control.
        let part = (sigma_t - self.control) / collision.rate;
        let factors = Rgb(self.optics.tint.0.map(|tint| 1.0 - tint * part));
        self.take(factors, stream)
    }
}

/// Returns an unbiased estimate of the transmittance of the whole ray in each channel.
///
/// Where the largest is below `roulette_weight`, all are raised by what raises it to that, or lost.
pub(super) fn estimate(
    mut ray: MediumRay<'_>,
    optics: Optics,
    roulette_weight: f32,
    stream: &mut Stream,
) -> Rgb {
    let mut visitor = Ratio {
        optics,
        weights: Rgb::WHITE,
        roulette_weight,
        exact_above: EXACT_COLLISIONS_PER_VOXEL * ray.voxels_per_length(),
        control: 0.0,
    };
    if visitor.take(Rgb::WHITE, stream).is_continue() {
        walk(&mut ray, stream, &mut visitor);
    }
    visitor.weights
}

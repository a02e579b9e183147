//! Where a path goes on after scattering: usually, or towards what the media emit.
//!
//! A small fire lights a floor by its own smoke as well, and paths from the floor come to that smoke as
//! rarely as the fire is small. So some of them are sent there: a direction is drawn by the phase
//! function, or as `guide` does, or from the density of directions towards the emission (see
//! `emission::lattice`), and has the weight of the balance heuristic, `phase / Σ chance · density`.
//! What the guide makes of its share has the mean of the phase function, so any guide will do.
//!
//! The chance of going to an emission falls where there is nothing to gain: beside it, where paths come
//! to it anyway, and where other lights are brighter.
//!
//! A path that is sent somewhere weighs little, and is worth as much as any: roulette is played about
//! the weight without that of steering, which is therefore kept apart.

use glam::DVec3;

use super::emission::{Emitter, Emitters};
use crate::sampling::Stream;
use crate::space::Ray;

/// Chance of going to an emission that is small, far away and all the light there is.
///
/// On the comparison campfire, without regard for distance, at 0, 0.12, 0.25 and 0.5: relMSE · samples
/// 4.3 ± 2.2, 1.8 ± 1.0, 0.61 ± 0.07, 0.98 ± 0.33.
const MOST_CHANCE: f32 = 0.25;

/// Chance below which no path is sent: its share of the light costs more than it brings. At 0.01 and
/// 0.05, a fire that fills the view, with a sun, has 0.93 and 0.99 of the efficiency that it has without.
const LEAST_CHANCE: f32 = 0.05;

/// Most that a path is worth for having been sent: more would be infinite in the end.
const MOST_WORTH: f32 = 1e30;

/// How a path goes on after scattering.
#[derive(Clone, Copy, Debug)]
pub(super) struct Onward {
    /// Of propagation.
    pub(super) direction: DVec3,
    /// What the throughput is multiplied by.
    pub(super) weight: f32,
    /// What that is worth, up to the next event: 1 or more.
    pub(super) importance: f32,
}

impl Onward {
    /// Goes on by the phase function alone.
    #[inline] // bench: frame
    pub(super) fn usual(direction: DVec3) -> Self {
        Self {
            direction,
            weight: 1.0,
            importance: 1.0,
        }
    }
}

impl Emitters<'_> {
    /// Draws how a path goes on from `origin`, where `phase` is the density of scattering: as `usual`
    /// does, or towards one of these. What that is worth from here on, the inverse of the weight that
    /// it brings, is multiplied with `worth`.
    #[cold] // bench: frame
    pub(super) fn steer(
        &self,
        origin: DVec3,
        phase: impl Fn(DVec3) -> f32,
        usual: impl FnOnce(&mut Stream) -> Onward,
        worth: &mut f32,
        stream: &mut Stream,
    ) -> Onward {
        let total: f32 = self.other_radiance + self.sum(|e| e.radiance_at(origin));
        let chance =
            |e: &Emitter<'_>| MOST_CHANCE * e.remoteness(origin) * e.radiance_at(origin) / total;
        let sent = self.sum(chance);
        // NaN: no light at all.
        if !self.are_lights || sent.is_nan() || sent < LEAST_CHANCE {
            return usual(stream);
        }
        let onward = match self.pick(stream.uniform(), chance) {
            Some(emitter) => Onward::usual(emitter.emission.sample_towards(origin, stream)),
            None => usual(stream),
        };
        let direction = onward.direction;
        let ray = Ray { origin, direction };
        let phase = phase(direction);
        let towards = self.sum(|e| chance(e) * e.emission.pdf_towards(&ray));
        let mix = (1.0 - sent) * phase + towards;
        let weight = phase / mix;
        // Not finite, or zero, where nothing scatters: such a path ends.
        let weight = if weight.is_normal() { weight } else { 0.0 };
        *worth = (*worth / weight.max(f32::MIN_POSITIVE)).min(MOST_WORTH);
        Onward {
            weight: onward.weight * weight,
            ..onward
        }
    }
}

//! Which estimators, by the names that scene files and the command line use.

use std::fmt;

use glam::DVec3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::distance::{self, FreeFlight};
use super::expected::{Expected, ExpectedChoice, ExpectedFlight};
use super::power_series::power_series;
use super::survey::Survey;
use super::transmittance::{self, Attenuation, approx_ray_marching};
use crate::medium::{LOOKUP_COST, Medium, MediumRay, Segments};
use crate::sampling::Stream;
use crate::space::Ray;

/// An enum whose variants have the names that scene files and the command line use.
macro_rules! named {
    ($(#[$doc:meta])* $name:ident { $($(#[$variant_doc:meta])* $variant:ident = $text:literal,)* }) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize, JsonSchema)]
        pub enum $name {
            $($(#[$variant_doc])* #[serde(rename = $text)] $variant,)*
        }

        impl $name {
            /// All of them, in the order of the documentation.
            pub const ALL: &'static [Self] = &[$(Self::$variant),*];

            /// Returns its name in scene files and on the command line.
            pub fn name(self) -> &'static str {
                match self {
                    $(Self::$variant => $text,)*
                }
            }
        }

        impl fmt::Display for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str(self.name())
            }
        }
    };
}

named! {
    /// How the distance to the next collision is drawn. All draw from the same distribution.
    DistanceEstimator {
        /// Decomposition, and regular tracking in segments where it is cheaper.
        #[default]
        Auto = "auto",
        /// By inverting the exponential; for media that are homogeneous throughout.
        ClosedForm = "closed-form",
        /// By adding up the optical depth cell by cell.
        Regular = "regular",
        /// By tentative collisions, real with probability `sigma_t / sigma_maj`.
        Delta = "delta",
        /// As `Delta`, but the segment's minimum collides without a lookup.
        Decomposition = "decomposition",
    }
}

named! {
    /// How the transmittance of a ray is estimated.
    TransmittanceEstimator {
        /// Residual ratio tracking, and exact in segments where it is cheaper.
        #[default]
        Auto = "auto",
        /// By the exponential; for media that are homogeneous throughout.
        ClosedForm = "closed-form",
        /// By adding up the optical depth cell by cell: no variance.
        Exact = "exact",
        /// The product of the probabilities of null collisions.
        Ratio = "ratio",
        /// As `Ratio`, after a control has been taken out in closed form.
        ResidualRatio = "residual-ratio",
        /// The power series of the exponential about a sum over equidistant points.
        PowerSeries = "power-series",
        /// 1 where delta tracking meets nothing, else 0.
        Delta = "delta",
        /// BIAS: the exponential of a sum over equidistant points; the image is too bright.
        ApproxRayMarching = "approx-ray-marching",
    }
}

named! {
    /// Which bounds tracking uses. The tighter, the fewer null collisions and the more steps.
    BoundsKind {
        /// The hierarchy, or the whole where that is thin: see [`Tracking::fitted`].
        #[default]
        Auto = "auto",
        /// One bound for the whole volume.
        Global = "global",
        /// One bound for each brick of 8³ voxels.
        Brick = "brick",
        /// That of a brick, or of a block of up to 16³ bricks where they are empty or thin.
        Hierarchy = "hierarchy",
    }
}

/// Which estimators track rays, and their parameters.
///
/// The defaults are unbiased and right for almost every volume.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Tracking {
    /// How the distance to the next collision is drawn.
    pub distance: DistanceEstimator,
    /// How the transmittance of a ray is estimated.
    pub transmittance: TransmittanceEstimator,
    /// Which bounds they use.
    pub bounds: BoundsKind,
    /// Tentative collisions for each unit of the bound, 1 or more, of the transmittance: more
    /// lower its variance and cost lookups.
    pub rate: f32,
    /// The same of the distance, where more only cost.
    pub flight_rate: f32,
    /// Of `ApproxRayMarching`: length of a step, in voxels.
    pub march_step: f64,
}

impl Default for Tracking {
    fn default() -> Self {
        Self {
            distance: DistanceEstimator::default(),
            transmittance: TransmittanceEstimator::default(),
            bounds: BoundsKind::default(),
            rate: 1.0,
            flight_rate: 1.0,
            march_step: 1.0,
        }
    }
}

impl Tracking {
    /// Draws the world distance of the next collision from 0 to `t_max`; `None` if there is
    /// none, with the probability of the transmittance.
    ///
    /// # Cost
    /// See [`distance`].
    #[inline] // bench: frame
    pub fn sample_collision(
        &self,
        medium: &Medium,
        ray: &Ray,
        t_max: f64,
        stream: &mut Stream,
    ) -> Option<f64> {
        let mut ray = medium.ray_over(ray, t_max, self.flight_segments());
        let depth = stream.exponential();
        self.next_collision(&mut ray, depth, stream)
    }

    /// Prepares the flights of a path that starts with `ray`, the first of them up to `t_max`.
    #[inline] // bench: frame
    pub fn start_path<'a>(&self, medium: &'a Medium, ray: &Ray, t_max: f64) -> MediumRay<'a> {
        medium.ray_over(ray, t_max, self.flight_segments())
    }

    /// As [`sample_collision`](Self::sample_collision), on a walk that
    /// [`start_path`](Self::start_path) has made and that may have turned since. `depth` is an
    /// exponential number of mean 1, which decides on the first tentative collision.
    #[inline] // bench: frame
    pub fn next_collision(
        &self,
        ray: &mut MediumRay<'_>,
        depth: f32,
        stream: &mut Stream,
    ) -> Option<f64> {
        let (decompose, exact_above) = match self.distance {
            DistanceEstimator::Auto => (true, distance::EXACT_COLLISIONS_PER_VOXEL),
            DistanceEstimator::ClosedForm | DistanceEstimator::Regular => (true, 0.0),
            DistanceEstimator::Delta => (false, f64::INFINITY),
            DistanceEstimator::Decomposition => (true, f64::INFINITY),
        };
        let flight = FreeFlight {
            rate: self.flight_rate,
            decompose,
            exact_above,
        };
        flight.sample(depth, ray, stream)
    }

    /// Returns the transmittance of the whole ray, estimated, and a collision that stands for the
    /// rest, as `choice` says.
    ///
    /// What is left of the weight goes on by [`sample_collision`](Self::sample_collision). The first
    /// depths are those of `stream`'s sequence, if it has one: to be drawn once a path.
    ///
    /// # Cost
    /// See [`ExpectedFlight`].
    #[inline] // bench: frame
    pub fn expected_flight(
        &self,
        medium: &Medium,
        ray: &Ray,
        choice: ExpectedChoice,
        stream: &mut Stream,
    ) -> ExpectedFlight {
        let ExpectedChoice {
            rate,
            analog_below,
            number,
        } = choice;
        let mut walk = Expected {
            rate,
            analog_below,
            exact_above: f64::INFINITY,
            weight: 1.0,
            met: 0.0,
            chosen: None,
            number,
            rest_from: None,
            depth_count: 0,
        };
        let segments = self.start_path(medium, ray, f64::INFINITY);
        walk.walk(segments, stream);
        // Zero: no rest is left.
        if let Some(t) = walk.rest_from.filter(|_| walk.weight > 0.0) {
            let rest = Ray {
                origin: ray.at(t),
                ..*ray
            };
            let hit = self.sample_collision(medium, &rest, f64::INFINITY, stream);
            if let Some(further) = hit {
                walk.meet(t + further, walk.weight);
                walk.weight = 0.0;
            }
        }
        ExpectedFlight {
            transmittance: walk.weight,
            collision: walk.chosen,
        }
    }

    /// As [`estimate_transmittance`](Self::estimate_transmittance), from distance `t` in the
    /// current segment of a path's walk towards `direction`, a unit vector in world space, up to
    /// `t_max` from there.
    #[inline] // bench: frame
    pub fn transmittance_from(
        &self,
        (path, t): (&MediumRay<'_>, f64),
        (direction, t_max): (DVec3, f64),
        roulette_weight: f32,
        stream: &mut Stream,
    ) -> f32 {
        let tracks = !matches!(
            self.transmittance,
            TransmittanceEstimator::Delta
                | TransmittanceEstimator::PowerSeries
                | TransmittanceEstimator::ApproxRayMarching
        );
        if !tracks || self.flight_segments() != self.shadow_segments() {
            let medium = path.medium();
            let ray = Ray {
                origin: path.world_position(t),
                direction,
            };
            return self.estimate_transmittance(medium, &ray, t_max, roulette_weight, stream);
        }
        let mut ray = path.clone();
        ray.turn(t, direction, t_max);
        self.attenuation().estimate(ray, roulette_weight, stream)
    }

    /// Estimates the transmittance from 0 to `t_max`, unbiased unless ray marching is asked for.
    ///
    /// Weights below `roulette_weight` are raised to it or dropped to zero, by their ratio: 0
    /// turns roulette off; 1 makes every estimate 0 or 1; above 1 most rays end before they
    /// start, for a caller who knows how little a whole one would matter. Delta tracking and ray
    /// marching play none; the power series goes by what it has added up so far.
    ///
    /// # Cost
    /// See [`transmittance`].
    #[inline] // bench: frame
    pub fn estimate_transmittance(
        &self,
        medium: &Medium,
        ray: &Ray,
        t_max: f64,
        roulette_weight: f32,
        stream: &mut Stream,
    ) -> f32 {
        match self.transmittance {
            TransmittanceEstimator::Delta => {
                let delta = Self {
                    distance: DistanceEstimator::Delta,
                    ..*self
                };
                let hit = delta.sample_collision(medium, ray, t_max, stream);
                if hit.is_none() { 1.0 } else { 0.0 }
            }
            TransmittanceEstimator::PowerSeries => {
                let ray = medium.ray_over(ray, t_max, self.segments());
                power_series(ray, self.rate, roulette_weight, stream)
            }
            TransmittanceEstimator::ApproxRayMarching => {
                let ray = medium.ray(ray, t_max);
                approx_ray_marching(ray, self.march_step, stream)
            }
            _ => {
                let ray = medium.ray_over(ray, t_max, self.shadow_segments());
                self.attenuation().estimate(ray, roulette_weight, stream)
            }
        }
    }

    /// Returns what the tracking estimators of the transmittance do.
    #[inline] // bench: frame
    fn attenuation(&self) -> Attenuation {
        use TransmittanceEstimator as E;
        let (residual, exact_above) = match self.transmittance {
            E::ClosedForm | E::Exact => (false, 0.0),
            E::Ratio => (false, f64::INFINITY),
            E::ResidualRatio => (true, f64::INFINITY),
            _ => (true, transmittance::EXACT_COLLISIONS_PER_VOXEL),
        };
        Attenuation {
            rate: self.rate,
            residual,
            exact_above,
        }
    }

    /// Of flights: cell by cell, larger segments would hide empty bricks.
    #[inline] // bench: frame
    fn flight_segments(&self) -> Segments {
        match self.distance {
            DistanceEstimator::ClosedForm | DistanceEstimator::Regular => Segments::Bricks,
            _ => self.segments(),
        }
    }

    /// Of shadow rays that are tracked.
    #[inline] // bench: frame
    fn shadow_segments(&self) -> Segments {
        match self.transmittance {
            TransmittanceEstimator::ClosedForm | TransmittanceEstimator::Exact => Segments::Bricks,
            _ => self.segments(),
        }
    }

    fn segments(&self) -> Segments {
        match self.bounds {
            BoundsKind::Global => Segments::Whole,
            BoundsKind::Brick => Segments::Bricks,
            BoundsKind::Auto | BoundsKind::Hierarchy => Segments::Blocks,
        }
    }

    /// Returns these settings with what `auto` picks for a whole medium.
    ///
    /// * Bounds: one for all where that saves more steps of the walk than it adds lookups, which
    ///   cost four times as much; the hierarchy elsewhere. The Disney cloud at a mean depth of
    ///   0.13: 0.07 in place of 0.10 CPU s brick by brick.
    /// * Rate of the transmittance: raised to two where rays meet up to 1.25 collisions, which is worth
    ///   its cost, and by less up to 2.5.
    #[must_use]
    pub fn fitted(self, survey: &Survey) -> Self {
        let is_thin = LOOKUP_COST * survey.added_collisions < survey.saved_segments;
        let bounds = match self.bounds {
            BoundsKind::Auto if is_thin => BoundsKind::Global,
            BoundsKind::Auto => BoundsKind::Hierarchy,
            asked => asked,
        };
        let rate = match self.transmittance {
            // An empty medium has no collisions, and no use for a rate.
            TransmittanceEstimator::Auto => {
                self.rate * (THIN_COLLISIONS / survey.collisions_per_ray).clamp(1.0, MAX_AUTO_RATE)
            }
            _ => self.rate,
        };
        Self {
            bounds,
            rate,
            ..self
        }
    }
}

/// Largest rate that `auto` picks.
const MAX_AUTO_RATE: f32 = 2.0;

/// Collisions of a ray above which `auto` leaves the rate of transmittances at 1.
const THIN_COLLISIONS: f32 = 2.5;

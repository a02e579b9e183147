//! Estimators along one ray: where the next collision is, and how much light gets through.
//!
//! * [`collision`]: the one loop that draws free flights over bound segments.
//! * [`distance`]: closed form, delta, decomposition and regular tracking.
//! * `chromatic`: flights and transmittances of three channels at once.
//! * `expected`: the transmittance, and one collision that stands for the rest.
//! * [`transmittance`]: closed form, exact, ratio, residual ratio, delta, ray marching.
//! * `power_series`: the debiased exponential of a ray-marched optical depth.
//! * [`Tracking`]: which of them, by name; [`Survey`]: what `auto` makes of a medium.
//!
//! Every estimator is a visitor of the one loop. The bound (which segments a ray is cut into) and
//! the rate (how many collisions are drawn for each unit of it) are separate parameters of all of
//! them. No lights, camera or film here.

mod chromatic;
pub mod collision;
pub mod distance;
mod expected;
mod power_series;
mod settings;
mod survey;
pub mod transmittance;

pub use chromatic::{ChromaticFlight, Factor};
pub use expected::{ExpectedChoice, ExpectedFlight};
pub use settings::{BoundsKind, DistanceEstimator, Tracking, TransmittanceEstimator};
pub use survey::{BrickShares, Survey};

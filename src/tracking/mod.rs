//! Estimators along one ray: where the next collision is, and how much light gets through.
//!
//! * [`collision`]: the one loop that draws free flights over bound segments.
//! * [`distance`]: delta tracking, the distance to the next real collision.
//! * [`transmittance`]: ratio tracking, the fraction of light that passes.
//!
//! Both estimators are visitors of the one loop. No lights, camera or film here.

pub mod collision;
pub mod distance;
pub mod transmittance;

pub use distance::sample_collision;
pub use transmittance::estimate_transmittance;

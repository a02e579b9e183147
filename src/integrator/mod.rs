//! Estimators of the radiance along a camera ray.

use serde::{Deserialize, Serialize};

/// Which integrator renders.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum IntegratorKind {
    /// Next-event estimation, absorption as weight, Russian roulette: the production choice.
    #[default]
    Path,
    /// Plain delta tracking without light sampling: the short reference. Cannot see a sun of
    /// zero diameter.
    Analog,
}

/// What the image is, as far as light transport is concerned.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TransportSettings {
    /// Which integrator renders.
    pub integrator: IntegratorKind,
    /// Paths end after this many scattering events. `None`: never, by roulette only.
    ///
    /// BIAS: a cap darkens the image; it is off unless asked for.
    pub max_bounces: Option<u32>,
}

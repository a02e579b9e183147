//! All estimators by name, with every kind of bound.

use crate::medium::Segments;
use crate::tracking::{BoundsKind, DistanceEstimator, Tracking, TransmittanceEstimator};

/// Bounds to be tested; the automatic one is one of these.
const BOUNDS: [BoundsKind; 3] = [BoundsKind::Global, BoundsKind::Brick, BoundsKind::Hierarchy];

/// Tentative collisions for each unit of the bound, where the rate is not 1.
const HIGH_RATE: f32 = 2.5;

/// A way to track rays, and what to call it.
#[derive(Clone, Debug)]
pub(super) struct Estimator {
    pub(super) name: String,
    pub(super) tracking: Tracking,
}

/// All estimators of distances in media that are not homogeneous.
pub(super) fn distance_estimators() -> Vec<Estimator> {
    use DistanceEstimator as D;
    let mut all = Vec::new();
    for distance in [D::Delta, D::Decomposition, D::Auto] {
        let tracking = Tracking {
            distance,
            ..Tracking::default()
        };
        with_bounds(&mut all, distance.name(), tracking);
    }
    all.push(Estimator {
        name: D::Regular.name().to_owned(),
        tracking: Tracking {
            distance: D::Regular,
            ..Tracking::default()
        },
    });
    all
}

/// All unbiased estimators of transmittance in media that are not homogeneous.
pub(super) fn transmittance_estimators() -> Vec<Estimator> {
    use TransmittanceEstimator as E;
    let mut all = Vec::new();
    for transmittance in [E::Ratio, E::ResidualRatio, E::PowerSeries, E::Auto] {
        let tracking = Tracking {
            transmittance,
            ..Tracking::default()
        };
        with_bounds(&mut all, transmittance.name(), tracking);
    }
    // Exact has no bound, and delta tracking a variance that does not depend on it.
    for transmittance in [E::Delta, E::Exact] {
        all.push(Estimator {
            name: transmittance.name().to_owned(),
            tracking: Tracking {
                transmittance,
                ..Tracking::default()
            },
        });
    }
    all
}

/// Adds an estimator with each kind of bound, and once at a rate above its bound.
fn with_bounds(all: &mut Vec<Estimator>, name: &str, tracking: Tracking) {
    for bounds in BOUNDS {
        all.push(Estimator {
            name: format!("{name} {bounds}"),
            tracking: Tracking { bounds, ..tracking },
        });
    }
    all.push(Estimator {
        name: format!("{name} rate {HIGH_RATE}"),
        tracking: Tracking {
            bounds: BoundsKind::Brick,
            rate: HIGH_RATE,
            flight_rate: HIGH_RATE,
            ..tracking
        },
    });
}

/// The segments that an estimator of transmittance with these bounds cuts rays into.
pub(super) fn segments(bounds: BoundsKind) -> Segments {
    match bounds {
        BoundsKind::Global => Segments::Whole,
        BoundsKind::Auto | BoundsKind::Brick => Segments::Bricks,
        BoundsKind::Hierarchy => Segments::Blocks,
    }
}

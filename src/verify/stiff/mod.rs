//! The stiffness certificate: extreme numbers, one case for each thing that is known to go wrong.
//!
//! Each case ends in a bounded number of steps, with finite values, the right mean, and no value
//! above its bound. The table of hazards and cases is in `docs/numerics.md`.
//!
//! * `coefficients`: extinctions of all sizes, spikes, denormal numbers.
//! * `geometry`: cameras far away, rays along faces, stretched voxels, huge coordinates.
//! * `grids`: empty, tiny and constant grids, tiles of all levels, voxels that are no numbers.
//! * `sampling`: the ends of the uniform numbers, peaked phase functions, long paths, streams.

mod coefficients;
mod file;
mod geometry;
mod grids;
mod sampling;

use glam::DVec3;

use super::measure::{Measured, measure};
use super::row::Row;
use super::{Check, Rows};
use crate::medium::Medium;
use crate::space::Ray;
use crate::tracking::{DistanceEstimator, Tracking, TransmittanceEstimator};

pub(super) fn checks(out: &mut Vec<Check>) {
    coefficients::checks(out);
    geometry::checks(out);
    grids::checks(out);
    sampling::checks(out);
}

/// What `f32` costs a transmittance or a probability.
const ROUNDING: &str = "f32 extinction and weights";

fn exact() -> Tracking {
    Tracking {
        transmittance: TransmittanceEstimator::Exact,
        distance: DistanceEstimator::Regular,
        ..Tracking::default()
    }
}

/// One estimate of the transmittance by exact integration, which has no variance.
fn exact_transmittance(medium: &Medium, ray: &Ray) -> Measured<1> {
    measure(0, 1, |stream| {
        let end = f64::INFINITY;
        let t = exact().estimate_transmittance(medium, ray, end, 0.0, stream);
        [f64::from(t)]
    })
}

/// Adds rows for a ray whose optical depth is known: flights that escape, estimates by the
/// automatic choice, exact integration; each in at most `steps` steps.
fn along(rows: &mut Rows, medium: &Medium, ray: &Ray, tau: f64, n: u64, steps: u64) {
    let expected = (-tau).exp();
    let tracking = Tracking::default();
    let flights = measure(rows.seed(), n, |stream| {
        let flight = tracking.sample_collision(medium, ray, f64::INFINITY, stream);
        [f64::from(u8::from(flight.is_none()))]
    });
    let row = Row::fraction("escape", expected, &flights.moments[0], &flights.seen);
    rows.push(row.tolerance(1e-6, ROUNDING).steps_within(steps));
    let weights = measure(rows.seed(), n, |stream| {
        let end = f64::INFINITY;
        let t = tracking.estimate_transmittance(medium, ray, end, 0.0, stream);
        [f64::from(t)]
    });
    // Estimates lie in [0, 1], so their variance is at most that of 0 and 1; it has to do where
    // too few rays collide to measure it.
    let few = n as f64 * -(-tau).exp_m1() < 100.0;
    let row = if few { Row::fraction } else { Row::mean };
    let row = row("T", expected, &weights.moments[0], &weights.seen);
    rows.push(row.tolerance(1e-6, ROUNDING).steps_within(steps));
    let integrated = exact_transmittance(medium, ray);
    let (mean, seen) = (integrated.moments[0].mean(), &integrated.seen);
    let row = Row::exact("T, exact", expected, mean, seen);
    rows.push(row.tolerance(1e-6, ROUNDING).steps_within(steps));
}

/// Oblique to all axes.
const OBLIQUE: DVec3 = DVec3::new(0.48, 0.36, 0.8);

/// A ray through the middle of the suite's cloud and cube, 4 units long.
fn middle() -> Ray {
    Ray {
        origin: DVec3::new(0.1, 0.2, 0.1) - OBLIQUE * 2.0,
        direction: OBLIQUE,
    }
}

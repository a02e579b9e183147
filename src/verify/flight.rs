//! Free flight and transmittance of every estimator, along rays whose optical depth is known.
//!
//! The extinction along each ray is piecewise cubic and integrated by the suite itself. Distances
//! must have the distribution function 1 − exp(−τ); estimates of the transmittance the mean
//! exp(−τ) and the variance that theory gives the estimator.

use glam::{DVec3, IVec3};

use super::estimators::{Estimator, distance_estimators, segments, transmittance_estimators};
use super::measure::measure;
use super::row::{Group, Row};
use super::volumes::{self, Volume, box_of};
use super::{Check, Rows};
use crate::grid::{Tree, TreeBuilder};
use crate::medium::{BoundSegment, Medium};
use crate::sampling::Stream;
use crate::space::Ray;
use crate::tracking::{DistanceEstimator, Tracking, TransmittanceEstimator};

const BEER_LAMBERT: Group = Group {
    name: "Beer and Lambert",
    oracle: "exp(-tau)",
};

const FREE_FLIGHT: Group = Group {
    name: "free flight",
    oracle: "escape: exp(-tau); distances: chi-square of 64 cells equal in 1 - exp(-tau)",
};

const TRANSMITTANCE: Group = Group {
    name: "transmittance",
    oracle: "exp(-tau); variance T^2 (exp(integral of E[(s - c)^2] / M) - 1), T (1 - T), 0",
};

const MARCHING: Group = Group {
    name: "ray marching, biased",
    oracle: "the mean over the offset of exp(-sum), by quadrature",
};

const SPLIT: Group = Group {
    name: "split ray",
    oracle: "T of the whole is the product of the parts'",
};

/// A ray through a volume, from its start to `end`, in units of voxels.
struct Case {
    name: &'static str,
    volume: Volume,
    sigma_t: f32,
    ray: Ray,
    end: f64,
}

impl Case {
    fn tau(&self, end: f64) -> f64 {
        f64::from(self.sigma_t) * self.volume.column(&self.ray, (0.0, end))
    }

    /// The same at another optical depth.
    fn of_depth(mut self, tau: f64) -> Self {
        let column = self.volume.column(&self.ray, (0.0, self.end));
        #[expect(clippy::cast_possible_truncation, reason = "rounded before it is used")]
        let sigma_t = (tau / column) as f32;
        self.sigma_t = sigma_t;
        self
    }

    fn medium(&self) -> Medium {
        self.volume.attenuating(self.sigma_t)
    }
}

/// Of free flights: most collide, and enough escape to be counted.
const THICK: f64 = 2.5;
/// Of transmittances: in a thick medium the mean of ratio tracking rests on a handful of large
/// weights, and a test of it sees nothing.
const THIN: f64 = 1.2;

fn cases(tau: f64) -> [Case; 4] {
    let tilted = DVec3::new(0.8, 0.36, 0.48);
    let from = |x, y, z, direction| Ray {
        origin: DVec3::new(x, y, z),
        direction,
    };
    let unit = |tree| Volume::uniform(tree, 1.0);
    let step = |at: i32, low: f32, high: f32| move |p: IVec3| if p.x < at { low } else { high };
    [
        Case {
            name: "step",
            volume: unit(box_of(IVec3::ZERO, IVec3::new(16, 8, 8), step(8, 0.2, 1.0))),
            sigma_t: 1.0,
            ray: from(-6.0, 3.0, 4.75, DVec3::X),
            end: 40.0,
        },
        Case {
            name: "oblique step",
            volume: unit(box_of(IVec3::ZERO, IVec3::splat(16), step(5, 0.1, 0.8))),
            sigma_t: 1.0,
            ray: from(-6.0, 1.3, 0.7, tilted),
            end: 60.0,
        },
        Case {
            name: "ramp",
            volume: unit(box_of(IVec3::ZERO, IVec3::splat(24), |p| {
                (p.x + 2 * p.y) as f32 * 0.02
            })),
            sigma_t: 1.0,
            ray: from(26.0, 20.3, 22.9, -tilted),
            end: 80.0,
        },
        Case {
            name: "lone voxel",
            volume: unit(Tree::from_voxels(0.0, [(IVec3::splat(8), 6.0)])),
            sigma_t: 1.0,
            ray: Ray {
                origin: DVec3::splat(7.7) - tilted * 6.0,
                direction: tilted,
            },
            end: 20.0,
        },
    ]
    .map(|case| case.of_depth(tau))
}

pub(super) fn checks(out: &mut Vec<Check>) {
    for decade in -8..=8 {
        let name = format!("sigma_t 1e{decade}, tau 1");
        out.push(Check::new(&BEER_LAMBERT, name, move |rows| {
            one_decade(rows, decade);
        }));
    }
    out.push(Check::new(&BEER_LAMBERT, "17 decades", all_decades));
    out.push(Check::new(&BEER_LAMBERT, "homogeneous tile", homogeneous));
    for (index, case) in cases(1.0).iter().enumerate() {
        out.push(Check::new(&FREE_FLIGHT, case.name, move |rows| {
            for estimator in distance_estimators() {
                distances(rows, &cases(THICK)[index], &estimator);
            }
        }));
    }
    for (index, case) in cases(1.0).iter().enumerate() {
        out.push(Check::new(&TRANSMITTANCE, case.name, move |rows| {
            estimates(rows, &cases(THIN)[index]);
        }));
    }
    out.push(Check::new(&MARCHING, "lone voxel, step", marching));
    out.push(Check::new(&SPLIT, "ramp, in three parts", split));
}

/// The oblique step, scaled as a whole so that its optical depth stays 1.
fn scaled(decade: i32) -> Case {
    let [_, case, ..] = cases(1.0);
    let scale = 10.0_f64.powi(-decade);
    Case {
        volume: Volume::uniform(case.volume.tree().clone(), scale),
        ray: Ray {
            origin: case.ray.origin * scale,
            direction: case.ray.direction,
        },
        end: case.end * scale,
        ..case
    }
    .of_depth(1.0)
}

/// A ray and what it goes through.
struct Shot<'a> {
    medium: Medium,
    ray: &'a Ray,
}

impl<'a> Shot<'a> {
    fn new(case: &'a Case) -> Self {
        Self {
            medium: case.medium(),
            ray: &case.ray,
        }
    }

    fn flight(&self, by: &Tracking, stream: &mut Stream) -> Option<f64> {
        by.sample_collision(&self.medium, self.ray, f64::INFINITY, stream)
    }

    /// 1 for a flight that leaves.
    fn escapes(&self, by: &Tracking, stream: &mut Stream) -> f64 {
        f64::from(u8::from(self.flight(by, stream).is_none()))
    }

    fn transmits(&self, by: &Tracking, stream: &mut Stream) -> f64 {
        self.transmits_above(0.0, by, stream)
    }

    fn transmits_above(&self, roulette: f32, by: &Tracking, stream: &mut Stream) -> f64 {
        let (medium, end) = (&self.medium, f64::INFINITY);
        by.estimate_transmittance(medium, self.ray, end, roulette, stream)
            .into()
    }
}

/// What rounding of the extinction and of each step to `f32` may cost.
const ROUNDING: &str = "f32 extinction and weights";

fn one_decade(rows: &mut Rows, decade: i32) {
    let case = scaled(decade);
    let expected = (-case.tau(case.end)).exp();
    let (shot, tracking) = (Shot::new(&case), Tracking::default());
    let flights = measure(rows.seed(), 150_000, |stream| {
        [shot.escapes(&tracking, stream)]
    });
    let row = Row::fraction("escape", expected, &flights.moments[0], &flights.seen);
    rows.push(row.tolerance(1e-6, ROUNDING));
    let weights = measure(rows.seed(), 150_000, |stream| {
        [shot.transmits(&tracking, stream)]
    });
    let row = Row::mean("T", expected, &weights.moments[0], &weights.seen);
    rows.push(row.tolerance(1e-6, ROUNDING));
}

/// Every estimator, over all decades in turn: one that fails in one of them is off by 1/17.
fn all_decades(rows: &mut Rows) {
    const FLIGHTS_OF_ALL: u64 = 17 * 10_000;
    let cases: Vec<Case> = (-8..=8).map(scaled).collect();
    let shots: Vec<Shot<'_>> = cases.iter().map(Shot::new).collect();
    let expected = cases.iter().map(|c| (-c.tau(c.end)).exp()).sum::<f64>() / 17.0;
    for Estimator { name, tracking } in distance_estimators() {
        let mut turn = shots.iter().cycle();
        let measured = measure(rows.seed(), FLIGHTS_OF_ALL, |stream| {
            let shot = turn.next();
            [shot.map_or(f64::NAN, |s| s.escapes(&tracking, stream))]
        });
        let name = format!("escape, {name}");
        let row = Row::fraction(name, expected, &measured.moments[0], &measured.seen);
        rows.push(row.tolerance(1e-6, ROUNDING));
    }
    for Estimator { name, tracking } in transmittance_estimators() {
        let mut turn = shots.iter().cycle();
        let measured = measure(rows.seed(), FLIGHTS_OF_ALL, |stream| {
            let shot = turn.next();
            [shot.map_or(f64::NAN, |s| s.transmits(&tracking, stream))]
        });
        let name = format!("T, {name}");
        let row = Row::mean(name, expected, &measured.moments[0], &measured.seen);
        rows.push(row.tolerance(1e-6, ROUNDING));
    }
}

/// The inside of one tile of 4096³ voxels among equals: closed forms.
fn homogeneous(rows: &mut Rows) {
    let mut b = TreeBuilder::new(0.0_f32);
    for i in 0..8 {
        // A tile's bound counts in what the filter reads of its upper neighbours.
        let corner = IVec3::new(i >> 2 & 1, i >> 1 & 1, i & 1);
        b.set_root_tile(corner * 4096, 1.0, true);
    }
    let volume = Volume::uniform(b.finish(Vec::new(), Vec::new()), 1.0);
    let medium = volume.attenuating(0.01);
    let ray = Ray {
        origin: DVec3::splat(2000.3),
        direction: DVec3::new(0.6, 0.0, 0.8),
    };
    let expected = (-f64::from(0.01_f32) * 150.0).exp();
    for distance in [DistanceEstimator::ClosedForm, DistanceEstimator::Delta] {
        let tracking = Tracking {
            distance,
            ..Tracking::default()
        };
        let measured = measure(rows.seed(), 400_000, |stream| {
            let flight = tracking.sample_collision(&medium, &ray, 150.0, stream);
            [f64::from(u8::from(flight.is_none()))]
        });
        let name = format!("escape, {distance}");
        rows.push(Row::fraction(
            name,
            expected,
            &measured.moments[0],
            &measured.seen,
        ));
    }
    for transmittance in [
        TransmittanceEstimator::ClosedForm,
        TransmittanceEstimator::Exact,
    ] {
        let tracking = Tracking {
            transmittance,
            ..Tracking::default()
        };
        let measured = measure(rows.seed(), 10, |stream| {
            let t = tracking.estimate_transmittance(&medium, &ray, 150.0, 0.0, stream);
            [f64::from(t)]
        });
        let name = format!("T, {transmittance}");
        let row = Row::exact(name, expected, measured.moments[0].mean(), &measured.seen);
        rows.push(row.tolerance(1e-7, "f32 depth and exponential"));
    }
}

fn distances(rows: &mut Rows, case: &Case, estimator: &Estimator) {
    const CELLS: usize = 64;
    const STEPS: usize = 4096;
    // The distribution function on a fine raster, for looking up cells.
    let step = case.end / STEPS as f64;
    let mut table = vec![0.0];
    for i in 0..STEPS {
        let piece = (i as f64 * step, (i + 1) as f64 * step);
        let column = case.volume.column(&case.ray, piece);
        table.push(table[i] + f64::from(case.sigma_t) * column);
    }
    let total = table[STEPS];
    let collided = -(-total).exp_m1();
    let shot = Shot::new(case);
    let mut cells = [0_u32; CELLS];
    let measured = measure(rows.seed(), FLIGHTS, |stream| {
        let flight = shot.flight(&estimator.tracking, stream);
        let Some(t) = flight else {
            return [1.0];
        };
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "indices, saturating"
        )]
        {
            let at = t / step;
            let k = (at as usize).min(STEPS - 1);
            let tau = table[k] + (table[k + 1] - table[k]) * (at - k as f64);
            // Uniform in [0, 1) given that the flight ended.
            let u = -(-tau).exp_m1() / collided;
            cells[((u * CELLS as f64) as usize).min(CELLS - 1)] += 1;
        }
        [0.0]
    });
    let name = &estimator.name;
    let escape = measured.moments[0];
    rows.push(Row::fraction(
        format!("{name} escape"),
        (-total).exp(),
        &escape,
        &measured.seen,
    ));
    let row = Row::chi_square(format!("{name} distances"), &cells, &measured.seen);
    rows.push(row);
}

const ESTIMATES: u64 = 3 << 16;

const FLIGHTS: u64 = 3 << 16;

/// Steps of a ray of optical depth 4 through 60 voxels.
const STEPS: u64 = 300;

fn estimates(rows: &mut Rows, case: &Case) {
    let expected = (-case.tau(case.end)).exp();
    let shot = Shot::new(case);
    for Estimator { name, tracking } in transmittance_estimators() {
        let measured = measure(rows.seed(), ESTIMATES, |stream| {
            [shot.transmits(&tracking, stream)]
        });
        let (moments, seen) = (&measured.moments[0], &measured.seen);
        let row = Row::mean(format!("{name} mean"), expected, moments, seen);
        rows.push(row.tolerance(1e-6, ROUNDING));
        if let Some(expected) = variance(case, &tracking) {
            let row = Row::variance(format!("{name} variance"), expected, moments, seen);
            // The control is off its formula by up to 2e-4 of the range.
            rows.push(row.tolerance(1e-3 * expected, "the control's series"));
        }
    }
    // Roulette at a weight that most estimates fall below.
    let tracking = Tracking::default();
    for roulette in [0.5, 2.0] {
        let measured = measure(rows.seed(), ESTIMATES, |stream| {
            [shot.transmits_above(roulette, &tracking, stream)]
        });
        let name = format!("auto, roulette below {roulette}");
        let row = Row::mean(name, expected, &measured.moments[0], &measured.seen);
        rows.push(row.tolerance(1e-6, ROUNDING));
    }
}

/// Novák's control of a segment and the bound of what it leaves, by the published formula.
fn novak(s: &BoundSegment) -> (f64, f64) {
    let [min, max, mean] = [s.sigma_min, s.sigma_maj, s.sigma_mean].map(f64::from);
    let range = max - min;
    let control = min + range * ((1.0 / (f64::from(s.diagonal) * range)).exp2() - 1.0);
    let control = control.clamp(min, mean.max(min));
    (control, (max - control).max(control - min))
}

/// The variance that theory gives an estimator; `None` for a mixture.
fn variance(case: &Case, tracking: &Tracking) -> Option<f64> {
    let transmittance = (-case.tau(case.end)).exp();
    let residual = match tracking.transmittance {
        TransmittanceEstimator::Exact => return Some(0.0),
        TransmittanceEstimator::Delta => return Some(transmittance * (1.0 - transmittance)),
        TransmittanceEstimator::Ratio => false,
        TransmittanceEstimator::ResidualRatio => true,
        _ => return None,
    };
    // ∫ E[(s − c)²] / M over the segments that are not closed forms.
    let medium = case.medium();
    let mut walk = medium.ray_over(&case.ray, f64::INFINITY, segments(tracking.bounds));
    let sigma_t = f64::from(case.sigma_t);
    let mut exponent = 0.0;
    while let Some(s) = walk.next_segment() {
        if s.is_homogeneous() {
            continue;
        }
        let (control, bound) = if residual {
            novak(&s)
        } else {
            (0.0, s.sigma_maj.into())
        };
        let range = (s.t0, s.t1);
        let square = sigma_t * sigma_t * case.volume.column_of_squares(&case.ray, range);
        let linear = sigma_t * case.volume.column(&case.ray, range);
        let constant = control * control * (s.t1 - s.t0);
        let rate = bound * f64::from(tracking.rate);
        exponent += (square - 2.0 * control * linear + constant) / rate;
    }
    Some(transmittance.powi(2) * exponent.exp_m1())
}

/// A biased estimator must have the bias that it says, and none at short steps.
fn marching(rows: &mut Rows) {
    let [.., case] = cases(THIN);
    let shot = Shot::new(&case);
    let to_index = case.ray.direction.abs().element_sum();
    for step_voxels in [2.0, 0.5] {
        let tracking = Tracking {
            transmittance: TransmittanceEstimator::ApproxRayMarching,
            march_step: step_voxels,
            ..Tracking::default()
        };
        let step = step_voxels / to_index;
        let marched = |offset: f64| {
            let points = (0..).map(|k| (f64::from(k) + offset) * step);
            let sum: f64 = points
                .take_while(|&t| t < case.end)
                .map(|t| volumes::trilinear(case.volume.tree(), case.ray.at(t)))
                .sum();
            (-f64::from(case.sigma_t) * sum * step).exp()
        };
        let expected = (0..2000).map(|i| marched((f64::from(i) + 0.5) / 2000.0));
        let expected = expected.sum::<f64>() / 2000.0;
        let measured = measure(rows.seed(), ESTIMATES, |stream| {
            [shot.transmits(&tracking, stream)]
        });
        let name = format!("{step_voxels} voxels");
        let row = Row::mean(name, expected, &measured.moments[0], &measured.seen);
        rows.push(row.tolerance(1e-5, "2000 offsets of the oracle"));
    }
    let exact = (-case.tau(case.end)).exp();
    let tracking = Tracking {
        transmittance: TransmittanceEstimator::ApproxRayMarching,
        march_step: 0.01,
        ..Tracking::default()
    };
    let measured = measure(rows.seed(), 100, |stream| {
        [shot.transmits(&tracking, stream)]
    });
    let mean = measured.moments[0].mean();
    let row = Row::exact("0.01 voxels: unbiased", exact, mean, &measured.seen);
    rows.push(row.tolerance(1e-4, "the square of the step"));
}

fn split(rows: &mut Rows) {
    let [_, _, case, _] = cases(THIN);
    let medium = case.medium();
    let expected = (-case.tau(case.end)).exp();
    let cuts = [0.0, 11.3, 24.0, case.end];
    for Estimator { name, tracking } in transmittance_estimators() {
        let measured = measure(rows.seed(), ESTIMATES / 4, |stream| {
            let parts = cuts.windows(2).map(|w| {
                let part = Ray {
                    origin: case.ray.at(w[0]),
                    direction: case.ray.direction,
                };
                let length = w[1] - w[0];
                tracking.estimate_transmittance(&medium, &part, length, 0.0, stream)
            });
            [f64::from(parts.product::<f32>())]
        });
        let row = Row::mean(name, expected, &measured.moments[0], &measured.seen);
        rows.push(row.tolerance(1e-6, ROUNDING));
    }
}

/// A thick ray: estimates of ratio tracking stay within 0 and 1, and the variance of residual
/// ratio tracking, whose factors do not, is still what theory says.
pub(super) fn thick(rows: &mut Rows) {
    let [_, case, ..] = cases(4.0);
    let shot = Shot::new(&case);
    for Estimator { name, tracking } in transmittance_estimators() {
        let measured = measure(rows.seed(), ESTIMATES, |stream| {
            let t = shot.transmits(&tracking, stream);
            [t, f64::from(u8::from(!(0.0..=1.0).contains(&t)))]
        });
        let [weights, outside] = &measured.moments;
        let row = Row::mean(
            format!("{name} mean"),
            (-case.tau(case.end)).exp(),
            weights,
            &measured.seen,
        );
        rows.push(row.tolerance(1e-6, ROUNDING).steps_within(STEPS));
        if tracking.transmittance == TransmittanceEstimator::ResidualRatio {
            let expected = variance(&case, &tracking).unwrap_or(f64::NAN);
            let name = format!("{name} variance");
            let row = Row::variance(name, expected, weights, &measured.seen);
            rows.push(row.tolerance(1e-3 * expected, "the control's series"));
        } else if !matches!(
            tracking.transmittance,
            TransmittanceEstimator::Auto | TransmittanceEstimator::PowerSeries
        ) {
            let name = format!("{name} outside of 0 to 1");
            let row = Row::exact(name, 0.0, outside.mean(), &measured.seen);
            rows.push(row.steps_within(STEPS));
        }
    }
}

//! Extinctions from 1e-30 to 1e12, spikes, denormal numbers, steps that vanish beside t.

use glam::{DVec3, IVec3};

use super::{ROUNDING, along, exact_transmittance, middle};
use crate::grid::Tree;
use crate::integrator::IntegratorKind;
use crate::space::Ray;
use crate::spectrum::Rgb;
use crate::tracking::Tracking;
use crate::verify::flight;
use crate::verify::measure::measure;
use crate::verify::oracle::HFunction;
use crate::verify::paths::{self, phase, sky, transport};
use crate::verify::row::{Group, Row};
use crate::verify::volumes::{self, Volume, box_of};
use crate::verify::{Check, Rows};

const SAME_GEOMETRY: Group = Group {
    name: "extinction 1e-8 to 1e8, same geometry",
    oracle: "exp(-tau); mean depth of flight over 1 - exp(-tau): 1; plane albedo by H",
};

const CUT_OFFS: Group = Group {
    name: "hidden cut-offs",
    oracle: "sigma_t 1/L over a length L gives 1/e",
};

const SPIKES: Group = Group {
    name: "spikes, denormals, weights",
    oracle: "exp(-tau) by quadrature; variance by the estimator's formula",
};

const ULP: Group = Group {
    name: "steps below one ulp of t",
    oracle: "a black and dense cube is black, and begins at its face",
};

/// Steps of a ray through a volume of 32 to 50 voxels: 4 collisions a voxel cell at most on
/// average, and 80 cells.
pub(super) const STEPS: u64 = 600;

pub(super) fn checks(out: &mut Vec<Check>) {
    for decade in -8..=8 {
        out.push(Check::new(
            &SAME_GEOMETRY,
            format!("1e{decade}"),
            move |rows| {
                same_geometry(rows, decade);
            },
        ));
    }
    for decade in [4, 6, 8] {
        let name = format!("1e{decade}, albedo 0.9");
        out.push(Check::new(&SAME_GEOMETRY, name, move |rows| {
            half_space(rows, decade);
        }));
    }
    for length in [1e12, 1e30] {
        out.push(Check::new(
            &CUT_OFFS,
            format!("L {length:e}"),
            move |rows| {
                let volume = Volume::uniform(cube_tree(), length / 32.0);
                #[expect(clippy::cast_possible_truncation, reason = "rounding is 6e-8 of it")]
                let medium = volume.attenuating((1.0 / length) as f32);
                let ray = Ray {
                    origin: DVec3::new(-length, 0.0, 0.0),
                    direction: DVec3::X,
                };
                along(rows, &medium, &ray, 1.0, 200_000, STEPS);
            },
        ));
    }
    out.push(Check::new(
        &SPIKES,
        "one voxel 1e9 among ones, missed",
        |rows| {
            spike(rows, DVec3::new(0.3, 5.2, 5.4));
        },
    ));
    out.push(Check::new(
        &SPIKES,
        "one voxel 1e9 among ones, grazed",
        |rows| {
            spike(rows, DVec3::new(0.3, 3.999999999, 3.2));
        },
    ));
    out.push(Check::new(&SPIKES, "denormal voxels", denormal));
    out.push(Check::new(&SPIKES, "thick, oblique step", flight::thick));
    out.push(Check::new(
        &ULP,
        "sigma_t 1e12, camera at 1e7",
        below_an_ulp,
    ));
}

fn cube_tree() -> Tree<f32> {
    box_of(IVec3::splat(-16), IVec3::splat(16), |_| 1.0)
}

fn same_geometry(rows: &mut Rows, decade: i32) {
    let cube = volumes::cube();
    let sigma_t = 10.0_f32.powi(decade);
    let (medium, ray) = (cube.attenuating(sigma_t), middle());
    let tau = f64::from(sigma_t) * cube.column(&ray, (0.0, 4.0));
    along(rows, &medium, &ray, tau, 60_000, STEPS);
    // E[min(depth, τ)] = 1 − e^(−τ) for an exponential depth.
    let collided = -(-tau).exp_m1();
    let tracking = Tracking::default();
    let n = 6_000;
    let measured = measure(rows.seed(), n, |stream| {
        let flight = tracking.sample_collision(&medium, &ray, 4.0, stream);
        let end = flight.unwrap_or(4.0);
        [f64::from(sigma_t) * cube.column(&ray, (0.0, end)) / collided]
    });
    // Its variance in closed form: too few flights collide at the thin end to measure it.
    let variance = if tau < 1e-3 {
        tau.powi(3) / 3.0
    } else {
        2.0 * (collided - tau * (-tau).exp()) - collided * collided
    };
    let error = (variance / n as f64).sqrt() / collided;
    let mean = measured.moments[0].mean();
    let row = Row::statistical("depth of flight", 1.0, mean, error, &measured.seen);
    rows.push(row.tolerance(1e-6, ROUNDING).steps_within(STEPS));
}

/// Deep inside nothing comes back: the face of the cube is a half-space.
fn half_space(rows: &mut Rows, decade: i32) {
    let medium = volumes::cube().medium(10.0_f32.powi(decade), Rgb::splat(0.9), phase(0.0));
    let settings = transport(IntegratorKind::Path, None);
    let measured = paths::radiance(
        &medium,
        &sky(Rgb::WHITE),
        settings,
        (rows.seed(), 60_000),
        |_| Ray {
            origin: DVec3::new(0.013, 0.021, 2.0),
            direction: DVec3::NEG_Z,
        },
    );
    let expected = HFunction::new(f64::from(0.9_f32)).plane_albedo(1.0);
    let row = Row::mean("white sky", expected, &measured.moments[0], &measured.seen);
    // A path of 400 bounces, each in a few cells.
    rows.push(row.steps_within(20_000));
}

fn spike(rows: &mut Rows, origin: DVec3) {
    let spike = IVec3::new(4, 3, 2);
    let tree = box_of(IVec3::ZERO, IVec3::splat(8), |p| {
        if p == spike { 1e9 } else { 1.0 }
    });
    let volume = Volume::uniform(tree, 1.0);
    let ray = Ray {
        origin: origin - DVec3::X * 5.0,
        direction: DVec3::X,
    };
    let tau = 0.1 * volume.column(&ray, (0.0, 30.0));
    along(rows, &volume.attenuating(0.1), &ray, tau, 100_000, STEPS);
}

fn denormal(rows: &mut Rows) {
    let tree = box_of(IVec3::splat(-16), IVec3::splat(16), |_| 1e-40);
    let volume = Volume::uniform(tree, 1.0);
    let ray = Ray {
        origin: DVec3::new(-30.0, 0.3, 0.4),
        direction: DVec3::X,
    };
    let tau = f64::from(3e38_f32) * volume.column(&ray, (0.0, 60.0));
    along(rows, &volume.attenuating(3e38), &ray, tau, 100_000, STEPS);
}

fn below_an_ulp(rows: &mut Rows) {
    let cube = volumes::cube();
    let medium = cube.medium(1e12, Rgb::BLACK, phase(0.0));
    let ray = Ray {
        origin: DVec3::new(-1e7, 0.013, 0.021),
        direction: DVec3::X,
    };
    let settings = transport(IntegratorKind::Path, None);
    let budget = (rows.seed(), 10_000);
    let lit = paths::radiance(&medium, &sky(Rgb::WHITE), settings, budget, |_| ray);
    let row = Row::exact("radiance", 0.0, lit.moments[0].mean(), &lit.seen);
    rows.push(row.steps_within(STEPS));
    let tracking = Tracking::default();
    let measured = measure(rows.seed(), 10_000, |stream| {
        let flight = tracking.sample_collision(&medium, &ray, f64::INFINITY, stream);
        [flight.map_or(f64::NAN, |t| t - 1e7)]
    });
    // The ramp begins at −17 voxels of 0.05, and is black after 1e-6 of one.
    let row = Row::exact("face", -0.85, measured.moments[0].mean(), &measured.seen);
    rows.push(
        row.tolerance(4e-6, "an ulp of 1e7, and the depth of the ramp")
            .steps_within(STEPS),
    );
    let dark = exact_transmittance(&medium, &ray);
    rows.push(Row::exact("T, exact", 0.0, dark.moments[0].mean(), &dark.seen).steps_within(STEPS));
}

//! One scattering and none: closed forms of the slab and of the ball.
//!
//! A ball of voxels is not a ball. Its optical depth along each ray is integrated through the
//! voxels as they are, by an oracle of its own, and what the renderer measures is held against
//! that; how far the voxels are from the ball is a row of its own.

use std::f64::consts::PI;

use glam::DVec3;

use super::measure::{Seen, measure};
use super::oracle;
use super::paths::{self, half_sky, only, phase, sky, sun, transport};
use super::row::{Group, Row};
use super::volumes::{self, Volume};
use super::{Check, Rows};
use crate::integrator::{Context, IntegratorKind};
use crate::sampling::Stream;
use crate::space::Ray;
use crate::spectrum::Rgb;

const SLAB: Group = Group {
    name: "slab, single scattering",
    oracle: "closed forms; hemispherical ones by Gauss-Legendre quadrature",
};

const BALL: Group = Group {
    name: "ball, single scattering",
    oracle: "w p(180) F (1 - e^(-2 tau))/2 and w p(0) F tau e^(-tau), tau through the voxels",
};

const ABSORPTION: Group = Group {
    name: "ball, absorption",
    oracle: "1 - e^-tau through the voxels by quadrature; A(2 sigma R) in closed form",
};

pub(super) fn checks(out: &mut Vec<Check>) {
    for mu in [1.0, 0.5] {
        out.push(Check::new(
            &SLAB,
            format!("reflected at mu {mu}, tau 1"),
            move |rows| {
                slab_radiance(rows, mu);
            },
        ));
    }
    for tau in [0.1, 1.0] {
        out.push(Check::new(
            &SLAB,
            format!("first order flux, tau {tau}"),
            move |rows| {
                slab_flux(rows, tau);
            },
        ));
    }
    for offset in [0.0, 0.5, 0.9] {
        out.push(Check::new(
            &BALL,
            format!("chord at {offset} R"),
            move |rows| {
                ball_chord(rows, offset);
            },
        ));
    }
    out.push(Check::new(&ABSORPTION, "A(td)", absorption));
}

fn slab_radiance(rows: &mut Rows, mu: f64) {
    let slab = volumes::slab();
    let medium = slab.medium(1.0, Rgb::WHITE, phase(0.0));
    let lights = only([sun(DVec3::Z)]);
    let settings = transport(IntegratorKind::Path, Some(1));
    let direction = DVec3::new((1.0 - mu * mu).sqrt(), 0.0, -mu);
    let origin = DVec3::Z * 0.5 - direction * 5.0;
    let measured = paths::radiance(&medium, &lights, settings, (rows.seed(), 700_000), |_| {
        Ray { origin, direction }
    });
    let expected = oracle::once_reflected(1.0, mu);
    rows.push(Row::mean(
        "",
        expected,
        &measured.moments[0],
        &measured.seen,
    ));
}

fn slab_flux(rows: &mut Rows, tau: f64) {
    let slab = volumes::slab();
    #[expect(clippy::cast_possible_truncation, reason = "0.1 or 1")]
    let medium = slab.medium(tau as f32, Rgb::WHITE, phase(0.0));
    let (r, t) = (
        oracle::flux(|mu| oracle::once_reflected(tau, mu)),
        oracle::flux(|mu| oracle::once_transmitted(tau, mu)),
    );
    for (name, zenith, expected) in [("R1", DVec3::Z, r), ("T1", DVec3::NEG_Z, t)] {
        for (integrator_name, integrator) in paths::INTEGRATORS {
            let lights = only([half_sky(zenith, Rgb::WHITE)]);
            let settings = transport(integrator, Some(1));
            let measured =
                paths::radiance(&medium, &lights, settings, (rows.seed(), 500_000), |_| {
                    Ray {
                        origin: DVec3::Z * 5.0,
                        direction: DVec3::NEG_Z,
                    }
                });
            // What passes straight through sees the light itself: not scattered.
            let direct = if name == "T1" { (-tau).exp() } else { 0.0 };
            let moments = &measured.moments[0];
            let name = format!("{name} {integrator_name}, with direct light");
            let row = Row::mean(name, expected + direct, moments, &measured.seen);
            rows.push(row.tolerance(2e-7, "64 nodes of quadrature"));
        }
    }
}

/// Voxels in the radius of the ball.
const RADIUS: i32 = 32;

/// Density 1 within radius 1.
fn ball() -> Volume {
    volumes::ball(RADIUS)
}

fn ball_chord(rows: &mut Rows, offset: f64) {
    const G: f32 = 0.5;
    const SIGMA_T: f32 = 2.0;
    const ALBEDO: f32 = 0.8;
    let ball = ball();
    // Oblique to the voxels.
    let direction = DVec3::new(0.48, 0.36, 0.8);
    let across = DVec3::new(0.6, -0.8, 0.0);
    let ray = Ray {
        origin: across * offset - direction * 2.0,
        direction,
    };
    let tau = f64::from(SIGMA_T) * ball.column(&ray, (0.0, 4.0));
    let medium = ball.medium(SIGMA_T, Rgb::splat(ALBEDO), phase(G));
    let settings = transport(IntegratorKind::Path, Some(1));
    let (g, w) = (f64::from(G), f64::from(ALBEDO));
    let p = |cos: f64| (1.0 - g * g) / (4.0 * PI * (1.0 + g * g - 2.0 * g * cos).powf(1.5));
    let back = w * p(-1.0) * -(-2.0 * tau).exp_m1() / 2.0;
    let forward = w * p(1.0) * tau * (-tau).exp();
    for (name, to_sun, expected) in [("back", -direction, back), ("forward", direction, forward)] {
        let lights = only([sun(to_sun)]);
        let measured = paths::radiance(&medium, &lights, settings, (rows.seed(), 200_000), |_| ray);
        rows.push(Row::mean(
            name,
            expected,
            &measured.moments[0],
            &measured.seen,
        ));
    }
}

/// Parallel light, spread over a square that holds the ball.
fn beam(stream: &mut Stream) -> Ray {
    let at = |u: f32| 2.2 * (f64::from(u) - 0.5);
    let (y, z) = (at(stream.uniform()), at(stream.uniform()));
    Ray {
        origin: DVec3::new(-2.0, y, z),
        direction: DVec3::X,
    }
}

fn absorption(rows: &mut Rows) {
    let ball = ball();
    // Area of the beam over that of the ball's disk.
    let area = 2.2 * 2.2 / PI;
    // The oracle's raster: the field is smooth on the scale of its 3 rays a voxel.
    let raster = 160;
    let columns: Vec<f64> = (0..raster * raster)
        .map(|i| {
            let at = |k: i32| 2.2 * ((f64::from(k) + 0.5) / f64::from(raster) - 0.5);
            let ray = Ray {
                origin: DVec3::new(-2.0, at(i % raster), at(i / raster)),
                direction: DVec3::X,
            };
            ball.column(&ray, (0.0, 4.0))
        })
        .collect();
    let settings = transport(IntegratorKind::Analog, None);
    for td in [0.1_f32, 1.0, 2.0, 5.0, 10.0] {
        let sigma_t = td / 2.0;
        let absorbed = columns.iter().map(|c| -(-f64::from(sigma_t) * c).exp_m1());
        let expected = area * absorbed.sum::<f64>() / columns.len() as f64;
        let medium = ball.medium(sigma_t, Rgb::BLACK, phase(0.0));
        let lights = sky(Rgb::WHITE);
        let context = Context::new(std::slice::from_ref(&medium), &lights, settings);
        let measured = measure(rows.seed(), 400_000, |stream| {
            let ray = beam(stream);
            let sample = context.sample_radiance(ray, stream);
            [area * (1.0 - f64::from(sample.radiance.0[0]))]
        });
        let row = Row::mean(
            format!("td {td}"),
            expected,
            &measured.moments[0],
            &measured.seen,
        );
        rows.push(row.tolerance(2e-5, "the raster of the oracle"));
        let closed = oracle::absorbed_by_ball(f64::from(td));
        let row = Row::exact(
            format!("td {td}, voxels for a ball"),
            closed,
            expected,
            &Seen::default(),
        );
        // A thick rim counts as much as what is behind it; a thin one only by its mass.
        let rim = f64::from(td.min(1.0)) / f64::from(RADIUS);
        rows.push(row.tolerance(rim, "a rim of half a voxel"));
    }
}

//! Slabs and half-spaces: plane-parallel light transport, where other people's digits exist.
//!
//! By reciprocity the radiance that a camera sees at an angle, when the upper half of the sky is
//! 1, is the fraction of a beam at that angle that comes back; when the lower half is, the
//! fraction that gets through.

use glam::DVec3;

use super::oracle::{self, HFunction, SLABS, SLABS_UNCERTAINTY, SlabRow};
use super::paths::{self, cosine_direction, half_sky, only, phase, sky, sun, transport};
use super::row::{Group, Row};
use super::volumes::{self, Volume};
use super::{Check, Rows};
use crate::integrator::IntegratorKind;
use crate::sampling::Stream;
use crate::space::Ray;
use crate::spectrum::Rgb;

const SLAB: Group = Group {
    name: "slab, multiple scattering",
    oracle: "discrete ordinates of 96 streams, which give van de Hulst's and Heaslet and \
             Warming's published values",
};

const HALF_SPACE: Group = Group {
    name: "half-space, Chandrasekhar's H",
    oracle: "the H function, solved by iteration and equal to the published digits",
};

const DIFFUSION: Group = Group {
    name: "diffusion limit",
    oracle: "4/3 / (tau + 2 q) with Hopf's q; similarity relations",
};

/// Where the camera's rays start: on the slab's upper face, which is at 1 + 1/256.
const TOP: DVec3 = DVec3::new(0.0, 0.0, 1.0 + 1.0 / 256.0);

pub(super) fn checks(out: &mut Vec<Check>) {
    for row in &SLABS {
        for (incidence, integrator) in [
            (Incidence::Normal, IntegratorKind::Analog),
            (Incidence::Diffuse, IntegratorKind::Analog),
            (Incidence::Normal, IntegratorKind::Path),
        ] {
            // Next-event estimation costs five times as much a bounce, and a peaked phase
            // function towards half a sky of light makes it noisy: the two thinnest slabs.
            if integrator == IntegratorKind::Path && row.tau > 2.0 {
                continue;
            }
            let name = format!(
                "g {} tau {} {} {}",
                row.g,
                row.tau,
                incidence.name(),
                name_of(integrator)
            );
            out.push(Check::new(&SLAB, name, move |rows| {
                finite_slab(rows, row, incidence, integrator);
            }));
        }
    }
    for (mu, mu_0) in [(1.0, 1.0), (0.5, 1.0), (0.25, 0.5)] {
        out.push(Check::new(
            &HALF_SPACE,
            format!("radiance mu {mu} mu0 {mu_0}"),
            move |rows| {
                half_space_radiance(rows, mu, mu_0);
            },
        ));
    }
    for (name, integrator) in paths::INTEGRATORS {
        out.push(Check::new(
            &HALF_SPACE,
            format!("albedos {name}"),
            move |rows| {
                half_space_albedos(rows, integrator);
            },
        ));
    }
    for tau in [10.0_f32, 20.0] {
        out.push(Check::new(
            &DIFFUSION,
            format!("T of diffuse light, tau {tau}"),
            move |rows| {
                let measured = lit(
                    &volumes::slab(),
                    (0.0, tau),
                    Rgb::WHITE,
                    -DVec3::Z,
                    &Shot {
                        incidence: Incidence::Diffuse,
                        integrator: IntegratorKind::Analog,
                        seed: rows.seed(),
                        n: 100_000,
                    },
                );
                let expected = oracle::thick_transmittance(f64::from(tau));
                let row = Row::mean("", expected, &measured.moments[0], &measured.seen);
                rows.push(row.tolerance((-f64::from(tau)).exp(), "the formula leaves out e^-tau"));
            },
        ));
    }
    out.push(Check::new(
        &DIFFUSION,
        "spherical albedo by similarity, g 0.85",
        |rows| {
            let albedo = [0.8, 0.9, 0.99];
            let measured = lit(
                &volumes::slab(),
                (0.85, 64.0),
                Rgb(albedo),
                DVec3::Z,
                &Shot {
                    incidence: Incidence::Diffuse,
                    integrator: IntegratorKind::Analog,
                    seed: rows.seed(),
                    n: 40_000,
                },
            );
            for (w, moments) in albedo.into_iter().zip(&measured.moments) {
                let expected = oracle::similar_spherical_albedo(f64::from(w), f64::from(0.85_f32));
                let row = Row::mean(format!("albedo {w}"), expected, moments, &measured.seen);
                rows.push(row.tolerance(4e-3, "similarity is good to a few thousandths"));
            }
        },
    ));
}

fn name_of(integrator: IntegratorKind) -> &'static str {
    match integrator {
        IntegratorKind::Path => "path",
        IntegratorKind::Analog => "analog",
    }
}

/// How light, or by reciprocity the camera's rays, meet the slab.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Incidence {
    Normal,
    Diffuse,
}

impl Incidence {
    fn name(self) -> &'static str {
        match self {
            Self::Normal => "normal",
            Self::Diffuse => "diffuse",
        }
    }

    fn ray(self, stream: &mut Stream) -> Ray {
        let direction = match self {
            Self::Normal => DVec3::NEG_Z,
            Self::Diffuse => cosine_direction(DVec3::NEG_Z, stream),
        };
        Ray {
            origin: TOP,
            direction,
        }
    }
}

/// How a slab is looked at.
struct Shot {
    incidence: Incidence,
    integrator: IntegratorKind,
    seed: u64,
    n: u64,
}

/// The mean radiance that leaves a slab's upper face when one half of the sky is lit.
fn lit(
    slab: &Volume,
    (g, tau): (f32, f32),
    albedo: Rgb,
    zenith: DVec3,
    shot: &Shot,
) -> super::measure::Measured<3> {
    let medium = slab.medium(tau, albedo, phase(g));
    let settings = transport(shot.integrator, None);
    let budget = (shot.seed, shot.n);
    paths::radiance(
        &medium,
        &only([half_sky(zenith, Rgb::WHITE)]),
        settings,
        budget,
        |stream| shot.incidence.ray(stream),
    )
}

fn finite_slab(
    rows: &mut Rows,
    row: &'static SlabRow,
    incidence: Incidence,
    integrator: IntegratorKind,
) {
    let slab = volumes::slab();
    let (albedo, expected) = match incidence {
        Incidence::Normal => (&[0.9_f32, 0.99, 1.0][..], &row.normal[..]),
        Incidence::Diffuse => (&[0.9_f32, 1.0][..], &row.diffuse[..]),
    };
    // The number of bounces grows as 2τ.
    let bounces = 4.0 + 2.0 * row.tau;
    let work = if integrator == IntegratorKind::Path {
        1.5e6
    } else {
        3e6
    };
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "a number of samples below a million"
    )]
    let n = (work / bounces) as u64;
    let channel = |i: usize| albedo[i.min(albedo.len() - 1)];
    for (name, zenith) in [("R", DVec3::Z), ("T", DVec3::NEG_Z)] {
        let shot = Shot {
            incidence,
            integrator,
            seed: rows.seed(),
            n,
        };
        let colours = Rgb([channel(0), channel(1), channel(2)]);
        let measured = lit(&slab, (row.g, row.tau), colours, zenith, &shot);
        for (i, (w, &(r, t))) in albedo.iter().zip(expected).enumerate() {
            let expected = if name == "R" { r } else { t };
            // Less than the table's digits show.
            if expected < 1e-5 {
                continue;
            }
            let row = Row::mean(
                format!("{name} albedo {w}"),
                expected,
                &measured.moments[i],
                &measured.seen,
            );
            rows.push(row.tolerance(SLABS_UNCERTAINTY, "digits of the table"));
        }
    }
}

/// So thick that of albedo 0.99 or less nothing comes back from below: e^(−2 · 48 · 0.173) is 6e-8.
const THICK: f32 = 48.0;
/// The same for 0.999.
const VERY_THICK: f32 = 256.0;
/// Thick enough for the formula for albedo 1, which leaves out e^−16, and for 0.8.
const CONSERVATIVE: f32 = 16.0;

fn half_space_radiance(rows: &mut Rows, mu: f64, mu_0: f64) {
    let slab = volumes::slab();
    // The camera looks along −μ, and the sun stands on the other side, a quarter turn away.
    let direction = DVec3::new((1.0 - mu * mu).sqrt(), 0.0, -mu);
    let to_sun = DVec3::new(0.0, (1.0 - mu_0 * mu_0).sqrt(), mu_0);
    let lights = only([sun(to_sun)]);
    let settings = transport(IntegratorKind::Path, None);
    let camera = |_: &mut Stream| Ray {
        origin: TOP,
        direction,
    };
    for (tau, albedo, n) in [
        (THICK, [0.5, 0.9, 0.99], 60_000),
        (CONSERVATIVE, [1.0, 0.8, 0.0], 60_000),
    ] {
        let medium = slab.medium(tau, Rgb(albedo), phase(0.0));
        let measured = paths::radiance(&medium, &lights, settings, (rows.seed(), n), camera);
        for (i, &w) in albedo.iter().enumerate().filter(|&(_, &w)| w > 0.0) {
            let h = HFunction::new(f64::from(w));
            let expected = if w == 1.0 {
                h.conservative_radiance(mu, mu_0, f64::from(tau))
            } else {
                h.radiance(mu, mu_0)
            };
            let moments = &measured.moments[i];
            rows.push(Row::mean(
                format!("albedo {w}"),
                expected,
                moments,
                &measured.seen,
            ));
        }
    }
}

/// A white sky shows a half-space as bright as it reflects.
fn half_space_albedos(rows: &mut Rows, integrator: IntegratorKind) {
    let slab = volumes::slab();
    for (what, incidence) in [
        ("plane albedo", Incidence::Normal),
        ("spherical albedo", Incidence::Diffuse),
    ] {
        for (tau, albedo, n) in [
            (THICK, [0.5, 0.9, 0.99], 60_000),
            (VERY_THICK, [0.999, 0.0, 0.0], 10_000),
        ] {
            // Weights keep paths going for thousands of bounces where analog ones are absorbed.
            if tau > THICK && integrator == IntegratorKind::Path {
                continue;
            }
            let medium = slab.medium(tau, Rgb(albedo), phase(0.0));
            let settings = transport(integrator, None);
            let measured = paths::radiance(
                &medium,
                &sky(Rgb::WHITE),
                settings,
                (rows.seed(), n),
                |stream| incidence.ray(stream),
            );
            for (i, &w) in albedo.iter().enumerate().filter(|&(_, &w)| w > 0.0) {
                let h = HFunction::new(f64::from(w));
                let expected = match incidence {
                    Incidence::Normal => h.plane_albedo(1.0),
                    Incidence::Diffuse => h.spherical_albedo(),
                };
                let moments = &measured.moments[i];
                let name = format!("{what} {w}");
                rows.push(Row::mean(name, expected, moments, &measured.seen));
            }
        }
    }
}

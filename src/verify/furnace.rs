//! Energy: white furnaces, the mean path through a convex body, and where all light goes.

use std::f64::consts::TAU;
use std::sync::atomic::AtomicBool;

use glam::{DAffine3, DMat3, DVec3};

use super::estimators::distance_estimators;
use super::measure::{Seen, measure};
use super::paths::{self, cosine_direction, half_sky, only, phase, sky, transport};
use super::row::{Group, Row};
use super::volumes::{self, Volume};
use super::{Check, Rows};
use crate::camera::Camera;
use crate::film::Film;
use crate::integrator::{Context, IntegratorKind};
use crate::light::{DistantLight, Lights};
use crate::render::{NoProgress, render};
use crate::sampling::Stream;
use crate::scene::Scene;
use crate::space::Ray;
use crate::spectrum::Rgb;

const FURNACE: Group = Group {
    name: "white furnace",
    oracle: "albedo 1 under a sky of 1 shows 1 in every pixel",
};

const CONVEX: Group = Group {
    name: "convex body, diffuse light",
    oracle: "mean path 4 V/S; mean number of scatterings (4/S) times the integral of sigma_s",
};

const BALANCE: Group = Group {
    name: "energy balance",
    oracle: "light is reflected, transmitted or absorbed",
};

pub(super) fn checks(out: &mut Vec<Check>) {
    for (name, volume) in [
        ("box", volumes::cube as fn() -> Volume),
        ("cloud", volumes::cloud),
        ("cloud, sheared", sheared_cloud),
    ] {
        for g in [0.0, 0.85] {
            for (integrator_name, integrator) in paths::INTEGRATORS {
                let name = format!("{name}, g {g}, {integrator_name}");
                out.push(Check::new(&FURNACE, name, move |rows| {
                    image(rows, &volume(), g, integrator);
                }));
            }
        }
    }
    out.push(Check::new(
        &FURNACE,
        "cloud, guided towards a sun of another colour",
        guided,
    ));
    for (name, body) in [("cube", Body::Cube(1.25)), ("ball", Body::Ball(2.2))] {
        for g in [0.0, 0.85, -0.5] {
            out.push(Check::new(
                &CONVEX,
                format!("cloud in a {name}, g {g}"),
                move |rows| {
                    convex(rows, body, g);
                },
            ));
        }
    }
    out.push(Check::new(&BALANCE, "R + T + A of a cloud", balance));
    out.push(Check::new(&BALANCE, "middle of a dark slab", weak_paths));
}

fn sheared_cloud() -> Volume {
    let shear = DMat3::from_cols(
        DVec3::X,
        DVec3::new(0.7, 1.0, 0.0),
        DVec3::new(-0.2, 0.3, 0.5),
    );
    let map = DAffine3::from_mat3(shear * 0.05);
    Volume::new(volumes::cloud_tree(), map)
}

/// A small picture of a volume from aslant, from 4 units away.
pub(super) fn scene(volume: &Volume, sigma_t: f32, albedo: Rgb, g: f32, lights: Lights) -> Scene {
    let eye = DVec3::new(0.5, -4.0, 0.8);
    Scene {
        width: 24,
        height: 16,
        spp: 64,
        seed: 0,
        frame: 0,
        aovs: vec![],
        camera: Camera::look_at(eye, DVec3::ZERO, DVec3::Z, 0.6, 1.5)
            .expect("the camera looks along y"),
        media: vec![volume.medium(sigma_t, albedo, phase(g))],
        lights,
        transport: transport(IntegratorKind::Path, None),
    }
}

fn image(rows: &mut Rows, volume: &Volume, g: f32, integrator: IntegratorKind) {
    let mut scene = scene(volume, 30.0, Rgb::WHITE, g, sky(Rgb::WHITE));
    scene.transport.integrator = integrator;
    let rendered = render(&scene, &NoProgress, &AtomicBool::new(false));
    let seen = Seen {
        counts: rendered.counts,
        ..Seen::default()
    };
    let farthest = farthest_from_white(&rendered.film);
    let counts = rendered.counts;
    let bounces = counts.scattered_rays as f64 / counts.camera_rays as f64;
    let row = Row::exact("farthest pixel", 1.0, farthest, &seen);
    rows.push(row.demanding(bounces > 2.0, "fewer than two scatterings a path"));
}

/// The channel of a pixel that is farthest from 1.
fn farthest_from_white(film: &Film) -> f64 {
    let channels = film.pixels().iter().flat_map(|p| p.mean);
    let far = |a: f64, b: f64| {
        if (a - 1.0).abs() > (b - 1.0).abs() {
            a
        } else {
            b
        }
    };
    channels.fold(1.0, far)
}

/// A sun that shines in blue only draws paths towards it; the red sky must not notice.
fn guided(rows: &mut Rows) {
    let cloud = volumes::cloud();
    let blue = DistantLight::new(DVec3::new(0.5, -0.5, 0.7), Rgb([0.0, 0.0, 9.0]), 0.01);
    let lights = Lights {
        distant: vec![blue.expect("a sun")],
        environment: Rgb([1.0, 0.0, 0.0]),
        ..Lights::default()
    };
    for g in [0.5, 0.85] {
        let medium = cloud.medium(12.0, Rgb::WHITE, phase(g));
        let settings = transport(IntegratorKind::Path, None);
        let measured = paths::radiance(
            &medium,
            &lights,
            settings,
            (rows.seed(), 100_000),
            |stream| Body::Cube(1.25).enter(stream),
        );
        rows.push(Row::mean(
            format!("g {g}"),
            1.0,
            &measured.moments[0],
            &measured.seen,
        ));
    }
}

/// A convex body around the origin.
#[derive(Clone, Copy)]
pub(super) enum Body {
    /// Half of its edge.
    Cube(f64),
    /// Its radius.
    Ball(f64),
}

impl Body {
    /// Draws a ray that enters, as under a uniform sky: a point uniform on the surface, a
    /// direction by the cosine.
    pub(super) fn enter(self, stream: &mut Stream) -> Ray {
        let mut signed = || 2.0 * f64::from(stream.uniform()) - 1.0;
        let (a, b, c) = (signed(), signed(), signed());
        let (origin, outwards) = match self {
            Self::Cube(half) => {
                let face = (c.abs() * 3.0).min(2.5);
                let side = 1.0_f64.copysign(c);
                let rotate = |v: DVec3| match () {
                    () if face < 1.0 => v,
                    () if face < 2.0 => DVec3::new(v.z, v.x, v.y),
                    () => DVec3::new(v.y, v.z, v.x),
                };
                (
                    rotate(DVec3::new(a, b, side)) * half,
                    rotate(DVec3::Z * side),
                )
            }
            Self::Ball(radius) => {
                let r = (1.0 - c * c).sqrt();
                let (sin, cos) = (TAU * a).sin_cos();
                let outwards = DVec3::new(r * cos, r * sin, c);
                (outwards * radius, outwards)
            }
        };
        Ray {
            origin,
            direction: cosine_direction(-outwards, stream),
        }
    }

    /// Distance along a ray from inside to the surface.
    fn exit(self, ray: &Ray) -> f64 {
        let Ray { origin, direction } = *ray;
        match self {
            Self::Cube(half) => {
                let along = |o: f64, d: f64| (half.copysign(d) - o) / d;
                let x = along(origin.x, direction.x);
                let y = along(origin.y, direction.y);
                let z = along(origin.z, direction.z);
                x.min(y).min(z).max(0.0)
            }
            Self::Ball(radius) => {
                let b = origin.dot(direction);
                let c = origin.length_squared() - radius * radius;
                (-b + (b * b - c).max(0.0).sqrt()).max(0.0)
            }
        }
    }

    /// 4 V / S.
    fn mean_chord(self) -> f64 {
        match self {
            Self::Cube(half) => 4.0 * half / 3.0,
            Self::Ball(radius) => 4.0 * radius / 3.0,
        }
    }

    pub(super) fn surface(self) -> f64 {
        match self {
            Self::Cube(half) => 24.0 * half * half,
            Self::Ball(radius) => 2.0 * TAU * radius * radius,
        }
    }
}

fn convex(rows: &mut Rows, body: Body, g: f32) {
    const SIGMA_T: f32 = 8.0;
    const PATHS: u64 = 150_000;
    let cloud = volumes::cloud();
    let medium = cloud.medium(SIGMA_T, Rgb::WHITE, phase(g));
    let scatterings = 4.0 / body.surface() * f64::from(SIGMA_T) * cloud.mass();
    let lights = sky(Rgb::WHITE);
    for (name, integrator) in paths::INTEGRATORS {
        let context = Context::new(
            std::slice::from_ref(&medium),
            &lights,
            transport(integrator, None),
        );
        let measured = measure(rows.seed(), PATHS, |stream| {
            let ray = body.enter(stream);
            let _radiance = context.sample_radiance(ray, stream);
            [stream.counts.scattered_rays as f64]
        });
        let name = format!("scatterings, {name}");
        rows.push(Row::mean(
            name,
            scatterings,
            &measured.moments[0],
            &measured.seen,
        ));
    }
    // One set of rows for every estimator, the others for the automatic one.
    let mut estimators = distance_estimators();
    if g != 0.85 {
        estimators.truncate(1);
    }
    for estimator in estimators {
        let measured = measure(rows.seed(), PATHS / 2, |stream| {
            let mut ray = body.enter(stream);
            let mut length = 0.0;
            loop {
                let exit = body.exit(&ray);
                let flight = estimator
                    .tracking
                    .sample_collision(&medium, &ray, exit, stream);
                let Some(t) = flight else {
                    return [length + exit];
                };
                length += t;
                ray = Ray {
                    origin: ray.at(t),
                    direction: medium.phase().sample(ray.direction, stream),
                };
            }
        });
        let name = format!("length, {}", estimator.name);
        rows.push(Row::mean(
            name,
            body.mean_chord(),
            &measured.moments[0],
            &measured.seen,
        ));
    }
}

fn balance(rows: &mut Rows) {
    let cloud = volumes::cloud();
    let albedo = 0.9;
    let medium = cloud.medium(12.0, Rgb::splat(albedo), phase(0.6));
    // What leaves upwards is red, what leaves downwards green.
    let lights = only([
        half_sky(DVec3::Z, Rgb([1.0, 0.0, 0.0])),
        half_sky(DVec3::NEG_Z, Rgb([0.0, 1.0, 0.0])),
    ]);
    let context = |integrator| {
        Context::new(
            std::slice::from_ref(&medium),
            &lights,
            transport(integrator, None),
        )
    };
    let analog = context(IntegratorKind::Analog);
    let camera = |stream: &mut Stream| Body::Cube(1.25).enter(stream);
    let nature = measure(rows.seed(), 400_000, |stream| {
        let ray = camera(stream);
        let [r, t, _] = analog.sample_radiance(ray, stream).radiance.0;
        // The last collision of a path that does not scatter absorbs.
        let absorbed = (stream.counts.real_collisions - stream.counts.scattered_rays) as f64;
        let (r, t) = (f64::from(r), f64::from(t));
        [r + t + absorbed, r, t, absorbed]
    });
    let sum = nature.moments[0];
    let row = Row::exact("analog", 1.0, sum.mean(), &nature.seen);
    rows.push(row.tolerance(2.5e-7, "two roundings of the light's radiance in f32"));
    let path = context(IntegratorKind::Path);
    let weighted = measure(rows.seed(), 250_000, |stream| {
        let ray = camera(stream);
        let [r, t, _] = path.sample_radiance(ray, stream).radiance.0;
        [f64::from(r + t), f64::from(r), f64::from(t)]
    });
    let [_, r, t, a] = nature.moments;
    let [both, path_r, path_t] = weighted.moments;
    let error = both.standard_error().hypot(a.standard_error());
    let seen = nature.seen.and(&weighted.seen);
    let total = both.mean() + a.mean();
    rows.push(Row::statistical(
        "path, A of analog",
        1.0,
        total,
        error,
        &seen,
    ));
    rows.push(Row::same_mean("R, path for analog", &r, &path_r, &seen));
    rows.push(Row::same_mean("T, path for analog", &t, &path_t, &seen));
}

/// What reaches the middle of a dark slab has scattered until its weight is low: roulette that
/// did not raise the weight of the paths it spares would lose 6 % of it.
fn weak_paths(rows: &mut Rows) {
    let medium = volumes::slab().medium(8.0, Rgb::splat(0.6), phase(0.0));
    let ray = Ray {
        origin: DVec3::Z * 0.5,
        direction: DVec3::X,
    };
    let [path, analog] = paths::INTEGRATORS.map(|(_, integrator)| {
        let settings = transport(integrator, None);
        let budget = (rows.seed(), 1_500_000);
        paths::radiance(&medium, &sky(Rgb::WHITE), settings, budget, |_| ray)
    });
    let seen = path.seen.and(&analog.seen);
    let (a, b) = (&analog.moments[0], &path.moments[0]);
    rows.push(Row::same_mean("path for analog", a, b, &seen));
}

#[cfg(test)]
mod tests {
    use glam::DVec4;

    use super::*;
    use crate::verify::measure::stream;

    #[test]
    fn rays_enter_bodies_uniformly() {
        for body in [Body::Cube(1.5), Body::Ball(1.5)] {
            let n = 20_000;
            let (mut mean, mut chord) = (DVec4::ZERO, 0.0);
            for i in 0..n {
                let ray = body.enter(&mut stream(1, i));
                mean += ray.origin.extend(1.0) / n as f64;
                chord += body.exit(&ray) / n as f64;
            }
            // Standard deviations below 1.5: 5 errors are 0.053.
            assert!(mean.truncate().length() < 0.08, "{mean}");
            assert!((chord - body.mean_chord()).abs() < 0.053, "{chord}");
        }
    }
}

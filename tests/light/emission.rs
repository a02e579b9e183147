//! Light that media emit.
//!
//! * Isothermal: a medium in a sky of its own black body's radiance shows that radiance everywhere,
//!   whatever its albedo and density.
//! * A slab that emits and absorbs is `L_e (1 − exp(−τ))`, channel by channel.
//! * Light without density is the integral along the ray.
//! * Path against analog integrator, and points drawn as of a light against chance alone: the same
//!   images, with grids of other resolution and place than the density's.
//! * Two media that emit half each are one that emits the whole.

#![allow(clippy::print_stdout, reason = "what a test can see is printed")]

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use crate::agreement::agree;
use glam::{DAffine3, DVec3, IVec3};
use majorant::blackbody::{Brightness, radiance};
use majorant::camera::Camera;
use majorant::emission::Glow;
use majorant::field::Field;
use majorant::film::Film;
use majorant::grid::{DensityGrid, Tree};
use majorant::integrator::{Context, IntegratorKind, TransportSettings};
use majorant::light::{DistantLight, Lights};
use majorant::medium::Medium;
use majorant::phase::Phase;
use majorant::render::{NoProgress, render};
use majorant::sampling::{SamplerKind, Stream, StreamKey};
use majorant::scene::Scene;
use majorant::space::{IndexTransform, Ray};
use majorant::spectrum::Rgb;
use majorant::tracking::{Tracking, TransmittanceEstimator};

/// A cube of `2 r` voxels of `size`, of what `value` says.
fn grid(r: i32, size: f64, value: impl Fn(IVec3) -> f32) -> Arc<DensityGrid> {
    let n = 2 * r;
    let at = |i: i32| IVec3::new(i / (n * n), i / n % n, i % n) - r;
    let voxels = (0..n * n * n).map(at).map(|p| (p, value(p)));
    let tree = Tree::from_voxels(0.0, voxels.filter(|(_, v)| *v > 0.0));
    let transform = IndexTransform::uniform(size);
    Arc::new(DensityGrid::new(tree, transform, usize::MAX).expect("no limit was set"))
}

fn cloud() -> Arc<DensityGrid> {
    grid(20, 0.06, |p| {
        let q = p.as_vec3();
        let lumps = (q.x * 0.5).sin() * (q.y * 0.4).cos() + (q.z * 0.6).sin();
        1.0 - q.length() / 17.0 + 0.4 * lumps
    })
}

/// A small hot spot near the cloud's face, of finer voxels than the cloud's.
fn spot() -> Field {
    let centre = DVec3::new(3.0, -2.0, 4.0).as_vec3();
    let values = grid(12, 0.025, |p| 1.0 - (p.as_vec3() - centre).length() / 8.0);
    let shift = DAffine3::from_translation(DVec3::new(0.3, -0.75, 0.3));
    Field::scalar(values).moved(shift).expect("a shift")
}

fn scene(media: Vec<Medium>, lights: Lights, integrator: IntegratorKind) -> Scene {
    let eye = DVec3::new(0.5, -4.5, 0.8);
    Scene {
        width: 48,
        height: 32,
        spp: 256,
        seed: 0,
        frame: 0,
        aovs: vec![],
        camera: Camera::look_at(eye, DVec3::ZERO, DVec3::Z, 0.6, 1.5).expect("a view"),
        media,
        lights,
        transport: TransportSettings {
            integrator,
            // Its variance is that of the noise.
            sampler: SamplerKind::Independent,
            ..TransportSettings::default()
        },
    }
}

fn film(mut scene: Scene, seed: u64) -> Film {
    scene.seed = seed;
    let rendered = render(&scene, &NoProgress, &AtomicBool::new(false));
    assert_eq!(rendered.counts.bound_violations, 0, "bounds hold");
    assert_eq!(rendered.counts.non_finite_samples, 0, "samples are finite");
    rendered.film
}

fn sky(environment: Rgb) -> Lights {
    Lights {
        environment,
        ..Lights::default()
    }
}

const KELVIN: f32 = 2200.0;

/// Temperatures of 2,200 K all over and around a cube, in units of 1000 K above 200 K.
fn isothermal() -> Glow {
    let field = Field::scalar(grid(20, 0.06, |_| 2.0));
    Glow::thermal(
        field,
        (1000.0, KELVIN - 2000.0),
        (8.0, Brightness::Spectrum),
    )
}

#[test]
fn an_isothermal_furnace_is_uniform() {
    let inside = grid(16, 0.06, |p| {
        0.6 + 0.4 * (p.as_vec3() * 0.5).element_sum().sin()
    });
    let glow = radiance(KELVIN.into(), Brightness::Spectrum) * 8.0;
    for (sigma_t, albedo, g) in [
        (0.5, Rgb::splat(0.5), 0.0),
        (4.0, Rgb::BLACK, 0.0),
        (4.0, Rgb([0.3, 0.6, 0.9]), 0.6),
        (20.0, Rgb([0.99, 0.9, 0.2]), 0.8),
    ] {
        for kind in [IntegratorKind::Path, IntegratorKind::Analog] {
            let phase = Phase::HenyeyGreenstein { g };
            let medium = Medium::new(Arc::clone(&inside), sigma_t, albedo, phase);
            let medium = medium.glowing(isothermal());
            let film = film(scene(vec![medium], sky(glow), kind), 1);
            let (mean, error) = film.mean();
            for c in 0..3 {
                let expected = f64::from(glow.0[c]);
                let z = (mean[c] - expected) / error[c].max(1e-12);
                let power = 5.0 * error[c] / expected;
                println!(
                    "sigma_t {sigma_t}, albedo {albedo:?}, {kind:?}: z {z:+.2}, sees {power:.1e}"
                );
                // A table of 2 K, and voxels of 16 bit.
                let rounding = 5e-4 * expected;
                assert!(
                    (mean[c] - expected).abs() < 5.0 * error[c] + rounding,
                    "{mean:?}, not {glow:?}"
                );
                assert!(
                    power < 0.02,
                    "this test cannot see a bias of 2 %: {error:?}"
                );
            }
        }
    }
}

/// The mean of samples along one ray, with its standard error.
fn along(media: &[Medium], lights: &Lights, ray: Ray, n: u32) -> ([f64; 3], [f64; 3]) {
    let context = Context::new(media, lights, TransportSettings::default());
    let (mut sum, mut squares) = ([0.0; 3], [0.0; 3]);
    for sample in 0..n {
        let mut stream = Stream::new(StreamKey {
            sample: sample.into(),
            ..StreamKey::default()
        });
        let found = context.sample_radiance(ray, &mut stream);
        for (c, x) in found.radiance.0.map(f64::from).into_iter().enumerate() {
            sum[c] += x;
            squares[c] += x * x;
        }
    }
    let n = f64::from(n);
    let error = |c: usize| ((squares[c] / n - (sum[c] / n).powi(2)).max(0.0) / n).sqrt();
    (sum.map(|s| s / n), std::array::from_fn(error))
}

#[test]
fn a_slab_that_absorbs_emits_what_it_should() {
    let ray = Ray {
        origin: DVec3::new(-4.0, 0.31, 0.17),
        direction: DVec3::new(1.0, 0.02, -0.03).normalize_or_zero(),
    };
    let lights = sky(Rgb::BLACK);
    let glow = radiance(KELVIN.into(), Brightness::Spectrum) * 8.0;
    let inside = grid(16, 0.06, |p| {
        0.6 + 0.4 * (p.as_vec3() * 0.5).element_sum().sin()
    });
    for (sigma_t, n) in [(0.05, 20_000), (1.0, 20_000), (10.0, 200_000)] {
        let medium = Medium::new(Arc::clone(&inside), sigma_t, Rgb::BLACK, Phase::Isotropic);
        let exact = Tracking {
            transmittance: TransmittanceEstimator::Exact,
            ..Tracking::default()
        };
        let mut stream = Stream::new(StreamKey::default());
        let end = f64::INFINITY;
        let through = exact.estimate_transmittance(&medium, &ray, end, 0.0, &mut stream);
        let (mean, error) = along(&[medium.glowing(isothermal())], &lights, ray, n);
        for c in 0..3 {
            let expected = f64::from(glow.0[c]) * (1.0 - f64::from(through));
            let z = (mean[c] - expected) / error[c];
            let power = 5.0 * error[c] / expected;
            println!("sigma_t {sigma_t}, channel {c}: z {z:+.2}, sees {power:.1e}");
            let rounding = 5e-4 * expected;
            assert!(
                (mean[c] - expected).abs() < 5.0 * error[c] + rounding,
                "{mean:?} for {expected}"
            );
            assert!(power < 0.01, "a bias of 1 % would be missed");
        }
    }
}

#[test]
fn light_without_density_is_its_integral() {
    let nothing = Medium::new(cloud(), 0.0, Rgb::splat(0.5), Phase::Isotropic);
    // A tent of voxels: 1 − |x| along any line through the middle of a face, so 1 in all.
    let tent = Field::scalar(grid(3, 1.0, |p| if p == IVec3::ZERO { 1.0 } else { 0.0 }));
    let medium = nothing.glowing(Glow::direct(tent, Rgb([1.0, 2.0, 0.5])));
    for (origin, factor) in [
        (DVec3::new(-9.0, 0.0, 0.0), 1.0),
        (DVec3::new(-9.0, 0.25, 0.5), 0.375),
    ] {
        let ray = Ray {
            origin,
            direction: DVec3::X,
        };
        let (mean, error) = along(std::slice::from_ref(&medium), &sky(Rgb::BLACK), ray, 20_000);
        for (c, colour) in [1.0, 2.0, 0.5].into_iter().enumerate() {
            let expected = factor * colour;
            assert!(
                (mean[c] - expected).abs() < 5.0 * error[c] + 1e-4,
                "{mean:?} for {expected}"
            );
            assert!(
                error[c] < 0.002 * expected,
                "{error:?}: a bias of 1 % would be missed"
            );
        }
    }
}

#[test]
fn path_and_analog_see_the_same_light() {
    let heat = Field::scalar(grid(14, 0.05, |p| 2.5 - p.as_vec3().length() / 20.0));
    let colours = [0.0, 1.0, 2.0].map(|shift: f32| {
        grid(14, 0.07, |p| {
            1.0 - (p.as_vec3() - shift * glam::Vec3::Y).length() / 12.0
        })
    });
    let glows = [
        ("spot", Glow::direct(spot(), Rgb([300.0, 150.0, 60.0]))),
        (
            "colours",
            Glow::direct(Field::colour(colours), Rgb::splat(2.0)),
        ),
        (
            "heat",
            Glow::thermal(heat, (1000.0, 100.0), (20.0, Brightness::Spectrum)),
        ),
    ];
    for (name, glow) in glows {
        for (sigma_t, albedo, g) in [
            (0.4, Rgb([0.9, 0.8, 0.5]), 0.0),
            (8.0, Rgb([0.95, 0.8, 0.4]), 0.6),
            (3.0, Rgb::BLACK, 0.0),
        ] {
            let phase = Phase::HenyeyGreenstein { g };
            let medium = Medium::new(cloud(), sigma_t, albedo, phase).glowing(glow.clone());
            let mut analog = scene(
                vec![medium.clone()],
                sky(Rgb::BLACK),
                IntegratorKind::Analog,
            );
            analog.spp = 4096;
            let a = film(analog, 1);
            let mut path = scene(vec![medium], sky(Rgb::BLACK), IntegratorKind::Path);
            path.spp = 512;
            agree(
                &format!("{name}, sigma_t {sigma_t}, g {g}"),
                0.05,
                &film(path, 2),
                &a,
            );
        }
    }
}

#[test]
fn light_points_change_the_noise_and_not_the_mean() {
    let sun = DistantLight::new(DVec3::new(0.5, -0.5, 0.7), Rgb([3.0, 2.5, 2.0]), 0.0);
    let lights = Lights {
        distant: vec![sun.expect("a sun")],
        environment: Rgb([0.02, 0.03, 0.05]),
        ..Lights::default()
    };
    for g in [0.0, 0.8] {
        let medium = Medium::new(cloud(), 6.0, Rgb::splat(0.9), Phase::HenyeyGreenstein { g });
        let medium = medium.glowing(Glow::direct(spot(), Rgb([300.0, 150.0, 60.0])));
        let image = |is_light: bool, seed| {
            let mut scene = scene(vec![medium.clone()], lights.clone(), IntegratorKind::Path);
            scene.spp = if is_light { 256 } else { 2048 };
            scene.transport.levers.emission_light = is_light;
            film(scene, seed)
        };
        let (by_light, by_chance) = (image(true, 1), image(false, 2));
        agree(
            &format!("sun, sky and spot, g {g}"),
            0.05,
            &by_light,
            &by_chance,
        );
        let variance = |film: &Film| (film.mean().1[0]).powi(2);
        let gain = 8.0 * variance(&by_chance) / variance(&by_light);
        println!("g {g}: {gain:.1} times less variance for as many samples");
        assert!(gain > 1.2, "g {g}: {gain}");
    }
}

#[test]
fn two_media_share_the_light() {
    let half = |part: f32| {
        let medium = Medium::new(cloud(), part * 6.0, Rgb::splat(0.8), Phase::Isotropic);
        medium.glowing(Glow::direct(spot(), Rgb([300.0, 150.0, 60.0]) * part))
    };
    let lights = sky(Rgb::BLACK);
    let one = film(
        scene(vec![half(1.0)], lights.clone(), IntegratorKind::Path),
        1,
    );
    let two = film(
        scene(vec![half(0.25), half(0.75)], lights, IntegratorKind::Path),
        2,
    );
    agree("parts of a light", 0.05, &two, &one);
}

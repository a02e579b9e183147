//! Light transport against closed forms and against itself.
//!
//! * White furnace: albedo 1 in a sky of 1 shows 1 in every pixel, whatever the density.
//! * Slabs: single scattering in closed form; reflection and transmission of multiple
//!   scattering from discrete ordinates, van de Hulst's tabulated value among them.
//! * Analog and path integrator: the same image, sun and sky apart.
//! * One thread or many: the same bits.
//!
//! Every z-test is on fixed seeds at |z| < 5.

#![allow(
    clippy::cast_possible_truncation,
    clippy::cast_possible_wrap,
    clippy::cast_sign_loss,
    clippy::print_stdout,
    reason = "small numbers; what a test can see is printed"
)]

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use glam::{DVec3, IVec3};
use majorant::camera::Camera;
use majorant::grid::{DensityGrid, Tree, TreeBuilder};
use majorant::integrator::{Context, IntegratorKind, TransportSettings};
use majorant::light::{DistantLight, Lights};
use majorant::medium::Medium;
use majorant::phase::Phase;
use majorant::render::{NoProgress, Rendered, render};
use majorant::sampling::{Stream, StreamKey};
use majorant::scene::Scene;
use majorant::space::{IndexTransform, Ray};
use majorant::spectrum::Rgb;
use majorant::tracking::Tracking;

fn grid(tree: Tree<f32>, voxel_size: f64) -> Arc<DensityGrid> {
    let transform = IndexTransform::uniform(voxel_size);
    Arc::new(DensityGrid::new(tree, transform, usize::MAX).expect("no limit was set"))
}

/// A lumpy ball of radius about 20 voxels around the origin, with holes.
fn cloud() -> Arc<DensityGrid> {
    let mut voxels = Vec::new();
    for i in 0..48 * 48 * 48 {
        let p = IVec3::new(i / 2304, i / 48 % 48, i % 48) - 24;
        let q = p.as_vec3();
        let lumps = (q.x * 0.5).sin() * (q.y * 0.4).cos() + (q.z * 0.6).sin();
        let density = 1.0 - q.length() / 20.0 + 0.4 * lumps;
        if density > 0.0 {
            voxels.push((p, density));
        }
    }
    grid(Tree::from_voxels(0.0, voxels), 0.05)
}

/// A box of constant density: closed forms inside, ramps at its faces.
fn cube() -> Arc<DensityGrid> {
    let at = |i: i32| IVec3::new(i / 1024, i / 32 % 32, i % 32) - 16;
    let voxels = (0..32 * 32 * 32).map(|i| (at(i), 1.0));
    grid(Tree::from_voxels(0.0, voxels), 0.05)
}

/// A slab of 4096 × 4096 × 128 voxels between z = 0 and 128, but for half a voxel of ramp.
fn slab() -> Arc<DensityGrid> {
    let mut b = TreeBuilder::new(0.0_f32);
    let node = b.upper_node(IVec3::ZERO);
    for xy in 0..32 * 32 {
        b.set_upper_tile(node, xy << 5, 1.0, true);
    }
    grid(b.finish(vec![], vec![]), 1.0)
}

fn scene(medium: Medium, lights: Lights, transport: TransportSettings) -> Scene {
    let eye = DVec3::new(0.5, -4.0, 0.8);
    let camera = Camera::look_at(eye, DVec3::ZERO, DVec3::Z, 0.7, 1.5).expect("a view");
    Scene {
        width: 48,
        height: 32,
        spp: 64,
        seed: 0,
        frame: 0,
        aovs: vec![],
        camera,
        media: vec![medium],
        lights,
        transport,
    }
}

fn run(scene: &Scene) -> Rendered {
    let rendered = render(scene, &NoProgress, &AtomicBool::new(false));
    assert!(rendered.complete, "not cancelled");
    assert_eq!(rendered.counts.bound_violations, 0, "bounds hold");
    assert_eq!(
        rendered.counts.non_finite_samples, 0,
        "all samples are finite"
    );
    rendered
}

#[test]
fn white_furnaces_are_white() {
    for (name, grid) in [("box", cube()), ("cloud", cloud())] {
        for g in [0.0, 0.85] {
            for integrator in [IntegratorKind::Analog, IntegratorKind::Path] {
                let phase = Phase::HenyeyGreenstein { g };
                let medium = Medium::new(Arc::clone(&grid), 30.0, Rgb::WHITE, phase);
                let lights = Lights {
                    distant: vec![],
                    environment: Rgb::WHITE,
                    ..Lights::default()
                };
                let transport = TransportSettings {
                    integrator,
                    ..TransportSettings::default()
                };
                let rendered = run(&scene(medium, lights, transport));
                // With one radiance everywhere and no absorption each path carries exactly 1.
                let (mean, error) = rendered.film.mean();
                for c in 0..3 {
                    let white = (mean[c] - 1.0).abs() <= 4.0 * error[c] + 1e-12;
                    assert!(white, "{name}, g {g}: {mean:?}");
                    assert!(error[c] < 2e-3, "{name}, g {g}: standard error {error:?}");
                }
                let counts = rendered.counts;
                let bounces = counts.scattered_rays as f64 / counts.camera_rays as f64;
                println!(
                    "{name}, g {g}, {integrator:?}: mean {mean:?} ± {error:?}, {bounces:.1} bounces"
                );
                assert!(
                    bounces > 3.0,
                    "the furnace is thick: {bounces} bounces a path"
                );
            }
        }
    }
}

#[test]
fn analog_and_path_agree_on_sun_and_sky() {
    let sun = |d: f64| DistantLight::new(DVec3::new(0.5, -0.5, 0.7), Rgb([3.0, 2.5, 2.0]), d);
    // A disk of 126 degrees, so that analog paths hit it.
    let sun = sun(2.2).expect("a sun");
    let albedo = Rgb([0.95, 0.8, 0.4]);
    for g in [0.0, 0.6, -0.4] {
        let part = |name: &str, lights: Lights| {
            let medium = Medium::new(cloud(), 12.0, albedo, Phase::HenyeyGreenstein { g });
            let image = |integrator, seed| {
                let transport = TransportSettings {
                    integrator,
                    ..TransportSettings::default()
                };
                let scene = scene(medium.clone(), lights.clone(), transport);
                run(&Scene {
                    seed,
                    spp: 512,
                    ..scene
                })
                .film
            };
            let a = image(IntegratorKind::Analog, 1);
            let b = image(IntegratorKind::Path, 2);
            let ((ma, ea), (mb, eb)) = (a.mean(), b.mean());
            for c in 0..3 {
                let z = (ma[c] - mb[c]) / ea[c].hypot(eb[c]);
                let power = 5.0 * ea[c].hypot(eb[c]) / ma[c];
                println!("{name}, g {g}, channel {c}: z {z:+.2}, smallest bias seen {power:.1e}");
                assert!(
                    z.abs() < 5.0,
                    "{name}, g {g}: {ma:?} ± {ea:?}, {mb:?} ± {eb:?}"
                );
                assert!(power < 0.05, "{name}: this test cannot see a bias of 5 %");
            }
        };
        let sky = Rgb([0.2, 0.3, 0.5]);
        part(
            "sky",
            Lights {
                distant: vec![],
                environment: sky,
                ..Lights::default()
            },
        );
        part(
            "sun",
            Lights {
                distant: vec![sun],
                environment: Rgb::BLACK,
                ..Lights::default()
            },
        );
    }
}

#[test]
fn single_scattering_in_a_slab_is_the_closed_form() {
    // L = F / (4π (1 + μ)) (1 − e^(−τ(1 + 1/μ))) for albedo 1, sun and camera on one side.
    let medium = Medium::new(slab(), 1.0 / 128.0, Rgb::WHITE, Phase::Isotropic);
    let sun = DistantLight::new(DVec3::Z, Rgb::WHITE, 0.0).expect("a sun");
    let lights = Lights {
        distant: vec![sun],
        environment: Rgb::BLACK,
        ..Lights::default()
    };
    let settings = TransportSettings {
        integrator: IntegratorKind::Path,
        max_bounces: Some(1),
        ..TransportSettings::default()
    };
    let context = Context::new(std::slice::from_ref(&medium), &lights, settings);
    for (mu, expected) in [(1.0_f64, 0.0344039), (0.5, 0.0504104)] {
        let direction = DVec3::new((1.0 - mu * mu).sqrt(), 0.0, -mu);
        let origin = DVec3::new(2000.0, 2000.0, 64.0) - direction * 500.0;
        let n = 1_600_000;
        let (mut sum, mut square) = (0.0, 0.0);
        for sample in 0..n {
            let mut stream = Stream::new(StreamKey {
                sample,
                ..StreamKey::default()
            });
            let ray = Ray { origin, direction };
            let x = context.sample_radiance(ray, &mut stream).radiance.0[0];
            sum += f64::from(x);
            square += f64::from(x).powi(2);
        }
        let n = n as f64;
        let mean = sum / n;
        let error = ((square / n - mean * mean) / n).sqrt();
        let z = (mean - expected) / error;
        println!("mu {mu}: {mean:.6}, expected {expected}, z {z:+.2}, error {error:.1e}");
        assert!(
            z.abs() < 5.0,
            "mu {mu}: {mean} ± {error}, expected {expected}"
        );
        assert!(error < 1e-3 * mean, "this test cannot see a bias of 0.5 %");
    }
}

#[test]
fn slabs_reflect_and_transmit_what_discrete_ordinates_say() {
    // (g, τ, albedo, R, T) for normal incidence; the third is van de Hulst's.
    let table = [
        (0.0, 1.0, 0.9, 0.267410, 0.591625),
        (0.0, 4.0, 1.0, 0.690926, 0.309074),
        (0.75, 2.0, 0.9, 0.097395, 0.660958),
        (0.85, 4.0, 1.0, 0.190915, 0.809085),
        (0.85, 16.0, 0.99, 0.417722, 0.306103),
    ];
    let grid = slab();
    for (g, tau, albedo, reflected, transmitted) in table {
        let phase = if g == 0.0 {
            Phase::Isotropic
        } else {
            Phase::HenyeyGreenstein { g }
        };
        let medium = Medium::new(Arc::clone(&grid), tau / 128.0, Rgb::WHITE, phase);
        let n = 200_000;
        let (mut up, mut down) = (Vec::with_capacity(n), Vec::with_capacity(n));
        for sample in 0..n as u64 {
            let mut stream = Stream::new(StreamKey {
                seed: 7,
                sample,
                ..StreamKey::default()
            });
            let tracking = Tracking::default();
            let origin = DVec3::new(2048.0, 2048.0, 1000.0);
            let mut ray = Ray {
                origin,
                direction: DVec3::NEG_Z,
            };
            let mut weight = 1.0_f64;
            let end = f64::INFINITY;
            while let Some(t) = tracking.sample_collision(&medium, &ray, end, &mut stream) {
                weight *= albedo;
                let direction = medium.phase().sample(ray.direction, &mut stream);
                ray = Ray {
                    origin: ray.at(t),
                    direction,
                };
            }
            up.push(if ray.direction.z > 0.0 { weight } else { 0.0 });
            down.push(if ray.direction.z > 0.0 { 0.0 } else { weight });
        }
        for (name, xs, expected) in [("R", up, reflected), ("T", down, transmitted)] {
            let n = xs.len() as f64;
            let mean = xs.iter().sum::<f64>() / n;
            let variance = xs.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / n;
            let z = (mean - expected) / (variance / n).sqrt();
            println!("g {g}, tau {tau}, albedo {albedo}: {name} {mean:.5}, z {z:+.2}");
            assert!(
                z.abs() < 5.0,
                "g {g}, tau {tau}: {name} is {mean}, expected {expected}"
            );
        }
    }
}

/// In the middle of a dark slab of optical thickness 8, weak paths bring a part of the light: if
/// roulette did not raise the weight of those it spares, 6.4 % would be missing.
#[test]
fn weak_paths_are_not_lost() {
    let albedo = Rgb::splat(0.6);
    let medium = Medium::new(slab(), 8.0 / 128.0, albedo, Phase::Isotropic);
    let lights = Lights {
        distant: vec![],
        environment: Rgb::WHITE,
        ..Lights::default()
    };
    let measure = |integrator, seed| {
        let settings = TransportSettings {
            integrator,
            ..TransportSettings::default()
        };
        let context = Context::new(std::slice::from_ref(&medium), &lights, settings);
        let origin = DVec3::new(2048.0, 2048.0, 64.0);
        let ray = Ray {
            origin,
            direction: DVec3::X,
        };
        let n = 1_600_000;
        let (mut sum, mut square) = (0.0, 0.0);
        for sample in 0..n {
            let key = StreamKey {
                seed,
                sample,
                ..StreamKey::default()
            };
            let mut stream = Stream::new(key);
            let sample = context.sample_radiance(ray, &mut stream);
            let x = f64::from(sample.radiance.0[0]);
            sum += x;
            square += x * x;
        }
        let n = n as f64;
        (sum / n, ((square / n - (sum / n).powi(2)) / n).sqrt())
    };
    let (analog, analog_error) = measure(IntegratorKind::Analog, 1);
    let (path, path_error) = measure(IntegratorKind::Path, 2);
    let error = analog_error.hypot(path_error);
    let z = (analog - path) / error;
    let power = 5.0 * error / analog;
    println!("analog {analog:.5}, path {path:.5}, z {z:+.2}, smallest bias seen {power:.1e}");
    assert!(z.abs() < 5.0, "analog {analog}, path {path} ± {error}");
    assert!(power < 0.05, "this test cannot see a bias of 5 %");
}

#[test]
fn images_are_the_same_bits_for_any_number_of_threads() {
    let sun = DistantLight::new(DVec3::Z, Rgb::WHITE, 0.01).expect("a sun");
    let lights = Lights {
        distant: vec![sun],
        environment: Rgb([0.1, 0.2, 0.3]),
        ..Lights::default()
    };
    let medium = Medium::new(
        cloud(),
        12.0,
        Rgb::splat(0.9),
        Phase::HenyeyGreenstein { g: 0.7 },
    );
    let scene = scene(medium, lights, TransportSettings::default());
    let with = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .expect("a pool");
        pool.install(|| run(&scene))
    };
    let (one, three) = (with(1), with(3));
    assert_eq!(one.film, three.film);
    assert_eq!(one.counts, three.counts);
    let other = run(&Scene { seed: 1, ..scene });
    assert_ne!(one.film, other.film, "another seed is another image");
}

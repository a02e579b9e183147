//! Extinction with a colour: closed forms, the analog integrator and less cunning flights.

#![allow(
    clippy::cast_possible_wrap,
    clippy::print_stdout,
    reason = "small numbers; what a test can see is printed"
)]

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use glam::{DAffine3, DVec3, IVec3};
use majorant::camera::Camera;
use majorant::film::Film;
use majorant::grid::{DensityGrid, Tree, TreeBuilder};
use majorant::integrator::{Context, IntegratorKind, TransportSettings};
use majorant::light::{DistantLight, Lights, LocalLight};
use majorant::medium::Medium;
use majorant::phase::Phase;
use majorant::render::{NoProgress, render};
use majorant::sampling::{Stream, StreamKey};
use majorant::scene::Scene;
use majorant::space::{IndexTransform, Ray};
use majorant::spectrum::Rgb;
use majorant::stats::Counts;
use majorant::tracking::Tracking;

fn grid(tree: Tree<f32>, voxel_size: f64) -> Arc<DensityGrid> {
    let transform = IndexTransform::uniform(voxel_size);
    Arc::new(DensityGrid::new(tree, transform, usize::MAX).expect("no limit was set"))
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

/// A lumpy ball of radius about 20 voxels, one unit, around the origin, with holes.
fn cloud() -> Arc<DensityGrid> {
    let voxels = (0..48 * 48 * 48).filter_map(|i| {
        let p = IVec3::new(i / 2304, i / 48 % 48, i % 48) - 24;
        let q = p.as_vec3();
        let lumps = (q.x * 0.5).sin() * (q.y * 0.4).cos() + (q.z * 0.6).sin();
        let density = 1.0 - q.length() / 20.0 + 0.4 * lumps;
        (density > 0.0).then_some((p, density))
    });
    grid(Tree::from_voxels(0.0, voxels), 0.05)
}

/// Mean and standard error of each channel of what comes along `ray`.
fn measure(
    media: &[Medium],
    lights: &Lights,
    settings: TransportSettings,
    ray: Ray,
    n: u32,
) -> ([f64; 3], [f64; 3]) {
    let context = Context::new(media, lights, settings);
    let (mut sum, mut square) = ([0.0; 3], [0.0; 3]);
    for sample in 0..n {
        let mut stream = Stream::new(StreamKey {
            sample: sample.into(),
            ..StreamKey::default()
        });
        let x = context.sample_radiance(ray, &mut stream).radiance;
        for c in 0..3 {
            sum[c] += f64::from(x.0[c]);
            square[c] += f64::from(x.0[c]).powi(2);
        }
    }
    let n = f64::from(n);
    let mean = sum.map(|s| s / n);
    let error = std::array::from_fn(|c| ((square[c] / n - mean[c] * mean[c]) / n).max(0.0).sqrt());
    (mean, error)
}

/// A slab of extinctions 0.1, 1 and 10, lit once from above: what shines through along a slanted ray,
/// and what is scattered once towards it. The noise is that of the analog integrator's single channel
/// beside it.
#[test]
fn a_slab_of_three_extinctions_is_three_slabs() {
    let tau = [0.1, 1.0, 10.0];
    let slab = Medium::new(slab(), 1.0 / 128.0, Rgb::WHITE, Phase::Isotropic);
    let slab = [slab.with_extinction_color(Rgb([0.1, 1.0, 10.0]))];
    let mu = 0.8_f64;
    let direction = DVec3::new((1.0 - mu * mu).sqrt(), 0.0, -mu);
    let ray = Ray {
        origin: DVec3::new(2000.0, 2000.0, 64.0) - direction * 500.0,
        direction,
    };
    // Through: a sky of 1 that is not scattered.
    let sky = Lights {
        environment: Rgb::WHITE,
        ..Lights::default()
    };
    let cap = |n| TransportSettings {
        max_bounces: Some(n),
        ..TransportSettings::default()
    };
    let analog = TransportSettings {
        integrator: IntegratorKind::Analog,
        ..cap(0)
    };
    let (through, error) = measure(&slab, &sky, cap(0), ray, 20_000);
    let (_, naive) = measure(&slab, &sky, analog, ray, 20_000);
    println!("through: {through:?} ± {error:?}, by single channels ± {naive:?} as measured");
    for c in 0..3 {
        let expected = (-tau[c] / mu).exp();
        let z = (through[c] - expected) / error[c].max(1e-5 * expected);
        println!("  channel {c}: expected {expected:.6}, z {z:+.2}");
        // The ramps of half a voxel, in which it is ratio tracking, are worth 1 % of the slab.
        assert!(z.abs() < 4.0, "channel {c}: {through:?}, not {expected}");
        // A single channel brings 3 with a third of the probability; the last is so rare that none
        // may have come through here.
        let naive = ((3.0 * expected - expected * expected) / 20_000.0).sqrt();
        println!("  ± {:.1e}, by single channels ± {naive:.1e}", error[c]);
        assert!(
            error[c] < 0.1 * naive,
            "channel {c}: as noisy as single channels"
        );
    }
    // Scattered once: L = F / (4π (1 + μ)) (1 − e^(−τ(1 + 1/μ))).
    let sun = DistantLight::new(DVec3::Z, Rgb::WHITE, 0.0).expect("a sun");
    let lights = Lights {
        distant: vec![sun],
        ..Lights::default()
    };
    let (once, error) = measure(&slab, &lights, cap(1), ray, 1_000_000);
    for c in 0..3 {
        let f = 1.0 / (4.0 * std::f64::consts::PI * (1.0 + mu));
        let expected = f * (1.0 - (-tau[c] * (1.0 + 1.0 / mu)).exp());
        let z = (once[c] - expected) / error[c];
        println!(
            "scattered once, channel {c}: {:.6}, expected {expected:.6}, z {z:+.2}",
            once[c]
        );
        assert!(
            z.abs() < 4.0,
            "channel {c}: {once:?} ± {error:?}, not {expected}"
        );
        assert!(
            error[c] < 3e-3 * once[c],
            "channel {c}: sees ± {error:?} at best"
        );
    }
}

/// The third channel has no extinction at all: exactly the sky, without noise, however thick the
/// others are; and none of the sun's light is scattered in it.
#[test]
fn a_channel_without_extinction_is_exact() {
    let sun = DistantLight::new(DVec3::new(0.5, -0.5, 0.7), Rgb::splat(3.0), 0.0).expect("a sun");
    let lights = Lights {
        distant: vec![sun],
        environment: Rgb([0.3, 0.4, 0.5]),
        ..Lights::default()
    };
    for sigma_t in [1.0, 30.0] {
        let medium = Medium::new(cloud(), sigma_t, Rgb::splat(0.95), Phase::Isotropic);
        let medium = medium.with_extinction_color(Rgb([1.0, 0.1, 0.0]));
        let film = film(&scene(vec![medium], lights.clone()));
        for pixel in film.pixels() {
            let (mean, variance) = (pixel.mean[2], pixel.variance_of_mean()[2]);
            assert!((mean - 0.5).abs() < 1e-6, "not the sky: {mean}");
            assert!(variance < 1e-12, "noise: {variance}");
        }
    }
}

fn scene(media: Vec<Medium>, lights: Lights) -> Scene {
    let eye = DVec3::new(0.5, -4.0, 0.8);
    Scene {
        width: 36,
        height: 24,
        spp: 256,
        seed: 0,
        frame: 0,
        aovs: vec![],
        camera: Camera::look_at(eye, DVec3::ZERO, DVec3::Z, 0.7, 1.5).expect("a view"),
        media,
        lights,
        transport: TransportSettings::default(),
    }
}

fn film(scene: &Scene) -> Film {
    let rendered = render(scene, &NoProgress, &AtomicBool::new(false));
    assert_eq!(rendered.counts.bound_violations, 0, "bounds hold");
    assert_eq!(
        rendered.counts.non_finite_samples, 0,
        "all samples are finite"
    );
    rendered.film
}

fn agree(name: &str, a: &Film, b: &Film) {
    let ((ma, ea), (mb, eb)) = (a.mean(), b.mean());
    for c in 0..3 {
        let error = ea[c].hypot(eb[c]);
        let (z, power) = ((ma[c] - mb[c]) / error, 5.0 * error / ma[c]);
        println!("{name}, channel {c}: z {z:+.2}, smallest bias seen {power:.1e}");
        assert!(z.abs() < 5.0, "{name}: {ma:?} ± {ea:?}, {mb:?} ± {eb:?}");
        assert!(power < 0.06, "{name}: sees {power} at best");
    }
}

/// Sun, sky and sphere, thin and thick, one volume and two that overlap: the same image as of single
/// channels by chance.
#[test]
fn analog_and_path_agree() {
    let broad = DistantLight::new(DVec3::new(0.5, -0.5, 0.7), Rgb([3.0, 2.5, 2.0]), 2.2);
    let sphere = LocalLight::sphere(DVec3::new(0.2, -0.3, 0.1), 0.3, Rgb([2.0, 3.0, 4.0]));
    let lights = Lights {
        distant: vec![broad.expect("a sun")],
        environment: Rgb([0.2, 0.3, 0.4]),
        local: vec![sphere.expect("a sphere")],
        ..Lights::default()
    };
    let hg = Phase::HenyeyGreenstein { g: 0.6 };
    for sigma_t in [0.5, 8.0] {
        let dyed = |color, phase| {
            let medium = Medium::new(cloud(), sigma_t, Rgb([0.95, 0.9, 0.8]), phase);
            medium.with_extinction_color(Rgb(color))
        };
        let first = dyed([1.0, 0.4, 0.05], hg);
        let second = dyed([0.1, 0.3, 0.9], Phase::Isotropic);
        let moved = DAffine3::from_translation(DVec3::new(0.3, 0.2, -0.1));
        let second = second.moved(moved).expect("a map");
        for media in [vec![first.clone()], vec![first, second]] {
            let name = format!("extinction {sigma_t}, {} media", media.len());
            let mut analog = scene(media.clone(), lights.clone());
            (analog.seed, analog.spp) = (1, 2048);
            analog.transport.integrator = IntegratorKind::Analog;
            let path = Scene {
                seed: 2,
                ..scene(media, lights.clone())
            };
            agree(&name, &film(&analog), &film(&path));
        }
    }
}

/// The same extinction in every channel is gray, and its colour then only a factor.
#[test]
fn an_even_colour_is_gray() {
    let medium = Medium::new(cloud(), 4.0, Rgb::splat(0.9), Phase::Isotropic);
    let even = medium.with_extinction_color(Rgb::splat(2.5));
    assert!(!even.is_chromatic(), "gray media keep their kernel");
    assert_eq!(even.sigma_t_per_density(), 10.0);
    let none = medium.with_extinction_color(Rgb::BLACK);
    assert_eq!(
        (none.sigma_t_per_density(), none.is_chromatic()),
        (0.0, false)
    );
}

/// One voxel of an optical depth of 1e6 in a haze of 0.05 a voxel: the channel that meets least sees
/// 1e2 of the former, or nothing at all.
///
/// Flights and expected flights must leave with the transmittance of each channel and collide where
/// that of each channel falls, in a number of steps that the voxels bound: at 1e6 tentative collisions
/// a voxel they would take that many.
#[test]
fn a_spike_costs_its_voxels_and_no_more() {
    let range = 0..16 * 16 * 16;
    let voxels = range.map(|i| (IVec3::new(i / 256, i / 16 % 16, i % 16) - 8, 0.05));
    let spike = voxels.map(|(p, v)| (p, if p == IVec3::ZERO { 1e6 } else { v }));
    let gray = Medium::new(
        grid(Tree::from_voxels(0.0, spike), 1.0),
        1.0,
        Rgb::WHITE,
        Phase::Isotropic,
    );
    // Past the spike at a distance of almost a voxel: a depth of some 1, 1e2 and 1e5.
    for (beside, tint) in [
        (1.0 - 1e-6, Rgb([1.0, 0.1, 0.0])),
        (1.0 - 1e-3, Rgb([1.0, 1e-3, 1e-4])),
        (0.5, Rgb([1.0, 1e-6, 0.0])),
    ] {
        let medium = gray.with_extinction_color(tint);
        let ray = Ray {
            origin: DVec3::new(-30.0, beside, 0.0),
            direction: DVec3::X,
        };
        // What is left of each channel after this distance, and at the end.
        let middle = 30.0 - 0.5;
        let depth = |t_max| {
            let mut walk = gray.ray(&ray, t_max);
            let mut depth = 0.0;
            while walk.next_segment().is_some() {
                depth += walk.optical_depth(&mut Counts::default());
            }
            depth
        };
        let left = |t_max| tint.0.map(|tint| (-f64::from(tint) * depth(t_max)).exp());
        let expected = [left(middle), left(f64::INFINITY)];
        let (n, tracking) = (200_000, Tracking::default());
        let mut counts = Counts::default();
        // [way][place]: weights of what got further.
        let mut sums = [[[0.0; 3]; 2]; 2];
        let mut squares = sums;
        for sample in 0..n {
            let mut stream = Stream::new(StreamKey {
                sample,
                ..StreamKey::default()
            });
            let mut weights = Rgb::WHITE;
            let place = (&medium, &ray, f64::INFINITY);
            let t = tracking.chromatic_collision(place, &mut weights, None, &mut stream);
            let flight = tracking.chromatic_flight(&medium, &ray, 0.1, &mut stream);
            counts.add(&stream.counts);
            let beyond = |t: f64| if t > middle { 1.0 } else { 0.0 };
            let by_chance = [
                weights * t.map_or(1.0, beyond),
                weights * if t.is_none() { 1.0 } else { 0.0 },
            ];
            let later = flight.collision.map_or(Rgb::BLACK, |(t, w)| w * beyond(t));
            let by_weight = [flight.transmittance + later, flight.transmittance];
            for (way, found) in [by_chance, by_weight].into_iter().enumerate() {
                for (place, weights) in found.into_iter().enumerate() {
                    for (c, x) in weights.0.map(f64::from).into_iter().enumerate() {
                        sums[way][place][c] += x;
                        squares[way][place][c] += x * x;
                    }
                }
            }
        }
        let n = n as f64;
        for (way, place, c) in (0..12).map(|i| (i / 6, i / 3 % 2, i % 3)) {
            let (mean, expected) = (sums[way][place][c] / n, expected[place][c]);
            let error = ((squares[way][place][c] / n - mean * mean).max(0.0) / n).sqrt();
            println!(
                "beside {beside}, way {way}, place {place}, channel {c}: {mean:.5} ± {error:.1e}, \
                 expected {expected:.5}"
            );
            // f32, and bounds of 16 bit around the spike.
            let off = (mean - expected).abs();
            assert!(off < 5.0 * error + 1e-4, "{mean} ± {error}, not {expected}");
            assert!(error < 4e-3, "a bias of 0.02 would be missed: {error}");
        }
        let steps = counts.tentative_collisions + counts.voxel_cells;
        let steps = steps as f64 / n;
        println!("  {steps:.0} steps for both");
        assert!(steps < 400.0, "{steps} steps through 16 voxels");
    }
}

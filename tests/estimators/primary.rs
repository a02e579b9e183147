//! The camera ray: its collisions by expectation, transmittances alone, pixels beside the medium,
//! and the numbers of a low-discrepancy sequence.
//!
//! Every z-test is on fixed seeds at |z| < 5.

#![allow(
    clippy::cast_possible_truncation,
    clippy::print_stdout,
    reason = "small numbers; what a test can see is printed"
)]

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use glam::{DAffine3, DVec2, DVec3, IVec3};
use majorant::camera::Camera;
use majorant::film::Pixel;
use majorant::grid::{DensityGrid, Tree, TreeBuilder};
use majorant::integrator::{CameraRay, TransportSettings};
use majorant::light::{DistantLight, Lights};
use majorant::medium::Medium;
use majorant::phase::Phase;
use majorant::render::{NoProgress, Rendered, render};
use majorant::sampling::{Number, PixelStreams, SamplerKind, Stream, StreamKey};
use majorant::scene::Scene;
use majorant::silhouette::Silhouette;
use majorant::space::{IndexTransform, Ray};
use majorant::spectrum::Rgb;
use majorant::tracking::{
    BoundsKind, DistanceEstimator, ExpectedChoice, Tracking, TransmittanceEstimator,
};

/// A lumpy ball of radius about 20 voxels around the origin, with holes.
fn lumps() -> Tree<f32> {
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
    Tree::from_voxels(0.0, voxels)
}

/// Tiles of 128³ voxels of density 1 in the plane y = 0: homogeneous segments.
fn tiles() -> Tree<f32> {
    let mut b = TreeBuilder::new(0.0_f32);
    let node = b.upper_node(IVec3::ZERO);
    for x in 0..4 {
        b.set_upper_tile(node, x << 10, 1.0, true);
    }
    b.finish(vec![], vec![])
}

fn medium(tree: Tree<f32>, voxel_size: f64, sigma_t: f32, albedo: Rgb) -> Medium {
    let transform = IndexTransform::uniform(voxel_size);
    let grid = DensityGrid::new(tree, transform, usize::MAX).expect("no limit was set");
    let phase = Phase::HenyeyGreenstein { g: 0.5 };
    Medium::new(Arc::new(grid), sigma_t, albedo, phase)
}

/// Returns a direction of length 1.
fn unit(d: DVec3) -> DVec3 {
    d.try_normalize().expect("a direction")
}

/// The walk's transmittance has the mean exp(−τ), and its collisions, with their weights, are
/// distributed as real ones: the weight that falls into each of eight intervals of equal length is
/// the difference of exact transmittances at its ends.
///
/// 2¹⁶ walks: sees 2 % of an interval's share where it is 0.1. The weights of a walk add up to 1.
#[test]
#[expect(clippy::too_many_lines, reason = "one case after the other")]
fn expected_flights_have_the_distribution_of_real_ones() {
    const CELLS: usize = 8;
    let slab = Ray {
        origin: DVec3::new(-0.3, 0.4, 0.5),
        direction: unit(DVec3::new(0.99, 0.08, 0.02)),
    };
    let through = Ray {
        origin: DVec3::new(0.2, -3.0, 0.15),
        direction: unit(DVec3::new(-0.03, 1.0, -0.04)),
    };
    let cases = [
        (
            "tiles",
            medium(tiles(), 0.01, 1.5, Rgb::WHITE),
            slab,
            0.0,
            5.5,
        ),
        (
            "thin",
            medium(lumps(), 0.05, 1.0, Rgb::WHITE),
            through,
            1.5,
            4.5,
        ),
        (
            "thick",
            medium(lumps(), 0.05, 12.0, Rgb::WHITE),
            through,
            1.5,
            4.5,
        ),
    ];
    let mut runs = Vec::new();
    for below in [0.0, 0.1, 0.7, 1.0] {
        for (bounds, rate) in [(BoundsKind::Brick, 1.0), (BoundsKind::Global, 2.5)] {
            for distance in [DistanceEstimator::Auto, DistanceEstimator::Delta] {
                let tracking = Tracking {
                    bounds,
                    distance,
                    ..Tracking::default()
                };
                runs.push((below, rate, tracking));
            }
        }
    }
    for (name, medium, ray, start, end) in cases {
        let exact = Tracking {
            transmittance: TransmittanceEstimator::Exact,
            ..Tracking::default()
        };
        let mut stream = Stream::new(StreamKey::default());
        let mut at = |t: f64| {
            let t = exact.estimate_transmittance(&medium, &ray, t, 0.0, &mut stream);
            f64::from(t)
        };
        let step = (end - start) / CELLS as f64;
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "t is not before the start"
        )]
        let cell_of = |t: f64| (((t - start) / step) as usize).min(CELLS - 1);
        let mut expected = [0.0; CELLS + 1];
        for (i, share) in expected.iter_mut().enumerate().take(CELLS) {
            let i = i as f64;
            *share = at(start + i * step) - at(start + (i + 1.0) * step);
        }
        expected[CELLS] = at(f64::INFINITY);
        let total: f64 = expected.iter().sum();
        assert!(
            (total - 1.0).abs() < 1e-6,
            "{name}: all is between {start} and {end}"
        );
        for (k, &(analog_below, rate, tracking)) in runs.iter().enumerate() {
            let mut stream = Stream::new(StreamKey::default());
            let n = 1 << 16;
            let (mut sum, mut square) = ([0.0; CELLS + 1], [0.0; CELLS + 1]);
            for pixel in 0..n {
                // A sample of a pixel, as a frame draws it: the numbers of its sequence are
                // independent among pixels.
                let streams = PixelStreams::new(1 + k as u64, 0, pixel, SamplerKind::Sobol);
                streams.start(5, &mut stream);
                let choice = ExpectedChoice {
                    rate,
                    analog_below,
                    number: stream.number(Number::Collision),
                };
                let flight = tracking.expected_flight(&medium, &ray, choice, &mut stream);
                let through = f64::from(flight.transmittance);
                assert!((0.0..=1.0).contains(&through), "{name}: {flight:?}");
                let mut x = [0.0; CELLS + 1];
                x[CELLS] = through;
                if let Some(t) = flight.collision {
                    x[cell_of(t)] = 1.0 - through;
                }
                for i in 0..=CELLS {
                    sum[i] += x[i];
                    square[i] += x[i] * x[i];
                }
            }
            assert_eq!(stream.counts.bound_violations, 0, "bounds hold");
            for i in 0..=CELLS {
                let n = n as f64;
                let mean = sum[i] / n;
                let mut error = ((square[i] / n - mean * mean) / n).sqrt();
                // Of few collisions the error is not known from them: once in 800 times there is one
                // where 9 are expected. It is at most that of flights that are drawn one by one.
                if expected[i] * n < 30.0 {
                    error = error.max((expected[i] / n).sqrt());
                }
                // Less than a collision in all is not seen, nor its error known.
                let z = (mean - expected[i]).abs() - 1.0 / n;
                assert!(
                    z <= 5.0 * error,
                    "{name}, analog below {analog_below}, rate {rate}, {tracking:?}, interval {i}: {mean} ± {error}, not {}",
                    expected[i]
                );
            }
        }
    }
}

fn scene(medium: Medium, lights: Lights, camera_ray: CameraRay, sampler: SamplerKind) -> Scene {
    let eye = DVec3::new(0.5, -4.0, 0.8);
    Scene {
        width: 48,
        height: 32,
        spp: 64,
        seed: 0,
        frame: 0,
        aovs: vec![],
        camera: Camera::look_at(eye, DVec3::ZERO, DVec3::Z, 0.7, 1.5).expect("a view"),
        media: vec![medium],
        lights,
        transport: TransportSettings {
            camera_ray,
            sampler,
            ..TransportSettings::default()
        },
    }
}

fn run(scene: &Scene) -> Rendered {
    let rendered = render(scene, &NoProgress, &AtomicBool::new(false));
    assert!(rendered.complete, "not cancelled");
    let counts = rendered.counts;
    assert_eq!(counts.bound_violations, 0, "bounds hold");
    assert_eq!(counts.non_finite_samples, 0, "all samples are finite");
    rendered
}

fn sun() -> Lights {
    let direction = DVec3::new(0.55, -0.45, 0.7);
    let sun = DistantLight::new(direction, Rgb([6.0, 5.0, 4.0]), 0.0).expect("a direction");
    Lights {
        distant: vec![sun],
        environment: Rgb::BLACK,
        ..Lights::default()
    }
}

fn sky() -> Lights {
    Lights {
        distant: vec![],
        environment: Rgb([0.3, 0.45, 0.75]),
        ..Lights::default()
    }
}

/// Sums of the pixels of 8 × 8 blocks of two images, and of both: no |z| above 5, and z² is on
/// average 1. Blocks where the first, analog, image has few collisions count for the whole only.
fn agree(what: &str, a: &Rendered, b: &Rendered) {
    let width = a.film.width() as usize;
    let blocks = a.film.pixels().len() / 64;
    let mut all = [[0.0; 2]; 3];
    let (mut squares, mut count) = (0.0, 0.0);
    for block in 0..blocks {
        let corner = block % (width / 8) * 8 + block / (width / 8) * 8 * width;
        for (c, all) in all.iter_mut().enumerate() {
            let (mut difference, mut variance, mut hits) = (0.0, 0.0, 0.0);
            for i in 0..64 {
                let at = corner + i % 8 + i / 8 * width;
                let (p, q): (&Pixel, &Pixel) = (&a.film.pixels()[at], &b.film.pixels()[at]);
                difference += p.mean[c] - q.mean[c];
                hits += p.opacity;
                variance += p.variance_of_mean()[c] + q.variance_of_mean()[c];
            }
            all[0] += difference;
            all[1] += variance;
            // Of fewer collisions the first image's variance is hardly known: not one in empty
            // blocks.
            if hits < 100.0 {
                continue;
            }
            let z = difference / f64::sqrt(variance);
            assert!(z.abs() < 5.0, "{what}, block {block}, channel {c}: z = {z}");
            squares += z * z;
            count += 1.0;
        }
    }
    for (c, [difference, variance]) in all.into_iter().enumerate() {
        let z = difference / f64::sqrt(variance);
        println!(
            "{what}, channel {c}: z = {z:.2}, mean z² {:.2} of {count}",
            squares / count
        );
        assert!(z.abs() < 5.0, "{what}, channel {c}: z = {z}");
    }
    let chi2 = (squares / count - 1.0) / (2.0_f64 / count).sqrt();
    assert!(chi2.abs() < 5.0, "{what}: mean z² is {}", squares / count);
}

/// Sun and sky apart, thin and thick, block by block. The image's mean is good to 0.2 to 0.5 %.
#[test]
fn expected_and_analog_camera_rays_agree() {
    for (lights_name, lights) in [("sun", sun()), ("sky", sky())] {
        for sigma_t in [0.5, 8.0] {
            let of = |camera_ray, seed| {
                let albedo = Rgb([0.9, 0.6, 0.3]);
                let medium = medium(lumps(), 0.05, sigma_t, albedo);
                run(&Scene {
                    seed,
                    spp: 256,
                    ..scene(medium, lights.clone(), camera_ray, SamplerKind::Independent)
                })
            };
            let (a, b) = (of(CameraRay::Analog, 1), of(CameraRay::Expected, 2));
            agree(&format!("{lights_name}, extinction {sigma_t}"), &a, &b);
            let alpha = |r: &Rendered| r.film.pixels().iter().map(Pixel::alpha).sum::<f64>();
            let (a, b) = (alpha(&a), alpha(&b));
            // The analog one: at most sqrt(p (1 − p) / 256 / pixels) = 8e-4 of all pixels, 5 sigma.
            assert!(
                (a - b).abs() < 5.0 * 8e-4 * 48.0 * 32.0,
                "opacities {a}, {b}"
            );
        }
    }
}

/// Where nothing scatters the image is the transmittance: the same as by delta tracking, without
/// any collision drawn for it, and with opacity and depth.
#[test]
fn absorbing_media_are_their_transmittance() {
    for sigma_t in [0.7, 6.0] {
        let of = |camera_ray, seed| {
            let medium = medium(lumps(), 0.05, sigma_t, Rgb::BLACK);
            run(&Scene {
                seed,
                spp: 256,
                ..scene(medium, sky(), camera_ray, SamplerKind::Independent)
            })
        };
        let (a, b) = (of(CameraRay::Analog, 1), of(CameraRay::Auto, 2));
        assert_eq!(b.counts.scattered_rays, 0, "nothing scatters");
        agree(&format!("absorption, extinction {sigma_t}"), &a, &b);
        // Depth where both know it well: the ball is 1 deep, seen from 4.
        let mut seen = 0;
        for (p, q) in a.film.pixels().iter().zip(b.film.pixels()) {
            if p.alpha() > 0.5 && q.depth_weight > 0.0 {
                assert!(
                    (p.alpha() - q.alpha()).abs() < 0.2,
                    "opacities {p:?}, {q:?}"
                );
                assert!(
                    (p.depth_mean - q.depth_mean).abs() < 1.5,
                    "depths {p:?}, {q:?}"
                );
                seen += 1;
            }
        }
        assert!(seen > 20, "{seen} pixels are opaque");
    }
}

/// A pixel that is said to see past the medium does, with every ray; and not many pixels are said
/// to see it that do not.
#[test]
fn pixels_beside_the_medium_see_nothing_of_it() {
    let sheared = DAffine3::from_cols(
        DVec3::new(0.05, 0.0, 0.0),
        DVec3::new(0.02, 0.0, 0.06),
        DVec3::new(0.0, -0.04, 0.01),
        DVec3::new(0.1, 0.2, -0.1),
    );
    let maps = [
        ("uniform", IndexTransform::uniform(0.05)),
        (
            "sheared",
            IndexTransform::from_world_from_index(sheared).expect("it can be inverted"),
        ),
    ];
    let exact = Tracking {
        transmittance: TransmittanceEstimator::Exact,
        ..Tracking::default()
    };
    for (name, transform) in maps {
        let grid = DensityGrid::new(lumps(), transform, usize::MAX).expect("no limit was set");
        let medium = Medium::new(Arc::new(grid), 10.0, Rgb::WHITE, Phase::Isotropic);
        for (eye, inside) in [
            (DVec3::new(0.5, -4.0, 0.8), false),
            (DVec3::new(-2.0, 2.5, -1.0), false),
            (DVec3::new(0.05, 0.0, 0.1), true),
        ] {
            let (width, height) = (60, 40);
            let to = DVec3::new(0.1, 0.2, -0.1);
            let camera = Camera::look_at(eye, to, DVec3::Z, 0.9, 1.5).expect("a view");
            let silhouette = Silhouette::new(std::slice::from_ref(&medium), &camera, width, height);
            let mut stream = Stream::new(StreamKey::default());
            let (mut covered, mut hit) = (0, 0);
            for (x, y) in (0..height).flat_map(|y| (0..width).map(move |x| (x, y))) {
                let mut least = 1.0_f32;
                for _ in 0..64 {
                    let jitter = DVec2::new(stream.uniform().into(), stream.uniform().into());
                    let film = (DVec2::new(x.into(), y.into()) + jitter)
                        / DVec2::new(width.into(), height.into());
                    let ray = camera.ray(film);
                    let end = f64::INFINITY;
                    let t = exact.estimate_transmittance(&medium, &ray, end, 0.0, &mut stream);
                    least = least.min(t);
                }
                if silhouette.covers(x, y) {
                    covered += 1;
                } else {
                    assert_eq!(least, 1.0, "{name}, from {eye}, pixel {x}, {y}");
                }
                hit += i32::from(least < 1.0);
            }
            println!(
                "{name}, from {eye}: {covered} covered, {hit} hit, of {}",
                width * height
            );
            if inside {
                assert_eq!(covered, 2400, "from inside, all");
            } else {
                assert!(
                    hit > 300 && f64::from(covered) < 1.4 * f64::from(hit),
                    "tight"
                );
            }
        }
    }
    let camera = Camera::look_at(DVec3::X, DVec3::ZERO, DVec3::Z, 0.9, 1.5).expect("a view");
    assert!(
        !Silhouette::new(&[], &camera, 4, 4).covers(3, 3),
        "nothing to see"
    );
}

/// Images by the sequence and by independent numbers have the same mean; of an absorbing medium,
/// whose noise is the pixels' area alone, that of the sequence is far smaller.
///
/// 40 seeds of each: their means are good to 2e-4 of the image's.
#[test]
fn the_sequence_changes_the_noise_and_not_the_mean() {
    let images = |sampler, first: u64| -> Vec<Vec<f64>> {
        let seeds = first..first + 40;
        seeds
            .map(|seed| {
                let medium = medium(lumps(), 0.05, 3.0, Rgb::BLACK);
                let rendered = run(&Scene {
                    seed,
                    spp: 16,
                    ..scene(medium, sky(), CameraRay::Auto, sampler)
                });
                rendered.film.pixels().iter().map(|p| p.mean[1]).collect()
            })
            .collect()
    };
    let statistics = |images: &[Vec<f64>]| {
        let n = images.len() as f64;
        let pixels = images[0].len();
        let (mut sum, mut spread) = (0.0, 0.0);
        for i in 0..pixels {
            let mean = images.iter().map(|x| x[i]).sum::<f64>() / n;
            sum += mean;
            spread += images.iter().map(|x| (x[i] - mean).powi(2)).sum::<f64>() / (n - 1.0);
        }
        // Pixels are independent of each other.
        (
            sum / pixels as f64,
            spread,
            (spread / n).sqrt() / pixels as f64,
        )
    };
    let (a, noise_a, error_a) = statistics(&images(SamplerKind::Independent, 1));
    let (b, noise_b, error_b) = statistics(&images(SamplerKind::Sobol, 1001));
    let z = (a - b) / error_a.hypot(error_b);
    println!("mean {a} ± {error_a}, {b} ± {error_b}, z {z}; noise {noise_a}, {noise_b}");
    assert!(z.abs() < 5.0, "{a} ± {error_a} and {b} ± {error_b}");
    assert!(noise_b < noise_a / 3.0, "{noise_a} becomes {noise_b}");
}

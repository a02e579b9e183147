//! Skies from images, points and spheres: against closed forms, against the analog integrator, and
//! against themselves with less cunning.
//!
//! Every z-test is on fixed seeds at |z| < 5, and says the smallest bias that it sees.

#![allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    clippy::print_stdout,
    reason = "small numbers; what a test can see is printed"
)]

use std::f64::consts::{FRAC_PI_2, PI, TAU};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use glam::{DVec3, IVec3};
use majorant::camera::Camera;
use majorant::film::Film;
use majorant::grid::{DensityGrid, Tree};
use majorant::integrator::{CameraRay, Context, IntegratorKind, Levers, TransportSettings};
use majorant::light::{EnvironmentMap, Lights, LocalLight, Orientation, SunSky};
use majorant::medium::Medium;
use majorant::phase::{Droplets, Phase};
use majorant::render::{NoProgress, render};
use majorant::sampling::{Stream, StreamKey};
use majorant::scene::Scene;
use majorant::space::{IndexTransform, Ray};
use majorant::spectrum::Rgb;

fn grid(voxels: impl IntoIterator<Item = (IVec3, f32)>) -> Arc<DensityGrid> {
    let tree = Tree::from_voxels(0.0, voxels);
    Arc::new(DensityGrid::new(tree, IndexTransform::uniform(0.05), usize::MAX).expect("no limit"))
}

/// A lumpy ball of radius about 20 voxels, one unit, around the origin, with holes.
fn cloud() -> Arc<DensityGrid> {
    grid((0..48 * 48 * 48).filter_map(|i| {
        let p = IVec3::new(i / 2304, i / 48 % 48, i % 48) - 24;
        let q = p.as_vec3();
        let lumps = (q.x * 0.5).sin() * (q.y * 0.4).cos() + (q.z * 0.6).sin();
        let density = 1.0 - q.length() / 20.0 + 0.4 * lumps;
        (density > 0.0).then_some((p, density))
    }))
}

/// A box of 96³ voxels of density 1 around the origin: ±2.4 units, ramps of a voxel at its faces.
fn fog() -> Arc<DensityGrid> {
    grid((0..96 * 96 * 96).map(|i| (IVec3::new(i / 9216, i / 96 % 96, i % 96) - 48, 1.0)))
}

/// A map whose texels are what `of` makes of the direction to their centre.
fn map(height: u16, of: impl Fn(DVec3) -> Rgb) -> EnvironmentMap {
    let width = 2 * height;
    let mut texels = Vec::new();
    for row in 0..height {
        for column in 0..width {
            let theta = (f64::from(row) + 0.5) / f64::from(height) * PI;
            let azimuth = (0.5 - (f64::from(column) + 0.5) / f64::from(width)) * TAU;
            let (sin, cos) = azimuth.sin_cos();
            texels.push(of(DVec3::new(
                theta.sin() * cos,
                theta.sin() * sin,
                theta.cos(),
            )));
        }
    }
    let size = (usize::from(width), usize::from(height));
    let orientation = Orientation::new(DVec3::Z, 0.4);
    EnvironmentMap::new(size, texels, 1.0, orientation).expect("the size is right")
}

/// Brighter upwards, with a broad spot of `spot` from the side.
fn sky(spot: f32) -> EnvironmentMap {
    let towards = DVec3::new(0.6, -0.64, 0.48);
    map(32, |d| {
        let base = (1.0 + 0.8 * d.z) as f32;
        let spot = if d.dot(towards) > 0.97 { spot } else { 0.0 };
        Rgb([
            0.3 * base + spot,
            0.5 * base + 0.9 * spot,
            base + 0.7 * spot,
        ])
    })
}

fn skies(maps: impl IntoIterator<Item = EnvironmentMap>) -> Lights {
    Lights {
        maps: maps.into_iter().map(Arc::new).collect(),
        ..Lights::default()
    }
}

fn lamps(local: impl IntoIterator<Item = LocalLight>) -> Lights {
    Lights {
        local: local.into_iter().collect(),
        ..Lights::default()
    }
}

fn sphere(p: [f64; 3], radius: f64, radiance: [f32; 3]) -> LocalLight {
    LocalLight::sphere(DVec3::from_array(p), radius, Rgb(radiance)).expect("a radius")
}

fn scene(medium: Medium, lights: Lights) -> Scene {
    let eye = DVec3::new(0.5, -4.0, 0.8);
    Scene {
        width: 36,
        height: 24,
        spp: 256,
        seed: 0,
        frame: 0,
        aovs: vec![],
        camera: Camera::look_at(eye, DVec3::ZERO, DVec3::Z, 0.7, 1.5).expect("a view"),
        media: vec![medium],
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

/// Compares the means of two films channel by channel.
fn agree(name: &str, a: &Film, b: &Film, power_limit: f64) {
    let ((ma, ea), (mb, eb)) = (a.mean(), b.mean());
    for c in 0..3 {
        let error = ea[c].hypot(eb[c]);
        let (z, power) = ((ma[c] - mb[c]) / error, 5.0 * error / ma[c]);
        println!(
            "{name}, channel {c}: {:.5} and {:.5}, z {z:+.2}, smallest bias seen {power:.1e}",
            ma[c], mb[c]
        );
        assert!(z.abs() < 5.0, "{name}: {ma:?} ± {ea:?}, {mb:?} ± {eb:?}");
        assert!(power < power_limit, "{name}: sees {power} at best");
    }
}

/// Skies and spheres in media from thin to thick, with every kind of phase function, both ways of
/// camera rays.
#[test]
fn analog_and_path_agree() {
    let hg = |g| Phase::HenyeyGreenstein { g };
    let double = Phase::DoubleHenyeyGreenstein {
        gs: [0.8, -0.4],
        first_weight: 0.7,
    };
    let droplets = Phase::Droplets(Droplets::new(8.0).expect("a diameter"));
    let mixed = Lights {
        environment: Rgb([0.1, 0.2, 0.3]),
        local: vec![
            sphere([0.1, 0.2, 0.1], 0.25, [4.0, 3.0, 2.0]),
            sphere([-1.2, -0.8, 0.9], 0.5, [1.0, 2.0, 3.0]),
        ],
        ..skies([sky(5.0)])
    };
    let cases = [
        ("sky, isotropic", Phase::Isotropic, 12.0, skies([sky(20.0)])),
        ("sky, forwards", hg(0.8), 12.0, skies([sky(20.0)])),
        ("sky, thin", hg(0.5), 0.4, skies([sky(20.0)])),
        (
            "two skies, rayleigh",
            Phase::Rayleigh,
            6.0,
            skies([sky(0.0), sky(9.0)]),
        ),
        ("sky, two lobes", double, 8.0, skies([sky(20.0)])),
        ("sky, droplets", droplets, 8.0, skies([sky(20.0)])),
        (
            "sphere inside",
            hg(0.3),
            2.0,
            lamps([sphere([0.0, 0.1, 0.0], 0.3, [5.0, 4.0, 3.0])]),
        ),
        (
            "sphere in thin smoke",
            Phase::Isotropic,
            0.3,
            lamps([sphere([0.3, -0.4, 0.2], 0.3, [5.0, 4.0, 3.0])]),
        ),
        ("all at once", hg(0.6), 4.0, mixed),
    ];
    for (name, phase, sigma_t, lights) in cases {
        let medium = Medium::new(cloud(), sigma_t, Rgb([0.95, 0.9, 0.8]), phase);
        let mut analog = scene(medium.clone(), lights.clone());
        (analog.seed, analog.spp) = (1, 1024);
        analog.transport.integrator = IntegratorKind::Analog;
        let analog = film(&analog);
        for camera_ray in [CameraRay::Analog, CameraRay::Expected] {
            let mut path = scene(medium.clone(), lights.clone());
            path.seed = 2;
            path.transport.camera_ray = camera_ray;
            let name = format!("{name}, {}", camera_ray.name());
            agree(&name, &analog, &film(&path), 0.06);
        }
    }
}

/// Without equiangular distances the light of a small lamp is found by free flights alone: the same
/// mean, and on rays that pass near it more noise, the more the thinner the fog.
#[test]
fn equiangular_distances_change_the_noise_and_not_the_mean() {
    let lights = lamps([
        sphere([0.0, 0.0, 0.2], 0.02, [800.0, 640.0, 480.0]),
        sphere([0.9, -2.6, -0.3], 0.02, [200.0, 300.0, 400.0]),
    ]);
    for (sigma_t, gain) in [(0.03, 20.0), (0.3, 5.0), (1.0, 0.8)] {
        let media = [Medium::new(
            fog(),
            sigma_t,
            Rgb::splat(0.9),
            Phase::Isotropic,
        )];
        for beside in [0.03, 0.1, 0.3] {
            let ray = Ray {
                origin: DVec3::new(-10.0, beside, 0.2),
                direction: DVec3::X,
            };
            let with = |equiangular, seed| {
                let settings = TransportSettings {
                    levers: Levers {
                        equiangular,
                        ..Levers::default()
                    },
                    ..TransportSettings::default()
                };
                let context = Context::new(&media, &lights, settings);
                measure(&context, |_| ray, seed, 60_000)
            };
            let ((on, on_error), (off, off_error)) = (with(true, 1), with(false, 2));
            let error = on_error[1].hypot(off_error[1]);
            let (z, power) = ((on[1] - off[1]) / error, 5.0 * error / on[1]);
            let ratio = (off_error[1] / on_error[1]).powi(2);
            println!(
                "extinction {sigma_t}, {beside} beside the lamp: {:.5}, variance by {ratio:.1} less; z \
                 {z:+.2}, smallest bias seen {power:.1e}",
                on[1]
            );
            assert!(
                z.abs() < 5.0,
                "{on:?} ± {on_error:?}, {off:?} ± {off_error:?}"
            );
            assert!(power < 0.6, "sees {power} at best");
            // Far beside, the light is spread out and free flight does as well.
            if beside < 0.2 {
                assert!(ratio > gain, "only {ratio} times less noise");
            }
        }
    }
}

/// Means and standard errors of what comes along `n` rays.
fn measure(
    context: &Context<'_>,
    ray: impl Fn(&mut Stream) -> Ray,
    seed: u64,
    n: u32,
) -> ([f64; 3], [f64; 3]) {
    let (mut sum, mut square) = ([0.0; 3], [0.0; 3]);
    for sample in 0..n {
        let mut stream = Stream::new(StreamKey {
            seed,
            sample: sample.into(),
            ..StreamKey::default()
        });
        let ray = ray(&mut stream);
        let x = context.sample_radiance(ray, &mut stream);
        for (c, x) in x.radiance.0.into_iter().enumerate() {
            sum[c] += f64::from(x);
            square[c] += f64::from(x).powi(2);
        }
    }
    let n = f64::from(n);
    let mean = sum.map(|sum| sum / n);
    let error = std::array::from_fn(|c| ((square[c] / n - mean[c] * mean[c]) / n).sqrt());
    (mean, error)
}

/// A point in homogeneous fog, scattered once: the integral along the ray, by a midpoint rule in the
/// angle seen from the light.
#[test]
fn single_scattering_of_a_point_is_the_integral() {
    let sigma_t = 0.4_f32;
    let p = DVec3::new(0.1, 0.0, 0.3);
    let lights = lamps([LocalLight::point(p, Rgb([2.0, 2.0, 2.0]))]);
    for (phase, height) in [
        (Phase::Isotropic, 0.001),
        (Phase::Isotropic, 0.3),
        (Phase::HenyeyGreenstein { g: 0.7 }, 0.1),
    ] {
        let medium = Medium::new(fog(), sigma_t, Rgb::splat(0.8), phase);
        let settings = TransportSettings {
            max_bounces: Some(1),
            ..TransportSettings::default()
        };
        let media = [medium];
        let context = Context::new(&media, &lights, settings);
        let ray = Ray {
            origin: DVec3::new(-10.0, height, 0.3),
            direction: DVec3::X,
        };
        let (mean, error) = measure(&context, |_| ray, 0, 400_000);
        let (mean, error) = (mean[0], error[0]);
        // Density ramps from 0 to 1 over the voxel around −2.425 and 2.375.
        let density = |x: f64| ((x + 2.45) / 0.05).min((2.4 - x) / 0.05).clamp(0.0, 1.0);
        let (start, end) = (-2.45, 2.4);
        let steps = 200_000;
        let angle = |x: f64| ((x - p.x) / height).atan();
        let (a, b) = (angle(start), angle(end));
        let s = f64::from(sigma_t);
        let expected: f64 = (0..steps)
            .map(|i| {
                let angle = a + (b - a) * (f64::from(i) + 0.5) / f64::from(steps);
                let x = p.x + height * angle.tan();
                // The ramp's half width counts as none: half a voxel on either side is full.
                let depth = s * (x + 2.425).max(0.0);
                let q = DVec3::new(x, height, 0.3);
                let to = (p - q).length();
                let cos = (p - q).x / to;
                let phase = f64::from(phase.eval(cos));
                s * density(x) * 0.8 * phase * 2.0 * (-depth - s * to).exp() / height
            })
            .sum::<f64>()
            * (b - a)
            / f64::from(steps);
        let z = (mean - expected) / error;
        println!(
            "height {height}: {mean:.6} ± {error:.1e}, expected {expected:.6}, z {z:+.2}, smallest \
             bias seen {:.1e}",
            5.0 * error / mean
        );
        // The ramp before the light is worth 1e-4 of the whole.
        let off = (mean - expected).abs();
        assert!(
            off < 5.0 * error + 2e-4 * expected,
            "{mean} ± {error}, not {expected}"
        );
        assert!(error < 4e-3 * mean, "sees {error} of {mean} at best");
    }
}

/// Lines through a white cloud, uniform over all of them: what comes out along them is on average
/// what goes in, the mean of the sky.
#[test]
fn a_white_cloud_under_an_uneven_sky_shows_its_mean() {
    for (spot, phase) in [
        (0.0, Phase::Isotropic),
        (50.0, Phase::Isotropic),
        (50.0, Phase::HenyeyGreenstein { g: 0.8 }),
        (
            50.0,
            Phase::Droplets(Droplets::new(20.0).expect("a diameter")),
        ),
    ] {
        let lights = skies([sky(spot)]);
        let media = [Medium::new(cloud(), 15.0, Rgb::WHITE, phase)];
        let context = Context::new(&media, &lights, TransportSettings::default());
        let points = 1_000_000;
        let mut expected = [0.0; 3];
        for i in 0..points {
            let z = 1.0 - 2.0 * (f64::from(i) + 0.5) / f64::from(points);
            let azimuth = f64::from(i) * 2.399_963_229_728_653;
            let r = (1.0 - z * z).sqrt();
            let seen = lights.radiance(DVec3::new(r * azimuth.cos(), r * azimuth.sin(), z));
            for (sum, c) in expected.iter_mut().zip(seen.0) {
                *sum += f64::from(c) / f64::from(points);
            }
        }
        let line = |stream: &mut Stream| {
            let mut u = || f64::from(stream.uniform());
            let (z, azimuth) = (1.0 - 2.0 * u(), TAU * u());
            let r = (1.0_f64 - z * z).sqrt();
            let direction = DVec3::new(r * azimuth.cos(), r * azimuth.sin(), z);
            let (s, t) = direction.any_orthonormal_pair();
            // The ball that holds the cloud.
            let (r, turn) = (1.5 * u().sqrt(), TAU * u());
            let origin = s * (r * turn.cos()) + t * (r * turn.sin()) - direction * 5.0;
            Ray { origin, direction }
        };
        let (means, errors) = measure(&context, line, 3, 150_000);
        for c in 0..3 {
            let (mean, error) = (means[c], errors[c]);
            let z = (mean - expected[c]) / error;
            println!(
                "spot {spot}, {phase:?}, channel {c}: {mean:.5}, the sky's mean {:.5}, z {z:+.2}, \
                 smallest bias seen {:.1e}",
                expected[c],
                5.0 * error / mean
            );
            assert!(z.abs() < 5.0, "{mean} ± {error}, not {}", expected[c]);
            assert!(error < 0.01 * mean, "sees {error} of {mean} at best");
        }
    }
}

/// A sun of 1e5 times the sky in four texels of a painted sky, over a forward-scattering cloud: what
/// single samples bring, beside the sky without it.
#[test]
fn a_painted_sun_makes_no_fireflies() {
    let towards = DVec3::new(0.4, -0.5, 0.77).normalize_or_zero();
    let painted = |sun: f32| {
        map(128, |d| {
            let sun = if d.dot(towards) > 0.9997 { sun } else { 0.0 };
            Rgb([0.3 + sun, 0.45 + 0.95 * sun, 0.75 + 0.9 * sun])
        })
    };
    let percentiles = |sun: f32, spp| {
        let phase = Phase::HenyeyGreenstein { g: 0.85 };
        let medium = Medium::new(cloud(), 20.0, Rgb::splat(0.99), phase);
        let mut scene = scene(medium, skies([painted(sun)]));
        scene.spp = spp;
        let film = film(&scene);
        let mut values: Vec<f64> = film.pixels().iter().map(|p| p.mean[1]).collect();
        values.sort_by(f64::total_cmp);
        #[expect(clippy::cast_sign_loss, reason = "an index from a share of 0 to 1")]
        let at = |share: f64| values[((values.len() - 1) as f64 * share).round() as usize];
        let (mean, error) = film.mean();
        println!(
            "sun {sun}, {spp} samples: mean {:.4} ± {:.1e}, median {:.3}, 99th percentile {:.3}, \
             99.9th {:.3}, largest {:.3}",
            mean[1],
            error[1],
            at(0.5),
            at(0.99),
            at(0.999),
            at(1.0)
        );
        (mean[1], at(0.999))
    };
    percentiles(0.0, 64);
    let (_, few) = percentiles(1e5, 64);
    let (mean, many) = percentiles(1e5, 1024);
    // A firefly is a pixel that more samples put back into line.
    assert!(
        few < 2.0 * many,
        "99.9th percentile {few}, of many samples {many}"
    );
    assert!(
        many < 20.0 * mean,
        "99.9th percentile {many} of a mean of {mean}"
    );
}

/// Preetham's sky: the zenith's luminance as his formula gives it, bluer away from the sun and redder
/// at its rise, a sun of 60 to 110 klx that is nearly white when high and red when low.
#[test]
fn the_sky_by_formula_is_a_sky() {
    let day = |elevation: f64, turbidity| {
        let sky = SunSky {
            turbidity,
            elevation_radians: elevation.to_radians(),
            azimuth_radians: 0.0,
            ground_albedo: Rgb::splat(0.2),
            scale: 1.0,
        };
        sky.lights(Orientation::new(DVec3::Z, 0.0))
    };
    let (map, sun) = day(45.0, 3.0);
    // Y_z = (4.0453 T − 4.9710) tan χ − 0.2155 T + 2.4192, χ = (4/9 − T/120)(π − 2 θ_s).
    let chi = (4.0 / 9.0 - 3.0 / 120.0) * FRAC_PI_2;
    let zenith = (4.0453 * 3.0 - 4.9710) * f64::tan(chi) - 0.2155 * 3.0 + 2.4192;
    let seen = f64::from(map.radiance(DVec3::Z).luminance());
    assert!(
        (seen / zenith - 1.0).abs() < 0.02,
        "zenith {seen}, not {zenith} kcd/m²"
    );
    let Rgb([r, _, b]) = map.radiance(DVec3::new(-0.6, 0.0, 0.8));
    assert!(b > 1.5 * r, "the sky away from the sun is blue: {r}, {b}");
    let ground = |x: f64| map.radiance(DVec3::new(x, 0.4, -0.87)).luminance();
    assert!(
        (ground(0.3) / ground(-0.3) - 1.0).abs() < 1e-5,
        "even ground"
    );
    let irradiance = |sun: &majorant::light::DistantLight| {
        let mut stream = Stream::new(StreamKey::default());
        sun.sample(&mut stream).weight
    };
    let high = irradiance(&sun);
    println!("sun at 45 degrees {high:?} klx");
    assert!((60.0..110.0).contains(&high.luminance()), "{high:?}");
    assert!(high.0[0] < 2.0 * high.0[2], "nearly white: {high:?}");
    let low = irradiance(&day(4.0, 3.0).1);
    println!("sun at 4 degrees {low:?} klx");
    assert!(low.0[0] > 4.0 * low.0[2], "red: {low:?}");
    assert!(
        (sun.direction().z - 0.5_f64.sqrt()).abs() < 1e-12,
        "where it was asked for"
    );
    for elevation in [1.0, 10.0, 89.0, 90.0] {
        for turbidity in [2.0, 5.0, 10.0] {
            let (map, _) = day(elevation, turbidity);
            assert!(map.mean_radiance().is_finite(), "{elevation}, {turbidity}");
            assert!(!map.mean_radiance().is_black(), "{elevation}, {turbidity}");
        }
    }
}

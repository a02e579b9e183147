//! Light of volumes against what is known of it exactly.
//!
//! * What is emitted in a medium that absorbs nothing comes out of it: whatever its shape, density,
//!   phase function and colour, the mean radiance of rays into a sphere around it, uniform over its
//!   surface and by the cosine over directions, is `∫ emission dV / (π R²)`. Every part of a path that
//!   scatters emitted light must be right for that: points drawn as of a light, points along rays,
//!   their shares.
//! * In a medium that only absorbs, a ray collects `∫ e^(−τ(t)) emission(t) dt`: by quadrature.
//! * The same of a slab whose extinction has a colour is `e / σ_c (1 − e^(−τ_c))`.

#![allow(
    clippy::cast_possible_truncation,
    clippy::print_stdout,
    reason = "small numbers; what a test can see is printed"
)]

use std::f64::consts::PI;
use std::sync::Arc;

use glam::{DAffine3, DVec3, IVec3, Vec3};
use majorant::blackbody::Brightness;
use majorant::emission::Glow;
use majorant::field::Field;
use majorant::grid::{DensityGrid, Tree, TreeBuilder};
use majorant::integrator::{CameraRay, Context, IntegratorKind, TransportSettings};
use majorant::light::Lights;
use majorant::medium::Medium;
use majorant::phase::Phase;
use majorant::sampling::{Stream, StreamKey, sample_cone};
use majorant::space::{IndexTransform, Ray};
use majorant::spectrum::Rgb;
use majorant::stats::Counts;
use rayon::prelude::*;

/// A cube of `2 r` voxels of `size`, of what `value` says.
fn grid(r: i32, size: f64, value: impl Fn(Vec3) -> f32) -> Arc<DensityGrid> {
    let n = 2 * r;
    let at = |i: i32| IVec3::new(i / (n * n), i / n % n, i % n) - r;
    let voxels = (0..n * n * n).map(at).map(|p| (p, value(p.as_vec3())));
    let tree = Tree::from_voxels(0.0, voxels.filter(|(_, v)| *v > 0.0));
    let transform = IndexTransform::uniform(size);
    Arc::new(DensityGrid::new(tree, transform, usize::MAX).expect("no limit was set"))
}

/// A lumpy ball of radius 1.2, with holes.
fn cloud() -> Arc<DensityGrid> {
    grid(21, 0.06, |q| {
        let lumps = (q.x * 0.5).sin() * (q.y * 0.4).cos() + (q.z * 0.6).sin();
        let is_inside = q.length() <= 20.0;
        if is_inside {
            1.0 - q.length() / 20.0 + 0.4 * lumps
        } else {
            0.0
        }
    })
}

fn fire(q: Vec3) -> f32 {
    1.0 - (q - Vec3::new(3.0, -2.0, 4.0)).length() / 10.0
}

/// A fire of radius 0.5 within the cloud, of finer voxels, in a colour.
fn glow(colour: Rgb) -> Glow {
    let shift = DAffine3::from_translation(DVec3::new(0.11, -0.32, 0.13));
    let field = Field::scalar(grid(15, 0.05, fire));
    Glow::direct(field.moved(shift).expect("a shift"), colour)
}

/// The integral of a [`glow`] of 1 over the world: trilinear values integrate to the sum of voxels.
fn power() -> f64 {
    let n = 30;
    let at = |i: i32| IVec3::new(i / (n * n), i / n % n, i % n) - 15;
    let values = (0..n * n * n).map(|i| f64::from(fire(at(i).as_vec3()).max(0.0)));
    values.sum::<f64>() * 0.05_f64.powi(3)
}

/// Mean and standard error of each channel of the radiance along `n` rays, each times a weight.
fn measure(
    context: &Context<'_>,
    n: u64,
    ray: impl Fn(&mut Stream) -> (Ray, f64) + Sync,
) -> ([f64; 3], [f64; 3]) {
    let chunk = 1 << 12;
    // Sums in order: the same bits for any number of threads.
    let sums: Vec<[[f64; 3]; 2]> = (0..n.div_ceil(chunk))
        .into_par_iter()
        .map(|k| {
            let mut counts = Counts::default();
            let mut sums = [[0.0; 3]; 2];
            for sample in k * chunk..((k + 1) * chunk).min(n) {
                let mut stream = Stream::new(StreamKey {
                    sample,
                    ..StreamKey::default()
                });
                let (ray, weight) = ray(&mut stream);
                let found = context.sample_radiance(ray, &mut stream);
                counts.add(&stream.counts);
                for (c, x) in found.radiance.0.into_iter().enumerate() {
                    let x = f64::from(x) * weight;
                    sums[0][c] += x;
                    sums[1][c] += x * x;
                }
            }
            assert_eq!(counts.bound_violations, 0, "bounds hold");
            sums
        })
        .collect();
    let total = |i: usize, c: usize| sums.iter().map(|s| s[i][c]).sum::<f64>() / n as f64;
    let mean: [f64; 3] = std::array::from_fn(|c| total(0, c));
    let error = |c: usize| ((total(1, c) - mean[c] * mean[c]).max(0.0) / n as f64).sqrt();
    (mean, std::array::from_fn(error))
}

/// Compares with what is expected to 5 standard errors and `rounding`; a bias of `sees` must show.
fn check(
    what: &str,
    (mean, error): ([f64; 3], [f64; 3]),
    expected: [f64; 3],
    (sees, rounding): (f64, f64),
) {
    for c in 0..3 {
        let off = mean[c] - expected[c];
        let (z, power) = (off / error[c].max(1e-30), 5.0 * error[c] / expected[c]);
        println!("{what}, channel {c}: z {z:+.2}, sees {power:.1e}");
        assert!(
            off.abs() < 5.0 * error[c] + rounding * expected[c],
            "{what}: {mean:?} ± {error:?}, not {expected:?}"
        );
        assert!(power < sees, "{what}: a bias of {sees} would be missed");
    }
}

/// Of a sphere around the cloud.
const RADIUS: f64 = 1.3;

/// A line that meets a ball, as light that is the same from everywhere: where it enters, and whereto.
fn into_ball((centre, radius): (DVec3, f64), stream: &mut Stream) -> Ray {
    let normal = sample_cone(DVec3::Z, 2.0, stream);
    // A point of the unit sphere that touches the surface from inside: by the cosine.
    let direction = (sample_cone(DVec3::Z, 2.0, stream) - normal).normalize_or(-normal);
    Ray {
        origin: centre + normal * radius,
        direction,
    }
}

/// A ray from outside through the sphere around the cloud: every other one meets the fire, and counts
/// for as many as do.
fn into_sphere(stream: &mut Stream) -> (Ray, f64) {
    let fire = (DVec3::new(0.26, -0.42, 0.33), 0.5);
    let share = (fire.1 / RADIUS).powi(2);
    if stream.uniform() < 0.5 {
        let mut ray = into_ball(fire, stream);
        ray.origin = ray.at(-2.0 * RADIUS);
        return (ray, 2.0 * share);
    }
    loop {
        let ray = into_ball((DVec3::ZERO, RADIUS), stream);
        let to = fire.0 - ray.origin;
        let beside = to - ray.direction * to.dot(ray.direction);
        if beside.length() > fire.1 {
            return (ray, 2.0 * (1.0 - share));
        }
    }
}

/// What is emitted in `media` that do not absorb, between them a [`glow`] of [`FIRE`], comes out.
fn comes_out(
    what: &str,
    media: &[Medium],
    settings: TransportSettings,
    (log2_n, sees): (u32, f64),
) {
    let dark = Lights::default();
    let context = Context::new(media, &dark, settings);
    let area = PI * RADIUS * RADIUS;
    let expected = FIRE.0.map(|c| f64::from(c) * power() / area);
    let found = measure(&context, 1 << log2_n, into_sphere);
    check(what, found, expected, (sees, 1e-4));
}

const FIRE: Rgb = Rgb([30.0, 15.0, 6.0]);

fn white(sigma_t: f32, g: f32) -> Medium {
    let phase = Phase::HenyeyGreenstein { g };
    Medium::new(cloud(), sigma_t, Rgb::WHITE, phase)
}

fn shifted(medium: &Medium) -> Medium {
    let shift = DAffine3::from_translation(DVec3::new(0.05, -0.03, 0.02));
    medium.moved(shift).expect("a shift")
}

#[test]
fn what_is_emitted_comes_out_of_gray_media_that_do_not_absorb() {
    let settings = TransportSettings::default();
    let by_chance = {
        let mut settings = settings;
        settings.levers.emission_light = false;
        settings
    };
    let expected = TransportSettings {
        camera_ray: CameraRay::Expected,
        ..settings
    };
    let analog = TransportSettings {
        integrator: IntegratorKind::Analog,
        ..settings
    };
    for (what, sigma_t, g, settings, effort) in [
        ("thin", 0.5, 0.0, settings, (19, 0.03)),
        ("thick", 8.0, 0.0, settings, (19, 0.03)),
        ("thick and narrow", 8.0, 0.8, settings, (19, 0.03)),
        ("expected", 1.0, 0.3, expected, (19, 0.03)),
        ("by chance", 4.0, 0.6, by_chance, (20, 0.03)),
        ("analog", 1.0, 0.0, analog, (20, 0.03)),
    ] {
        let media = [white(sigma_t, g).glowing(glow(FIRE))];
        comes_out(what, &media, settings, effort);
    }
}

#[test]
fn what_is_emitted_comes_out_of_several_media_and_of_dyed_ones() {
    let settings = TransportSettings::default();
    let expected = TransportSettings {
        camera_ray: CameraRay::Expected,
        ..settings
    };
    let by_chance = {
        let mut settings = settings;
        settings.levers.emission_light = false;
        settings
    };
    let half = || glow(FIRE * 0.5);
    let dye = Rgb([1.0, 0.3, 0.03]);
    let dyed = white(6.0, 0.0).with_extinction_color(dye);
    let clear = white(8.0, 0.6).with_extinction_color(Rgb([0.2, 1.0, 0.0]));
    let two = [
        white(3.0, 0.6).glowing(half()),
        shifted(&white(2.0, 0.0)).glowing(half()),
    ];
    let two_dyed = [
        white(3.0, 0.6).glowing(half()),
        shifted(&dyed).glowing(half()),
    ];
    for (what, media, settings) in [
        ("two", &two[..], settings),
        ("dyed", &[dyed.glowing(glow(FIRE))], settings),
        (
            "a clear channel",
            &[clear.clone().glowing(glow(FIRE))],
            expected,
        ),
        ("by chance", &[clear.glowing(glow(FIRE))], by_chance),
        ("two, one of them dyed", &two_dyed, settings),
    ] {
        comes_out(what, media, settings, (19, 0.05));
    }
}

#[test]
fn rays_through_absorbing_media_collect_their_integral() {
    let second = DAffine3::from_translation(DVec3::new(0.2, -0.1, 0.1));
    let ray = Ray {
        origin: DVec3::new(0.5, -4.5, 0.8),
        direction: DVec3::new(-0.09, 1.0, -0.14).normalize_or_zero(),
    };
    let dye = Rgb([1.0, 0.3, 0.0]);
    for (sigma_t, sees) in [(0.5, 0.04), (5.0, 0.2)] {
        let black = Medium::new(cloud(), sigma_t, Rgb::BLACK, Phase::Isotropic);
        let one = black.clone().glowing(glow(FIRE));
        let other = black.moved(second).expect("a shift");
        let heat = Field::scalar(grid(14, 0.05, |q| 2.5 - q.length() / 6.0));
        let law = (20.0, Brightness::Spectrum);
        let dyed = one.with_extinction_color(dye);
        for (what, media) in [
            ("one", vec![one.clone()]),
            ("two", vec![one, other.clone()]),
            (
                "hot",
                vec![black.glowing(Glow::thermal(heat, (1000.0, 100.0), law))],
            ),
            ("dyed", vec![dyed.clone()]),
            ("dyed and gray", vec![dyed, other]),
        ] {
            let steps = 40_000;
            let step = 9.0 / f64::from(steps);
            let (mut depth, mut expected) = ([0.0; 3], [0.0; 3]);
            for i in 0..steps {
                let p = ray.at((f64::from(i) + 0.5) * step);
                let of = |m: &Medium| m.tint() * m.sigma_t_at(p);
                let sigma = media.iter().map(of).fold(Rgb::BLACK, |a, b| a + b);
                let emitted = media.iter().map(|m| m.emitted(p));
                let emitted = emitted.fold(Rgb::BLACK, |a, b| a + b);
                for c in 0..3 {
                    let half = 0.5 * step * f64::from(sigma.0[c]);
                    depth[c] += half;
                    expected[c] += step * f64::from(emitted.0[c]) * (-depth[c]).exp();
                    depth[c] += half;
                }
            }
            let lights = Lights::default();
            for (kernel, camera_ray, integrator, log2_n) in [
                ("auto", CameraRay::Auto, IntegratorKind::Path, 14),
                ("by chance", CameraRay::Analog, IntegratorKind::Path, 16),
                ("expected", CameraRay::Expected, IntegratorKind::Path, 16),
                ("analog", CameraRay::Auto, IntegratorKind::Analog, 19),
            ] {
                let settings = TransportSettings {
                    integrator,
                    camera_ray,
                    ..TransportSettings::default()
                };
                let context = Context::new(&media, &lights, settings);
                let found = measure(&context, 1 << log2_n, |_| (ray, 1.0));
                let what = format!("sigma_t {sigma_t}, {what}, {kernel}");
                check(&what, found, expected, (sees, 1e-3));
            }
        }
    }
}

/// A slab of 4096 × 4096 × 128 voxels between z = 0 and 128, but for half a voxel of ramp.
fn slab() -> Arc<DensityGrid> {
    let mut b = TreeBuilder::new(0.0_f32);
    let node = b.upper_node(IVec3::ZERO);
    for xy in 0..32 * 32 {
        b.set_upper_tile(node, xy << 5, 1.0, true);
    }
    let tree = b.finish(vec![], vec![]);
    let transform = IndexTransform::uniform(1.0 / 128.0);
    Arc::new(DensityGrid::new(tree, transform, usize::MAX).expect("no limit was set"))
}

/// Extinctions of 0.1, 1 and 10, none, or the same, over the slab.
#[test]
fn a_slab_whose_extinction_has_a_colour_glows_in_closed_form() {
    let mu = 0.8_f64;
    let direction = DVec3::new((1.0 - mu * mu).sqrt(), 0.0, -mu);
    let ray = Ray {
        origin: DVec3::new(16.0, 16.0, 0.5) - direction * 4.0,
        direction,
    };
    let colour = Rgb([0.5, 1.0, 2.0]);
    let slab = slab();
    for tau in [[0.1, 1.0, 10.0], [5.0, 0.0, 0.5], [100.0, 1.0, 0.001]] {
        let color = Rgb(tau.map(|t| t as f32));
        let medium = Medium::new(Arc::clone(&slab), 1.0, Rgb::BLACK, Phase::Isotropic);
        let medium = medium.with_extinction_color(color);
        let medium = medium.glowing(Glow::direct(Field::scalar(Arc::clone(&slab)), colour));
        let expected = std::array::from_fn(|c| {
            let depth = tau[c] / mu;
            // Zero: nothing is absorbed.
            let part = if depth > 0.0 {
                -(-depth).exp_m1() / depth
            } else {
                1.0
            };
            f64::from(colour.0[c]) * part / mu
        });
        let lights = Lights::default();
        for (kernel, integrator, n) in [
            ("path", IntegratorKind::Path, 1 << 16),
            ("analog", IntegratorKind::Analog, 1 << 18),
        ] {
            let settings = TransportSettings {
                integrator,
                ..TransportSettings::default()
            };
            let media = std::slice::from_ref(&medium);
            let context = Context::new(media, &lights, settings);
            let found = measure(&context, n, |_| (ray, 1.0));
            check(
                &format!("slab of {tau:?}, {kernel}"),
                found,
                expected,
                (0.1, 1e-3),
            );
        }
    }
}

//! Three ways to find the light of volumes, to 1 %.
//!
//! The path integrator as it is, the same with emission found by chance alone, and the analog one.
//! Emission that scatters is found in rare bright samples by the latter two, so errors are estimated
//! from independent renders: 16 of each, of few large pixels and many samples. Every pixel counts,
//! none is left out: it is one of 24 blocks, through which millions of paths go.
//!
//! Student's t of 15 to 30 degrees of freedom: |t| < 7.5 has a probability of 2e-6 to be exceeded by
//! 15, and the mean of t² of 24 pixels and three channels is 1.1.

#![allow(clippy::print_stdout, reason = "what a test can see is printed")]

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use glam::{DAffine3, DVec3, IVec3, Vec3};
use majorant::blackbody::Brightness;
use majorant::camera::Camera;
use majorant::emission::Glow;
use majorant::field::Field;
use majorant::grid::{DensityGrid, Tree};
use majorant::integrator::{IntegratorKind, TransportSettings};
use majorant::light::Lights;
use majorant::medium::Medium;
use majorant::phase::Phase;
use majorant::render::{NoProgress, render};
use majorant::scene::Scene;
use majorant::space::IndexTransform;
use majorant::spectrum::Rgb;

/// A cube of `2 r` voxels of `size`, of what `value` says.
fn grid(r: i32, size: f64, value: impl Fn(Vec3) -> f32) -> Arc<DensityGrid> {
    let n = 2 * r;
    let at = |i: i32| IVec3::new(i / (n * n), i / n % n, i % n) - r;
    let voxels = (0..n * n * n).map(at).map(|p| (p, value(p.as_vec3())));
    let tree = Tree::from_voxels(0.0, voxels.filter(|(_, v)| *v > 0.0));
    let transform = IndexTransform::uniform(size);
    Arc::new(DensityGrid::new(tree, transform, usize::MAX).expect("no limit was set"))
}

fn cloud() -> Arc<DensityGrid> {
    grid(20, 0.06, |q| {
        let lumps = (q.x * 0.5).sin() * (q.y * 0.4).cos() + (q.z * 0.6).sin();
        1.0 - q.length() / 17.0 + 0.4 * lumps
    })
}

/// A small hot spot near the cloud's face, of finer voxels than the cloud's.
fn spot() -> Glow {
    let centre = Vec3::new(3.0, -2.0, 4.0);
    let values = grid(12, 0.025, |q| 1.0 - (q - centre).length() / 8.0);
    let shift = DAffine3::from_translation(DVec3::new(0.3, -0.75, 0.3));
    let field = Field::scalar(values).moved(shift).expect("a shift");
    Glow::direct(field, Rgb([300.0, 150.0, 60.0]))
}

/// Three balls side by side, of a colour each, deep in the cloud.
fn colours() -> Glow {
    let ball = |shift: f32| {
        grid(10, 0.04, move |q| {
            1.0 - (q - shift * Vec3::Y).length() / 4.0
        })
    };
    let field = Field::colour([0.0, 1.0, 2.0].map(ball));
    Glow::direct(field, Rgb::splat(20.0))
}

/// Heat of a narrow peak: its light falls off steeply.
fn heat() -> Glow {
    let field = Field::scalar(grid(14, 0.05, |q| 2.5 - q.length() / 6.0));
    Glow::thermal(field, (1000.0, 100.0), (20.0, Brightness::Spectrum))
}

const RENDERS: u64 = 16;

/// Pixels of each render, and its mean as one more.
type Renders = Vec<Vec<[f64; 3]>>;

/// Renders of a view that the cloud fills.
fn renders(media: &[Medium], how: impl Fn(&mut TransportSettings), spp: u32, seed: u64) -> Renders {
    let eye = DVec3::new(0.5, -4.5, 0.8);
    let mut transport = TransportSettings::default();
    how(&mut transport);
    let one = |seed| {
        let scene = Scene {
            width: 6,
            height: 4,
            spp,
            seed,
            frame: 0,
            aovs: vec![],
            camera: Camera::look_at(eye, DVec3::ZERO, DVec3::Z, 0.4, 1.5).expect("a view"),
            media: media.to_vec(),
            lights: Lights::default(),
            transport,
        };
        let rendered = render(&scene, &NoProgress, &AtomicBool::new(false));
        assert_eq!(rendered.counts.bound_violations, 0, "bounds hold");
        assert_eq!(rendered.counts.non_finite_samples, 0, "samples are finite");
        let film = &rendered.film;
        let pixels = film.pixels().iter().map(|pixel| pixel.mean);
        pixels.chain([film.mean().0]).collect()
    };
    (0..RENDERS).map(|i| one(seed + i)).collect()
}

/// Mean of numbers, and its variance.
fn moments(numbers: &[f64]) -> (f64, f64) {
    let n = numbers.len() as f64;
    let mean = numbers.iter().sum::<f64>() / n;
    let squares = numbers.iter().map(|x| (x - mean).powi(2));
    (mean, squares.sum::<f64>() / (n * (n - 1.0)))
}

/// The difference of two in standard errors, and the least relative bias that so many of them show.
fn compare(a: &[f64], b: &[f64], errors: f64) -> (f64, f64) {
    let ((x, vx), (y, vy)) = (moments(a), moments(b));
    let error = (vx + vy).sqrt();
    ((x - y) / error, errors * error / x)
}

/// Compares renders; of the whole image a bias of `sees` must show.
fn agree(what: &str, sees: f64, a: &Renders, b: &Renders) {
    let pixel_count = a[0].len() - 1;
    let column = |renders: &Renders, place: usize, c: usize| -> Vec<f64> {
        renders.iter().map(|pixels| pixels[place][c]).collect()
    };
    for c in 0..3 {
        let whole = [a, b].map(|renders| column(renders, pixel_count, c));
        // 5 standard errors: of the whole, t is as good as normal.
        let (t, power) = compare(&whole[0], &whole[1], 5.0);
        println!("{what}, channel {c}: t {t:+.2}, smallest bias seen {power:.1e}");
        assert!(t.abs() < 5.0, "{what}, channel {c}: t {t}");
        assert!(power < sees, "{what}: a bias of {sees} would be missed");
        let (mut squares, mut count, mut worst, mut weakest) = (0.0, 0.0, 0.0_f64, 0.0_f64);
        let mut rest = [vec![0.0; a.len()], vec![0.0; b.len()]];
        for place in 0..pixel_count {
            let pixel = [a, b].map(|renders| column(renders, place, c));
            let is_steady = pixel.iter().all(|numbers| {
                let (mean, variance) = moments(numbers);
                variance < (STEADY * mean).powi(2)
            });
            if !is_steady {
                for (rest, pixel) in rest.iter_mut().zip(&pixel) {
                    for (sum, x) in rest.iter_mut().zip(pixel) {
                        *sum += x;
                    }
                }
                continue;
            }
            let (t, power) = compare(&pixel[0], &pixel[1], 7.5);
            assert!(t.abs() < 7.5, "{what}, pixel {place}, channel {c}: t {t}");
            squares += t * t;
            count += 1.0;
            worst = worst.max(t.abs());
            weakest = weakest.max(power);
        }
        let mean_square = squares / f64::max(count, 1.0);
        let (t, power) = compare(&rest[0], &rest[1], 7.5);
        println!(
            "  {count} steady pixels, largest t {worst:.1}, mean t² {mean_square:.2}, see \
             {weakest:.1e}; others together t {t:+.1}, see {power:.1e}"
        );
        assert!(
            mean_square < 1.1 + 5.0 * (2.0 / f64::max(count, 1.0)).sqrt(),
            "{what}, channel {c}: mean of t² {mean_square}"
        );
    }
}

/// Standard error over mean below which t of a pixel is as good as Student's. At 0.1 a mean is made of some
/// hundred bright paths in all: t² of 21 pixels had a mean of 2.8 once, where four times the samples show
/// no bias of 1 %.
const STEADY: f64 = 0.05;

/// Samples a pixel of the path integrator, with emission found by chance, and of the analog one; which
/// bias of the image the latter two must show.
type Effort = ([u32; 3], [f64; 2]);

/// No render of a run shares its `seed` with another: where the media are the same, so would be the flights.
fn three_ways(name: &str, glow: &Glow, seed: u64, ([path, chance, analog], sees): Effort) {
    for (seed, sigma_t, albedo, g) in [
        (seed, 0.4, Rgb([0.9, 0.8, 0.5]), 0.0),
        (seed + 300, 3.0, Rgb([0.95, 0.8, 0.4]), 0.6),
        (seed + 600, 3.0, Rgb::BLACK, 0.0),
    ] {
        let phase = Phase::HenyeyGreenstein { g };
        let media = [Medium::new(cloud(), sigma_t, albedo, phase).glowing(glow.clone())];
        let what = |other: &str| format!("{name}, sigma_t {sigma_t}, g {g}, path and {other}");
        let path = renders(&media, |_| (), path, seed);
        let by_chance = |t: &mut TransportSettings| t.levers.emission_light = false;
        let by_chance = renders(&media, by_chance, chance, seed + 100);
        agree(&what("by chance"), sees[0], &path, &by_chance);
        let by_analog = |t: &mut TransportSettings| t.integrator = IntegratorKind::Analog;
        let by_analog = renders(&media, by_analog, analog, seed + 200);
        agree(&what("analog"), sees[1], &path, &by_analog);
    }
}

/// Some seconds each.
const QUICK: [u32; 3] = [1 << 10, 1 << 11, 1 << 13];

#[test]
fn a_small_spot_is_the_same_in_three_ways() {
    three_ways("spot", &spot(), 1000, (QUICK, [0.03, 0.03]));
}

#[test]
fn balls_of_colours_are_the_same_in_three_ways() {
    three_ways("colours", &colours(), 2000, (QUICK, [0.2, 0.2]));
}

#[test]
fn heat_is_the_same_in_three_ways() {
    three_ways("heat", &heat(), 3000, (QUICK, [0.12, 0.25]));
}

/// To 1 % where light is small, and to 5 % in the colour of heat: eight times the samples.
#[test]
#[ignore = "minutes"]
fn by_hand_emission_is_the_same_in_three_ways() {
    let more = QUICK.map(|n| 8 * n);
    three_ways("spot", &spot(), 1000, (more, [0.011, 0.011]));
    three_ways("colours", &colours(), 2000, (more, [0.075, 0.075]));
    three_ways("heat", &heat(), 3000, (more, [0.045, 0.09]));
}

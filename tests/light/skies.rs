//! Skies from images: where they look, what they draw, and what a white cloud makes of them.

#![allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    clippy::print_stdout,
    reason = "small numbers; what a test can see is printed"
)]

use std::f64::consts::{FRAC_PI_2, PI, TAU};

use crate::support::chi_square_p;
use glam::DVec3;
use majorant::light::{EnvironmentMap, Orientation};
use majorant::sampling::{Stream, StreamKey};
use majorant::spectrum::Rgb;

/// A map whose texels are what `of` makes of the direction to their centre, in the map's frame.
fn map(
    (width, height): (u16, u16),
    orientation: Orientation,
    of: impl Fn(DVec3) -> Rgb,
) -> EnvironmentMap {
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
    EnvironmentMap::new(size, texels, 1.0, orientation).expect("the size is right")
}

/// A lumpy sky with a spot of 100 times the rest, a third of a turn from `+x`.
fn lumpy(d: DVec3) -> Rgb {
    let lumps = 1.2 + (3.0 * d.x).sin() * (5.0 * d.z).cos();
    let spot = DVec3::new(-0.4, 0.69, 0.6).normalize_or_zero();
    let sun = if d.dot(spot) > 0.995 { 100.0 } else { 0.0 };
    Rgb([lumps as f32, 0.8 * lumps as f32, 0.5 * lumps as f32]) + Rgb([sun, sun, 0.6 * sun])
}

fn orientations() -> [Orientation; 3] {
    [
        Orientation::new(DVec3::Z, 0.0),
        Orientation::new(DVec3::Y, 0.7),
        Orientation::new(DVec3::new(0.36, -0.48, -0.8), -2.0),
    ]
}

#[test]
fn the_middle_of_the_image_is_x_and_the_first_row_the_zenith() {
    // Red grows to the right, green downwards.
    let place = |orientation, d: DVec3| {
        let map = map((64, 32), orientation, |d| {
            let right = 0.5 - d.y.atan2(d.x) / TAU;
            Rgb([right as f32, (d.z.acos() / PI) as f32, 0.0])
        });
        let Rgb([right, down, _]) = map.radiance(d);
        (right, down)
    };
    let near = |(a, b): (f32, f32), (x, y): (f32, f32)| {
        assert!(
            (a - x).abs() < 0.01 && (b - y).abs() < 0.02,
            "({a}, {b}), not ({x}, {y})"
        );
    };
    let upright = Orientation::new(DVec3::Z, 0.0);
    near(place(upright, DVec3::X), (0.5, 0.5));
    // To the right is clockwise from above.
    near(place(upright, DVec3::NEG_Y), (0.75, 0.5));
    near(place(upright, DVec3::Y), (0.25, 0.5));
    let up = DVec3::new(1e-3, 0.0, 1.0).normalize_or_zero();
    assert!(place(upright, up).1 < 0.02, "the zenith is the first row");
    // A quarter turn counter-clockwise carries the middle to y.
    near(
        place(Orientation::new(DVec3::Z, FRAC_PI_2), DVec3::Y),
        (0.5, 0.5),
    );
    // With y up the map's y is the world's −z.
    let y_up = Orientation::new(DVec3::Y, 0.0);
    near(place(y_up, DVec3::X), (0.5, 0.5));
    near(place(y_up, DVec3::NEG_Z), (0.25, 0.5));
    let up = DVec3::new(1e-3, 1.0, 0.0).normalize_or_zero();
    assert!(place(y_up, up).1 < 0.02, "the zenith is up");
}

/// Chi-square of 2²⁰ drawn directions over the cells of the map, which lie between the centres of its
/// texels and are found here from the direction alone, against the density in their middle times
/// their solid angle; cells where few are expected are pooled. A cell whose share is off by 15 % of
/// itself is seen, or many that are off by 1 %.
#[test]
fn directions_follow_the_density_that_the_map_says() {
    let (width, height) = (37_u16, 19_u16);
    for (i, orientation) in orientations().into_iter().enumerate() {
        let map = map((width, height), orientation, lumpy);
        let to_world = orientation.world_from_map();
        let mut stream = Stream::new(StreamKey {
            seed: i as u64,
            ..StreamKey::default()
        });
        let n = 1 << 20;
        let (columns, rows) = (usize::from(width), usize::from(height) + 1);
        let mut hits = vec![0.0; columns * rows];
        for _ in 0..n {
            let sample = map.sample(&mut stream).expect("the sky is not even");
            let d = sample.direction;
            assert!((d.length() - 1.0).abs() < 1e-12, "a unit vector");
            let (radiance, pdf) = map.radiance_and_pdf(d);
            // Rounding may move a direction over the border of a cell: one in 1e5 or so.
            let same = (pdf / sample.pdf - 1.0).abs() < 1e-4;
            let close = (radiance.0[0] / sample.radiance.0[0] - 1.0).abs() < 1e-2;
            assert!(same && close, "{d}: {radiance:?}, {pdf}, not {sample:?}");
            let d = to_world.transpose() * d;
            let across = (0.5 - d.y.atan2(d.x) / TAU) * f64::from(width) - 0.5;
            let column = across.rem_euclid(f64::from(width)) as usize % columns;
            let row = (d.z.acos() / PI * f64::from(height) + 0.5) as usize;
            hits[row * columns + column] += 1.0;
        }
        let (mut total, mut chi2, mut degrees) = (0.0, 0.0, -1.0);
        let (mut rest, mut rest_hits) = (0.0, 0.0);
        for row in 0..=height {
            let angle = |k: f64| (PI * (f64::from(row) + k) / f64::from(height)).clamp(0.0, PI);
            let (top, bottom) = (angle(-0.5), angle(0.5));
            let solid_angle = TAU / f64::from(width) * (top.cos() - bottom.cos());
            for column in 0..width {
                let azimuth = TAU * (0.5 - (f64::from(column) + 1.0) / f64::from(width));
                let theta = f64::midpoint(top, bottom);
                let (sin, cos) = azimuth.sin_cos();
                let d = DVec3::new(theta.sin() * cos, theta.sin() * sin, theta.cos());
                let share = f64::from(map.radiance_and_pdf(to_world * d).1) * solid_angle;
                total += share;
                let expected = share * f64::from(n);
                let hit = hits[usize::from(row) * columns + usize::from(column)];
                if expected > 20.0 {
                    chi2 += (hit - expected).powi(2) / expected;
                    degrees += 1.0;
                } else {
                    rest += expected;
                    rest_hits += hit;
                }
            }
        }
        assert!(
            (total - 1.0).abs() < 1e-5,
            "the density integrates to {total}"
        );
        assert!(
            (rest - rest_hits).abs() < 5.0 * rest.sqrt() + 1e-9,
            "{rest_hits}, not {rest}"
        );
        let p = chi_square_p(chi2, degrees);
        println!("orientation {i}: integral {total:.6}, chi2 {chi2:.0} of {degrees}, p {p:.4}");
        assert!(p > 1e-5, "chi2 {chi2} of {degrees}, p {p}");
    }
}

/// The mean over the sphere that the map says, against the mean of what it shows.
#[test]
fn means_are_those_of_what_is_seen() {
    for orientation in orientations() {
        let map = map((64, 32), orientation, lumpy);
        let n = 4_000_000;
        let mut sum = [0.0; 3];
        for i in 0..n {
            // Points of a golden spiral.
            let z = 1.0 - 2.0 * (f64::from(i) + 0.5) / f64::from(n);
            let azimuth = f64::from(i) * 2.399_963_229_728_653;
            let r = (1.0 - z * z).sqrt();
            let seen = map.radiance(DVec3::new(r * azimuth.cos(), r * azimuth.sin(), z));
            for (sum, c) in sum.iter_mut().zip(seen.0) {
                *sum += f64::from(c) / f64::from(n);
            }
        }
        for (said, seen) in map.mean_radiance().0.into_iter().zip(sum) {
            // Bilinear in angles, the mean of a cell is that of its corners but for the curvature
            // of the sphere: 1e-3 for cells of 6 degrees.
            assert!(
                (f64::from(said) / seen - 1.0).abs() < 5e-3,
                "{said}, not {seen}"
            );
        }
    }
}

#[test]
fn even_and_black_skies_draw_nothing() {
    for level in [0.0, 1.0, 1e10] {
        let map = map((16, 8), orientations()[1], |_| Rgb::splat(level));
        assert!(!map.is_sampled(), "there is nothing to prefer");
        assert_eq!(map.sample(&mut Stream::new(StreamKey::default())), None);
        assert_eq!(map.radiance_and_pdf(DVec3::X), (Rgb::splat(level), 0.0));
    }
}

#[test]
fn the_smallest_maps_work() {
    for size in [(1, 1), (1, 2), (2, 1), (2, 2)] {
        let map = map(size, orientations()[0], |d| Rgb::splat((2.0 + d.z) as f32));
        for d in [DVec3::Z, DVec3::NEG_Z, DVec3::X, DVec3::NEG_X, DVec3::NEG_Y] {
            assert!(map.radiance(d).is_finite(), "{size:?}, {d}");
        }
    }
    let orientation = orientations()[0];
    assert!(EnvironmentMap::new((0, 0), vec![], 1.0, orientation).is_err());
    assert!(EnvironmentMap::new((2, 2), vec![Rgb::BLACK], 1.0, orientation).is_err());
    let huge = (usize::MAX, 2);
    assert!(EnvironmentMap::new(huge, vec![Rgb::BLACK], 1.0, orientation).is_err());
}

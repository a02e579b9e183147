//! Every phase function: density, sampling and mean cosine say the same.
//!
//! Densities are integrated by a rule that knows nothing of how they are sampled. The chi-square
//! tests draw 2²⁰ directions into 64 cells of the angle, equal in probability: a share that is off
//! by 4 % of itself in one cell, or by 0.5 % in half of them, is seen.

#![allow(clippy::print_stdout, reason = "what a test can see is printed")]

use std::f64::consts::TAU;

use crate::support::chi_square_p;
use glam::DVec3;
use majorant::phase::{Droplets, Phase};
use majorant::sampling::{Stream, StreamKey};

/// Phase functions by name, extremes among them.
fn phases() -> Vec<(String, Phase)> {
    let mut phases = vec![
        ("isotropic".to_owned(), Phase::Isotropic),
        ("rayleigh".to_owned(), Phase::Rayleigh),
    ];
    for g in [-0.999, -0.5, 0.0, 1e-6, 0.3, 0.85, 0.999, 0.999_999] {
        phases.push((
            format!("henyey-greenstein {g}"),
            Phase::HenyeyGreenstein { g },
        ));
    }
    for (gs, first_weight) in [
        ([0.9, -0.4], 0.8),
        ([0.999, -0.999], 0.5),
        ([0.2, 0.95], 0.0),
        ([0.2, 0.95], 1.0),
    ] {
        let phase = Phase::DoubleHenyeyGreenstein { gs, first_weight };
        phases.push((format!("double {gs:?} {first_weight}"), phase));
    }
    for d in [
        1e-4, 0.05, 0.1, 0.4, 1.0, 1.5, 3.0, 4.999, 5.0, 10.0, 20.0, 50.0,
    ] {
        let droplets = Droplets::new(d).expect("a diameter of the fit");
        phases.push((format!("droplets of {d} um"), Phase::Droplets(droplets)));
    }
    phases
}

/// `x = 1 − cos θ` in steps that resolve peaks of any width at both ends: near 0 as 2⁻ᵏ, near 2 as
/// 2 − 2⁻ᵏ, each octave cut into `parts`.
fn nodes(parts: u32) -> Vec<f64> {
    let octaves = 60 * parts;
    let near = (0..octaves).map(|i| (-f64::from(i) / f64::from(parts)).exp2());
    let mut xs: Vec<f64> = near.clone().collect();
    xs.push(0.0);
    xs.reverse();
    xs.extend(near.skip(1).map(|x| 2.0 - x));
    xs.push(2.0);
    xs
}

/// The probability and the mean of `1 − cos θ` up to each node, by Simpson's rule.
fn cumulative(phase: Phase, xs: &[f64]) -> Vec<(f64, f64)> {
    let p = |x: f64| TAU * f64::from(phase.eval(1.0 - x));
    let mut sum = (0.0, 0.0);
    let steps = xs.windows(2).map(|w| {
        let (a, b, m) = (w[0], w[1], f64::midpoint(w[0], w[1]));
        let h = (b - a) / 6.0;
        sum.0 += h * (p(a) + 4.0 * p(m) + p(b));
        sum.1 += h * (a * p(a) + 4.0 * m * p(m) + b * p(b));
        sum
    });
    std::iter::once((0.0, 0.0)).chain(steps).collect()
}

#[test]
fn densities_integrate_to_one_with_the_mean_cosine_they_say() {
    let xs = nodes(32);
    for (name, phase) in phases() {
        let &(total, mean) = cumulative(phase, &xs).last().expect("nodes");
        let cos = 1.0 - mean;
        println!("{name}: integral {total:.6}, mean cosine {cos:.6}");
        // Simpson's rule is good to 1e-6. eval() takes a cosine, which cannot tell angles below
        // 1e-8 apart: peaks of 1 − g = 1e-6 have half their light above 1e-12.
        assert!((total - 1.0).abs() < 2e-5, "{name}: integral {total}");
        let said = f64::from(phase.mean_cosine());
        assert!(
            (cos - said).abs() < 2e-5,
            "{name}: mean cosine {cos}, not {said}"
        );
    }
}

/// Returns p of 2²⁰ drawn values of `1 − cos θ` against the density, in 64 cells.
fn goodness(phase: Phase, mut draw: impl FnMut() -> f64) -> f64 {
    let xs = nodes(64);
    let cumulative = cumulative(phase, &xs);
    // Edges at nodes, where equal shares are passed.
    let cells = 64_u32;
    let mut edges = vec![0];
    for k in 1..cells {
        let share = f64::from(k) / f64::from(cells);
        let at = cumulative.partition_point(|c| c.0 < share);
        if at > edges[edges.len() - 1] && at < xs.len() - 1 {
            edges.push(at);
        }
    }
    edges.push(xs.len() - 1);
    let n = 1 << 20;
    let mut hits = vec![0_u32; edges.len() - 1];
    for _ in 0..n {
        let x = draw();
        assert!((0.0..=2.0).contains(&x), "1 - cos is {x}");
        let cell = edges[1..edges.len() - 1].partition_point(|&e| xs[e] <= x);
        hits[cell] += 1;
    }
    let mut chi2 = 0.0;
    for (cell, &hit) in hits.iter().enumerate() {
        let share = cumulative[edges[cell + 1]].0 - cumulative[edges[cell]].0;
        let expected = share * f64::from(n);
        assert!(expected > 100.0, "cells are full");
        chi2 += (f64::from(hit) - expected).powi(2) / expected;
    }
    chi_square_p(chi2, f64::from(u32::try_from(hits.len()).expect("few") - 1))
}

#[test]
fn samples_follow_the_density() {
    let axis = DVec3::new(0.36, -0.48, 0.8);
    for (name, phase) in phases() {
        let mut stream = Stream::new(StreamKey::default());
        // From the sine, which keeps the digits of small angles.
        let p = goodness(phase, || {
            let d = phase.sample(axis, &mut stream);
            let (sin2, cos) = (axis.cross(d).length_squared(), axis.dot(d));
            if cos > 0.0 {
                sin2 / (1.0 + cos)
            } else {
                1.0 - cos
            }
            .min(2.0)
        });
        println!("{name}: p {p:.4}");
        assert!(p > 1e-5, "{name}: p {p}");
    }
}

#[test]
fn inverted_numbers_follow_the_density() {
    // In f32, `1 − cos` near 2 is good to 1e-7: too little for a peak backwards, which only
    // samples resolve.
    let resolved = phases()
        .into_iter()
        .filter(|(_, phase)| phase.eval(-1.0) < 1e4);
    for (name, phase) in resolved {
        let mut stream = Stream::new(StreamKey {
            seed: 1,
            ..StreamKey::default()
        });
        let p = goodness(phase, || f64::from(phase.invert(stream.uniform_positive())));
        println!("{name}: p {p:.4}");
        assert!(p > 1e-5, "{name}: p {p}");
    }
}

/// Chi-square of 16 azimuths around the axis of each of several directions.
#[test]
fn azimuths_are_uniform() {
    let phase = Phase::Droplets(Droplets::new(20.0).expect("a diameter of the fit"));
    for axis in [DVec3::Z, DVec3::NEG_Z, DVec3::new(0.36, -0.48, 0.8)] {
        let mut stream = Stream::new(StreamKey::default());
        let s = axis.any_orthonormal_vector();
        let t = axis.cross(s);
        let (n, mut hits) = (1 << 20, [0_u32; 16]);
        for _ in 0..n {
            let d = phase.sample(axis, &mut stream);
            let turn = d.dot(t).atan2(d.dot(s)) / TAU + 0.5;
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "a number in [0, 1]"
            )]
            let cell = ((turn * 16.0) as usize).min(15);
            hits[cell] += 1;
        }
        let expected = f64::from(n) / 16.0;
        let chi2 = hits
            .iter()
            .map(|&h| (f64::from(h) - expected).powi(2) / expected);
        let p = chi_square_p(chi2.sum(), 15.0);
        assert!(p > 1e-5, "axis {axis}: p {p}");
    }
}

//! Oracles and statistics that several test files share.
#![allow(
    dead_code,
    clippy::cast_possible_truncation,
    reason = "each test file uses its own part; numbers are small"
)]

use glam::{DVec3, IVec3};
use majorant::grid::Tree;
use statrs::distribution::{ChiSquared, ContinuousCDF as _};

/// The trilinear value at `p`, in `f64`, by the textbook's sum over eight corners.
pub(crate) fn trilinear(tree: &Tree<f32>, p: DVec3) -> f64 {
    let lo = p.floor();
    let f = p - lo;
    (0..8)
        .map(|i| {
            let corner = IVec3::new(i >> 2 & 1, i >> 1 & 1, i & 1);
            let w = |axis: usize| {
                if corner[axis] == 1 {
                    f[axis]
                } else {
                    1.0 - f[axis]
                }
            };
            let weight = w(0) * w(1) * w(2);
            weight * f64::from(tree.probe(lo.as_ivec3() + corner).value)
        })
        .sum()
}

/// ∫ value dt along `o + t·d` from `t0` to `t1`: the value along a cell is a cubic in t, which
/// four-point Gauss integrates exactly.
pub(crate) fn integrate(tree: &Tree<f32>, (o, d): (DVec3, DVec3), (t0, t1): (f64, f64)) -> f64 {
    const NODES: [(f64, f64); 2] = [
        (0.339_981_043_584_856_26, 0.652_145_154_862_546_1),
        (0.861_136_311_594_052_6, 0.347_854_845_137_453_86),
    ];
    let mut cuts = vec![t0, t1];
    for axis in 0..3 {
        // Zero: parallel to the planes of this axis.
        if d[axis] != 0.0 {
            let (a, b) = (o[axis] + d[axis] * t0, o[axis] + d[axis] * t1);
            let (first, last) = (a.min(b).ceil(), a.max(b).floor());
            let count = (last - first).max(-1.0) as i64;
            cuts.extend((0..=count).map(|k| (first + k as f64 - o[axis]) / d[axis]));
        }
    }
    cuts.retain(|&t| t >= t0 && t <= t1);
    cuts.sort_by(f64::total_cmp);
    cuts.windows(2)
        .map(|w| {
            let (mid, half) = (f64::midpoint(w[0], w[1]), (w[1] - w[0]) / 2.0);
            let at = |x: f64| trilinear(tree, o + d * (mid + half * x));
            half * NODES
                .iter()
                .map(|&(x, w)| w * (at(x) + at(-x)))
                .sum::<f64>()
        })
        .sum()
}

/// The probability of a chi-square statistic at least this large, by chance.
pub(crate) fn chi_square_p(chi2: f64, degrees: f64) -> f64 {
    1.0 - ChiSquared::new(degrees)
        .expect("degrees are positive")
        .cdf(chi2)
}

/// Mean, variance and fourth central moment of a sample.
pub(crate) fn moments(xs: &[f64]) -> (f64, f64, f64) {
    let n = xs.len() as f64;
    let mean = xs.iter().sum::<f64>() / n;
    let central = |k: i32| xs.iter().map(|x| (x - mean).powi(k)).sum::<f64>() / n;
    (mean, central(2), central(4))
}

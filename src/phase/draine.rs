//! Draine's phase function: Henyey–Greenstein times `1 + α cos² θ`.
//!
//! Between the two it is built of: α = 0 is Henyey–Greenstein, g = 0 and α = 1 is Rayleigh's.
//! Sampling inverts the distribution, which is known in closed form, by Newton's method in `f64`:
//! exact to rounding, for any g and α.
//!
//! # Reference
//! `[Draine2003]`.

use super::eval_henyey_greenstein;

/// Below this |g| the closed form of the distribution, which divides by g³, loses digits; there a
/// quadrature of five points is good to 1e-9.
const LEAST_CLOSED_G: f64 = 0.1;

/// Nodes in (0, 1) and weights of the Gauss–Legendre rule of five points.
const GAUSS: [(f64, f64); 5] = [
    (0.046_910_077_030_668, 0.118_463_442_528_095),
    (0.230_765_344_947_158, 0.239_314_335_249_683),
    (0.5, 0.284_444_444_444_444),
    (0.769_234_655_052_842, 0.239_314_335_249_683),
    (0.953_089_922_969_332, 0.118_463_442_528_095),
];

/// Draine's phase function.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Draine {
    /// Of the Henyey–Greenstein factor, in (−1, 1).
    pub(super) g: f32,
    /// Weight of cos², 0 or more.
    pub(super) alpha: f32,
}

impl Draine {
    /// Returns the integral of `1 + α cos²` over the Henyey–Greenstein function.
    fn norm(self) -> f64 {
        let (g, alpha) = (f64::from(self.g), f64::from(self.alpha));
        1.0 + alpha * (1.0 + 2.0 * g * g) / 3.0
    }

    /// Returns the density per steradian at `1 − cos θ`.
    #[expect(clippy::cast_possible_truncation, reason = "densities are f32")]
    pub(super) fn eval(self, one_minus_cos: f64) -> f32 {
        let cos = (1.0 - one_minus_cos) as f32;
        let factor = (1.0 + self.alpha * cos * cos) / self.norm() as f32;
        factor * eval_henyey_greenstein(self.g, one_minus_cos)
    }

    /// Returns `1 − cos θ` for the uniform number `u`; 1 is straight on.
    ///
    /// In terms of `z` with `cos θ = 2z(1 + g − gz) − 1` and `s = 1 + g − 2gz`, the distribution has
    /// the density `(1 + α cos²)(1 − g²)/s²`, smooth for any g, and `1 − cos θ = 2(1 − z)(1 − gz)`
    /// keeps the digits of small angles.
    pub(super) fn sample(self, u: f32) -> f64 {
        let g = f64::from(self.g);
        let target = f64::from(u) * self.norm();
        // Where Henyey–Greenstein alone would go; then Newton, kept between what is too low and too
        // high, since the density is a hundred times smaller sideways than ahead.
        let (mut low, mut high) = (0.0, 1.0);
        let mut z = f64::from(u) * (1.0 + g) / (1.0 - g + 2.0 * g * f64::from(u));
        for _ in 0..64 {
            let error = self.cumulative(z) - target;
            if error > 0.0 {
                high = z;
            } else {
                low = z;
            }
            let step = z - error / self.density(z);
            let next = if step > low && step < high {
                step
            } else {
                f64::midpoint(low, high)
            };
            let moved = (next - z).abs();
            z = next;
            if moved < 1e-13 {
                break;
            }
        }
        2.0 * (1.0 - z) * (1.0 - g * z)
    }

    /// Returns the mean cosine.
    ///
    /// # Reference
    /// `[Draine2003]`.
    #[expect(clippy::cast_possible_truncation, reason = "a number in [-1, 1]")]
    pub(super) fn mean_cosine(self) -> f32 {
        let (g, alpha) = (f64::from(self.g), f64::from(self.alpha));
        (g * (1.0 + alpha * (3.0 + 2.0 * g * g) / 5.0) / self.norm()) as f32
    }

    /// Returns the density in `z`, up to the norm.
    fn density(self, z: f64) -> f64 {
        let (g, alpha) = (f64::from(self.g), f64::from(self.alpha));
        let cos = 2.0 * z * (1.0 + g - g * z) - 1.0;
        let s = 1.0 + g - 2.0 * g * z;
        (1.0 + alpha * cos * cos) * (1.0 - g * g) / (s * s)
    }

    /// Returns the integral of the density from 0 to `z`.
    fn cumulative(self, z: f64) -> f64 {
        let (g, alpha) = (f64::from(self.g), f64::from(self.alpha));
        if g.abs() < LEAST_CLOSED_G {
            return GAUSS.iter().map(|(x, w)| w * z * self.density(z * x)).sum();
        }
        // cos = (1 + g² − s²)/(2g): a sum of powers of s.
        let (top, k) = (1.0 + g, 1.0 + g * g);
        let s = top - 2.0 * g * z;
        let a = alpha / (4.0 * g * g);
        let sum = (1.0 + a * k * k) * (1.0 / s - 1.0 / top) - 2.0 * a * k * (top - s)
            + a / 3.0 * (top.powi(3) - s.powi(3));
        sum * (1.0 - g * g) / (2.0 * g)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_forms_of_the_distribution_meet() {
        for alpha in [0.0, 1.0, 30.0, 250.0] {
            for g in [-0.62, -0.11, -0.099, 0.0, 1e-5, 0.099, 0.11, 0.62, 0.9] {
                let draine = Draine { g, alpha };
                let total = draine.cumulative(1.0);
                assert!(
                    (total / draine.norm() - 1.0).abs() < 1e-9,
                    "g {g}, alpha {alpha}: {total}, not {}",
                    draine.norm()
                );
                // Inverse of the distribution, against a midpoint rule of the density.
                let n = 100_000;
                for u in [1e-6_f32, 0.1, 0.5, 0.9, 0.999_999] {
                    let x = draine.sample(u);
                    let below: f64 = (0..n)
                        .map(|i| {
                            let x = 2.0 - (2.0 - x) * (f64::from(i) + 0.5) / f64::from(n);
                            f64::from(draine.eval(x))
                        })
                        .sum();
                    let below = std::f64::consts::TAU * below * (2.0 - x) / f64::from(n);
                    assert!(
                        (below - f64::from(u)).abs() < 1e-5,
                        "g {g}, alpha {alpha}, u {u}: {below} lies below"
                    );
                }
            }
        }
    }
}

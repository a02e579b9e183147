//! Phase functions: the density of the scattered direction.
//!
//! The angle is between **directions of propagation**, in and out: `cos_theta = 1` goes
//! straight on, and `g > 0` scatters forwards. Densities are per steradian and integrate to 1
//! over the sphere. Sampling is exact, so a sampled direction carries weight 1.
//!
//! Functions of two lobes choose a lobe, then draw from it: the density is that of the sum.

mod draine;
mod droplets;

use std::f32::consts::PI;

use glam::DVec3;

use crate::sampling::Stream;
use crate::space::orthonormal_frame;

pub use self::droplets::Droplets;

/// A phase function of the cosine between the directions of propagation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Phase {
    /// Every direction alike.
    Isotropic,
    /// Henyey–Greenstein with mean cosine `g` in (−1, 1).
    ///
    /// # Reference
    /// `[Henyey1941]`.
    HenyeyGreenstein {
        /// Mean cosine.
        g: f32,
    },
    /// Two Henyey–Greenstein lobes: one forwards and one backwards, say.
    DoubleHenyeyGreenstein {
        /// Their mean cosines, each in (−1, 1).
        gs: [f32; 2],
        /// Share of the first, in [0, 1].
        first_weight: f32,
    },
    /// Particles much smaller than the wavelength, as air: `3 (1 + cos² θ) / 16π`.
    Rayleigh,
    /// Water droplets of one size: mist, fog and clouds.
    Droplets(Droplets),
}

impl Phase {
    /// Returns the density per steradian at `cos_theta`.
    pub fn eval(self, cos_theta: f64) -> f32 {
        match self {
            Self::Isotropic => 1.0 / (4.0 * PI),
            Self::HenyeyGreenstein { g } => eval_henyey_greenstein(g, 1.0 - cos_theta),
            Self::DoubleHenyeyGreenstein {
                gs: [a, b],
                first_weight,
            } => {
                let x = 1.0 - cos_theta;
                first_weight * eval_henyey_greenstein(a, x)
                    + (1.0 - first_weight) * eval_henyey_greenstein(b, x)
            }
            Self::Rayleigh => {
                #[expect(clippy::cast_possible_truncation, reason = "a number in [-1, 1]")]
                let cos = cos_theta as f32;
                3.0 / (16.0 * PI) * (1.0 + cos * cos)
            }
            Self::Droplets(droplets) => droplets.eval(1.0 - cos_theta),
        }
    }

    /// Draws a direction of propagation after scattering out of the unit vector `direction`.
    pub fn sample(self, direction: DVec3, stream: &mut Stream) -> DVec3 {
        let one_minus_cos = match self {
            Self::Isotropic => 2.0 * (1.0 - f64::from(stream.uniform())),
            Self::HenyeyGreenstein { g } => sample_henyey_greenstein(g, stream.uniform_positive()),
            _ => self.sample_lobe(stream.uniform(), stream.uniform_positive()),
        };
        deflect(direction, one_minus_cos, stream.uniform())
    }

    /// Returns `1 − cos θ` for the uniform number `u` in (0, 1]: the inverse of its distribution,
    /// one lobe after the other if it has two.
    #[expect(
        clippy::cast_possible_truncation,
        reason = "within 6e-8 of the sampled angle"
    )]
    pub fn invert(self, u: f32) -> f32 {
        match self {
            Self::Isotropic => 2.0 * (1.0 - u),
            Self::HenyeyGreenstein { g } => sample_henyey_greenstein(g, u) as f32,
            _ => {
                let first = self.first_weight();
                // The lobes may have a share of zero, which no number is in.
                let within = if u <= first {
                    u / first
                } else {
                    (u - first) / (1.0 - first)
                };
                let choice = if u <= first { 0.0 } else { 1.0 };
                self.sample_lobe(choice, within.min(1.0)) as f32
            }
        }
    }

    /// Returns the mean cosine.
    pub fn mean_cosine(self) -> f32 {
        match self {
            Self::Isotropic | Self::Rayleigh => 0.0,
            Self::HenyeyGreenstein { g } => g,
            Self::DoubleHenyeyGreenstein {
                gs: [a, b],
                first_weight,
            } => first_weight * a + (1.0 - first_weight) * b,
            Self::Droplets(droplets) => droplets.mean_cosine(),
        }
    }

    /// Returns the share of the lobe that is drawn for choices below it.
    fn first_weight(self) -> f32 {
        match self {
            Self::DoubleHenyeyGreenstein { first_weight, .. } => first_weight,
            Self::Droplets(droplets) => droplets.first_weight(),
            Self::Isotropic | Self::HenyeyGreenstein { .. } | Self::Rayleigh => 1.0,
        }
    }

    /// Returns `1 − cos θ` for the uniform number `u` in the lobe that the number `choice` selects.
    fn sample_lobe(self, choice: f32, u: f32) -> f64 {
        match self {
            Self::Isotropic => 2.0 * (1.0 - f64::from(u)),
            Self::HenyeyGreenstein { g } => sample_henyey_greenstein(g, u),
            Self::DoubleHenyeyGreenstein {
                gs: [a, b],
                first_weight,
            } => sample_henyey_greenstein(if choice < first_weight { a } else { b }, u),
            Self::Rayleigh => sample_rayleigh(u),
            Self::Droplets(droplets) => droplets.sample(choice, u),
        }
    }
}

/// Draws `1 − cos θ` of Rayleigh's function from the uniform number `u`.
///
/// Its distribution is the cubic `(cos³ θ + 3 cos θ + 4)/8`, whose inverse is
/// `cos θ = 2 sinh(asinh(4u − 2)/3)`, since `4 sinh³ x + 3 sinh x = sinh 3x`.
fn sample_rayleigh(u: f32) -> f64 {
    let cos = 2.0 * ((4.0 * f64::from(u) - 2.0).asinh() / 3.0).sinh();
    (1.0 - cos).clamp(0.0, 2.0)
}

/// Returns the Henyey–Greenstein density in terms of `1 − cos θ`.
///
/// `(1 − g²) / (4π (e² + 2g(1 − cos θ))^{3/2})` with `e = 1 − g`: a sum of positive terms
/// for g > 0, where the textbook's `1 + g² − 2g cos θ` cancels to nothing near g = 1. The
/// mirror image serves g < 0.
fn eval_henyey_greenstein(g: f32, one_minus_cos: f64) -> f32 {
    let (g, x) = if g < 0.0 {
        (-g, 2.0 - one_minus_cos)
    } else {
        (g, one_minus_cos)
    };
    #[expect(
        clippy::cast_possible_truncation,
        reason = "the small angle keeps its digits"
    )]
    let x = x as f32;
    let e = 1.0 - g;
    let d = e * e + 2.0 * g * x.max(0.0);
    e * (1.0 + g) / (4.0 * PI * d * d.sqrt())
}

/// Draws `1 − cos θ` of the Henyey–Greenstein function from the uniform number `u`.
///
/// With `e = 1 − g`, `d = e + 2gu`, `s = e(1 + g)/d`, the inverse of the distribution is
/// `1 − cos θ = e(1 − u)(s + e)/d`. In `f32` the textbook's form returns cos θ = 1 for 59 %
/// of all u at g = 0.9999, and cos θ > 1 for some; this one keeps all digits of the small
/// angle, so the mean cosine is right to 1e-6 up to 1 − g = 1e-6.
fn sample_henyey_greenstein(g: f32, u: f32) -> f64 {
    let a = g.abs();
    let e = 1.0 - a;
    let d = e + 2.0 * a * u;
    let s = e * (1.0 + a) / d;
    // In f64 from here: near g = -1, f32 could not tell 2 - x from 2.
    let x = f64::from(e * (1.0 - u) * (s + e) / d).min(2.0);
    if g < 0.0 { 2.0 - x } else { x }
}

/// Turns the unit vector `direction` by the polar angle given as `1 − cos θ` and the azimuth
/// `2π u`.
fn deflect(direction: DVec3, one_minus_cos: f64, u: f32) -> DVec3 {
    let x = one_minus_cos;
    let sin_theta = (x * (2.0 - x)).max(0.0).sqrt();
    let (sin_phi, cos_phi) = (2.0 * PI * u).sin_cos();
    let (s, t) = orthonormal_frame(direction);
    let v = s * (sin_theta * f64::from(cos_phi))
        + t * (sin_theta * f64::from(sin_phi))
        + direction * (1.0 - x);
    // One Newton step: the f32 sine and cosine are off unit length by 1e-7, which thousands
    // of bounces would add up.
    v * (1.5 - 0.5 * v.length_squared())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampling::StreamKey;

    const GS: [f32; 9] = [
        -0.999_999, -0.95, -0.5, 0.0, 0.3, 0.85, 0.95, 0.999, 0.999_999,
    ];

    #[test]
    fn densities_integrate_to_one_with_mean_cosine_g() {
        // At 1e-6 from 1 the midpoint rule below is too coarse; the next test goes there.
        for g in GS.into_iter().filter(|g| g.abs() < 0.9999) {
            // Substituting the sampler's own variable resolves the peak at any g.
            let n = 400_000;
            let (mut total, mut mean) = (0.0_f64, 0.0_f64);
            let x_of = |u: f32| sample_henyey_greenstein(g, u);
            for i in 0..n {
                let (a, b) = (x_of(i as f32 / n as f32), x_of((i + 1) as f32 / n as f32));
                let mid = f64::midpoint(a, b);
                let p = f64::from(eval_henyey_greenstein(g, mid));
                total += 2.0 * std::f64::consts::PI * p * (a - b).abs();
                mean += 2.0 * std::f64::consts::PI * p * (a - b).abs() * (1.0 - mid);
            }
            // The midpoint rule is off by less than 1e-3 in the steepest cell at |g| → 1.
            assert!((total - 1.0).abs() < 2e-3, "g {g}: integral {total}");
            assert!(
                (mean - f64::from(g)).abs() < 2e-3,
                "g {g}: mean cosine {mean}"
            );
        }
    }

    #[test]
    fn mean_cosine_of_samples_is_g_to_the_edge() {
        for g in GS {
            // u = v^8 puts equally many points into each decade of the steep end.
            let n = 1 << 20;
            let mean = (0..n)
                .map(|i| {
                    let v = (f64::from(i) + 0.5) / f64::from(n);
                    #[expect(clippy::cast_possible_truncation, reason = "test input")]
                    let u = v.powi(8) as f32;
                    8.0 * v.powi(7) * sample_henyey_greenstein(g, u)
                })
                .sum::<f64>()
                / f64::from(n);
            let (one_minus_g, scale) = (1.0 - f64::from(g), 1.0 - f64::from(g.abs()));
            // f32 arithmetic at 1 - |g| = 1e-6 leaves 1e-3 of it; the sum itself is good to 1e-6.
            let error = (mean - one_minus_g).abs() / scale;
            assert!(
                error < 5e-3,
                "g {g}: mean of 1 - cos is off by {error} of 1 - |g|"
            );
        }
    }

    #[test]
    fn directions_keep_unit_length_over_thousands_of_bounces() {
        let mut stream = Stream::new(StreamKey {
            seed: 1,
            ..StreamKey::default()
        });
        for phase in [Phase::Isotropic, Phase::HenyeyGreenstein { g: 0.999 }] {
            let mut d = DVec3::Z;
            for _ in 0..10_000 {
                d = phase.sample(d, &mut stream);
            }
            assert!(
                (d.length() - 1.0).abs() < 1e-12,
                "{phase:?}: length {}",
                d.length()
            );
        }
    }

    #[test]
    fn forward_is_forward() {
        let mut stream = Stream::new(StreamKey {
            seed: 2,
            ..StreamKey::default()
        });
        let phase = Phase::HenyeyGreenstein { g: 0.85 };
        let n = 100_000;
        let axis = DVec3::new(0.6, 0.0, -0.8);
        let mean = (0..n)
            .map(|_| phase.sample(axis, &mut stream).dot(axis))
            .sum::<f64>()
            / f64::from(n);
        // The standard deviation of the cosine is below 0.3, so 5 sigma are 0.005.
        assert!((mean - 0.85).abs() < 5e-3, "mean cosine {mean}");
        assert!(
            phase.eval(1.0) > 100.0 * phase.eval(-1.0),
            "cos 1 is straight on"
        );
    }
}

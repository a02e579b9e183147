//! Scattering by water droplets of one size, as a fit to Mie's theory.
//!
//! A narrow Henyey–Greenstein lobe for what is diffracted and refracted forwards, and Draine's
//! function for the rest with its rise backwards. The four parameters are published functions of
//! the diameter, in four ranges. Colour, the fog bow and the glory are not in the fit: it is for
//! the mean over visible wavelengths.
//!
//! # Reference
//! `[Jendersie2023]`, the formulas of its supplement for small droplets.

use super::draine::Draine;
use super::{eval_henyey_greenstein, sample_henyey_greenstein};

/// The fit for one diameter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Droplets {
    /// Mean cosine of the narrow lobe.
    g: f32,
    draine: Draine,
    /// Share of Draine's function.
    draine_weight: f32,
}

impl Droplets {
    /// Largest diameter of the fit, in micrometres.
    pub const MAX_MICROMETRES: f64 = 50.0;

    /// Fits droplets of a diameter in micrometres; `None` outside (0, 50].
    ///
    /// The four ranges of the fit meet at 0.1, 1.5 and 5 micrometres, with jumps of up to 0.02 of
    /// the mean cosine. Droplets without size scatter as Rayleigh says.
    pub fn new(micrometres: f64) -> Option<Self> {
        let d = micrometres;
        if !(d > 0.0 && d <= Self::MAX_MICROMETRES) {
            return None;
        }
        let l = d.ln();
        let (g, draine_g, alpha, weight) = if d < 0.1 {
            (
                13.8 * d * d,
                1.1456 * d * (9.29044 * d).sin(),
                250.0,
                0.252977 - 312.983 * d.powf(4.3),
            )
        } else if d < 1.5 {
            let inner = (l - 0.238604) * (l + 1.00667) / (0.507522 - 0.15677 * l);
            let outer = 1.19692 * inner.cos() + 1.37932 * l + 0.0625835;
            (
                0.862 - 0.143 * l * l,
                0.379685 * outer.cos() + 0.344213,
                250.0,
                0.146209 * (3.38707 * l + 2.11193).cos() + 0.316072 + 0.0778917 * l,
            )
        } else if d < 5.0 {
            let ll = l.ln();
            (
                0.0604931 * ll + 0.940256,
                0.500411 - 0.081287 / (-2.0 * l + l.tan() + 1.27551),
                7.30354 * l + 6.31675,
                0.026914 * (l - (5.68947 * (ll - 0.0292149)).cos()) + 0.376475,
            )
        } else {
            (
                (-0.0990567 / (d - 1.67154)).exp(),
                (-2.20679 / (d + 3.91029) - 0.428934).exp(),
                (3.62489 - 8.29288 / (d + 5.52825)).exp(),
                (-0.599085 / (d - 0.641583) - 0.665888).exp(),
            )
        };
        #[expect(clippy::cast_possible_truncation, reason = "parameters are f32")]
        Some(Self {
            g: g as f32,
            draine: Draine {
                g: draine_g as f32,
                alpha: alpha as f32,
            },
            draine_weight: weight as f32,
        })
    }

    /// Returns the density per steradian at `1 − cos θ`.
    pub(super) fn eval(self, one_minus_cos: f64) -> f32 {
        let narrow = eval_henyey_greenstein(self.g, one_minus_cos);
        narrow + self.draine_weight * (self.draine.eval(one_minus_cos) - narrow)
    }

    /// Returns `1 − cos θ` for the uniform number `u` within a lobe that `choice` selects.
    pub(super) fn sample(self, choice: f32, u: f32) -> f64 {
        if choice < self.draine_weight {
            self.draine.sample(u)
        } else {
            sample_henyey_greenstein(self.g, u)
        }
    }

    /// Returns the share of the lobe that small choices select.
    pub(super) fn first_weight(self) -> f32 {
        self.draine_weight
    }

    /// Returns the mean cosine.
    pub(super) fn mean_cosine(self) -> f32 {
        self.g + self.draine_weight * (self.draine.mean_cosine() - self.g)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parameters_are_in_range_for_every_diameter() {
        let mut before = Droplets::new(1e-6).unwrap().mean_cosine();
        for i in 0..=5000 {
            let d = 1e-3 * (f64::from(i) / 5000.0 * (50_000.0_f64).ln()).exp();
            let droplets = Droplets::new(d.min(50.0)).unwrap();
            let Droplets {
                g,
                draine,
                draine_weight,
            } = droplets;
            assert!(g.abs() < 1.0 && draine.g.abs() < 1.0, "{d}: {droplets:?}");
            assert!(draine.alpha >= 0.0, "{d}: {droplets:?}");
            assert!((0.0..=1.0).contains(&draine_weight), "{d}: {droplets:?}");
            let mean = droplets.mean_cosine();
            assert!(
                (mean - before).abs() < 0.03,
                "{d}: mean cosine jumps from {before} to {mean}"
            );
            before = mean;
        }
        assert!(Droplets::new(0.0).is_none() && Droplets::new(50.1).is_none());
        assert!(Droplets::new(f64::NAN).is_none());
    }

    #[test]
    fn the_smallest_scatter_as_rayleigh_says() {
        let droplets = Droplets::new(1e-3).unwrap();
        for cos in [-1.0, -0.3, 0.0, 0.7, 1.0_f32] {
            let rayleigh = 3.0 / (16.0 * std::f32::consts::PI) * (1.0 + cos * cos);
            let eval = droplets.eval(f64::from(1.0 - cos));
            assert!((eval / rayleigh - 1.0).abs() < 0.01, "cos {cos}: {eval}");
        }
    }
}

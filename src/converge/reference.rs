//! What images are compared with: a mean and, where it is known, its own noise.
//!
//! A reference is an estimate itself. The expectation of a squared difference is
//! `E (x − r)² = var(x) + var(r) + bias²`, so the noise of the reference is subtracted from what
//! is measured, and shown as the floor below which nothing can be told. A reference without a
//! known variance counts as exact, and whoever prints results says so.

use crate::film::{Film, Pixel};

/// An image to compare with, row by row from the top left.
#[derive(Clone, Debug, PartialEq)]
pub struct Reference {
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Linear radiance.
    pub mean: Vec<[f64; 3]>,
    /// Variance of `mean`, if it is known.
    pub variance: Option<Vec<[f64; 3]>>,
    /// Largest rounding error of `mean` relative to the value, such as 2⁻¹¹ for halves. It is
    /// the same wherever values are the same, so averaging over pixels does not reduce it.
    pub relative_rounding: f64,
}

impl Reference {
    /// Takes the mean and the variance of a film.
    ///
    /// The variance is unknown if a pixel has less than two samples.
    pub fn from_film(film: &Film) -> Self {
        let known = film.pixels().iter().all(|p| p.count >= 2);
        let variance = || film.pixels().iter().map(Pixel::variance_of_mean).collect();
        Self {
            width: film.width(),
            height: film.height(),
            mean: film.pixels().iter().map(|p| p.mean).collect(),
            variance: known.then(variance),
            relative_rounding: 0.0,
        }
    }

    /// Returns the variance of one pixel, rounding included; zero where it is unknown.
    pub fn variance_at(&self, pixel: usize) -> [f64; 3] {
        let variance = self.variance.as_ref().map_or([0.0; 3], |v| v[pixel]);
        let mean = self.mean[pixel];
        std::array::from_fn(|c| {
            // A uniform error of at most h has the variance h²/3.
            let rounding = mean[c] * self.relative_rounding;
            variance[c] + rounding * rounding / 3.0
        })
    }
}

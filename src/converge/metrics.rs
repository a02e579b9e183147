//! Errors of one image against the reference.
//!
//! All are taken over the pixels that the medium covers, R, G and B alike. With `x` the image,
//! `r` the reference and `w = 1 / (r² + 0.01)`:
//!
//! * MSE is the mean of `(x − r)²`, relMSE that of `w (x − r)²`. The constant keeps black pixels
//!   from deciding everything; 0.01 suits scenes whose radiance is of the order of one.
//! * The trimmed relMSE leaves out the worst hundredth of the pixels. Where it is far below the
//!   untrimmed one, a few bright pixels make up the error.
//! * The noise of the reference, the mean of `var(r)` or `w var(r)` over the same pixels, is
//!   reported beside each, for the reader to subtract.
//! * The variance comes from the image's own samples, without the reference: what remains of the
//!   error where there is no bias.

use serde::{Deserialize, Serialize};

use super::Reference;
use crate::film::{Film, Pixel};

/// The constant of the relative error.
pub const EPSILON: f64 = 0.01;

/// The trimmed error leaves out the worst one of so many pixels.
pub const TRIMMED_ONE_OF: usize = 100;

/// A mean squared error, and how much of it is the reference's own noise.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SquaredError {
    /// As measured.
    pub raw: f64,
    /// Expected of a perfect image.
    pub noise: f64,
}

impl SquaredError {
    /// Returns the error without the reference's noise. Below zero by chance where the error is
    /// smaller than what the reference can tell.
    pub fn value(&self) -> f64 {
        self.raw - self.noise
    }
}

/// Errors of one image.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Errors {
    /// Mean squared error.
    pub mse: SquaredError,
    /// Relative mean squared error.
    pub rel_mse: SquaredError,
    /// The same without the worst pixels.
    pub rel_mse_trimmed: SquaredError,
    /// Variance of the pixels by the image's own samples; `None` below two samples.
    pub variance: Option<f64>,
    /// The same weighted like the relative error.
    pub rel_variance: Option<f64>,
}

/// Returns the weight of the relative error at a reference value.
pub fn relative_weight(reference: f64) -> f64 {
    (reference * reference + EPSILON).recip()
}

/// Measures `film` against `reference` over the pixels of index `covered`.
///
/// An empty selection has no error.
pub fn errors(film: &Film, reference: &Reference, covered: &[usize]) -> Errors {
    let n = (covered.len() * 3) as f64;
    if covered.is_empty() {
        return Errors::default();
    }
    let mut mse = SquaredError::default();
    let (mut variance, mut rel_variance) = (0.0, 0.0);
    // Of each pixel, the relative squared error and the reference's share, summed over channels.
    let mut relative = Vec::with_capacity(covered.len());
    for &i in covered {
        let pixel = &film.pixels()[i];
        let (r, r_variance) = (reference.mean[i], reference.variance_at(i));
        let own_variance = pixel.variance_of_mean();
        let mut sums = (0.0, 0.0);
        for c in 0..3 {
            let w = relative_weight(r[c]);
            let squared = (pixel.mean[c] - r[c]).powi(2);
            mse.raw += squared / n;
            mse.noise += r_variance[c] / n;
            variance += own_variance[c] / n;
            rel_variance += w * own_variance[c] / n;
            sums.0 += w * squared;
            sums.1 += w * r_variance[c];
        }
        relative.push(sums);
    }
    let mean_of = |kept: &[(f64, f64)]| SquaredError {
        raw: kept.iter().map(|s| s.0).sum::<f64>() / (kept.len() * 3) as f64,
        noise: kept.iter().map(|s| s.1).sum::<f64>() / (kept.len() * 3) as f64,
    };
    let rel_mse = mean_of(&relative);
    relative.sort_by(|a, b| a.0.total_cmp(&b.0));
    let kept = covered.len() - covered.len() / TRIMMED_ONE_OF;
    let known = covered.iter().all(|&i| film.pixels()[i].count >= 2);
    Errors {
        mse,
        rel_mse,
        rel_mse_trimmed: mean_of(&relative[..kept]),
        variance: known.then_some(variance),
        rel_variance: known.then_some(rel_variance),
    }
}

/// Returns the relative error of one pixel: the root of the mean over channels of
/// `w (x − r)²`. For pictures.
pub fn relative_error(pixel: &Pixel, reference: [f64; 3]) -> f64 {
    let squared = |c: usize| (pixel.mean[c] - reference[c]).powi(2) * relative_weight(reference[c]);
    ((0..3).map(squared).sum::<f64>() / 3.0).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn film(pixels: &[[f64; 3]], m2: f64) -> Film {
        let width = u32::try_from(pixels.len()).unwrap();
        let mut film = Film::new(width, 1);
        for (pixel, &mean) in film.pixels_mut().iter_mut().zip(pixels) {
            *pixel = Pixel {
                count: 3,
                mean,
                m2: [m2; 3],
                ..Pixel::default()
            };
        }
        film
    }

    #[test]
    fn errors_are_those_worked_out_by_hand() {
        let image = film(&[[1.0, 2.0, 3.0], [0.0, 0.0, 0.5]], 0.6);
        let reference = Reference {
            width: 2,
            height: 1,
            mean: vec![[1.0, 1.0, 1.0], [0.0, 0.1, 0.0]],
            variance: Some(vec![[0.3; 3], [0.0, 0.6, 0.0]]),
            relative_rounding: 0.0,
        };
        let e = errors(&image, &reference, &[0, 1]);
        let close = |a: f64, b: f64| assert!((a - b).abs() < 1e-12, "{a}, not {b}");
        // (0 + 1 + 4 + 0 + 0.01 + 0.25) / 6
        close(e.mse.raw, 5.26 / 6.0);
        close(e.mse.noise, 1.5 / 6.0);
        // Weights: 1/1.01 in the first pixel; 100, 50 and 100 in the second.
        close(e.rel_mse.raw, (5.0 / 1.01 + 0.01 * 50.0 + 25.0) / 6.0);
        close(e.rel_mse.noise, (0.9 / 1.01 + 0.6 * 50.0) / 6.0);
        // The variance of the mean of three samples with m2 = 0.6 is 0.1.
        close(e.variance.unwrap(), 0.1);
        close(e.rel_variance.unwrap(), 0.1 * (3.0 / 1.01 + 250.0) / 6.0);
        close(errors(&image, &reference, &[0]).mse.raw, 5.0 / 3.0);
        assert_eq!(errors(&image, &reference, &[]), Errors::default());
    }

    #[test]
    fn trimming_leaves_out_the_worst_hundredth() {
        let mut pixels = vec![[0.1; 3]; 200];
        pixels[17] = [100.0; 3];
        pixels[180] = [50.0; 3];
        let reference = Reference {
            width: 200,
            height: 1,
            mean: vec![[0.0; 3]; 200],
            variance: None,
            relative_rounding: 0.0,
        };
        let covered: Vec<usize> = (0..200).collect();
        let e = errors(&film(&pixels, 0.0), &reference, &covered);
        assert!((e.rel_mse_trimmed.raw - 1.0).abs() < 1e-12, "{e:?}");
        assert!(e.rel_mse.raw > 6000.0, "{e:?}");
    }

    #[test]
    fn one_sample_has_no_variance() {
        let mut image = film(&[[1.0; 3]], 0.0);
        let reference = Reference::from_film(&image);
        image.pixels_mut()[0].count = 1;
        let e = errors(&image, &reference, &[0]);
        assert_eq!((e.variance, e.rel_variance), (None, None));
        assert_eq!(Reference::from_film(&image).variance, None);
    }
}

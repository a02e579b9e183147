//! Whether an estimator's image differs from the reference by more than noise.
//!
//! All renders of an estimator are merged into one film, whose mean and variance per pixel are
//! then the best known. With `d = x − r` and `v = var(x) + var(r)` per pixel and channel:
//!
//! * `z = d / √v` is N(0, 1) without bias, if the samples are many and not too heavy-tailed:
//!   mean 0, standard deviation 1, 0.27 % beyond ±3.
//! * The mean of `d` over the image has the standard error `√(Σ v) / n`: sees a bias that is the
//!   same everywhere, however small in each pixel.
//! * The means over tiles of 8×8 pixels, squared and summed, follow chi-square: sees a bias that
//!   cancels in the whole image.
//! * The mean of `w (d² − v)` is the squared bias. It is what remains of the relative error after
//!   infinitely many samples: the level where the error curve flattens.
//!
//! The image is called biased if one of the last three is beyond [`THRESHOLD`] standard errors.
//! For an unbiased estimator that has a probability of 4e-5.
//!
//! Assumes that pixels are independent, as they are with a stream each. What it cannot see is
//! written beside the verdict.

use serde::{Deserialize, Serialize};

use super::Reference;
use super::metrics::relative_weight;
use crate::film::Film;

/// Standard errors that chance is not believed to reach.
pub const THRESHOLD: f64 = 4.5;

/// Edge of the tiles in pixels.
const TILE: usize = 8;

/// What the comparison says.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Verdict {
    /// Nothing beyond noise was found.
    Unbiased,
    /// The difference from the reference is not noise.
    Biased,
    /// It is not noise of the image, but may be that of the reference, which is not known.
    Differs,
    /// There is nothing to compare: no pixel with two samples.
    Unknown,
}

/// The comparison of all of an estimator's samples with the reference.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct BiasTest {
    /// What it all comes to.
    pub verdict: Verdict,
    /// Difference of the mean of the covered pixels from the reference's, relative to it; of
    /// the channel with the largest `mean_z`.
    pub mean_difference: f64,
    /// Its standard error, relative to the same.
    pub mean_standard_error: f64,
    /// Their ratio.
    pub mean_z: f64,
    /// Tiles that were compared.
    pub tile_count: usize,
    /// Sum of the squared z of the tiles, as a standard normal number.
    pub tile_z: f64,
    /// Pixels times channels that have any variance, so that z is defined.
    pub z_count: usize,
    /// Mean of z over them.
    pub z_mean: f64,
    /// Standard deviation of z.
    pub z_std: f64,
    /// Share of |z| above 3; 0.27 % without bias.
    pub z_beyond_3: f64,
    /// Mean squared bias, weighted like relMSE; below zero by chance where there is none.
    pub squared_bias: f64,
    /// Its standard error.
    pub squared_bias_standard_error: f64,
}

impl BiasTest {
    /// Returns the squared bias in standard errors.
    pub fn squared_bias_z(&self) -> f64 {
        ratio(self.squared_bias, self.squared_bias_standard_error)
    }
}

/// Zero over zero, no difference without noise, is no evidence.
fn ratio(difference: f64, standard_error: f64) -> f64 {
    if difference == 0.0 {
        0.0
    } else {
        difference / standard_error
    }
}

/// Returns z of one pixel and channel; `None` where neither image has any noise.
pub fn pixel_z(film: &Film, reference: &Reference, pixel: usize, channel: usize) -> Option<f64> {
    let p = &film.pixels()[pixel];
    let v = p.variance_of_mean()[channel] + reference.variance_at(pixel)[channel];
    let d = p.mean[channel] - reference.mean[pixel][channel];
    // Zero: the pixel sees nothing random. Infinite: it has one sample.
    (v > 0.0 && v.is_finite()).then(|| d / v.sqrt())
}

/// Compares `film` with `reference` over the pixels of index `covered`.
pub fn test_bias(film: &Film, reference: &Reference, covered: &[usize]) -> BiasTest {
    let known: Vec<usize> = covered
        .iter()
        .copied()
        .filter(|&i| film.pixels()[i].count >= 2)
        .collect();
    let sums = Sums::of(film, reference, &known);
    let (mean_difference, mean_standard_error) = sums.worst_mean();
    let mean_z = ratio(mean_difference, mean_standard_error);
    let values = known.iter().flat_map(|&i| (0..3).map(move |c| (i, c)));
    let zs: Vec<f64> = values
        .filter_map(|(i, c)| pixel_z(film, reference, i, c))
        .collect();
    let n = (zs.len() as f64).max(1.0);
    let z_mean = zs.iter().sum::<f64>() / n;
    let z_std = (zs.iter().map(|z| (z - z_mean).powi(2)).sum::<f64>() / n).sqrt();
    let (tile_count, tile_z) = tiles(film, reference, &known);
    let (squared_bias, squared_bias_standard_error) = sums.squared_bias();
    let mut test = BiasTest {
        verdict: Verdict::Unknown,
        mean_difference,
        mean_standard_error,
        mean_z,
        tile_count,
        tile_z,
        z_count: zs.len(),
        z_mean,
        z_std,
        z_beyond_3: zs.iter().filter(|z| z.abs() > 3.0).count() as f64 / n,
        squared_bias,
        squared_bias_standard_error,
    };
    let far = mean_z.abs() > THRESHOLD || tile_z > THRESHOLD || test.squared_bias_z() > THRESHOLD;
    test.verdict = match (known.is_empty(), far, reference.variance.is_some()) {
        (true, _, _) => Verdict::Unknown,
        (false, false, _) => Verdict::Unbiased,
        (false, true, true) => Verdict::Biased,
        (false, true, false) => Verdict::Differs,
    };
    test
}

/// Sums over pixels.
#[derive(Default)]
struct Sums {
    count: f64,
    difference: [f64; 3],
    variance: [f64; 3],
    reference: [f64; 3],
    rounding: [f64; 3],
    squared_bias: f64,
    squared_bias_squared: f64,
}

impl Sums {
    fn of(film: &Film, reference: &Reference, pixels: &[usize]) -> Self {
        let mut sums = Self::default();
        for &i in pixels {
            let p = &film.pixels()[i];
            let (own, other) = (p.variance_of_mean(), reference.variance_at(i));
            let mut squared_bias = 0.0;
            for c in 0..3 {
                let r = reference.mean[i][c];
                let (d, v) = (p.mean[c] - r, own[c] + other[c]);
                sums.difference[c] += d;
                sums.variance[c] += v;
                sums.reference[c] += r;
                sums.rounding[c] += r.abs() * reference.relative_rounding;
                squared_bias += relative_weight(r) * (d * d - v) / 3.0;
            }
            sums.squared_bias += squared_bias;
            sums.squared_bias_squared += squared_bias * squared_bias;
            sums.count += 1.0;
        }
        sums
    }

    /// Mean difference and standard error, relative to the reference, of the worst channel.
    fn worst_mean(&self) -> (f64, f64) {
        let channel = |c: usize| {
            let scale = self.reference[c].abs().max(f64::MIN_POSITIVE);
            // Rounding errors of equal pixels are equal: they do not average out.
            let error = (self.variance[c] + self.rounding[c].powi(2) / 3.0).sqrt();
            (self.difference[c] / scale, error / scale)
        };
        let z = |&(d, e): &(f64, f64)| ratio(d, e).abs();
        (0..3)
            .map(channel)
            .max_by(|a, b| z(a).total_cmp(&z(b)))
            .unwrap_or_default()
    }

    /// Mean over pixels and its standard error.
    fn squared_bias(&self) -> (f64, f64) {
        let n = self.count.max(1.0);
        let mean = self.squared_bias / n;
        let variance = (self.squared_bias_squared / n - mean * mean).max(0.0);
        (mean, (variance / n).sqrt())
    }
}

/// Returns the number of tiles and the chi-square of their means as a standard normal number,
/// of the channel where it is largest.
fn tiles(film: &Film, reference: &Reference, pixels: &[usize]) -> (usize, f64) {
    let width = film.width() as usize;
    let columns = width.div_ceil(TILE);
    let rows = (film.height() as usize).div_ceil(TILE);
    let mut sums = vec![[(0.0, 0.0); 3]; columns * rows];
    for &i in pixels {
        let tile = &mut sums[i / width / TILE * columns + i % width / TILE];
        let p = &film.pixels()[i];
        let (own, other) = (p.variance_of_mean(), reference.variance_at(i));
        for c in 0..3 {
            tile[c].0 += p.mean[c] - reference.mean[i][c];
            tile[c].1 += own[c] + other[c];
        }
    }
    let channel = |c: usize| {
        let squares = sums
            .iter()
            .map(|tile| tile[c])
            .filter(|&(_, v)| v > 0.0)
            .map(|(d, v)| d * d / v);
        squares.fold((0_usize, 0.0), |(n, chi2), z2| (n + 1, chi2 + z2))
    };
    (0..3)
        .map(channel)
        .map(|(n, chi2)| (n, normal_from_chi_square(chi2, n as f64)))
        .max_by(|a, b| a.1.total_cmp(&b.1))
        .unwrap_or_default()
}

/// Returns the standard normal number that is as improbable as a chi-square.
///
/// # Reference
/// `[Wilson1931]`: the cube root is nearly normal.
fn normal_from_chi_square(chi2: f64, degrees: f64) -> f64 {
    if degrees == 0.0 {
        return 0.0;
    }
    let variance = 2.0 / (9.0 * degrees);
    ((chi2 / degrees).cbrt() - (1.0 - variance)) / variance.sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn chi_square_becomes_normal() {
        // The 97.5 % points of chi-square.
        for (degrees, chi2) in [(10.0, 20.483), (100.0, 129.561)] {
            let z = normal_from_chi_square(chi2, degrees);
            assert!((z - 1.96).abs() < 0.01, "{degrees}: {z}");
        }
    }
}

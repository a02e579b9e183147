//! Mean and second moment, opacity and depth of one pixel, with the sample count.
//!
//! A [`Batch`] sums samples and their squares in `f64`, relative to its first sample: no
//! division for each sample, and no digits lost where samples vary little about a large mean.
//! [`Pixel`]s merge exactly like one longer run (Chan's formula). No reconstruction filter: a
//! sample belongs to one pixel (box filter of one pixel width).

use crate::spectrum::Rgb;

/// What one camera path brings home.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Sample {
    /// Radiance towards the camera.
    pub radiance: Rgb,
    /// Estimate of the opacity along the camera ray: 0 or 1, or what is between.
    pub opacity: f64,
    /// Depth of the first collision along the camera axis.
    pub depth: f64,
    /// Its weight in the mean depth; 0 if there is none.
    pub depth_weight: f64,
}

/// Sums over samples of one pixel, in the order they come.
#[derive(Clone, Copy, Debug, Default)]
pub struct Batch {
    count: u64,
    /// The first sample's radiance, which is taken off all.
    origin: [f64; 3],
    sum: [f64; 3],
    squares: [f64; 3],
    opacity: f64,
    depth_weight: f64,
    /// Weighted.
    depth: f64,
}

impl Batch {
    /// Adds one sample.
    #[inline] // bench: frame
    pub fn add(&mut self, sample: &Sample) {
        let radiance = sample.radiance.0.map(f64::from);
        if self.count == 0 {
            self.origin = radiance;
        }
        self.count += 1;
        for (c, x) in radiance.into_iter().enumerate() {
            let x = x - self.origin[c];
            self.sum[c] += x;
            self.squares[c] += x * x;
        }
        self.opacity += sample.opacity;
        self.depth_weight += sample.depth_weight;
        self.depth += sample.depth_weight * sample.depth;
    }

    /// Adds `count` samples of one radiance that hit nothing, to no others or to such.
    pub fn add_constant(&mut self, radiance: Rgb, count: u64) {
        debug_assert!(
            self.count == 0 || self.origin == radiance.0.map(f64::from),
            "the pixel saw something else"
        );
        self.origin = radiance.0.map(f64::from);
        self.count += count;
    }

    /// Returns how many samples were added.
    pub fn count(&self) -> u64 {
        self.count
    }

    /// Returns all there is as bits, for a checkpoint.
    pub(super) fn to_words(self) -> [u64; Self::WORDS] {
        let Self {
            count,
            origin: o,
            sum: s,
            squares: q,
            opacity,
            depth_weight,
            depth,
        } = self;
        let [a, b, c] = [o, s, q].map(|v| v.map(f64::to_bits));
        let [opacity, weight, depth] = [opacity, depth_weight, depth].map(f64::to_bits);
        [
            count, a[0], a[1], a[2], b[0], b[1], b[2], c[0], c[1], c[2], opacity, weight, depth,
        ]
    }

    /// Returns what [`Self::to_words`] was made of.
    pub(super) fn from_words(words: [u64; Self::WORDS]) -> Self {
        let f = |i: usize| f64::from_bits(words[i]);
        Self {
            count: words[0],
            origin: [1, 2, 3].map(f),
            sum: [4, 5, 6].map(f),
            squares: [7, 8, 9].map(f),
            opacity: f(10),
            depth_weight: f(11),
            depth: f(12),
        }
    }

    /// Numbers of eight bytes in a checkpoint.
    pub(super) const WORDS: usize = 13;

    /// Returns the statistics of the samples so far.
    pub fn pixel(&self) -> Pixel {
        if self.count == 0 {
            return Pixel::default();
        }
        let n = self.count as f64;
        Pixel {
            count: self.count,
            mean: std::array::from_fn(|c| self.origin[c] + self.sum[c] / n),
            // Rounding may take equal samples below zero.
            m2: std::array::from_fn(|c| (self.squares[c] - self.sum[c] * self.sum[c] / n).max(0.0)),
            opacity: self.opacity,
            depth_weight: self.depth_weight,
            // Zero: nothing was hit.
            depth_mean: if self.depth_weight > 0.0 {
                self.depth / self.depth_weight
            } else {
                0.0
            },
        }
    }
}

/// Statistics of one pixel.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Pixel {
    /// Samples taken.
    pub count: u64,
    /// Mean radiance, one entry a channel.
    pub mean: [f64; 3],
    /// Sum of squared deviations from the mean, one entry a channel.
    pub m2: [f64; 3],
    /// Sum of the samples' opacities.
    pub opacity: f64,
    /// Sum of the weights of their depths.
    pub depth_weight: f64,
    /// Mean depth of the first collision, so weighted.
    pub depth_mean: f64,
}

impl Pixel {
    /// Returns the opacity: one minus the mean transmittance of the camera rays.
    pub fn alpha(&self) -> f64 {
        if self.count == 0 {
            0.0
        } else {
            self.opacity / self.count as f64
        }
    }

    /// Returns the variance of the pixel's mean, one entry a channel; infinite below two
    /// samples, where nothing is known of it.
    pub fn variance_of_mean(&self) -> [f64; 3] {
        let n = self.count as f64;
        self.m2.map(|m2| {
            if self.count < 2 {
                f64::INFINITY
            } else {
                m2 / (n - 1.0) / n
            }
        })
    }

    /// Merges the statistics of other samples of the same pixel into these.
    ///
    /// # Reference
    /// `[Chan1983]`.
    pub fn merge(&mut self, other: &Self) {
        let (na, nb) = (self.count as f64, other.count as f64);
        let n = na + nb;
        if other.count == 0 {
            return;
        }
        for c in 0..3 {
            let delta = other.mean[c] - self.mean[c];
            self.mean[c] += delta * nb / n;
            self.m2[c] += other.m2[c] + delta * delta * na * nb / n;
        }
        self.count += other.count;
        self.opacity += other.opacity;
        self.depth_weight += other.depth_weight;
        // Zero: neither has a depth.
        if self.depth_weight > 0.0 {
            let weight = other.depth_weight / self.depth_weight;
            self.depth_mean += (other.depth_mean - self.depth_mean) * weight;
        }
    }
}

/// What the samples of one pixel cost.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PixelCost {
    /// Voxel values read.
    pub values_read: u64,
    /// Tentative collisions that turned out to be with nothing.
    pub null_collisions: u64,
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample(i: u32) -> Sample {
        let x = (i as f32 * 0.37).sin() + 2.0;
        Sample {
            radiance: Rgb([x, x * x, 1.0]),
            opacity: f64::from(i % 3) / 4.0,
            depth: f64::from(i),
            depth_weight: f64::from(i % 2),
        }
    }

    fn pixel(samples: impl Iterator<Item = Sample>) -> Pixel {
        let mut batch = Batch::default();
        for sample in samples {
            batch.add(&sample);
        }
        batch.pixel()
    }

    #[test]
    fn merged_parts_equal_one_run() {
        let whole = pixel((0..100).map(sample));
        let mut a = pixel((0..37).map(sample));
        let b = pixel((37..100).map(sample));
        let mut none = Pixel::default();
        none.merge(&Pixel::default());
        assert_eq!(none, Pixel::default(), "nothing and nothing is nothing");
        a.merge(&b);
        assert_eq!(a.count, whole.count);
        for c in 0..3 {
            assert!((a.mean[c] - whole.mean[c]).abs() < 1e-12, "mean {c}");
            assert!((a.m2[c] - whole.m2[c]).abs() < 1e-10, "m2 {c}");
        }
        assert!((a.opacity - whole.opacity).abs() < 1e-12, "opacity");
        assert_eq!(a.depth_weight, whole.depth_weight);
        assert!((a.depth_mean - whole.depth_mean).abs() < 1e-12, "depth");
    }

    #[test]
    fn variance_is_the_textbook_one() {
        let of = |x| Sample {
            radiance: Rgb::splat(x),
            ..Sample::default()
        };
        let p = pixel([1.0, 2.0, 4.0].map(of).into_iter());
        // mean 7/3, sum of squares 14/3, variance of the mean 14/3 / 2 / 3
        assert!(
            (p.variance_of_mean()[0] - 14.0 / 18.0).abs() < 1e-12,
            "{p:?}"
        );
        assert_eq!(p.alpha(), 0.0);
    }

    /// Samples of 1e6 that differ by 1: the squares themselves are good to 1e-4 of a unit, those
    /// about the first sample to all digits.
    #[test]
    fn small_deviations_from_a_large_mean_are_not_lost() {
        let n = 1_000;
        let p = pixel((0..n).map(|i| Sample {
            radiance: Rgb::splat(1e6 + (i % 2) as f32),
            ..Sample::default()
        }));
        assert!((p.mean[0] - 1e6 - 0.5).abs() < 1e-9, "{p:?}");
        assert!((p.m2[0] - f64::from(n) / 4.0).abs() < 1e-6, "{p:?}");
    }

    #[test]
    fn depth_is_weighted() {
        let at = |depth_weight, depth| Sample {
            depth,
            depth_weight,
            ..Sample::default()
        };
        let p = pixel([at(0.5, 1.0), at(0.0, 7.0), at(1.0, 4.0)].into_iter());
        assert!((p.depth_mean - 3.0).abs() < 1e-12, "{p:?}");
    }

    #[test]
    fn a_constant_pixel_is_what_its_samples_would_make() {
        let radiance = Rgb([0.3, 0.45, 0.1]);
        let samples = (0..7).map(|_| Sample {
            radiance,
            ..Sample::default()
        });
        let mut batch = Batch::default();
        batch.add_constant(radiance, 3);
        batch.add_constant(radiance, 4);
        assert_eq!(batch.pixel(), pixel(samples));
    }
}

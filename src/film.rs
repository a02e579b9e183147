//! Per-pixel mean and second moment, opacity and depth, with sample counts.
//!
//! Moments follow Welford's update in `f64`, so that a pixel of 10⁶ samples loses no digits
//! and two films merge exactly like one longer run (Chan's formula). No reconstruction
//! filter: a sample belongs to one pixel (box filter of one pixel width).

use crate::spectrum::Rgb;

/// What one camera path brings home.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// Radiance towards the camera.
    pub radiance: Rgb,
    /// World distance to the first collision along the camera axis; `None` if the camera ray
    /// left the scene without one.
    pub first_depth: Option<f64>,
}

/// Running statistics of one pixel.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Pixel {
    /// Samples taken.
    pub count: u64,
    /// Mean radiance, one entry a channel.
    pub mean: [f64; 3],
    /// Sum of squared deviations from the mean, one entry a channel.
    pub m2: [f64; 3],
    /// Samples whose camera ray collided: the fraction is the opacity.
    pub hit_count: u64,
    /// Mean depth of the first collision over those.
    pub depth_mean: f64,
}

impl Pixel {
    /// Adds one sample.
    ///
    /// # Reference
    /// `[Welford1962]`.
    pub fn add(&mut self, sample: &Sample) {
        self.count += 1;
        let n = self.count as f64;
        for (c, &x) in sample.radiance.0.iter().enumerate() {
            let x = f64::from(x);
            let delta = x - self.mean[c];
            self.mean[c] += delta / n;
            self.m2[c] += delta * (x - self.mean[c]);
        }
        if let Some(depth) = sample.first_depth {
            self.hit_count += 1;
            self.depth_mean += (depth - self.depth_mean) / self.hit_count as f64;
        }
    }

    /// Returns the opacity: one minus the mean transmittance of the camera rays.
    pub fn alpha(&self) -> f64 {
        if self.count == 0 {
            0.0
        } else {
            self.hit_count as f64 / self.count as f64
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
        self.hit_count += other.hit_count;
        if self.hit_count > 0 {
            let weight = other.hit_count as f64 / self.hit_count as f64;
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

/// A rectangle of pixels, row by row from the top left.
#[derive(Clone, Debug, PartialEq)]
pub struct Film {
    width: u32,
    height: u32,
    pixels: Vec<Pixel>,
}

impl Film {
    /// Makes an empty film.
    pub fn new(width: u32, height: u32) -> Self {
        let len = width as usize * height as usize;
        Self {
            width,
            height,
            pixels: vec![Pixel::default(); len],
        }
    }

    /// Returns the number of columns.
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Returns the number of rows.
    pub fn height(&self) -> u32 {
        self.height
    }

    /// Returns all pixels, row by row from the top.
    pub fn pixels(&self) -> &[Pixel] {
        &self.pixels
    }

    /// Returns all pixels for writing, row by row from the top.
    pub fn pixels_mut(&mut self) -> &mut [Pixel] {
        &mut self.pixels
    }

    /// Returns the mean of the image and its standard error, one entry a channel.
    pub fn mean(&self) -> ([f64; 3], [f64; 3]) {
        let n = self.pixels.len() as f64;
        let mut mean = [0.0; 3];
        let mut variance = [0.0; 3];
        for pixel in &self.pixels {
            let v = pixel.variance_of_mean();
            for c in 0..3 {
                mean[c] += pixel.mean[c] / n;
                variance[c] += v[c] / (n * n);
            }
        }
        (mean, variance.map(f64::sqrt))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample(i: u32) -> Sample {
        let x = (i as f32 * 0.37).sin() + 2.0;
        let first_depth = (i.is_multiple_of(3)).then(|| f64::from(i));
        Sample {
            radiance: Rgb([x, x * x, 1.0]),
            first_depth,
        }
    }

    #[test]
    fn merged_parts_equal_one_run() {
        let (mut whole, mut a, mut b) = (Pixel::default(), Pixel::default(), Pixel::default());
        for i in 0..100 {
            whole.add(&sample(i));
            if i < 37 {
                a.add(&sample(i));
            } else {
                b.add(&sample(i));
            }
        }
        let mut none = Pixel::default();
        none.merge(&Pixel::default());
        assert_eq!(none, Pixel::default(), "nothing and nothing is nothing");
        a.merge(&b);
        assert_eq!((a.count, a.hit_count), (whole.count, whole.hit_count));
        for c in 0..3 {
            assert!((a.mean[c] - whole.mean[c]).abs() < 1e-12, "mean {c}");
            assert!((a.m2[c] - whole.m2[c]).abs() < 1e-10, "m2 {c}");
        }
        assert!((a.depth_mean - whole.depth_mean).abs() < 1e-12, "depth");
    }

    #[test]
    fn variance_is_the_textbook_one() {
        let mut p = Pixel::default();
        for x in [1.0, 2.0, 4.0] {
            p.add(&Sample {
                radiance: Rgb::splat(x),
                first_depth: None,
            });
        }
        // mean 7/3, sum of squares 14/3, variance of the mean 14/3 / 2 / 3
        assert!(
            (p.variance_of_mean()[0] - 14.0 / 18.0).abs() < 1e-12,
            "{p:?}"
        );
        assert_eq!(p.alpha(), 0.0);
    }
}

//! Drawing samples from fixed streams and summing them up.
//!
//! A measurement is a function of (seed, number of samples) alone.

use crate::sampling::{Stream, StreamKey};
use crate::stats::Counts;

/// Sums of the first four powers of a sample, about its first value.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Moments {
    count: f64,
    first: f64,
    powers: [f64; 4],
}

impl Moments {
    pub(super) fn add(&mut self, x: f64) {
        if self.count == 0.0 {
            self.first = x;
        }
        self.count += 1.0;
        let d = x - self.first;
        let square = d * d;
        for (sum, power) in self
            .powers
            .iter_mut()
            .zip([d, square, square * d, square * square])
        {
            *sum += power;
        }
    }

    pub(super) fn count(&self) -> f64 {
        self.count
    }

    pub(super) fn mean(&self) -> f64 {
        self.first + self.powers[0] / self.count
    }

    pub(super) fn variance(&self) -> f64 {
        let [a, b, ..] = self.powers.map(|s| s / self.count);
        (b - a * a).max(0.0)
    }

    pub(super) fn standard_error(&self) -> f64 {
        (self.variance() / (self.count - 1.0)).sqrt()
    }

    /// √((m₄ − m₂²) / n), m the central moments.
    pub(super) fn standard_error_of_variance(&self) -> f64 {
        let [a, b, c, d] = self.powers.map(|s| s / self.count);
        let fourth = d - 4.0 * a * c + 6.0 * a * a * b - 3.0 * a.powi(4);
        ((fourth - self.variance().powi(2)).max(0.0) / self.count).sqrt()
    }
}

/// What went on while something was measured.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Seen {
    pub(super) counts: Counts,
    /// Segments, collisions and voxel cells of the sample that had most of them.
    pub(super) worst_steps: u64,
    /// Samples that were not finite; they are left out of the moments.
    pub(super) non_finite: u64,
}

impl Seen {
    /// Adds what one ray or path did.
    pub(super) fn add(&mut self, counts: &Counts) {
        let steps = counts.segments + counts.tentative_collisions + counts.voxel_cells;
        self.worst_steps = self.worst_steps.max(steps);
        self.counts.add(counts);
    }

    /// Joins two measurements.
    #[must_use]
    pub(super) fn and(mut self, other: &Self) -> Self {
        self.counts.add(&other.counts);
        self.worst_steps = self.worst_steps.max(other.worst_steps);
        self.non_finite += other.non_finite;
        self
    }
}

/// Moments of `K` values for each sample, and what went on.
#[derive(Clone, Copy, Debug)]
pub(super) struct Measured<const K: usize> {
    pub(super) moments: [Moments; K],
    pub(super) seen: Seen,
}

/// Measures `n` samples, each from its own stream.
pub(super) fn measure<const K: usize>(
    seed: u64,
    n: u64,
    mut sample: impl FnMut(&mut Stream) -> [f64; K],
) -> Measured<K> {
    let mut moments = [Moments::default(); K];
    let mut seen = Seen::default();
    for index in 0..n {
        let mut stream = stream(seed, index);
        let values = sample(&mut stream);
        seen.add(&stream.counts);
        if values.iter().all(|x| x.is_finite()) {
            for (m, x) in moments.iter_mut().zip(values) {
                m.add(x);
            }
        } else {
            seen.non_finite += 1;
        }
    }
    Measured { moments, seen }
}

/// Returns the stream of one sample.
pub(super) fn stream(seed: u64, sample: u64) -> Stream {
    Stream::new(StreamKey {
        seed,
        sample,
        ..StreamKey::default()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn moments_are_the_textbook_ones() {
        let mut m = Moments::default();
        for x in [1.0, 2.0, 4.0, 9.0] {
            m.add(x);
        }
        // Deviations from 4 are −3, −2, 0, 5: squares sum to 38, fourth powers to 722.
        assert!((m.mean() - 4.0).abs() < 1e-12);
        assert!((m.variance() - 9.5).abs() < 1e-12);
        assert!((m.standard_error() - (9.5_f64 / 3.0).sqrt()).abs() < 1e-12);
        let fourth = 722.0 / 4.0;
        let expected = ((fourth - 9.5 * 9.5) / 4.0_f64).sqrt();
        assert!((m.standard_error_of_variance() - expected).abs() < 1e-12);
    }
}

//! Counter-keyed random streams, and sampling of simple distributions.
//!
//! A stream is a function of (seed, frame, pixel, sample) and nothing else: no global state,
//! no generator shared between threads. The image is therefore the same bits for any number
//! of threads and any order of tiles, and a range of samples can be rendered elsewhere.
//!
//! The key is hashed to the 128-bit state of a PCG multiplicative generator `[ONeill2014]`,
//! so neighbouring pixels and samples start at unrelated places of its period of 2¹²⁶. The
//! chance that any two of 2⁴⁰ streams of 2²⁰ draws overlap is about 2⁻²⁵.
//!
//! The first few decisions of a camera path have a number each ([`Number`]), which may come from a
//! low-discrepancy sequence (see `sobol`); a loop of unknown length draws from the stream.

use glam::DVec3;
use rand_core::Rng as _;
use rand_pcg::Pcg64Mcg;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::sobol::{DIMENSIONS, PixelSequence};
use crate::space::orthonormal_frame;
use crate::stats::Counts;

/// Where the first numbers of a camera path come from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum SamplerKind {
    /// A scrambled Sobol' sequence for each pixel: less noise, and a variance channel that
    /// overestimates it.
    #[default]
    Sobol,
    /// Independent numbers: the variance channel is that of the noise.
    Independent,
}

impl SamplerKind {
    /// All of them, in the order of the documentation.
    pub const ALL: &'static [Self] = &[Self::Sobol, Self::Independent];

    /// Returns its name in scene files and on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Sobol => "sobol",
            Self::Independent => "independent",
        }
    }
}

/// The decisions that have a number of their own, by dimension of the sequence.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Number {
    /// Where in the pixel, across.
    FilmX = 0,
    /// Where in the pixel, down.
    FilmY = 1,
    /// How far the camera ray's first tentative collision is.
    FirstDepth = 2,
    /// How far from there the second is.
    SecondDepth = 3,
    /// Which of the camera ray's collisions.
    Collision = 4,
    /// Whether the path goes on there.
    Roulette = 5,
    /// How far the next tentative collision is, once it has scattered.
    ScatteredDepth = 6,
    /// How far the camera ray's third tentative collision is from its second.
    ThirdDepth = 7,
}

/// The streams of one pixel: what they share is hashed once.
#[derive(Clone, Copy, Debug)]
pub struct PixelStreams {
    hash: u64,
    sequence: Option<PixelSequence>,
}

impl PixelStreams {
    /// Prepares the streams of pixel `pixel`.
    pub fn new(seed: u64, frame: i32, pixel: u64, sampler: SamplerKind) -> Self {
        let hash = hash_pixel(seed, frame, pixel);
        // Other constants than the streams' own, so that neither is a part of the other.
        let bits = |i: usize| mix(hash.rotate_left(17) ^ (i as u64 + 1).wrapping_mul(GOLDEN));
        let sequence = (sampler == SamplerKind::Sobol)
            .then(|| PixelSequence::new(std::array::from_fn(|d| [bits(2 * d), bits(2 * d + 1)])));
        Self { hash, sequence }
    }

    /// Has `stream` begin at sample `sample`; its counts go on.
    #[inline] // bench: frame
    pub fn start(&self, sample: u64, stream: &mut Stream) {
        #[expect(clippy::cast_possible_truncation, reason = "the sequence begins again")]
        let index = sample as u32;
        stream.rng = generator(self.hash, sample);
        stream.numbers = self.sequence.map(|s| s.point(index));
    }
}

/// What a random stream is derived from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct StreamKey {
    /// The user's seed.
    pub seed: u64,
    /// Frame number, so that the noise of a sequence does not stand still.
    pub frame: i32,
    /// Index of the pixel, row by row.
    pub pixel: u64,
    /// Index of the sample within the pixel.
    pub sample: u64,
}

/// An endless sequence of independent uniform numbers, and the tally of what became of them.
///
/// The two go everywhere together. A second pointer took a register from the loops over collisions:
/// 0.6 % of a cloud's instructions.
#[derive(Clone, Debug)]
pub struct Stream {
    rng: Pcg64Mcg,
    /// Of the decisions that have one; `None`: drawn as the rest.
    numbers: Option<[f32; DIMENSIONS]>,
    /// What the rays did that this stream was passed along with.
    pub counts: Counts,
}

/// 2⁶⁴ divided by the golden ratio: keeps zero keys from hashing to zero.
const GOLDEN: u64 = 0x9e37_79b9_7f4a_7c15;

/// Mixes the bits of `x` so that each input bit flips each output bit with probability 1/2.
fn mix(x: u64) -> u64 {
    // Rounds of xor-shift and odd multiplication; the constants are from [Stafford2011], mix 13.
    let x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^ (x >> 31)
}

#[expect(
    clippy::cast_sign_loss,
    reason = "the frame's bits are hashed, not its value"
)]
fn hash_pixel(seed: u64, frame: i32, pixel: u64) -> u64 {
    let h = mix(seed.wrapping_add(GOLDEN));
    let h = mix(h ^ u64::from(frame as u32).wrapping_add(GOLDEN));
    mix(h ^ pixel.wrapping_mul(GOLDEN))
}

/// Returns the generator of a pixel's sample.
#[inline] // bench: frame
fn generator(pixel_hash: u64, sample: u64) -> Pcg64Mcg {
    let low = mix(pixel_hash ^ sample.wrapping_add(GOLDEN));
    let high = mix(low ^ pixel_hash.rotate_left(32));
    Pcg64Mcg::new(u128::from(high) << 64 | u128::from(low))
}

impl Stream {
    /// Starts the stream of a key, all of its numbers independent.
    pub fn new(key: StreamKey) -> Self {
        let StreamKey {
            seed,
            frame,
            pixel,
            sample,
        } = key;
        Self {
            rng: generator(hash_pixel(seed, frame, pixel), sample),
            numbers: None,
            counts: Counts::default(),
        }
    }

    /// Returns the uniform number in [0, 1) of a decision: the same one each time if it comes from
    /// a sequence, so to be asked for once a path.
    #[inline] // bench: frame
    pub fn number(&mut self, of: Number) -> f32 {
        match self.numbers {
            Some(numbers) => numbers[of as usize],
            None => self.uniform(),
        }
    }

    /// Draws from the exponential distribution of mean 1 by the number of a decision, with a tail
    /// as long as that of [`exponential`](Self::exponential).
    #[inline] // bench: frame
    pub fn exponential_of(&mut self, of: Number) -> f32 {
        // The number has 24 digits: another one stands for those that follow.
        let u = self.number(of) + self.uniform_positive() * (1.0 / 16_777_216.0);
        // The sum rounds to 1 at most.
        -u.ln()
    }

    /// Returns 64 random bits.
    #[inline] // bench: frame
    pub fn bits(&mut self) -> u64 {
        self.rng.next_u64()
    }

    /// Returns a uniform number in [0, 1), a multiple of 2⁻²⁴.
    #[inline] // bench: frame
    pub fn uniform(&mut self) -> f32 {
        (self.bits() >> 40) as f32 * (1.0 / 16_777_216.0)
    }

    /// Returns a uniform number in (0, 1] with a relative precision of 2⁻²⁴ down to 2⁻⁶³.
    ///
    /// For inversions that are steep near 0: the tail of a free path, the peak of a phase
    /// function.
    #[inline] // bench: frame
    pub fn uniform_positive(&mut self) -> f32 {
        /// 2⁻⁶³: a signed number converts in one instruction, an unsigned one in eight.
        const SCALE: f32 = 1.0 / (1_u128 << 63) as f32;
        (self.bits() >> 1 | 1).cast_signed() as f32 * SCALE
    }

    /// Draws from the exponential distribution of mean 1.
    ///
    /// Depths up to 44 mean free paths occur with the right probability; with uniform numbers
    /// of 24 bits, transmittances below 6e-8 would never occur.
    #[inline] // bench: frame
    pub fn exponential(&mut self) -> f32 {
        // The number rounds to exactly 1 with probability 2⁻²⁵: depth 0, a valid draw.
        -self.uniform_positive().ln()
    }
}

/// Draws a direction uniformly within `half_angle` of the unit vector `axis`.
///
/// `one_minus_cos_max` is `1 − cos(half_angle)`. The density is one over the
/// solid angle, `2π · one_minus_cos_max`.
pub fn sample_cone(axis: DVec3, one_minus_cos_max: f64, stream: &mut Stream) -> DVec3 {
    let x = f64::from(stream.uniform()) * one_minus_cos_max;
    let sin = (x * (2.0 - x)).sqrt();
    let (sin_phi, cos_phi) = (std::f64::consts::TAU * f64::from(stream.uniform())).sin_cos();
    let (s, t) = orthonormal_frame(axis);
    s * (sin * cos_phi) + t * (sin * sin_phi) + axis * (1.0 - x)
}

#[cfg(test)]
mod tests {
    use super::*;
    use statrs::distribution::{ChiSquared, ContinuousCDF as _};

    #[test]
    fn neighbouring_streams_are_uncorrelated() {
        // First numbers of 2^16 neighbouring pixels in pairs: the correlation coefficient has
        // standard deviation 2^-8, so 5 sigma are 0.02.
        let first = |pixel, sample| {
            f64::from(
                Stream::new(StreamKey {
                    pixel,
                    sample,
                    ..StreamKey::default()
                })
                .uniform(),
            ) - 0.5
        };
        let n = 1 << 16;
        for (dp, ds) in [(1, 0), (0, 1), (1, 1), (256, 0)] {
            let sum: f64 = (0..n).map(|i| first(i, 0) * first(i + dp, ds)).sum();
            let correlation = 12.0 * sum / n as f64;
            assert!(correlation.abs() < 0.02, "step {dp},{ds}: {correlation}");
        }
    }

    #[test]
    fn keys_that_differ_anywhere_give_different_streams() {
        let base = StreamKey {
            seed: 3,
            frame: 1,
            pixel: 5,
            sample: 7,
        };
        let keys = [
            base,
            StreamKey { seed: 4, ..base },
            StreamKey { frame: -1, ..base },
            StreamKey {
                pixel: 7,
                sample: 5,
                ..base
            },
            StreamKey { sample: 8, ..base },
        ];
        let mut firsts: Vec<u64> = keys.iter().map(|&k| Stream::new(k).bits()).collect();
        firsts.sort_unstable();
        firsts.dedup();
        assert_eq!(firsts.len(), keys.len(), "two keys share a stream");
    }

    #[test]
    fn exponential_has_the_right_tail() {
        // Chi-square over 31 cells of width 1, the tail pooled from 15 mean free paths on: at
        // 2^24 draws, 5 are expected there. A bias of 1e-3 of the mean shifts the statistic by
        // 17 standard deviations.
        let n = 1 << 24;
        let mut counts = [0_u32; 16];
        let mut stream = Stream::new(StreamKey::default());
        for _ in 0..n {
            let x = stream.exponential();
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "x >= 0"
            )]
            let cell = (x as usize).min(15);
            counts[cell] += 1;
        }
        let chi2: f64 = (0_u8..16)
            .map(|i| {
                let from = (-f64::from(i)).exp();
                let to = if i == 15 {
                    0.0
                } else {
                    (-f64::from(i + 1)).exp()
                };
                let expected = f64::from(n) * (from - to);
                (f64::from(counts[usize::from(i)]) - expected).powi(2) / expected
            })
            .sum();
        let p = 1.0 - ChiSquared::new(15.0).unwrap().cdf(chi2);
        assert!(p > 1e-4, "chi2 {chi2}, p {p}, counts {counts:?}");
    }

    /// Of a pixel's 16 samples each sixteenth of the distribution has one; single samples over 2¹⁶
    /// pixels by chi-square of 16 cells, which sees a cell that is off by 8 %.
    #[test]
    fn depths_of_decisions_are_exponential_and_spread() {
        let pixels = 1 << 16;
        let mut stream = Stream::new(StreamKey::default());
        for of in [Number::FirstDepth, Number::ScatteredDepth] {
            let mut seen = [0.0; 16];
            let mut uneven = 0;
            for pixel in 0..pixels {
                let streams = PixelStreams::new(7, 0, pixel, SamplerKind::Sobol);
                let mut hit = [0; 16];
                for sample in 0..16 {
                    streams.start(sample, &mut stream);
                    let share = (-stream.exponential_of(of)).exp();
                    #[expect(
                        clippy::cast_possible_truncation,
                        clippy::cast_sign_loss,
                        reason = "a number in [0, 1]"
                    )]
                    let cell = ((share * 16.0) as usize).min(15);
                    hit[cell] += 1;
                    if sample == 5 {
                        seen[cell] += 1.0;
                    }
                }
                uneven += u32::from(hit.iter().any(|&h| h != 1));
            }
            // Logarithm and exponential are rounded: one in 10⁵ may fall on the other side.
            assert!(uneven < 100, "{of:?}: {uneven} of {pixels} pixels");
            let expected = pixels as f64 / 16.0;
            let chi2: f64 = seen.iter().map(|s| (s - expected).powi(2) / expected).sum();
            let p = 1.0 - ChiSquared::new(15.0).unwrap().cdf(chi2);
            assert!(p > 1e-5, "{of:?}: p = {p}");
        }
    }

    /// What lies behind the smallest number of 24 digits is exponential, too: 10⁵ draws of mean 1,
    /// known to 0.3 %.
    #[test]
    fn depths_of_decisions_have_a_tail() {
        let mut stream = Stream::new(StreamKey::default());
        stream.numbers = Some([0.0; DIMENSIONS]);
        let n = 100_000;
        let start = -(1.0_f32 / 16_777_216.0).ln();
        let beyond = (0..n).map(|_| f64::from(stream.exponential_of(Number::FirstDepth) - start));
        let mean = beyond.sum::<f64>() / f64::from(n);
        assert!((mean - 1.0).abs() < 0.016, "{mean}");
    }

    #[test]
    fn cone_samples_stay_in_the_cone() {
        let mut stream = Stream::new(StreamKey::default());
        let axis = DVec3::new(0.0, -0.6, 0.8);
        let x_max = 1.0 - 0.25_f64.to_radians().cos();
        for _ in 0..1000 {
            let d = sample_cone(axis, x_max, &mut stream);
            assert!(1.0 - d.dot(axis) <= x_max * (1.0 + 1e-9), "{d}");
            assert!((d.length() - 1.0).abs() < 1e-12, "{d}");
        }
    }
}

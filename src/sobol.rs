//! The first numbers of a camera path from a low-discrepancy sequence: Sobol' points, scrambled
//! anew for each pixel.
//!
//! A path draws hundreds of numbers, but most of a thin medium's noise comes from the first few:
//! where in the pixel, where the camera ray tentatively collides, which of its collisions goes on, and
//! how far. Those are spread evenly over a pixel's samples.
//!
//! * Points: the Sobol' sequence `[Sobol1967]` with the direction numbers of `[Joe2008]`; any 2ᵏ
//!   consecutive points from a multiple of 2ᵏ on are stratified in every dimension.
//! * Scrambling: Owen's nested one `[Owen1995]`, by a hash of each number's leading digits
//!   `[Laine2011]` `[Burley2020]`, and a digital shift, which by itself makes every single number
//!   uniform whatever the hash is worth.
//!
//! A number is a function of the pixel's key, the sample's index and the dimension, so a range of
//! samples can be rendered elsewhere. After 2³² samples the sequence begins again.
//!
//! Unbiased: each point is uniform in the unit cube. Points of one pixel are not independent, so
//! the sample variance of a pixel overestimates the error of its mean.

/// Numbers of a path that come from the sequence.
pub const DIMENSIONS: usize = 8;

/// Digits of a number.
const BITS: usize = 32;

/// Primitive polynomials and first direction numbers of the dimensions after the first: degree,
/// inner coefficients as bits, and odd numbers below 2, 4, 8, 16, 32.
const POLYNOMIALS: [(usize, u32, [u32; 5]); DIMENSIONS - 1] = [
    (1, 0, [1, 0, 0, 0, 0]),
    (2, 1, [1, 3, 0, 0, 0]),
    (3, 1, [1, 3, 1, 0, 0]),
    (3, 2, [1, 1, 1, 0, 0]),
    (4, 1, [1, 1, 3, 3, 0]),
    (4, 4, [1, 3, 5, 13, 0]),
    (5, 2, [1, 1, 5, 5, 17]),
];

/// For each bit of the index, what it adds to the digits of each dimension; the first digit after
/// the point is the lowest bit.
const DIRECTIONS: [[u32; DIMENSIONS]; BITS] = directions();

const fn directions() -> [[u32; DIMENSIONS]; BITS] {
    let mut all = [[0; DIMENSIONS]; BITS];
    let mut k = 0;
    while k < BITS {
        all[k][0] = 1 << k;
        k += 1;
    }
    let mut d = 1;
    while d < DIMENSIONS {
        let (degree, inner, first) = POLYNOMIALS[d - 1];
        let mut m = [0_u64; BITS];
        k = 0;
        while k < BITS {
            if k < degree {
                m[k] = first[k] as u64;
            } else {
                // The recurrence of the polynomial's coefficients, the last of which is 1.
                m[k] = m[k - degree] ^ m[k - degree] << degree;
                let mut i = 1;
                while i < degree {
                    if inner >> (degree - 1 - i) & 1 == 1 {
                        m[k] ^= m[k - i] << i;
                    }
                    i += 1;
                }
            }
            // m / 2^(k + 1) is the number: its k + 1 digits, the first one lowest.
            let digits = m[k].reverse_bits() >> (63 - k);
            all[k][d] = (digits & 0xffff_ffff) as u32;
            k += 1;
        }
        d += 1;
    }
    all
}

/// One pixel's scrambled sequence.
#[derive(Clone, Copy, Debug)]
pub struct PixelSequence {
    offset: [u32; DIMENSIONS],
    factor: [u32; DIMENSIONS],
    shift: [u32; DIMENSIONS],
}

impl PixelSequence {
    /// Makes the sequence from 128 random bits for each dimension.
    pub fn new(bits: [[u64; 2]; DIMENSIONS]) -> Self {
        #[expect(clippy::cast_possible_truncation, reason = "half of the bits each")]
        let half = |d: usize, i: usize, shift: u32| (bits[d][i] >> shift) as u32;
        Self {
            offset: std::array::from_fn(|d| half(d, 0, 0)),
            factor: std::array::from_fn(|d| half(d, 0, 32) | 1),
            shift: std::array::from_fn(|d| half(d, 1, 0)),
        }
    }

    /// Returns the point of sample `index`: numbers in [0, 1), multiples of 2⁻²⁴.
    ///
    /// # Cost
    /// Eight lanes of integer arithmetic, 15 ns for the indices that occur.
    #[inline] // bench: frame
    pub fn point(&self, index: u32) -> [f32; DIMENSIONS] {
        let mut x = [0_u32; DIMENSIONS];
        for (k, directions) in DIRECTIONS.iter().enumerate() {
            if index >> k == 0 {
                break;
            }
            let mask = (index >> k & 1).wrapping_neg();
            for d in 0..DIMENSIONS {
                x[d] ^= directions[d] & mask;
            }
        }
        // Every step changes a bit by lower ones only, which are the digits before it. The even
        // factors are those of [Burley2020].
        for (d, x) in x.iter_mut().enumerate() {
            let mut y = *x;
            y ^= y.wrapping_mul(0x3d20_adea);
            y = y.wrapping_add(self.offset[d]);
            y = y.wrapping_mul(self.factor[d]);
            y ^= y.wrapping_mul(0x0552_6c56);
            y ^= y.wrapping_mul(0x53a2_2864);
            *x = y ^ self.shift[d];
        }
        x.map(|y| (y.reverse_bits() >> 8) as f32 * (1.0 / 16_777_216.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampling::{Stream, StreamKey};
    use statrs::distribution::{ChiSquared, ContinuousCDF as _};

    fn sequence(pixel: u64) -> PixelSequence {
        let mut stream = Stream::new(StreamKey {
            pixel,
            ..StreamKey::default()
        });
        PixelSequence::new(std::array::from_fn(|_| [stream.bits(), stream.bits()]))
    }

    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "numbers in [0, 1)"
    )]
    fn cell(x: f32, cells: u32) -> usize {
        (x * cells as f32) as usize
    }

    /// Of 2ᵏ consecutive points, each of 2ᵏ intervals holds exactly one, in every dimension; and of
    /// the first two dimensions, every elementary box of that volume.
    #[test]
    fn points_are_stratified() {
        for pixel in 0..50 {
            let sequence = sequence(pixel);
            for log2 in [0, 3, 6, 10] {
                let n = 1_u32 << log2;
                for block in [0, 1, 5] {
                    let points: Vec<_> = (block * n..(block + 1) * n)
                        .map(|i| sequence.point(i))
                        .collect();
                    for d in 0..DIMENSIONS {
                        let mut hit = vec![0; n as usize];
                        for p in &points {
                            hit[cell(p[d], n)] += 1;
                        }
                        assert!(hit.iter().all(|&h| h == 1), "dimension {d}, {n} points");
                    }
                    for log2_x in 0..=log2 {
                        let (nx, ny) = (1 << log2_x, 1 << (log2 - log2_x));
                        let mut hit = vec![0; n as usize];
                        for p in &points {
                            hit[cell(p[0], nx) * ny as usize + cell(p[1], ny)] += 1;
                        }
                        assert!(hit.iter().all(|&h| h == 1), "{nx} by {ny} boxes");
                    }
                }
            }
        }
    }

    /// A single sample's numbers over 2¹⁶ pixels, chi-square of 16 cells for each dimension and of
    /// 8 × 8 for each pair: sees a share of a cell that is off by 8 % of itself.
    #[test]
    fn a_single_sample_is_uniform_over_pixels() {
        let n = 1 << 16;
        for index in [0, 1, 6, 1000] {
            let points: Vec<_> = (0..n).map(|p| sequence(p).point(index)).collect();
            let check = |cells: usize, of: &dyn Fn(&[f32; DIMENSIONS]) -> usize, what: &str| {
                let mut hit = vec![0.0; cells];
                for p in &points {
                    hit[of(p)] += 1.0;
                }
                let expected = n as f64 / cells as f64;
                let chi2: f64 = hit
                    .iter()
                    .map(|h| (h - expected) * (h - expected) / expected)
                    .sum();
                let p = 1.0 - ChiSquared::new(cells as f64 - 1.0).unwrap().cdf(chi2);
                assert!(p > 1e-5, "{what} of sample {index}: p = {p}");
            };
            for d in 0..DIMENSIONS {
                check(16, &|p| cell(p[d], 16), &format!("dimension {d}"));
                for e in 0..d {
                    let of = |p: &[f32; DIMENSIONS]| cell(p[d], 8) * 8 + cell(p[e], 8);
                    check(64, &of, &format!("dimensions {d}, {e}"));
                }
            }
        }
    }

    /// The variance of a mean over 256 points falls far below that of independent ones: of a
    /// product of eight smooth factors by more than 20.
    #[test]
    fn means_converge_faster() {
        let (n, pixels) = (256, 2000);
        let f = |p: [f32; DIMENSIONS]| {
            p.iter()
                .map(|&x| f64::from(1.0 + 0.5 * (x - 0.5)))
                .product::<f64>()
        };
        let mut square = 0.0;
        for pixel in 0..pixels {
            let sequence = sequence(pixel);
            let mean = (0..n).map(|i| f(sequence.point(i))).sum::<f64>() / f64::from(n);
            square += (mean - 1.0).powi(2) / pixels as f64;
        }
        // The variance of one factor is 1/48.
        let independent = ((1.0 + 1.0_f64 / 48.0).powi(8) - 1.0) / f64::from(n);
        assert!(
            square < independent / 20.0,
            "{square}, independent {independent}"
        );
    }
}

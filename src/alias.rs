//! Drawing one of many in proportion to its weight, in constant time.
//!
//! # Reference
//! `[Vose1991]`.

/// Numbers of weights, prepared to be drawn.
#[derive(Clone, Debug, Default)]
pub struct AliasTable {
    /// Of each: the probability of staying, and where to go otherwise.
    entries: Vec<(f32, u32)>,
}

impl AliasTable {
    /// Prepares `weights`, fewer than 2³²; `None` unless they are finite and not negative and one of
    /// them is positive.
    pub fn new(weights: &[f32]) -> Option<Self> {
        let count = u32::try_from(weights.len()).ok()?;
        let total: f64 = weights.iter().map(|&w| f64::from(w)).sum();
        let valid = weights.iter().all(|w| (0.0..f32::INFINITY).contains(w));
        if !valid || total <= 0.0 {
            return None;
        }
        let scale = f64::from(count) / total;
        // In units of the mean: what is below 1 is filled up by what is above.
        let mut left: Vec<f64> = weights.iter().map(|&w| f64::from(w) * scale).collect();
        let mut entries: Vec<(f32, u32)> = (0..count).map(|i| (1.0, i)).collect();
        let (mut small, mut large): (Vec<u32>, Vec<u32>) =
            (0..count).partition(|&i| left[i as usize] < 1.0);
        while let (Some(s), Some(&l)) = (small.pop(), large.last()) {
            #[expect(clippy::cast_possible_truncation, reason = "a probability")]
            let stay = left[s as usize] as f32;
            entries[s as usize] = (stay, l);
            left[l as usize] -= 1.0 - left[s as usize];
            if left[l as usize] < 1.0 {
                large.pop();
                small.push(l);
            }
        }
        Some(Self { entries })
    }

    /// Returns the index that 64 random `bits` draw, with a probability good to 2⁻²⁴ of itself and
    /// 2⁻⁵³ of the mean: a sky has millions of cells, most of them dark beside a sun.
    #[inline] // bench: frame
    pub fn index(&self, bits: u64) -> usize {
        let product = u128::from(bits) * self.entries.len() as u128;
        // The high half picks an entry, and what that leaves of the number whether to stay.
        #[expect(clippy::cast_possible_truncation, reason = "the two halves")]
        let (i, rest) = ((product >> 64) as usize, product as u64);
        let (stay, other) = self.entries[i];
        if rest as f64 * (-64.0_f64).exp2() < f64::from(stay) {
            i
        } else {
            other as usize
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampling::{Stream, StreamKey};

    #[test]
    fn frequencies_are_the_weights() {
        let weights = [0.0, 3.0, 0.001, 0.5, 10.0, 0.0, 1.0, 1.0];
        let table = AliasTable::new(&weights).unwrap();
        let mut stream = Stream::new(StreamKey::default());
        let n = 1 << 22;
        let mut counts = [0_u32; 8];
        for _ in 0..n {
            counts[table.index(stream.bits())] += 1;
        }
        let total: f32 = weights.iter().sum();
        for (count, weight) in counts.into_iter().zip(weights) {
            let expected = f64::from(n) * f64::from(weight / total);
            let off = (f64::from(count) - expected).abs();
            // 5 standard deviations: 1 % of the weight of 0.5.
            assert!(off <= 5.0 * expected.sqrt(), "{count} for {expected}");
        }
    }

    #[test]
    fn what_is_no_weight_is_refused() {
        for weights in [
            &[][..],
            &[0.0, 0.0],
            &[1.0, -1.0],
            &[1.0, f32::NAN],
            &[f32::INFINITY],
        ] {
            assert!(AliasTable::new(weights).is_none(), "{weights:?}");
        }
    }
}

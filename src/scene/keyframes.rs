//! Numbers between keyframes.
//!
//! Before the first key and after the last a value rests. Between two, `linear` goes straight and
//! `smooth` along cubics whose slope is continuous and which never leave the range of the two keys
//! beside them: a density scale cannot become negative on its way from 0 to 1. At the first and
//! last key, and where the values turn, the slope is zero.

/// How values between two keys follow from them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum Interpolation {
    /// Straight.
    #[default]
    Linear,
    /// With a continuous slope.
    Smooth,
}

/// Returns the value at `frame` of `keys`: pairs of frame and value, frames ascending, at least
/// one.
pub(super) fn value_at(keys: &[(i32, f64)], how: Interpolation, frame: i32) -> f64 {
    let after = keys.partition_point(|&(f, _)| f <= frame);
    let Some(before) = after.checked_sub(1) else {
        return keys[0].1;
    };
    let Some(&(f1, y1)) = keys.get(after) else {
        return keys[before].1;
    };
    let (f0, y0) = keys[before];
    let width = f64::from(f1) - f64::from(f0);
    let s = (f64::from(frame) - f64::from(f0)) / width;
    match how {
        Interpolation::Linear => y0 + (y1 - y0) * s,
        Interpolation::Smooth => {
            let (m0, m1) = (width * slope(keys, before), width * slope(keys, after));
            // The cubic through (0, y0) and (1, y1) with slopes m0 and m1.
            let bulge = (m0 * (1.0 - s) - m1 * s) * s * (1.0 - s);
            y0 + (y1 - y0) * s * s * (3.0 - 2.0 * s) + bulge
        }
    }
}

/// Returns the slope at key `i`: a harmonic mean of the slopes beside it, weighted by their
/// widths, which is what keeps the cubics within their keys.
///
/// # Reference
/// `[Fritsch1984]`.
fn slope(keys: &[(i32, f64)], i: usize) -> f64 {
    let (Some(left), Some(right)) = (i.checked_sub(1), keys.get(i + 1)) else {
        return 0.0;
    };
    let (left, middle) = (keys[left], keys[i]);
    let width = |a: (i32, f64), b: (i32, f64)| f64::from(b.0) - f64::from(a.0);
    let (h0, h1) = (width(left, middle), width(middle, *right));
    let (d0, d1) = ((middle.1 - left.1) / h0, (right.1 - middle.1) / h1);
    // Zero or less: flat on one side, or the values turn here.
    if d0 * d1 <= 0.0 {
        return 0.0;
    }
    let (w0, w1) = (2.0 * h1 + h0, h1 + 2.0 * h0);
    (w0 + w1) / (w0 / d0 + w1 / d1)
}

#[cfg(test)]
mod tests {
    use super::*;

    const KEYS: &[(i32, f64)] = &[(0, 1.0), (10, 3.0), (14, 4.0), (20, 4.0), (30, -2.0)];

    fn smooth(frame: i32) -> f64 {
        value_at(KEYS, Interpolation::Smooth, frame)
    }

    #[test]
    fn keys_are_met_and_ends_rest() {
        for how in [Interpolation::Linear, Interpolation::Smooth] {
            for &(frame, value) in KEYS {
                assert!(
                    (value_at(KEYS, how, frame) - value).abs() < 1e-12,
                    "{how:?} at {frame}"
                );
            }
            assert_eq!(value_at(KEYS, how, -100), 1.0);
            assert_eq!(value_at(KEYS, how, i32::MAX), -2.0);
            assert_eq!(value_at(&[(5, 7.0)], how, 5), 7.0, "a single key");
        }
        assert_eq!(value_at(KEYS, Interpolation::Linear, 4), 1.8);
        let wide = [(i32::MIN, 0.0), (i32::MAX, 1.0)];
        assert!((value_at(&wide, Interpolation::Linear, 0) - 0.5).abs() < 1e-9);
    }

    #[test]
    fn smooth_stays_between_its_keys_and_turns_without_a_corner() {
        for pair in KEYS.windows(2) {
            let (low, high) = (pair[0].1.min(pair[1].1), pair[0].1.max(pair[1].1));
            for frame in pair[0].0..=pair[1].0 {
                let y = smooth(frame);
                assert!(
                    (low..=high).contains(&y),
                    "{y} at {frame}, not in {low}..={high}"
                );
            }
        }
        // Scaled by 1000 frames, the slopes on both sides of a key agree.
        let fine: Vec<_> = KEYS.iter().map(|&(f, y)| (1000 * f, y)).collect();
        for &(frame, _) in &fine {
            let at = |f| value_at(&fine, Interpolation::Smooth, f);
            let (left, right) = (at(frame) - at(frame - 1), at(frame + 1) - at(frame));
            assert!((left - right).abs() < 2e-6, "{left} and {right} at {frame}");
        }
        // Two keys: at rest, half way, at rest.
        let two = [(0, 0.0), (4, 1.0)];
        assert_eq!(value_at(&two, Interpolation::Smooth, 2), 0.5);
        assert_eq!(value_at(&two, Interpolation::Smooth, 1), 0.15625);
    }
}

//! How many samples a picture needs for an error that was asked for.
//!
//! Stopping when the samples so far say that they are good enough keeps the lucky ones, and the
//! picture gets darker than it should. So the pixels are two halves (`film::half_of`), and how
//! many samples one takes follows from the noise that the other showed in a pilot, the first
//! samples of all. No pixel's count depends on its own samples: its mean keeps its expectation,
//! and no sample is thrown away. That the count follows from a pilot in one step is `[Stein1945]`.

/// The pilot takes one of so many of the samples allowed.
const PILOT_SHARE: u64 = 16;

/// Least samples of a pilot: variances of fewer are mostly chance.
const MIN_PILOT: u64 = 16;

/// Returns how many samples of at most `end` the pilot takes.
pub fn pilot(end: u64) -> u64 {
    (end / PILOT_SHARE).max(MIN_PILOT).min(end)
}

/// Returns how many samples of at most `end` are enough in each half, if the relative errors were
/// `noise` after the pilot and `limit` is asked for.
pub fn enough(noise: [f64; 2], limit: f64, end: u64) -> [u64; 2] {
    let pilot = pilot(end);
    let of = |judge: f64| {
        // The error falls as one over the root of the samples. A cast saturates; an error that is
        // not finite asks for all.
        let needed = pilot as f64 * (judge / limit) * (judge / limit);
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "saturates, and is not negative"
        )]
        let count = needed.ceil() as u64;
        if needed.is_nan() {
            end
        } else {
            count.clamp(pilot, end)
        }
    };
    [of(noise[1]), of(noise[0])]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_half_follows_the_other() {
        assert_eq!(pilot(1024), 64);
        assert_eq!(enough([0.04, 0.02], 0.01, 1024), [256, 1024]);
        assert_eq!(
            enough([0.1, 0.001], 0.01, 1024),
            [64, 1024],
            "no less, no more"
        );
        assert_eq!(enough([f64::INFINITY, f64::NAN], 0.01, 100), [100, 100]);
        assert_eq!(pilot(8), 8);
        assert_eq!(enough([0.04, 0.02], 0.01, 8), [8, 8]);
    }
}

//! Whether two images agree: blocks of 8 × 8 pixels, |z| < 5, and the mean of z² is 1.
//!
//! The smallest bias of the image's mean that is seen is printed, and below what the test says.

#![allow(clippy::print_stdout, reason = "what a test can see is printed")]

use majorant::film::Film;

/// Compares two images block by block and as a whole, where a bias of `sees` of the mean is to be seen.
pub(crate) fn agree(what: &str, sees: f64, a: &Film, b: &Film) {
    let (width, size) = (a.width() as usize, a.pixels().len());
    let (mut squares, mut count) = (0.0, 0.0);
    let (mut difference, mut variance, mut mean) = ([0.0; 3], [0.0; 3], [0.0; 3]);
    let image = b.mean().0;
    for block in 0..size / 64 {
        let corner = block % (width / 8) * 8 + block / (width / 8) * 8 * width;
        for c in 0..3 {
            let (mut d, mut v, mut hits, mut light) = (0.0, 0.0, 0.0, 0.0);
            for i in 0..64 {
                let at = corner + i % 8 + i / 8 * width;
                let (p, q) = (&a.pixels()[at], &b.pixels()[at]);
                d += p.mean[c] - q.mean[c];
                v += p.variance_of_mean()[c] + q.variance_of_mean()[c];
                hits += p.opacity.min(q.opacity);
                light += q.mean[c];
            }
            mean[c] += light;
            difference[c] += d;
            variance[c] += v;
            // Of few collisions, or of little light found rarely, the variance is hardly known: such
            // blocks count for the whole alone.
            if hits < 100.0 || light < 64.0 * 0.01 * image[c] {
                continue;
            }
            if v > 0.0 {
                assert!(
                    d * d < 25.0 * v,
                    "{what}, block {block}, channel {c}: {d} ± {}",
                    v.sqrt()
                );
                squares += d * d / v;
                count += 1.0;
            } else {
                assert!(d.abs() < 1e-6, "{what}, block {block}: {d} without noise");
            }
        }
    }
    for c in 0..3 {
        let error = variance[c].sqrt();
        let power = 5.0 * error / mean[c];
        let z = difference[c] / error.max(1e-30);
        println!("{what}, channel {c}: z {z:+.2}, smallest bias seen {power:.1e}");
        assert!(
            difference[c].abs() < 5.0 * error + 1e-6,
            "{what}: channel {c} is off, z {z}"
        );
        assert!(power < sees, "{what}: a bias of {sees} would be missed");
    }
    // Channels go together: as if a third of them were independent, 5 standard deviations.
    let spread = 5.0 * (2.0 / (count / 3.0_f64)).sqrt();
    let mean_square = squares / count;
    assert!(
        mean_square < 1.0 + spread,
        "{what}: mean of z² {mean_square} over {count} blocks"
    );
}

//! Which pixels the media cover: those whose errors count.
//!
//! A pixel that sees the sky only is exact with one sample; averaging over many of them would
//! only say how much sky is in the picture.

use std::ops::Range;

use glam::DVec2;

use crate::sampling::{Stream, StreamKey};
use crate::scene::Scene;
use crate::tracking::{Tracking, TransmittanceEstimator};

/// Optical depth through a pixel's centre from which on the medium covers it.
pub const LEAST_DEPTH: f64 = 0.01;

/// Returns the indices of the pixels that the medium covers, row by row; of all pixels if it
/// covers none.
///
/// By the exact transmittance, so that noise does not choose.
pub fn covered_pixels(scene: &Scene) -> Vec<usize> {
    let tracking = Tracking {
        transmittance: TransmittanceEstimator::Exact,
        ..Tracking::default()
    };
    #[expect(clippy::cast_possible_truncation, reason = "a number near 1")]
    let clear = (-LEAST_DEPTH).exp() as f32;
    let size = DVec2::new(f64::from(scene.width), f64::from(scene.height));
    let is_covered = |x: u32, y: u32| {
        let centre = DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5) / size;
        let ray = scene.camera.ray(centre);
        // Neither is used: the estimate is exact and plays no roulette.
        let mut stream = Stream::new(StreamKey::default());
        let end = f64::INFINITY;
        let through = scene
            .media
            .iter()
            .map(|medium| tracking.estimate_transmittance(medium, &ray, end, 0.0, &mut stream));
        through.product::<f32>() < clear
    };
    let columns: Range<u32> = 0..scene.width;
    let pixels = (0..scene.height).flat_map(|y| columns.clone().map(move |x| (x, y)));
    let covered: Vec<usize> = pixels
        .enumerate()
        .filter(|&(_, (x, y))| is_covered(x, y))
        .map(|(i, _)| i)
        .collect();
    if covered.is_empty() {
        (0..scene.width as usize * scene.height as usize).collect()
    } else {
        covered
    }
}

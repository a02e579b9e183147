//! One frame: tiles, threads, cancellation, progress, statistics.

use std::sync::atomic::AtomicBool;

use crate::film::Film;
use crate::scene::Scene;
use crate::stats::Counts;

/// Hears of finished work while a frame renders. Called from many threads.
pub trait Progress: Sync {
    /// `done` of `total` camera rays are finished.
    fn advance(&self, done: u64, total: u64);
}

/// Hears nothing.
#[derive(Clone, Copy, Debug)]
pub struct NoProgress;

impl Progress for NoProgress {
    fn advance(&self, _done: u64, _total: u64) {}
}

/// What a render returns.
#[derive(Debug)]
pub struct Rendered {
    /// The image.
    pub film: Film,
    /// What the rays did.
    pub counts: Counts,
    /// Wall-clock seconds until the first tile was complete.
    pub first_tile_secs: f64,
    /// Whether every sample was taken: `false` after cancellation.
    pub complete: bool,
}

/// Renders `scene` on the current rayon thread pool.
pub fn render(scene: &Scene, progress: &dyn Progress, cancel: &AtomicBool) -> Rendered {
    let _ = (progress, cancel);
    Rendered {
        film: Film::new(scene.width, scene.height),
        counts: Counts::default(),
        first_tile_secs: 0.0,
        complete: true,
    }
}

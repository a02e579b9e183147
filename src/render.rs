//! One frame: tiles over threads, passes, cancellation, progress, counters.
//!
//! A pixel's samples are taken in order from streams keyed by (seed, frame, pixel, sample), and
//! counters are sums of integers, so the result is the same bits for any number of threads, any
//! order of tiles, and however many passes it takes.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Instant;

use glam::DVec2;
use rayon::prelude::*;

use crate::film::{Accumulation, Cell, Film, PixelCost, Region, Sample, Tile, half_of};
use crate::integrator::Context;
use crate::sampling::{Number, PixelStreams};
use crate::scene::Scene;
use crate::silhouette::Silhouette;
use crate::stats::Counts;

/// Hears of finished work while a frame renders. Called from many threads.
pub trait Progress: Sync {
    /// `done` of `total` camera rays are finished.
    fn advance(&self, done: u64, total: u64);

    /// A tile that was begun at `begin` is finished, by this thread.
    fn tile(&self, _begin: Instant) {}
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
///
/// Setting `cancel` ends the render at the next pixel; pixels that were not reached are empty.
pub fn render(scene: &Scene, progress: &dyn Progress, cancel: &AtomicBool) -> Rendered {
    render_with_costs(scene, progress, cancel).0
}

/// Renders like [`render`], and also returns what each pixel cost, row by row from the top.
pub fn render_with_costs(
    scene: &Scene,
    progress: &dyn Progress,
    cancel: &AtomicBool,
) -> (Rendered, Vec<PixelCost>) {
    let whole = Region::whole(scene.width, scene.height);
    let mut state = Accumulation::new([scene.width, scene.height], whole, 0);
    let until = [scene.spp.into(); 2];
    let start = Instant::now();
    let frame = Frame::new(scene);
    let prepared = start.elapsed().as_secs_f64();
    let pass = frame.advance(&mut state, until, progress, cancel);
    let rendered = Rendered {
        film: state.film(),
        counts: pass.counts,
        first_tile_secs: prepared + pass.first_tile_secs,
        complete: pass.complete,
    };
    (rendered, state.costs())
}

/// A scene, prepared once for all passes over its pixels.
#[derive(Debug)]
pub struct Frame<'a> {
    scene: &'a Scene,
    context: Context<'a>,
    silhouette: Silhouette,
}

/// What one pass over the pixels did.
#[derive(Clone, Copy, Debug)]
pub struct Pass {
    /// What its rays did.
    pub counts: Counts,
    /// Wall-clock seconds until the first tile was complete.
    pub first_tile_secs: f64,
    /// Whether every sample was taken: `false` after cancellation.
    pub complete: bool,
}

impl<'a> Frame<'a> {
    /// Prepares a scene.
    ///
    /// # Cost
    /// That of the integrator's [`Context`], and of the medium's [`Silhouette`].
    pub fn new(scene: &'a Scene) -> Self {
        Self {
            scene,
            context: Context::new(&scene.media, &scene.lights, scene.transport),
            silhouette: Silhouette::new(&scene.media, &scene.camera, scene.width, scene.height),
        }
    }

    /// Takes the samples below `until` that pixels do not have yet, those of half 0 and of half 1
    /// (see [`half_of`]); on the current rayon thread pool.
    ///
    /// Setting `cancel` ends the pass at the next pixel: `state` is then good to go on from.
    ///
    /// # Panics
    /// If `state` is not of the scene's resolution.
    pub fn advance(
        &self,
        state: &mut Accumulation,
        until: [u64; 2],
        progress: &dyn Progress,
        cancel: &AtomicBool,
    ) -> Pass {
        let size = [self.scene.width, self.scene.height];
        assert_eq!(state.full_size(), size, "a state of another image");
        let start = Instant::now();
        let total = state.missing(until);
        let done = AtomicU64::new(0);
        let (counts, first_tile_secs) = state
            .tiles_mut()
            .par_iter_mut()
            // Tiles cost from nothing to a hundred times the mean: left to itself, rayon hands out a
            // quarter of the image at a time, and a thread ends up waiting for the other.
            .with_max_len(1)
            .map(|tile| {
                let begin = Instant::now();
                let counts = self.render_tile(tile, until, cancel);
                progress.tile(begin);
                let rays = counts.camera_rays;
                let before = done.fetch_add(rays, Ordering::Relaxed);
                progress.advance(before + rays, total);
                (counts, start.elapsed().as_secs_f64())
            })
            .reduce(
                || (Counts::default(), f64::INFINITY),
                |(mut sum, first), (counts, secs)| {
                    sum.add(&counts);
                    (sum, first.min(secs))
                },
            );
        Pass {
            counts,
            first_tile_secs,
            complete: counts.camera_rays == total,
        }
    }

    /// Estimates the relative error of the pixels that may see the medium, in half 0 and half 1:
    /// the root of the mean of variance over squared mean, each about as large as at least a
    /// tenth. Infinite below two samples.
    pub fn noise(&self, state: &Accumulation) -> [f64; 2] {
        let Region { min, max } = state.region();
        let places = (min[1]..max[1]).flat_map(|y| (min[0]..max[0]).map(move |x| (x, y)));
        let mut sums = [(0.0, 0_u64); 2];
        for ((x, y), cell) in places.zip(state.cells()) {
            if !self.silhouette.covers(x, y) {
                continue;
            }
            let pixel = cell.batch.pixel();
            let variance = pixel.variance_of_mean();
            let (sum, count) = &mut sums[half_of(self.pixel_index(x, y))];
            for (variance, mean) in variance.iter().zip(pixel.mean) {
                *sum += variance / (mean * mean + DARK * DARK);
            }
            *count += 3;
        }
        // No pixel that sees the medium: no noise.
        sums.map(|(sum, count)| (sum / count.max(1) as f64).sqrt())
    }

    fn pixel_index(&self, x: u32, y: u32) -> u64 {
        u64::from(y) * u64::from(self.scene.width) + u64::from(x)
    }

    fn render_tile(&self, tile: &mut Tile, until: [u64; 2], cancel: &AtomicBool) -> Counts {
        let mut counts = Counts::default();
        for (x, y, cell) in tile.cells_mut() {
            if cancel.load(Ordering::Relaxed) {
                break;
            }
            let index = self.pixel_index(x, y);
            let samples = cell.next..until[half_of(index)];
            if samples.is_empty() {
                continue;
            }
            let before = counts;
            self.render_pixel([x, y], index, samples, cell, &mut counts);
            cell.cost.values_read += counts.values_read() - before.values_read();
            cell.cost.null_collisions += counts.null_collisions - before.null_collisions;
        }
        counts
    }

    fn render_pixel(
        &self,
        [x, y]: [u32; 2],
        index: u64,
        samples: std::ops::Range<u64>,
        cell: &mut Cell,
        counts: &mut Counts,
    ) {
        let Self {
            scene,
            context,
            silhouette,
        } = self;
        cell.next = samples.end;
        if !silhouette.covers(x, y)
            && let Some(radiance) = scene.lights.constant_radiance()
        {
            let count = samples.end - samples.start;
            counts.camera_rays += count;
            cell.batch.add_constant(radiance, count);
            return;
        }
        let scale = DVec2::new(f64::from(scene.width), f64::from(scene.height)).recip();
        let corner = DVec2::new(f64::from(x), f64::from(y));
        let streams = PixelStreams::new(scene.seed, scene.frame, index, scene.transport.sampler);
        // A copy that can stay in registers.
        let mut batch = cell.batch;
        for sample in samples {
            let mut stream = streams.stream(sample);
            let jitter = DVec2::new(
                f64::from(stream.number(Number::FilmX)),
                f64::from(stream.number(Number::FilmY)),
            );
            let ray = scene.camera.ray((corner + jitter) * scale);
            let path = context.sample_radiance(ray, &mut stream, counts);
            if path.radiance.is_finite() {
                let depth = |(t, weight)| (scene.camera.depth(ray.at(t)), f64::from(weight));
                let (depth, depth_weight) = path.first_collision.map_or((0.0, 0.0), depth);
                batch.add(&Sample {
                    radiance: path.radiance,
                    opacity: f64::from(path.opacity),
                    depth,
                    depth_weight,
                });
            } else {
                counts.non_finite_samples += 1;
            }
        }
        cell.batch = batch;
    }
}

/// Radiance below which an error no longer counts as relative, as in `converge`'s measure.
const DARK: f64 = 0.1;

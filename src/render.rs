//! One frame: tiles over threads, cancellation, progress, counters.
//!
//! A pixel's samples are taken in order from streams keyed by (seed, frame, pixel, sample), and
//! counters are sums of integers, so the result is the same bits for any number of threads and
//! any order of tiles.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Instant;

use glam::DVec2;
use rayon::prelude::*;

use crate::film::{Batch, Film, Pixel, PixelCost, Sample};
use crate::integrator::Context;
use crate::sampling::{Number, PixelStreams};
use crate::scene::Scene;
use crate::silhouette::Silhouette;
use crate::stats::Counts;

/// Pixels along a tile's edge: small enough to balance two threads, large enough that the
/// rays of a tile read the same bricks.
const TILE: u32 = 16;

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
///
/// Setting `cancel` ends the render at the next pixel; pixels that were not reached are empty.
pub fn render(scene: &Scene, progress: &dyn Progress, cancel: &AtomicBool) -> Rendered {
    render_each(scene, progress, cancel, &mut |_, _| {})
}

/// Renders like [`render`], and also returns what each pixel cost, row by row from the top.
///
/// # Cost
/// 16 bytes a pixel; the samples are the same.
pub fn render_with_costs(
    scene: &Scene,
    progress: &dyn Progress,
    cancel: &AtomicBool,
) -> (Rendered, Vec<PixelCost>) {
    let mut costs = vec![PixelCost::default(); scene.width as usize * scene.height as usize];
    let rendered = render_each(scene, progress, cancel, &mut |at, cost| costs[at] = cost);
    (rendered, costs)
}

fn render_each(
    scene: &Scene,
    progress: &dyn Progress,
    cancel: &AtomicBool,
    on_cost: &mut dyn FnMut(usize, PixelCost),
) -> Rendered {
    let start = Instant::now();
    let context = Context::new(&scene.media, &scene.lights, scene.transport);
    let mut film = Film::new(scene.width, scene.height);
    let total = u64::from(scene.width) * u64::from(scene.height) * u64::from(scene.spp);
    let done = AtomicU64::new(0);
    let silhouette = Silhouette::new(&scene.media, &scene.camera, scene.width, scene.height);
    let tiles: Vec<Tile> = tiles(scene.width, scene.height).collect();
    let rendered: Vec<(Pixels, Counts, f64)> = tiles
        .par_iter()
        // Tiles cost from nothing to a hundred times the mean: left to itself, rayon hands out a
        // quarter of the image at a time, and a thread ends up waiting for the other.
        .with_max_len(1)
        .map(|tile| {
            let (pixels, counts) = render_tile(scene, &context, &silhouette, tile, cancel);
            let rays = counts.camera_rays;
            let before = done.fetch_add(rays, Ordering::Relaxed);
            progress.advance(before + rays, total);
            (pixels, counts, start.elapsed().as_secs_f64())
        })
        .collect();
    let mut counts = Counts::default();
    let mut first_tile_secs = f64::INFINITY;
    for (tile, (pixels, tile_counts, secs)) in tiles.iter().zip(rendered) {
        counts.add(&tile_counts);
        first_tile_secs = first_tile_secs.min(secs);
        for ((x, y), (pixel, cost)) in tile.pixels().zip(pixels) {
            let at = y as usize * scene.width as usize + x as usize;
            film.pixels_mut()[at] = pixel;
            on_cost(at, cost);
        }
    }
    Rendered {
        film,
        counts,
        first_tile_secs,
        complete: counts.camera_rays == total,
    }
}

/// The pixels of a tile and what they cost.
type Pixels = Vec<(Pixel, PixelCost)>;

/// A rectangle of pixels.
struct Tile {
    x: std::ops::Range<u32>,
    y: std::ops::Range<u32>,
}

impl Tile {
    fn pixels(&self) -> impl Iterator<Item = (u32, u32)> + '_ {
        self.y
            .clone()
            .flat_map(|y| self.x.clone().map(move |x| (x, y)))
    }
}

fn tiles(width: u32, height: u32) -> impl Iterator<Item = Tile> {
    let starts = |n: u32| (0..n).step_by(TILE as usize);
    starts(height).flat_map(move |y| {
        starts(width).map(move |x| Tile {
            x: x..width.min(x.saturating_add(TILE)),
            y: y..height.min(y.saturating_add(TILE)),
        })
    })
}

fn render_tile(
    scene: &Scene,
    context: &Context<'_>,
    silhouette: &Silhouette,
    tile: &Tile,
    cancel: &AtomicBool,
) -> (Pixels, Counts) {
    let mut counts = Counts::default();
    let scale = DVec2::new(f64::from(scene.width), f64::from(scene.height)).recip();
    let pixels = tile.pixels().map(|(x, y)| {
        if cancel.load(Ordering::Relaxed) {
            return (Pixel::default(), PixelCost::default());
        }
        if !silhouette.covers(x, y)
            && let Some(radiance) = scene.lights.constant_radiance()
        {
            counts.camera_rays += u64::from(scene.spp);
            let pixel = Pixel::constant(radiance, scene.spp.into());
            return (pixel, PixelCost::default());
        }
        let before = counts;
        let corner = DVec2::new(f64::from(x), f64::from(y));
        let index = u64::from(y) * u64::from(scene.width) + u64::from(x);
        let streams = PixelStreams::new(scene.seed, scene.frame, index, scene.transport.sampler);
        let mut batch = Batch::default();
        for sample in 0..u64::from(scene.spp) {
            let mut stream = streams.stream(sample);
            let jitter = DVec2::new(
                f64::from(stream.number(Number::FilmX)),
                f64::from(stream.number(Number::FilmY)),
            );
            let ray = scene.camera.ray((corner + jitter) * scale);
            let path = context.sample_radiance(ray, &mut stream, &mut counts);
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
        let cost = PixelCost {
            values_read: counts.values_read() - before.values_read(),
            null_collisions: counts.null_collisions - before.null_collisions,
        };
        (batch.pixel(), cost)
    });
    (pixels.collect(), counts)
}

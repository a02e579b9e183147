//! One frame: tiles over threads, passes, cancellation, progress, counters.
//!
//! A pixel's samples are taken in order from streams keyed by (seed, frame, pixel, sample), and
//! counters are sums of integers, so the result is the same bits for any number of threads, any
//! order of tiles, and however many passes it takes.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Instant;

use glam::DVec2;
use rayon::prelude::*;

use crate::aov::Aov;
use crate::film::{Accumulation, Cell, Film, PixelCost, Region, Sample, Tile, half_of};
use crate::integrator::{Context, Parts, PathSample};
use crate::sampling::{Number, PixelStreams, Stream, StreamKey};
use crate::scene::Scene;
use crate::silhouette::Silhouette;
use crate::space::Ray;
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
    let state = Accumulation::new([scene.width, scene.height], whole, 0);
    let mut state = state.with_channels(&scene.channels());
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
        // One for all pixels, whose samples start it over: the counts go on.
        let mut stream = Stream::new(StreamKey::default());
        for (x, y, cell, sums) in tile.cells_and_sums_mut() {
            if cancel.load(Ordering::Relaxed) {
                break;
            }
            let index = self.pixel_index(x, y);
            let samples = cell.next..until[half_of(index)];
            if samples.is_empty() {
                continue;
            }
            let before = stream.counts;
            self.render_pixel([x, y], index, samples, (cell, sums), &mut stream);
            let counts = &stream.counts;
            cell.cost.values_read += counts.values_read() - before.values_read();
            cell.cost.null_collisions += counts.null_collisions - before.null_collisions;
        }
        tile.settle();
        stream.counts
    }

    fn render_pixel(
        &self,
        [x, y]: [u32; 2],
        index: u64,
        samples: std::ops::Range<u64>,
        (cell, sums): (&mut Cell, &mut [f64]),
        stream: &mut Stream,
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
            stream.counts.camera_rays += count;
            cell.batch.add_constant(radiance, count);
            if !scene.aovs.is_empty() {
                let parts = Parts::of_sky(&scene.lights);
                Variables::of_sky(&parts).add_to(sums, &scene.aovs, count as f64);
            }
            return;
        }
        let scale = DVec2::new(f64::from(scene.width), f64::from(scene.height)).recip();
        let corner = DVec2::new(f64::from(x), f64::from(y));
        let streams = PixelStreams::new(scene.seed, scene.frame, index, scene.transport.sampler);
        let extent = if scene.aovs.contains(&Aov::Depth) {
            let ray = scene.camera.ray((corner + 0.5) * scale);
            self.extent(ray, &mut stream.counts)
        } else {
            [f64::INFINITY; 2]
        };
        // A copy that can stay in registers.
        let mut batch = cell.batch;
        for sample in samples {
            streams.start(sample, stream);
            let jitter = DVec2::new(
                f64::from(stream.number(Number::FilmX)),
                f64::from(stream.number(Number::FilmY)),
            );
            let ray = scene.camera.ray((corner + jitter) * scale);
            let path = if scene.aovs.is_empty() {
                context.sample_radiance(ray, stream)
            } else {
                let before = stream.counts.values_read();
                let path = context.sample_parts(ray, stream);
                let lookups = stream.counts.values_read() - before;
                let variables = Variables::of(&path, lookups as f64, extent);
                if path.radiance.radiance.is_finite() {
                    variables.add_to(sums, &scene.aovs, 1.0);
                }
                path.whole()
            };
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
                stream.counts.non_finite_samples += 1;
            }
        }
        cell.batch = batch;
    }

    /// Returns the depths, along the camera's axis, at which the media begin and end; infinite where
    /// there is less than [`LEAST_DEPTH`].
    fn extent(&self, ray: Ray, counts: &mut Counts) -> [f64; 2] {
        let depth = |t: f64| self.scene.camera.depth(ray.at(t));
        match self.context.extent(&ray, LEAST_DEPTH, counts) {
            Some((front, back)) => [depth(front), depth(back)],
            None => [f64::INFINITY; 2],
        }
    }
}

/// Optical depth in front of which a medium has not begun, and behind which it has ended.
const LEAST_DEPTH: f64 = 1e-3;

/// Output variables of a sample.
struct Variables<'a> {
    parts: &'a Parts,
    transmittance: f64,
    lookups: f64,
    /// Where the media begin and end.
    extent: [f64; 2],
}

impl<'a> Variables<'a> {
    fn of(path: &'a PathSample<Parts>, lookups: f64, extent: [f64; 2]) -> Self {
        Self {
            parts: &path.radiance,
            transmittance: 1.0 - f64::from(path.opacity),
            lookups,
            extent,
        }
    }

    /// Returns those of a ray past all media.
    fn of_sky(parts: &'a Parts) -> Self {
        Self {
            parts,
            transmittance: 1.0,
            lookups: 0.0,
            extent: [f64::INFINITY; 2],
        }
    }

    /// Adds those that are asked for to the sums of a pixel, `count` times.
    fn add_to(&self, sums: &mut [f64], aovs: &[Aov], count: f64) {
        let Self {
            parts,
            transmittance,
            lookups,
            extent,
        } = self;
        let mut rest = sums.iter_mut();
        for aov in aovs {
            let values: &[[f32; 3]] = match aov {
                Aov::Transmittance => {
                    add(&mut rest, [*transmittance], count);
                    continue;
                }
                Aov::Lookups => {
                    add(&mut rest, [*lookups], count);
                    continue;
                }
                Aov::Depth => {
                    add(&mut rest, *extent, count);
                    continue;
                }
                Aov::Albedo => &[parts.albedo.0],
                Aov::Normal => &[parts.normal.to_array()],
                Aov::Emission => &[parts.by_order[0].0],
                Aov::Direct => &[parts.by_order[1].0],
                Aov::Indirect => &[parts.by_order[2].0],
                Aov::Lights => &parts
                    .by_light
                    .iter()
                    .map(|light| light.0)
                    .collect::<Vec<_>>(),
            };
            add(
                &mut rest,
                values.as_flattened().iter().map(|&x| x.into()),
                count,
            );
        }
    }
}

/// Adds `values`, `count` times, to the next sums.
fn add<'a>(
    sums: &mut impl Iterator<Item = &'a mut f64>,
    values: impl IntoIterator<Item = f64>,
    count: f64,
) {
    for value in values {
        if let Some(sum) = sums.next() {
            *sum += value * count;
        }
    }
}

/// Radiance below which an error no longer counts as relative, as in `converge`'s measure.
const DARK: f64 = 0.1;

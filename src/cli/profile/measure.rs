//! Where the time of a scene's paths goes, and the memory that they touch.
//!
//! ```text
//! tiles of the image ─┬─ rendered, timed ────────► CPU time, counts of events
//!                     └─ plain paths ─ replay, timed in four passes ─► CPU time of an event
//! ```
//!
//! Rendering has no clocks inside: reading one takes as long as a lookup or two. So each kind of event is
//! counted where it happens, as it always is, and timed apart, in the same process, on the scene's own grid and
//! rays. Counts times times leave a rest: phase functions, lights, roulette, sums of pixels.
//!
//! Nothing of this is in the library: images come from the same code as without it.

use std::sync::atomic::AtomicBool;
use std::time::Duration;

use cpu_time::ThreadTime;
use glam::DVec2;
use majorant::film::{Accumulation, Region};
use majorant::render::{Frame, NoProgress};
use majorant::sampling::StreamKey;
use majorant::scene::Scene;
use majorant::silhouette::Silhouette;
use majorant::stats::Counts;
use serde::Serialize;

use super::replay::{Pass, Replay, Tracked, tracked};
use super::reuse::{Follower, Reuse};

/// Edge of a tile in pixels: that of the tiles that threads render.
const TILE: u32 = 16;

/// Samples of each pixel of a tile.
const SAMPLES: u64 = 4;

/// Times that a tile is timed, of which the shortest counts: the others were disturbed.
pub(super) const REPEATS: usize = 3;

/// What was measured of the paths of some tiles. Times are CPU seconds of one thread.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub(super) struct Measured {
    /// Tiles that were measured, and all in which the medium may be seen.
    pub(super) tiles: [usize; 2],
    /// Samples in them whose camera ray was traced.
    pub(super) paths: u64,
    /// What rendering them takes.
    pub(super) render_secs: f64,
    /// What their rays did.
    pub(super) counts: Counts,
    /// What replaying rays takes: placing them in the grid, and stepping, and reading, and all.
    pub(super) replay_secs: [f64; 4],
    /// Rays that were replayed, one for each medium.
    pub(super) replayed_rays: u64,
    /// What they did when recorded.
    pub(super) recorded: Counts,
    /// What the estimators did along them.
    pub(super) tracked: Counts,
    /// Reads of memory.
    pub(super) reuse: Reuse,
    /// Bytes of a voxel value, and of the bounds that a step reads.
    pub(super) bytes_per_event: [usize; 2],
    /// Media, each of which a ray may meet.
    pub(super) media: usize,
}

/// Work of one kind.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(super) struct Work {
    /// Name.
    pub(super) name: &'static str,
    /// What is counted.
    pub(super) event: &'static str,
    /// Events of a path.
    pub(super) events_per_path: f64,
    /// Nanoseconds of an event.
    pub(super) nanoseconds: f64,
    /// Nanoseconds of a path: the product.
    pub(super) nanoseconds_per_path: f64,
    /// Share of all of the path's time.
    pub(super) share: f64,
}

/// What tiles are measured with.
struct Bench<'a> {
    scene: &'a Scene,
    frame: &'a Frame<'a>,
    silhouette: Silhouette,
    tracked: Vec<Tracked<'a>>,
    /// Shadow rays for each vertex.
    shadows: f32,
}

/// Measures paths of a scene, tile after tile from all over the image, until `budget` of rendering is
/// spent. `counts` are those of the whole image.
///
/// Takes about ten times the budget on the calling thread, if that is alone in its pool.
pub(super) fn measure(
    scene: &Scene,
    frame: &Frame<'_>,
    counts: &Counts,
    budget: Duration,
) -> Measured {
    let Scene { width, height, .. } = *scene;
    let vertices = counts.scattered_rays.max(1) as f32;
    let bench = Bench {
        scene,
        frame,
        silhouette: Silhouette::new(&scene.media, &scene.camera, width, height),
        tracked: tracked(scene),
        // Not endless, whatever the counts.
        shadows: (counts.shadow_rays as f32 / vertices).min(16.0),
    };
    let tiles = bench.covered_tiles();
    let mut follower = Follower::default();
    let bytes = bench.tracked.iter().map(Tracked::bytes_per_event);
    let mut measured = Measured {
        tiles: [0, tiles.len()],
        media: scene.media.len(),
        bytes_per_event: bytes
            .reduce(|a, b| [a[0].max(b[0]), a[1]])
            .unwrap_or_default(),
        ..Measured::default()
    };
    for i in scattered(tiles.len()) {
        measured.tile(&bench, tiles[i], &mut follower);
        measured.tiles[0] += 1;
        if measured.render_secs >= budget.as_secs_f64() {
            break;
        }
    }
    measured.reuse = follower.reuse;
    measured
}

impl Bench<'_> {
    /// Returns the tiles in which the medium may be seen.
    fn covered_tiles(&self) -> Vec<Region> {
        let Scene { width, height, .. } = *self.scene;
        let rows = (0..height).step_by(TILE as usize);
        let tiles = rows.flat_map(|y| (0..width).step_by(TILE as usize).map(move |x| [x, y]));
        let tiles = tiles.map(|[x, y]| Region {
            min: [x, y],
            max: [(x + TILE).min(width), (y + TILE).min(height)],
        });
        let is_covered = |tile: &Region| pixels(*tile).any(|[x, y]| self.silhouette.covers(x, y));
        tiles.filter(is_covered).collect()
    }

    /// Renders a tile as an image would.
    fn render(&self, tile: Region) -> Counts {
        let size = [self.scene.width, self.scene.height];
        let mut state = Accumulation::new(size, tile, 0);
        let never = AtomicBool::new(false);
        let pass = self
            .frame
            .advance(&mut state, [SAMPLES; 2], &NoProgress, &never);
        pass.counts
    }

    /// Returns plain paths from the pixels of a tile, and their number.
    fn replay(&self, tile: Region, follower: &mut Follower) -> (Replay<'_>, u64) {
        let Scene { width, height, .. } = *self.scene;
        let key = StreamKey {
            seed: self.scene.seed,
            frame: self.scene.frame,
            pixel: u64::from(tile.min[1]) << 32 | u64::from(tile.min[0]),
            sample: 0,
        };
        let mut replay = Replay::new(self.scene, &self.tracked, self.shadows, key);
        let scale = DVec2::new(f64::from(width), f64::from(height)).recip();
        let mut paths = 0;
        let covered = pixels(tile).filter(|&[x, y]| self.silhouette.covers(x, y));
        for [x, y] in covered {
            for sample in 0..SAMPLES {
                let across = (sample as f64 + 0.5) / SAMPLES as f64;
                let at = DVec2::new(f64::from(x) + across, f64::from(y) + 0.5);
                replay.add_path(self.scene.camera.ray(at * scale), follower);
                follower.end_path();
                paths += 1;
            }
        }
        follower.end_tile();
        (replay, paths)
    }
}

fn pixels(Region { min, max }: Region) -> impl Iterator<Item = [u32; 2]> {
    (min[1]..max[1]).flat_map(move |y| (min[0]..max[0]).map(move |x| [x, y]))
}

/// Returns 0 to `count - 1` in an order whose beginnings are spread evenly.
fn scattered(count: usize) -> impl Iterator<Item = usize> {
    let bits = count.next_power_of_two().trailing_zeros();
    let reversed = (0..1_usize << bits).map(move |i| match bits {
        0 => 0,
        _ => i.reverse_bits() >> (usize::BITS - bits),
    });
    reversed.filter(move |&i| i < count)
}

impl Measured {
    /// Adds what is measured of a tile.
    fn tile(&mut self, bench: &Bench<'_>, tile: Region, follower: &mut Follower) {
        let (replay, paths) = bench.replay(tile, follower);
        self.paths += paths;
        self.recorded.add(replay.recorded());
        self.replayed_rays += replay.ray_count() as u64;
        let mut counts = Counts::default();
        self.render_secs += shortest(|| counts = bench.render(tile));
        self.counts.add(&counts);
        for (secs, pass) in self.replay_secs.iter_mut().zip(Pass::ALL) {
            *secs += shortest(|| counts = replay.run(pass));
        }
        // Of the last pass.
        self.tracked.add(&counts);
    }

    /// Returns nanoseconds of a path.
    pub(super) fn nanoseconds_per_path(&self) -> f64 {
        1e9 * self.render_secs / self.paths.max(1) as f64
    }

    /// Returns the rays that were traced for the paths, one for each medium.
    pub(super) fn rays(&self) -> u64 {
        let Counts {
            scattered_rays,
            shadow_rays,
            ..
        } = self.counts;
        (self.paths + scattered_rays + shadow_rays) * self.media as u64
    }

    /// Returns where the time goes, in order: starts of rays, steps, reads, collisions, and the rest.
    pub(super) fn work(&self) -> [Work; 5] {
        // A voxel cell that is integrated is one read, of eight values.
        let reads = |c: &Counts| (c.lookups + c.voxel_cells) as f64;
        let steps = |c: &Counts| c.segments as f64;
        let collisions = |c: &Counts| c.tentative_collisions as f64;
        let each = |secs: f64, events: f64| secs.max(0.0) / events.max(1.0);
        let Self {
            counts,
            recorded,
            tracked,
            ..
        } = self;
        let [start, walk, read, track] = self.replay_secs;
        let step_secs = each(walk - start, steps(recorded));
        let read_secs = each(read - walk, reads(recorded));
        // The estimators take other steps and reads than were recorded.
        let rest = track - start - step_secs * steps(tracked) - read_secs * reads(tracked);
        let collision_secs = each(rest, collisions(tracked));
        let timed = [
            (
                "starting rays",
                "ray",
                each(start, self.replayed_rays as f64),
                self.rays() as f64,
            ),
            ("traversal", "step", step_secs, steps(counts)),
            ("lookups", "read", read_secs, reads(counts)),
            ("sampling", "collision", collision_secs, collisions(counts)),
        ];
        let known: f64 = timed.iter().map(|(.., secs, events)| secs * events).sum();
        let vertices = (counts.scattered_rays + self.paths) as f64;
        let [a, b, c, d] = timed;
        let left = (self.render_secs - known) / vertices.max(1.0);
        let rest = ("shading and the rest", "vertex", left, vertices);
        [a, b, c, d, rest].map(|(name, event, secs, events)| {
            let paths = self.paths.max(1) as f64;
            Work {
                name,
                event,
                events_per_path: events / paths,
                nanoseconds: 1e9 * secs,
                nanoseconds_per_path: 1e9 * secs * events / paths,
                share: secs * events / self.render_secs.max(f64::MIN_POSITIVE),
            }
        })
    }

    /// Returns the share of tentative collisions that were with nothing, 0 without any.
    pub(super) fn null_ratio(counts: &Counts) -> f64 {
        counts.null_collisions as f64 / counts.tentative_collisions.max(1) as f64
    }
}

/// Returns the shortest CPU time, in seconds, of some runs.
fn shortest(mut run: impl FnMut()) -> f64 {
    let times = (0..REPEATS).map(|_| {
        let begin = ThreadTime::try_now();
        run();
        // Without such a clock nothing takes any time, and the page says so.
        begin.map_or(0.0, |begin| begin.elapsed().as_secs_f64())
    });
    times.fold(f64::INFINITY, f64::min)
}

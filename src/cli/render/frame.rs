//! Renders one frame, pass by pass, and writes its files.

use std::path::Path;
use std::time::{Duration, Instant};

use majorant::film::Film;
use majorant::output::{self, Identity, Provenance, SampleRanges};
use majorant::render::{Frame, Progress};

use super::job::Ready;
use super::summary::{summarise, warn_of_trouble};
use super::viewer::Viewer;
use super::watch::{Cause, Interruption, Watch};
use super::work::Work;
use crate::cli::args::RenderArgs;
use crate::cli::progress::{Place, RenderProgress};
use crate::cli::stats::{Clock, Stats};
use crate::cli::trace::{Lane, Trace};
use crate::cli::{Failure, memory, report};

/// How long a pass over the pixels is to take: short enough that a snapshot shows all of the
/// picture, long enough that its end, where threads wait for each other, costs nothing.
const PASS: Duration = Duration::from_secs(2);

/// Time between two estimates of the image's error, which take about 20 ns a pixel.
const ERROR_INTERVAL: Duration = Duration::from_secs(5);

/// How a frame ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum End {
    /// It is written.
    Done,
    /// A checkpoint is written.
    Stopped(Cause),
}

/// Renders a frame and writes its files.
pub(super) fn render(
    ready: &Ready,
    stats: &mut Stats,
    (watch, mut viewer): (&mut Watch, Option<&mut Viewer>),
    args: &RenderArgs,
    place: Place,
    trace: Option<&Trace>,
) -> Result<End, Failure> {
    let span = |name: &str, begin: Instant| {
        if let Some(trace) = trace {
            trace.span(Lane::Main, name.to_owned(), begin);
        }
    };
    let checkpoint = &ready.outputs.checkpoint;
    let resume = args.batch.resume.then_some(checkpoint.as_path());
    let size = [ready.scene.width, ready.scene.height];
    let mut work = Work::new(
        &ready.identity,
        size,
        ready.region,
        &ready.scene.channels(),
        resume,
    );
    watch.begin_frame();
    let mut clock = Clock::start();
    let begin = Instant::now();
    let frame = Frame::new(&ready.scene);
    span("prepare", begin);
    let mut first_tile_secs = None;
    let progress = RenderProgress::start(args.progress, place, work.counts.camera_rays);
    let mut preview = Preview::new(ready, args.preview_every);
    let mut error_at = begin;
    let mut step = 1;
    while let Some(until) = work.next(&frame, step) {
        let pass_begin = Instant::now();
        let told = Told {
            progress: &progress,
            watch,
            trace,
            done: work.counts.camera_rays,
            total: work.total(),
        };
        let pass = frame.advance(&mut work.state, until, &told, watch.flag());
        work.counts.add(&pass.counts);
        span(
            &format!("pass to sample {}", until[0].max(until[1])),
            pass_begin,
        );
        let waited = (pass_begin - begin).as_secs_f64();
        first_tile_secs.get_or_insert(waited + pass.first_tile_secs);
        if pass.complete {
            step = next_step(step, pass_begin.elapsed(), watch.time_left().min(PASS));
        }
        preview.after_pass(&work);
        if let Some(viewer) = &mut viewer {
            viewer.show_sometimes(&ready.outputs.image, || work.state.film());
        }
        if progress.shows_error() && error_at.elapsed() > ERROR_INTERVAL {
            error_at = Instant::now();
            let [a, b] = frame.noise(&work.state);
            progress.set_error(f64::midpoint(a, b));
        }
        match watch.interruption() {
            Some(Interruption::Stop(cause)) if work.next(&frame, 1).is_some() => {
                work.save(checkpoint).map_err(Failure::failed)?;
                return Ok(End::Stopped(cause));
            }
            Some(Interruption::Checkpoint) => {
                // The picture itself may still find room.
                if let Err(e) = work.save(checkpoint) {
                    tracing::warn!("no checkpoint: {}", report::chain(&e));
                }
            }
            Some(Interruption::Snapshot) => write_snapshot(ready, &work, stats)?,
            Some(Interruption::Stop(_)) | None => {}
        }
    }
    drop(progress);
    stats.seconds.first_sample = first_tile_secs.map(|secs| ready.loading.wall + secs);
    stats.seconds.render = Some(work.render_secs());
    stats.cpu_seconds.render = clock.lap().cpu;
    stats.counts.rays = work.counts;
    stats.peak_memory_bytes = memory::peak_bytes();
    let film = work.state.film();
    drop(work);
    (stats.image_mean, stats.image_standard_error) = film.mean();
    if let Some(viewer) = viewer {
        viewer.show(&ready.outputs.image, &film);
    }
    let write_begin = Instant::now();
    write(ready, &film, stats)?;
    span("write", write_begin);
    span(&format!("frame {}", ready.scene.frame), begin);
    remove_checkpoint(ready);
    Ok(End::Done)
}

/// The picture that is rewritten while the image converges.
struct Preview<'a> {
    path: Option<&'a Path>,
    interval: Duration,
    last: Instant,
}

impl<'a> Preview<'a> {
    fn new(ready: &'a Ready, every: Option<f64>) -> Self {
        let interval = every.and_then(|secs| Duration::try_from_secs_f64(secs).ok());
        Self {
            path: interval.and(ready.outputs.preview.as_deref()),
            interval: interval.unwrap_or_default(),
            last: Instant::now(),
        }
    }

    fn after_pass(&mut self, work: &Work) {
        let Some(path) = self.path.filter(|_| self.last.elapsed() >= self.interval) else {
            return;
        };
        if let Err(e) = output::write_png(path, &work.state.film()) {
            tracing::warn!("no preview: {}", report::chain(&e));
        }
        self.last = Instant::now();
    }
}

/// Returns how many samples the next pass is to take for `aim`, after `step` took `elapsed`.
fn next_step(step: u64, elapsed: Duration, aim: Duration) -> u64 {
    let factor = aim.as_secs_f64() / elapsed.as_secs_f64().max(1e-9);
    // No more than four times: the first samples tell little of the next.
    let wanted = step as f64 * factor.min(4.0);
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "positive, and saturates"
    )]
    let wanted = wanted as u64;
    wanted.max(1)
}

/// Hears of finished tiles: shows progress, and looks at the clock.
struct Told<'a> {
    progress: &'a RenderProgress,
    watch: &'a Watch,
    trace: Option<&'a Trace>,
    /// Camera rays before this pass.
    done: u64,
    /// Camera rays of the whole frame.
    total: u64,
}

impl Progress for Told<'_> {
    fn advance(&self, done: u64, _pass_total: u64) {
        self.progress.advance(self.done + done, self.total);
        self.watch.tick();
    }

    fn tile(&self, begin: Instant) {
        if let Some(trace) = self.trace {
            trace.span(Lane::here(), "tile".to_owned(), begin);
        }
    }
}

fn provenance(ready: &Ready, identity: Identity, stats: &Stats) -> Result<Provenance, Failure> {
    let command_line: Vec<_> = std::env::args_os().collect();
    let words = command_line.iter().map(|w| w.to_string_lossy());
    let scene = &ready.scene;
    Ok(Provenance {
        camera_from_world: scene.camera.camera_from_world(),
        half_size: scene.camera.half_size(),
        identity,
        seed: scene.seed,
        frame: scene.frame,
        command_line: words.collect::<Vec<_>>().join(" "),
        render_secs: stats.seconds.render.unwrap_or(0.0),
        peak_memory_bytes: stats.peak_memory_bytes,
        stats_json: serde_json::to_string(stats).map_err(Failure::failed)?,
    })
}

/// Writes the image so far, with no claim to be the frame.
fn write_snapshot(ready: &Ready, work: &Work, stats: &Stats) -> Result<(), Failure> {
    let path = &ready.outputs.snapshot;
    let next = work.state.next();
    let end = *next[0].end().max(next[1].end());
    let Some(samples) = SampleRanges::one(work.state.first()..end) else {
        return Ok(());
    };
    let identity = Identity {
        samples,
        ..ready.identity.clone()
    };
    let provenance = provenance(ready, identity, stats)?;
    match output::write_exr(path, &work.state.film(), &provenance) {
        Ok(()) => tracing::info!("{}: a snapshot", path.display()),
        Err(e) => tracing::warn!("no snapshot: {}", report::chain(&e)),
    }
    Ok(())
}

/// Writes a frame's files, the image last but for the statistics that tell how long that took.
fn write(ready: &Ready, film: &Film, stats: &mut Stats) -> Result<(), Failure> {
    let mut clock = Clock::start();
    let outputs = &ready.outputs;
    if let Some(path) = &outputs.preview {
        output::write_png(path, film).map_err(Failure::failed)?;
    }
    if ready.is_part {
        let provenance = provenance(ready, ready.identity.clone(), stats)?;
        output::write_float_exr(&outputs.image, film, &provenance).map_err(Failure::failed)?;
    } else {
        stats.counts.half_clamped_pixels = output::half_overflow_count(film);
        let provenance = provenance(ready, ready.identity.clone(), stats)?;
        output::write_exr(&outputs.image, film, &provenance).map_err(Failure::failed)?;
    }
    warn_of_trouble(stats);
    let lap = clock.lap();
    stats.seconds.write = Some(lap.wall);
    stats.cpu_seconds.write = lap.cpu;
    if let Some(path) = &outputs.stats {
        let json = serde_json::to_string_pretty(stats).map_err(Failure::failed)?;
        output::write_text(path, &format!("{json}\n")).map_err(Failure::failed)?;
    }
    summarise(&outputs.image, stats);
    Ok(())
}

/// Removes what a finished frame no longer needs.
fn remove_checkpoint(ready: &Ready) {
    let outputs = &ready.outputs;
    match std::fs::remove_file(&outputs.checkpoint) {
        Err(e) if e.kind() != std::io::ErrorKind::NotFound => {
            tracing::warn!("{}: cannot be removed: {e}", outputs.checkpoint.display());
        }
        _ => {}
    }
    for path in [&outputs.image, &outputs.checkpoint] {
        output::remove_remnants(path);
    }
}

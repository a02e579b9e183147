//! Frame after frame: the next one loads while one renders; a failure ends its frame alone.
//!
//! Loading ahead stays within the memory that may be used: what this frame holds is taken off.
//! Whatever goes wrong there is tried again when the frame's turn comes, with all the memory.

use std::time::Instant;

use super::frame::{self, End};
use super::job::{Job, Jobs, Ready};
use super::summary::{explanation, report_plan};
use super::viewer::Viewer;
use super::watch::{Cause, Watch};
use crate::cli::args::RenderArgs;
use crate::cli::progress::{Place, say_status};
use crate::cli::stats::{Clock, Stats};
use crate::cli::trace::Lane;
use crate::cli::{Failure, report};

/// A run over frames.
pub(super) struct Batch<'a> {
    args: &'a RenderArgs,
    jobs: &'a Jobs<'a>,
    frames: &'a [Option<i32>],
    watch: Watch,
    viewer: Option<Viewer>,
    /// Since the program's start, for the first frame to be rendered.
    begin: Option<Clock>,
    tally: Tally,
}

/// How frames ended.
#[derive(Default)]
struct Tally {
    rendered: usize,
    existing: usize,
    left_out: usize,
    failed: Vec<(i32, String)>,
}

impl<'a> Batch<'a> {
    pub(super) fn new(
        args: &'a RenderArgs,
        jobs: &'a Jobs<'a>,
        frames: &'a [Option<i32>],
        begin: Clock,
    ) -> Result<Self, Failure> {
        let batch = &args.batch;
        Ok(Self {
            args,
            jobs,
            frames,
            watch: Watch::new(Instant::now(), batch.time_limit, batch.checkpoint)?,
            viewer: args.preview.as_deref().map(Viewer::find).transpose()?,
            begin: Some(begin),
            tally: Tally::default(),
        })
    }

    /// Renders all frames, and reports those that failed.
    pub(super) fn run(self) -> Result<(), Failure> {
        let (jobs, args) = (self.jobs, self.args);
        let result = self.run_frames();
        if let Some((trace, path)) = jobs.trace().zip(args.trace.as_ref()) {
            trace.write(path).map_err(Failure::failed)?;
        }
        result
    }

    fn run_frames(mut self) -> Result<(), Failure> {
        let mut ahead = None;
        for (i, &frame) in self.frames.iter().enumerate() {
            if let Some(cause) = self.watch.stop() {
                return Err(self.stopped(cause, i));
            }
            let max_memory = self.jobs.max_memory_bytes();
            let job = match ahead.take() {
                Some(Ok(job)) => Ok(job),
                Some(Err(_)) | None => self.jobs.prepare(frame, max_memory, Lane::Main),
            };
            let place = Place {
                frame: frame.unwrap_or(0),
                index: i,
                count: self.frames.len(),
            };
            let ended = job.and_then(|job| match job {
                Job::Exists(outputs) => {
                    tracing::info!("{}: complete, left as it is", outputs.image.display());
                    self.tally.existing += 1;
                    Ok(None)
                }
                Job::LeftOut(missing) => {
                    tracing::warn!("{}: missing, its frame is left out", missing.path.display());
                    self.tally.left_out += 1;
                    Ok(None)
                }
                Job::Ready(ready) => {
                    let place = Place {
                        frame: ready.scene.frame,
                        ..place
                    };
                    say_status(self.args.progress, place, "rendering");
                    let next = Some(i + 1).filter(|&next| next < self.frames.len());
                    let (end, loaded) = self.render(*ready, place, next)?;
                    ahead = loaded;
                    Ok(Some(end))
                }
            });
            match ended {
                Ok(Some(End::Stopped(cause))) => return Err(self.stopped(cause, i)),
                Ok(Some(End::Done)) => self.tally.rendered += 1,
                Ok(None) => {}
                Err(failure) => match frame.filter(|_| self.is_sequence()) {
                    None => return Err(failure),
                    Some(frame) => self.failed(frame, &failure),
                },
            }
        }
        self.finish()
    }

    /// Renders one frame, while the next one loads.
    fn render(
        &mut self,
        ready: Ready,
        place: Place,
        next: Option<usize>,
    ) -> Result<(End, Option<Result<Job, Failure>>), Failure> {
        let Self {
            args, jobs, frames, ..
        } = *self;
        let mut stats = Stats::new(
            &args.input,
            &ready.outputs.image,
            &ready.scene,
            &ready.volumes,
        );
        let loading = match self.begin.take() {
            Some(mut begin) => begin.lap(),
            None => ready.loading,
        };
        let ready = Ready { loading, ..ready };
        ready.stages.write_to(&mut stats, loading);
        if args.explain {
            report::print(&explanation(&stats))?;
        }
        report_plan(&stats);
        let left = jobs.max_memory_bytes().saturating_sub(ready.memory_bytes());
        let (watch, viewer) = (&mut self.watch, self.viewer.as_mut());
        std::thread::scope(|scope| {
            let loader = next
                .map(|next| scope.spawn(move || jobs.prepare(frames[next], left, Lane::Loader)));
            let end = frame::render(
                &ready,
                &mut stats,
                (watch, viewer),
                args,
                place,
                jobs.trace(),
            );
            // A panic there is a bug: it ends the program here as it would have without a thread.
            let loaded = loader.map(|thread| match thread.join() {
                Ok(job) => job,
                Err(panic) => std::panic::resume_unwind(panic),
            });
            Ok((end?, loaded))
        })
    }

    fn is_sequence(&self) -> bool {
        self.args.batch.frames().is_some()
    }

    fn failed(&mut self, frame: i32, failure: &Failure) {
        report::error(&format!("frame {frame} failed:"));
        report::failure(failure);
        if let Some(reason) = report::reason(failure) {
            self.tally.failed.push((frame, reason));
        }
    }

    /// Says how a sequence ended.
    fn finish(self) -> Result<(), Failure> {
        if !self.is_sequence() {
            return Ok(());
        }
        let Tally {
            rendered,
            existing,
            left_out,
            failed,
        } = self.tally;
        let mut parts = vec![format!("{rendered} rendered")];
        for (count, what) in [
            (existing, "complete before"),
            (left_out, "left out"),
            (failed.len(), "FAILED"),
        ] {
            if count > 0 {
                parts.push(format!("{count} {what}"));
            }
        }
        let total = self.frames.len();
        let frames = if total == 1 { "frame" } else { "frames" };
        tracing::info!("{total} {frames}: {}", parts.join(", "));
        for (frame, reason) in &failed {
            report::error(&format!("frame {frame}: {reason}"));
        }
        if failed.is_empty() {
            Ok(())
        } else {
            Err(Failure::SomeFrames)
        }
    }

    /// Says why frames from the `i`-th on are not there, and how to go on.
    fn stopped(self, cause: Cause, i: usize) -> Failure {
        let why = match cause {
            Cause::Signal => "interrupted",
            Cause::TimeLimit => "the time limit is reached",
        };
        let left = self.frames.len() - i;
        let frames = if left == 1 { "frame" } else { "frames" };
        tracing::warn!(
            "{why} with {left} {frames} to go: the same command with --resume --skip-existing \
             goes on"
        );
        for (frame, reason) in &self.tally.failed {
            report::error(&format!("frame {frame}: {reason}"));
        }
        Failure::Stopped
    }
}

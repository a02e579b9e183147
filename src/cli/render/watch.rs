//! What may stop or interrupt a render: signals, and the clock.
//!
//! INT and TERM end it with a checkpoint, USR1 asks for a snapshot; a second INT or TERM ends the
//! program at once. The clock is looked at whenever a tile is done; no thread waits for it.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use signal_hook::consts::{SIGINT, SIGTERM};
use signal_hook::flag;

use crate::cli::Failure;

/// Why rendering pauses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Interruption {
    /// To end with a checkpoint.
    Stop(Cause),
    /// To write the image so far.
    Snapshot,
    /// To write a checkpoint, since it is time to.
    Checkpoint,
}

/// What ended a render early.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Cause {
    /// INT or TERM.
    Signal,
    /// `--time-limit`.
    TimeLimit,
}

/// Watches for interruptions.
pub(super) struct Watch {
    stop: Arc<AtomicBool>,
    snapshot: Arc<AtomicBool>,
    /// Set with either, or when a time is up: what rendering looks at.
    pause: Arc<AtomicBool>,
    deadline: Option<Instant>,
    interval: Option<Duration>,
    next_checkpoint: Option<Instant>,
}

impl Watch {
    /// Begins to watch. Times are in seconds from `start`.
    pub(super) fn new(
        start: Instant,
        time_limit: Option<f64>,
        checkpoint: Option<f64>,
    ) -> Result<Self, Failure> {
        // A time that is too long for the clock never comes.
        let duration = |secs: f64| Duration::try_from_secs_f64(secs).ok();
        let watch = Self {
            stop: Arc::default(),
            snapshot: Arc::default(),
            pause: Arc::default(),
            deadline: time_limit
                .and_then(duration)
                .and_then(|d| start.checked_add(d)),
            interval: checkpoint.and_then(duration),
            next_checkpoint: None,
        };
        for signal in [SIGINT, SIGTERM] {
            // In this order, or the first signal would find the flag set.
            flag::register_conditional_shutdown(signal, 75, Arc::clone(&watch.stop))
                .and_then(|_| flag::register(signal, Arc::clone(&watch.stop)))
                .and_then(|_| flag::register(signal, Arc::clone(&watch.pause)))
                .map_err(Failure::failed)?;
        }
        #[cfg(unix)]
        flag::register(signal_hook::consts::SIGUSR1, Arc::clone(&watch.snapshot))
            .and_then(|_| flag::register(signal_hook::consts::SIGUSR1, Arc::clone(&watch.pause)))
            .map_err(Failure::failed)?;
        Ok(watch)
    }

    /// Begins a frame: the next checkpoint is a whole interval away.
    pub(super) fn begin_frame(&mut self) {
        self.next_checkpoint = self.interval.and_then(|i| Instant::now().checked_add(i));
    }

    /// The flag at which rendering pauses.
    pub(super) fn flag(&self) -> &AtomicBool {
        &self.pause
    }

    /// Returns how long until the time limit, at which a pass is to end: the clock is looked at
    /// only where a tile ends, which in a small picture is where the pass does.
    pub(super) fn time_left(&self) -> Duration {
        self.deadline.map_or(Duration::MAX, |at| {
            at.saturating_duration_since(Instant::now())
        })
    }

    /// Looks at the clock.
    pub(super) fn tick(&self) {
        let now = Instant::now();
        let is_past = |at: Option<Instant>| at.is_some_and(|at| now >= at);
        if is_past(self.deadline) || is_past(self.next_checkpoint) {
            self.pause.store(true, Ordering::Relaxed);
        }
    }

    /// Returns why the program is to end, if it is.
    pub(super) fn stop(&self) -> Option<Cause> {
        if self.stop.load(Ordering::Relaxed) {
            return Some(Cause::Signal);
        }
        let is_late = self.deadline.is_some_and(|at| Instant::now() >= at);
        is_late.then_some(Cause::TimeLimit)
    }

    /// Returns why rendering paused, once for each reason; `None` to go on.
    pub(super) fn interruption(&mut self) -> Option<Interruption> {
        if let Some(cause) = self.stop() {
            return Some(Interruption::Stop(cause));
        }
        // Before the flags are read: what is set after that pauses again.
        self.pause.store(false, Ordering::Relaxed);
        if self.stop.load(Ordering::Relaxed) {
            return Some(Interruption::Stop(Cause::Signal));
        }
        if self.snapshot.swap(false, Ordering::Relaxed) {
            return Some(Interruption::Snapshot);
        }
        if self.next_checkpoint.is_some_and(|at| Instant::now() >= at) {
            self.begin_frame();
            return Some(Interruption::Checkpoint);
        }
        None
    }
}

//! `--trace`: what ran when, on which thread, in the form that Chrome's tracing and Perfetto open.
//!
//! Spans are frames, loading and its stages, passes, tiles and writing; never rays. Without
//! `--trace` nothing is kept.

use std::path::Path;
use std::sync::{Mutex, PoisonError};
use std::time::Instant;

use majorant::output::{self, OutputError};
use serde::Serialize;
use serde_json::json;

/// A thread of the trace.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Lane {
    /// The one that goes through frames.
    Main,
    /// The one that loads ahead.
    Loader,
    /// One of the pool, by number.
    Worker(usize),
}

impl Lane {
    /// Returns that of the caller, if it is of the pool, and else the main one.
    pub(super) fn here() -> Self {
        rayon::current_thread_index().map_or(Self::Main, Self::Worker)
    }

    fn number(self) -> usize {
        match self {
            Self::Main => 0,
            Self::Loader => 1,
            Self::Worker(i) => 2 + i,
        }
    }

    fn name(self) -> String {
        match self {
            Self::Main => "frames".to_owned(),
            Self::Loader => "loading ahead".to_owned(),
            Self::Worker(i) => format!("worker {i}"),
        }
    }
}

/// A complete event, in microseconds.
#[derive(Clone, Debug, Serialize)]
struct Event {
    name: String,
    ph: &'static str,
    ts: f64,
    dur: f64,
    pid: u32,
    tid: usize,
}

/// All events of a run.
#[derive(Debug)]
pub(super) struct Trace {
    begin: Instant,
    events: Mutex<Vec<Event>>,
}

impl Trace {
    pub(super) fn start() -> Self {
        Self {
            begin: Instant::now(),
            events: Mutex::default(),
        }
    }

    /// Keeps a span from `begin` to now.
    pub(super) fn span(&self, lane: Lane, name: String, begin: Instant) {
        self.span_between(lane, name, begin, Instant::now());
    }

    /// Keeps a span.
    pub(super) fn span_between(&self, lane: Lane, name: String, begin: Instant, end: Instant) {
        let micros = |at: Instant| at.saturating_duration_since(self.begin).as_secs_f64() * 1e6;
        let event = Event {
            name,
            ph: "X",
            ts: micros(begin),
            dur: micros(end) - micros(begin),
            pid: 1,
            tid: lane.number(),
        };
        // Pushing leaves nothing half done, whoever panicked.
        let mut events = self.events.lock().unwrap_or_else(PoisonError::into_inner);
        events.push(event);
    }

    /// Writes what there is.
    pub(super) fn write(&self, path: &Path) -> Result<(), OutputError> {
        let events = self.events.lock().unwrap_or_else(PoisonError::into_inner);
        let workers = (0..rayon::current_num_threads()).map(Lane::Worker);
        let lanes = [Lane::Main, Lane::Loader].into_iter().chain(workers);
        let names = lanes.map(|lane| {
            json!({"name": "thread_name", "ph": "M", "pid": 1, "tid": lane.number(),
                "args": {"name": lane.name()}})
        });
        let events = events.iter().map(|event| json!(event));
        let all: Vec<_> = names.chain(events).collect();
        let trace = json!({"displayTimeUnit": "ms", "traceEvents": all});
        output::write_text(path, &trace.to_string())
    }
}

//! Times the stages of loading.

use std::time::Instant;

use majorant::scene::LoadStage;

use crate::cli::stats::{Clock, Lap, Stats};
use crate::cli::trace::{Lane, Trace};

/// Times the stages of loading.
#[derive(Debug, Default)]
pub(in crate::cli) struct Stages {
    running: Option<(LoadStage, Clock, Instant)>,
    /// Each stage with its begin and end.
    spans: Vec<(LoadStage, Instant, Instant)>,
    pub(in crate::cli) read: Lap,
    pub(in crate::cli) decode: Lap,
    pub(in crate::cli) build: Lap,
}

impl Stages {
    pub(in crate::cli) fn enter(&mut self, stage: LoadStage) {
        self.end();
        self.running = Some((stage, Clock::start(), Instant::now()));
    }

    pub(in crate::cli) fn end(&mut self) {
        if let Some((stage, mut clock, begin)) = self.running.take() {
            self.spans.push((stage, begin, Instant::now()));
            let lap = clock.lap();
            match stage {
                LoadStage::Read => self.read = lap,
                LoadStage::Decode => self.decode = lap,
                LoadStage::Build => self.build = lap,
            }
        }
    }

    /// Puts the stages into a trace.
    pub(super) fn trace(&self, trace: &Trace, lane: Lane) {
        for &(stage, begin, end) in &self.spans {
            let name = match stage {
                LoadStage::Read => "read",
                LoadStage::Decode => "decode",
                LoadStage::Build => "build",
            };
            trace.span_between(lane, name.to_owned(), begin, end);
        }
    }

    /// Everything of `total`, from the frame's start to its first ray, that was not building counts
    /// as loading.
    pub(in crate::cli) fn write_to(&self, stats: &mut Stats, total: Lap) {
        stats.seconds.read = Some(self.read.wall);
        stats.seconds.decode = Some(self.decode.wall);
        stats.seconds.build = Some(self.build.wall);
        stats.seconds.load = Some(total.wall - self.build.wall);
        stats.cpu_seconds.build = self.build.cpu;
        stats.cpu_seconds.load = total
            .cpu
            .zip(self.build.cpu)
            .map(|(all, build)| all - build);
    }
}

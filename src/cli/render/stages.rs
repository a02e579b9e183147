//! Times the stages of loading.

use majorant::scene::LoadStage;

use crate::cli::stats::{Clock, Lap, Stats};

/// Times the stages of loading.
#[derive(Debug, Default)]
pub(in crate::cli) struct Stages {
    running: Option<(LoadStage, Clock)>,
    pub(in crate::cli) read: Lap,
    pub(in crate::cli) decode: Lap,
    pub(in crate::cli) build: Lap,
}

impl Stages {
    pub(in crate::cli) fn enter(&mut self, stage: LoadStage) {
        self.end();
        self.running = Some((stage, Clock::start()));
    }

    pub(in crate::cli) fn end(&mut self) {
        if let Some((stage, mut clock)) = self.running.take() {
            let lap = clock.lap();
            match stage {
                LoadStage::Read => self.read = lap,
                LoadStage::Decode => self.decode = lap,
                LoadStage::Build => self.build = lap,
            }
        }
    }

    /// Everything of `total`, from the frame's start to its first ray, that was not building counts
    /// as loading.
    pub(super) fn write_to(&self, stats: &mut Stats, total: Lap) {
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

//! A frame in progress: its samples so far, what it still needs, and its checkpoint.

use std::fs::File;
use std::io::{self, BufReader};
use std::path::Path;
use std::time::Instant;

use majorant::film::{Accumulation, Checkpoint, CheckpointError, Region};
use majorant::noise_limit::{enough, pilot};
use majorant::output::{self, Identity, OutputError};
use majorant::render::Frame;
use majorant::stats::Counts;

use crate::cli::report;

/// Samples of a frame, and what they took.
pub(super) struct Work {
    pub(super) state: Accumulation,
    pub(super) counts: Counts,
    /// Index after the last sample.
    end: u64,
    noise_limit: Option<f64>,
    /// Samples that are enough for the noise limit, once the pilot is over.
    enough: Option<[u64; 2]>,
    key: String,
    /// Wall-clock seconds before this process went on with it.
    earlier_secs: f64,
    begin: Instant,
}

impl Work {
    /// Begins a frame, or goes on from the checkpoint at `resume`, if there is one that fits.
    pub(super) fn new(
        identity: &Identity,
        full_size: [u32; 2],
        region: Region,
        channels: &[String],
        resume: Option<&Path>,
    ) -> Self {
        let samples = &identity.samples.ranges()[0];
        let mut work = Self {
            state: Accumulation::new(full_size, region, samples.start).with_channels(channels),
            counts: Counts::default(),
            end: samples.end,
            noise_limit: identity.noise_limit,
            enough: None,
            key: key(identity),
            earlier_secs: 0.0,
            begin: Instant::now(),
        };
        if let Some(path) = resume {
            work.resume(path);
        }
        work
    }

    /// Goes on from a checkpoint. One that is damaged or of something else is left alone: the
    /// frame begins anew, as it would without.
    fn resume(&mut self, path: &Path) {
        let shown = path.display();
        let region = self.state.region();
        let pixels = u64::from(region.width()) * u64::from(region.height());
        let read = || {
            let mut file = BufReader::with_capacity(1 << 20, File::open(path)?);
            Checkpoint::read_from(&mut file, pixels)
        };
        let (about, state) = match read() {
            Ok(found) => found,
            Err(CheckpointError::Io(e)) if e.kind() == io::ErrorKind::NotFound => return,
            Err(e) => {
                tracing::warn!("{shown}: {}: the frame begins anew", report::chain(&e));
                return;
            }
        };
        let goals = about.enough.unwrap_or([self.end; 2]);
        let next = state.next();
        let fits = about.key == self.key
            && state.full_size() == self.state.full_size()
            && state.region() == region
            && state.first() == self.state.first()
            && state.channels() == self.state.channels()
            && next
                .iter()
                .zip(goals)
                .all(|(next, goal)| *next.end() <= goal);
        if !fits {
            tracing::warn!("{shown}: of another scene, sampling or version: the frame begins anew");
            return;
        }
        let least = next[0].start().min(next[1].start());
        tracing::info!("{shown}: going on from sample {least}");
        self.state = state;
        self.counts = about.counts;
        self.enough = about.enough;
        self.earlier_secs = about.render_secs;
    }

    /// Returns the samples below which both halves have all that they need, as far as is known.
    fn goals(&self) -> [u64; 2] {
        match (self.noise_limit, self.enough) {
            (None, _) => [self.end; 2],
            (Some(_), Some(enough)) => enough,
            (Some(_), None) => [pilot(self.end); 2],
        }
    }

    /// Returns how many samples the frame takes, as far as is known.
    pub(super) fn total(&self) -> u64 {
        self.counts.camera_rays + self.state.missing(self.goals())
    }

    /// Returns where the next pass ends, `step` samples a pixel further; `None` if there is nothing
    /// left to do.
    pub(super) fn next(&mut self, frame: &Frame<'_>, step: u64) -> Option<[u64; 2]> {
        if self.state.missing(self.goals()) == 0 {
            let limit = self.noise_limit.filter(|_| self.enough.is_none())?;
            let noise = frame.noise(&self.state);
            self.enough = Some(enough(noise, limit, self.end));
        }
        let goals = self.goals();
        if self.state.missing(goals) == 0 {
            return None;
        }
        let next = self.state.next();
        let until = |half: usize| goals[half].min(next[half].start().saturating_add(step));
        Some([until(0), until(1)])
    }

    /// Returns the wall-clock seconds that it took so far.
    pub(super) fn render_secs(&self) -> f64 {
        self.earlier_secs + self.begin.elapsed().as_secs_f64()
    }

    /// Writes the checkpoint.
    pub(super) fn save(&self, path: &Path) -> Result<(), OutputError> {
        let about = Checkpoint {
            key: self.key.clone(),
            counts: self.counts,
            render_secs: self.render_secs(),
            enough: self.enough,
        };
        output::write_with(path, |out| {
            about.write_to(&self.state, out).map_err(io::Error::other)
        })
    }
}

/// All that must be the same to go on, but the number of samples: more may be asked for.
fn key(identity: &Identity) -> String {
    let Identity {
        version,
        scene_hash,
        samples,
        noise_limit,
    } = identity;
    let key = format!("version {version}\nscene {scene_hash:016x}");
    match noise_limit {
        None => key,
        // The pilot is a share of the samples.
        Some(limit) => format!("{key}\nsamples {samples}\nnoise limit {limit}"),
    }
}

//! One frame of a batch, from its number to a scene that is loaded.

use std::ops::Range;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Instant;

use majorant::film::Region;
use majorant::output::{Identity, SampleRanges, read_identity};
use majorant::scene::{
    BYTES_PER_PIXEL, Checked, LoadOptions, LoadedVolume, MissingFile, Scene, SceneFile,
    SceneTemplate,
};

use super::input::Input;
use super::overrides::overridden;
use super::stages::Stages;
use super::targets::{Outputs, Targets};
use crate::cli::args::{MissingArg, RenderArgs};
use crate::cli::stats::{Clock, Lap};
use crate::cli::trace::{Lane, Trace};
use crate::cli::{Failure, report};

/// What makes frames ready to render; shared between the thread that renders and the one that
/// loads the next frame.
pub(super) struct Jobs<'a> {
    args: &'a RenderArgs,
    template: SceneTemplate,
    targets: Targets,
    max_memory_bytes: u64,
    trace: Option<Trace>,
    /// Of a bare volume: it was loaded to choose its look, and is the first frame's.
    chosen: Mutex<Option<(LoadedVolume, Stages)>>,
    /// The volumes of the last frame that was loaded, which the next may share, each with the key
    /// of all that decides what it is.
    kept: Mutex<Vec<(String, LoadedVolume)>>,
}

/// What is to be done for a frame.
pub(super) enum Job {
    /// It is there.
    Exists(Outputs),
    /// Its volume is not there, and it is to be left out.
    LeftOut(MissingFile),
    Ready(Box<Ready>),
}

/// A frame that is ready to render.
pub(super) struct Ready {
    pub(super) scene: Scene,
    pub(super) volumes: Vec<LoadedVolume>,
    pub(super) outputs: Outputs,
    pub(super) identity: Identity,
    pub(super) region: Region,
    /// Whether the image is to be merged with others.
    pub(super) is_part: bool,
    pub(super) stages: Stages,
    /// What loading took.
    pub(super) loading: Lap,
}

impl Ready {
    /// Returns about how many bytes the frame takes while it renders and is written.
    pub(super) fn memory_bytes(&self) -> u64 {
        let pixels = u64::from(self.region.width()) * u64::from(self.region.height());
        let grids = self.volumes.iter().map(|v| v.grid.memory_bytes() as u64);
        grids.sum::<u64>() + pixels * BYTES_PER_PIXEL
    }
}

/// A frame's scene before its volume is loaded.
pub(super) struct Described {
    pub(super) frame: i32,
    pub(super) checked: Checked,
    pub(super) missing: Vec<MissingFile>,
    pub(super) identity: Identity,
    pub(super) resolution: [u32; 2],
    pub(super) region: Region,
    pub(super) outputs: Outputs,
}

impl<'a> Jobs<'a> {
    pub(super) fn new(args: &'a RenderArgs, input: Input, targets: Targets, max: u64) -> Self {
        let Input {
            template,
            volume,
            stages,
        } = input;
        Self {
            args,
            template,
            targets,
            max_memory_bytes: max,
            trace: args.trace.is_some().then(Trace::start),
            chosen: Mutex::new(volume.map(|volume| (volume, stages))),
            kept: Mutex::default(),
        }
    }

    pub(super) fn max_memory_bytes(&self) -> u64 {
        self.max_memory_bytes
    }

    pub(super) fn trace(&self) -> Option<&Trace> {
        self.trace.as_ref()
    }

    pub(super) fn args(&self) -> &RenderArgs {
        self.args
    }

    /// Returns the scene of a frame as the command line changes it.
    pub(super) fn file(&self, frame: Option<i32>) -> Result<SceneFile, Failure> {
        Ok(overridden(self.template.at(frame)?, self.args))
    }

    /// Checks all that can be known of a frame without its volume.
    pub(super) fn describe(&self, frame: Option<i32>) -> Result<Described, Failure> {
        let mut file = self.file(frame)?;
        let missing = file.number_files(self.args.batch.missing == MissingArg::Hold);
        let checked = file.check(self.max_memory_bytes)?;
        let resolution = *file.desc.image.resolution.get_ref();
        let spp = *file.desc.render.spp.get_ref();
        let samples = match (&self.args.samples, self.args.shard) {
            (Some(range), _) => range.clone(),
            (None, Some([i, n])) => shard(spp, i, n)?,
            (None, None) => 0..spp,
        };
        let [width, height] = resolution;
        let whole = Region::whole(width, height);
        let region = self.args.crop.unwrap_or(whole);
        let region = region.within(width, height).ok_or_else(|| {
            let [x, y] = region.min;
            Failure::Usage(format!(
                "--crop begins at {x},{y}: outside of the image of {width}x{height} pixels"
            ))
        })?;
        let samples = u64::from(samples.start)..u64::from(samples.end);
        Ok(Described {
            frame: file.desc.render.frame,
            identity: Identity {
                version: env!("CARGO_PKG_VERSION").to_owned(),
                scene_hash: file.hash(checked.volume_paths()),
                samples: SampleRanges::one(samples).expect("checked to be at least one"),
                noise_limit: self.args.noise_limit,
            },
            checked,
            missing,
            resolution,
            region,
            outputs: self.targets.of(frame),
        })
    }

    /// Makes a frame ready, within `max_memory_bytes`.
    pub(super) fn prepare(
        &self,
        frame: Option<i32>,
        max_memory_bytes: u64,
        lane: Lane,
    ) -> Result<Job, Failure> {
        let begin = Instant::now();
        let clock = Clock::start();
        let described = self.describe(frame)?;
        if described.exists(self.args.batch.skip_existing) {
            return Ok(Job::Exists(described.outputs));
        }
        for file in &described.missing {
            match (&file.held, self.args.batch.missing) {
                (None, MissingArg::Skip) => return Ok(Job::LeftOut(file.clone())),
                (Some(held), _) => tracing::warn!(
                    "{}: missing, {} is taken for it",
                    file.path.display(),
                    held.display()
                ),
                _ => {}
            }
        }
        described.outputs.check()?;
        let ready = self.load(described, clock, max_memory_bytes)?;
        if let Some(trace) = &self.trace {
            trace.span(lane, format!("load frame {}", ready.scene.frame), begin);
            ready.stages.trace(trace, lane);
        }
        Ok(Job::Ready(Box::new(ready)))
    }

    /// Loads what a frame needs.
    pub(super) fn load(
        &self,
        described: Described,
        mut clock: Clock,
        max_memory_bytes: u64,
    ) -> Result<Ready, Failure> {
        let Described {
            checked,
            identity,
            region,
            outputs,
            ..
        } = described;
        let options = LoadOptions {
            max_memory_bytes,
            sanitize: self.args.sanitize,
        };
        let mut stages = Stages::default();
        let volumes = self.volumes(&checked, &options, &mut stages)?;
        let scene = checked.into_scene(&volumes)?;
        stages.end();
        Ok(Ready {
            scene,
            volumes,
            outputs,
            identity,
            region,
            is_part: self.args.samples.is_some() || self.args.shard.is_some(),
            stages,
            loading: clock.lap(),
        })
    }

    /// Loads a frame's volumes, but for those that are there.
    fn volumes(
        &self,
        checked: &Checked,
        options: &LoadOptions,
        stages: &mut Stages,
    ) -> Result<Vec<LoadedVolume>, Failure> {
        if let Some((volume, took)) = locked(&self.chosen).take() {
            *stages = took;
            return Ok(vec![volume]);
        }
        let keys: Vec<_> = checked.volume_keys().collect();
        // What this frame does not need goes before the rest is loaded: all might not fit.
        let mut kept = std::mem::take(&mut *locked(&self.kept));
        kept.retain(|(key, _)| keys.contains(key));
        let volumes = checked.load_new_volumes(options, &kept, &mut |stage| stages.enter(stage))?;
        *locked(&self.kept) = keys.into_iter().zip(volumes.iter().cloned()).collect();
        Ok(volumes)
    }
}

/// Returns the `i`-th of `n` parts of `spp` samples, as equal as whole numbers are.
fn shard(spp: u32, i: u32, n: u32) -> Result<Range<u32>, Failure> {
    let start = |i: u32| {
        let start = u64::from(spp) * u64::from(i) / u64::from(n);
        u32::try_from(start).expect("at most spp")
    };
    let range = start(i)..start(i + 1);
    if range.is_empty() {
        return Err(Failure::Usage(format!(
            "--shard {i}/{n}: no samples, expected at most {spp} shards of {spp} samples"
        )));
    }
    Ok(range)
}

/// What a thread that panicked left is whole: nothing is done under the lock but taking and
/// putting.
fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Described {
    /// Returns whether the frame is on disk: whole, and of this scene, samples and version.
    pub(super) fn exists(&self, skip_existing: bool) -> bool {
        let Outputs {
            image,
            preview,
            stats,
            ..
        } = &self.outputs;
        let mut all = std::iter::once(image).chain(preview).chain(stats);
        if !skip_existing || !all.all(|path| path.exists()) {
            return false;
        }
        let shown = image.display();
        match read_identity(image) {
            Ok((identity, size, region)) => {
                let is_same =
                    identity == self.identity && size == self.resolution && region == self.region;
                if !is_same {
                    tracing::info!("{shown}: of another scene, sampling or version: again");
                }
                is_same
            }
            Err(e) => {
                tracing::warn!("{}: again", report::chain(&e));
                false
            }
        }
    }
}

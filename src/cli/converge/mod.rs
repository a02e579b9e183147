//! `majorant converge`: error against run time, with files that survive an interruption.
//!
//! Estimators take turns, rung by rung, so that a busy hour of the machine hits all of them, and
//! an early end leaves curves of all. After each render the estimator's record replaces the one
//! in `DIR/checkpoint`, whole or not at all; whatever happens, only the render in progress is lost.

mod references;

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use majorant::converge::estimator::{Estimator, parse_list};
use majorant::converge::ladder::{Comparison, Extent, Record, Seconds, Step, measure};
use majorant::converge::results::{EstimatorResults, ReferenceInfo, Results, RunTiming};
use majorant::converge::{
    Reference, checkpoint, covered_pixels, metrics, report as page, summarise,
};
use majorant::film::Film;
use majorant::output;
use majorant::render::NoProgress;
use majorant::scene::desc::unplaced;
use majorant::scene::{LoadOptions, Scene, SceneFile};

use super::args::ConvergeArgs;
use super::progress::LadderProgress;
use super::render::{Stages, is_volume, start_threads};
use super::stats::Clock;
use super::{Failure, memory, report};
use references::KnownReference;

/// Bytes for a pixel of each estimator: 88 of its record, and as many while it is written.
const RECORD_BYTES: u64 = 2 * 88;

pub(super) fn run(args: &ConvergeArgs) -> Result<(), Failure> {
    start_threads(args.threads)?;
    let mut run = Run::new(args)?;
    let interrupted = listen()?;
    let references = run.references(&interrupted)?;
    let covered = covered_pixels(&run.scene);
    let mut records = run.read_records()?;
    run.measure_all(&mut records, &references, &covered, &interrupted)?;
    run.write(&records, &references, &covered)?;
    if interrupted.load(Ordering::Relaxed) {
        return Err(interruption(&run.folder));
    }
    Ok(())
}

/// Catches the first SIGINT as a flag; a second one ends the program at once.
fn listen() -> Result<Arc<AtomicBool>, Failure> {
    let flag = Arc::new(AtomicBool::new(false));
    let signal = signal_hook::consts::SIGINT;
    // In this order, or the first signal would find the flag set.
    signal_hook::flag::register_conditional_shutdown(signal, 130, Arc::clone(&flag))
        .and_then(|_| signal_hook::flag::register(signal, Arc::clone(&flag)))
        .map_err(Failure::failed)?;
    Ok(flag)
}

fn interruption(folder: &Path) -> Failure {
    let folder = folder.display();
    tracing::warn!("interrupted: {folder} keeps what was measured, --resume goes on");
    Failure::Interrupted
}

struct Run<'a> {
    args: &'a ConvergeArgs,
    folder: PathBuf,
    scene: Scene,
    scene_hash: u64,
    seed: u64,
    estimators: Vec<Estimator>,
    stages: Stages,
    extent: Extent,
}

impl<'a> Run<'a> {
    /// Loads the scene and finds out whether all that was asked for can be done.
    fn new(args: &'a ConvergeArgs) -> Result<Self, Failure> {
        if is_volume(&args.scene) {
            let volume = args.scene.display();
            return Err(Failure::Usage(format!(
                "{volume}: expected a scene file; make one by `majorant render {volume} \
                 --print-scene > scene.toml`"
            )));
        }
        let max_memory_bytes = memory::limit(args.max_memory);
        let options = LoadOptions {
            max_memory_bytes,
            sanitize: false,
        };
        let mut file = SceneFile::read(&args.scene)?;
        if let Some(resolution) = args.resolution {
            file.desc.image.resolution = unplaced(resolution);
        }
        let folder = folder(args);
        let checked = file.check(max_memory_bytes)?;
        let scene_hash = file.hash(checked.volume_paths());
        let mut stages = Stages::default();
        let volumes = checked.load_volumes(&options, &mut |stage| stages.enter(stage))?;
        stages.end();
        let scene = checked.into_scene(&volumes)?;
        let estimators =
            parse_list(&args.estimators, &scene).map_err(|e| Failure::Usage(e.to_string()))?;
        check_memory(&scene, estimators.len(), max_memory_bytes)?;
        let run = Self {
            extent: Extent {
                seeds: args.seeds,
                budget_secs: args.budget,
                max_spp: args.max_spp.unwrap_or(u32::MAX),
            },
            seed: scene.seed,
            args,
            folder,
            scene,
            scene_hash,
            estimators,
            stages,
        };
        run.prepare_folder()?;
        Ok(run)
    }

    /// Refuses to mix with an earlier run unless told to go on with it.
    fn prepare_folder(&self) -> Result<(), Failure> {
        let folder = self.checkpoint("x");
        output::check_writable(&folder).map_err(Failure::failed)?;
        let entries = std::fs::read_dir(folder.with_file_name("")).map_err(Failure::failed)?;
        for entry in entries {
            let path = entry.map_err(Failure::failed)?.path();
            // Left by a render that was killed while its checkpoint was written.
            if path.extension().is_some_and(|e| e == "part") {
                std::fs::remove_file(&path).map_err(Failure::failed)?;
            } else if !self.args.resume {
                let folder = self.folder.display();
                return Err(Failure::Usage(format!(
                    "{folder}: holds an earlier run: add --resume to go on with it, or name \
                     another folder by --output"
                )));
            }
        }
        Ok(())
    }

    fn checkpoint(&self, name: &str) -> PathBuf {
        self.folder.join("checkpoint").join(format!("{name}.ckpt"))
    }

    /// What must be the same to go on, one setting a line.
    fn key(&self, name: &str, compared_with: &str) -> String {
        let Scene { width, height, .. } = self.scene;
        let (hash, seeds) = (self.scene_hash, self.extent.seeds);
        let version = env!("CARGO_PKG_VERSION");
        format!(
            "version {version}\nresolution {width}x{height}\nscene {hash:016x}\nestimator {name}\n\
             seeds {seeds}\nreference {compared_with}"
        )
    }

    /// Reads a record, or begins an empty one.
    fn read_record(&self, name: &str, key: &str) -> Result<Record, Failure> {
        let path = self.checkpoint(name);
        let bytes = match std::fs::read(&path) {
            Ok(bytes) => bytes,
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => {
                return Ok(Record::new(self.scene.width, self.scene.height));
            }
            Err(e) => return Err(Failure::BadInput(format!("{}: {e}", path.display()))),
        };
        let shown = path.display();
        let (found, record) = checkpoint::from_bytes(&bytes)
            .map_err(|e| Failure::BadInput(format!("{shown}: damaged: {}", report::chain(&e))))?;
        let differing = found.lines().zip(key.lines()).find(|(a, b)| a != b);
        let (was, is) = match differing {
            Some(lines) => lines,
            None if found == key => return Ok(record),
            None => (&*found, key),
        };
        Err(Failure::BadInput(format!(
            "{shown}: measured with {was}, now {is}: resume with the same settings, or name \
             another folder by --output"
        )))
    }

    fn write_record(&self, name: &str, key: &str, record: &Record) -> Result<(), Failure> {
        let bytes = checkpoint::to_bytes(key, record).map_err(Failure::failed)?;
        output::write_bytes(&self.checkpoint(name), &bytes).map_err(Failure::failed)
    }

    /// Renders one step; returns whether it was finished.
    fn render(
        &mut self,
        record: &mut Record,
        step: Step,
        seed: u64,
        comparison: Option<Comparison<'_>>,
        cancel: &AtomicBool,
    ) -> bool {
        let start = std::cell::RefCell::new((Clock::start(), Seconds::default()));
        let clock = || {
            let (clock, seconds) = &mut *start.borrow_mut();
            let lap = clock.lap();
            seconds.wall += lap.wall;
            // Without a processor clock, wall-clock time times threads is the nearest.
            let threads = rayon::current_num_threads() as f64;
            seconds.cpu += lap.cpu.unwrap_or(lap.wall * threads);
            *seconds
        };
        let watch = (&NoProgress as _, cancel);
        measure(
            record,
            &mut self.scene,
            step,
            seed,
            comparison,
            &clock,
            watch,
        )
    }

    fn read_records(&self) -> Result<Vec<Record>, Failure> {
        let estimators = self.estimators.iter();
        estimators
            .map(|e| self.read_record(&e.to_string(), &self.estimator_key(e)))
            .collect()
    }

    fn estimator_key(&self, estimator: &Estimator) -> String {
        let reference = match self.reference_index(estimator) {
            _ if self.args.reference.as_os_str() != "auto" => {
                self.args.reference.display().to_string()
            }
            0 => Estimator::exact().to_string(),
            _ => Estimator::textbook().to_string(),
        };
        self.key(&estimator.to_string(), &reference)
    }

    fn measure_all(
        &mut self,
        records: &mut [Record],
        references: &[KnownReference],
        covered: &[usize],
        cancel: &AtomicBool,
    ) -> Result<(), Failure> {
        let estimators = self.estimators.clone();
        let total = self.extent.budget_secs * estimators.len() as f64;
        let mut progress = LadderProgress::start("estimators", total);
        let mut rung = 0;
        loop {
            let mut is_done = true;
            for (i, estimator) in estimators.iter().enumerate() {
                let comparison = Comparison {
                    reference: &references[self.reference_index(estimator)].reference,
                    covered,
                };
                estimator.apply(&mut self.scene);
                let (name, key) = (estimator.to_string(), self.estimator_key(estimator));
                let mut measured = None;
                while let Some(step) = records[i].next_step(&self.extent) {
                    is_done = false;
                    if step.rung > rung {
                        break;
                    }
                    let seed = step.seed(self.seed, 0);
                    if !self.render(&mut records[i], step, seed, Some(comparison), cancel) {
                        return Ok(());
                    }
                    self.write_record(&name, &key, &records[i])?;
                    measured = Some(step);
                }
                if let Some(step) = measured {
                    let spent = records.iter().map(Record::cpu_secs).sum();
                    progress.advance(spent, &self.line(&name, step, &records[i]));
                }
            }
            if is_done {
                return Ok(());
            }
            rung += 1;
        }
    }

    /// What was found last, for people who wait.
    fn line(&self, name: &str, step: Step, record: &Record) -> String {
        let rung = record.complete_rungs(self.extent.seeds).last();
        let errors = rung.unwrap_or_default().iter().filter_map(|m| m.errors);
        let error = errors.map(|e| e.rel_mse.value()).sum::<f64>() / f64::from(self.extent.seeds);
        format!("{name}, {} spp: relMSE {error:.2e}", step.spp())
    }

    fn results(
        &self,
        records: &[Record],
        references: &[KnownReference],
        covered: &[usize],
    ) -> Results {
        let estimator = |(estimator, record): (&Estimator, &Record)| {
            let reference = self.reference_index(estimator);
            let comparison = Comparison {
                reference: &references[reference].reference,
                covered,
            };
            EstimatorResults {
                name: estimator.to_string(),
                approximate: estimator.is_approximate(),
                reference,
                summary: summarise(record, self.extent.seeds, comparison, self.args.target),
            }
        };
        let Scene { width, height, .. } = self.scene;
        let info = |r: &KnownReference| ReferenceInfo {
            source: r.source.clone(),
            spp: r.spp,
            noise_known: r.reference.variance.is_some(),
            rel_mse_noise: metrics::errors(&Film::new(width, height), &r.reference, covered)
                .rel_mse
                .noise,
        };
        let load = sysinfo::System::load_average().ok();
        Results {
            version: env!("CARGO_PKG_VERSION"),
            scene: self.args.scene.display().to_string(),
            scene_hash: format!("{:016x}", self.scene_hash),
            resolution: [width, height],
            covered_pixels: covered.len(),
            seeds: self.extent.seeds,
            budget_secs: self.extent.budget_secs,
            target_rel_mse: self.args.target,
            complete: records.iter().all(|r| r.next_step(&self.extent).is_none()),
            references: references.iter().map(info).collect(),
            estimators: self.estimators.iter().zip(records).map(estimator).collect(),
            timing: RunTiming {
                processor: processor(),
                threads: rayon::current_num_threads(),
                load_average: load.map(|l| [l.one, l.five, l.fifteen]),
                load_secs: self.stages.read.wall + self.stages.decode.wall,
                build_secs: self.stages.build.wall,
                reference_cpu_secs: references.iter().map(|r| r.cpu_secs).collect(),
            },
        }
    }

    fn write(
        &self,
        records: &[Record],
        references: &[KnownReference],
        covered: &[usize],
    ) -> Result<(), Failure> {
        let results = self.results(records, references, covered);
        let json = serde_json::to_string_pretty(&results).map_err(Failure::failed)?;
        let images: Vec<Reference> = references.iter().map(|r| r.reference.clone()).collect();
        let records: Vec<&Record> = records.iter().collect();
        for (name, text) in [
            ("results.json", format!("{json}\n")),
            ("results.csv", results.to_csv()),
            ("report.html", page::html(&results, &records, &images)),
        ] {
            output::write_text(&self.folder.join(name), &text).map_err(Failure::failed)?;
        }
        for e in results.by_efficiency() {
            let efficiency = e.summary.timing.efficiency.map_or(f64::NAN, |x| x.value);
            let bias = e.summary.bias.mean_difference * 100.0;
            tracing::info!(
                "{}: efficiency {efficiency:.3}, mean {bias:+.2} %, {:?}",
                e.name,
                e.summary.bias.verdict
            );
        }
        tracing::info!("{}", self.folder.join("report.html").display());
        Ok(())
    }
}

/// Refuses what would need too much memory, before any is taken.
fn check_memory(scene: &Scene, estimators: usize, max_bytes: u64) -> Result<(), Failure> {
    let Scene { width, height, .. } = *scene;
    // Two more: the references.
    let records = estimators as u64 + 2;
    let bytes = u64::from(width) * u64::from(height) * RECORD_BYTES * records;
    if bytes <= max_bytes {
        return Ok(());
    }
    Err(Failure::BadInput(format!(
        "{records} images of {width} by {height} pixels take {bytes} bytes, expected at most \
         {max_bytes}: lower --resolution, name fewer estimators or raise --max-memory"
    )))
}

/// The folder asked for, or one named after the scene.
fn folder(args: &ConvergeArgs) -> PathBuf {
    args.output.clone().unwrap_or_else(|| {
        let mut name = args.scene.file_stem().unwrap_or_default().to_owned();
        name.push("-converge");
        PathBuf::from(name)
    })
}

/// Returns the processor's name, where the system tells.
fn processor() -> Option<String> {
    let info = std::fs::read_to_string("/proc/cpuinfo").ok()?;
    let line = info.lines().find(|l| l.starts_with("model name"))?;
    Some(line.split_once(':')?.1.trim().to_owned())
}

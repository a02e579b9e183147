//! `majorant render`: a scene file or a volume to an image, or a sequence of them.
//!
//! * `input`, `overrides`: scenes, from files and the command line.
//! * `job`: one frame from its number to a loaded scene; `targets`: the files it becomes.
//! * `batch`: frame after frame, the next one loading while one renders.
//! * `frame`, `work`, `watch`: one frame pass by pass, its checkpoint, and what interrupts it.
//! * `viewer`: the image on a screen while it converges.
//! * `dry_run`, `stages`, `summary`: what is said.

mod batch;
mod dry_run;
mod frame;
mod input;
mod job;
mod overrides;
mod stages;
mod summary;
mod targets;
mod viewer;
mod watch;
mod work;

pub(super) use input::is_volume;
pub(super) use stages::Stages;

use majorant::scene::LoadOptions;

use super::args::RenderArgs;
use super::progress::say_end;
use super::stats::Clock;
use super::{Failure, memory, report};
use batch::Batch;
use input::Input;
use job::Jobs;
use targets::Targets;

pub(super) fn run(args: &RenderArgs) -> Result<(), Failure> {
    let result = run_all(args);
    match &result {
        Ok(()) => say_end(args.progress, None),
        Err(failure) => {
            let why = report::reason(failure);
            say_end(args.progress, Some(why.as_deref().unwrap_or("see the log")));
        }
    }
    result
}

fn run_all(args: &RenderArgs) -> Result<(), Failure> {
    let begin = Clock::start();
    let frames = frames(args);
    let targets = Targets::new(args, frames.len())?;
    start_threads(args.threads)?;
    let max_memory_bytes = memory::limit(args.max_memory);
    let options = LoadOptions {
        max_memory_bytes,
        sanitize: args.sanitize,
    };
    let input = Input::new(args, &options, frames[0])?;
    let jobs = Jobs::new(args, input, targets, max_memory_bytes);
    if args.print_scene {
        let file = jobs.file(frames[0])?;
        file.check(max_memory_bytes)?;
        return report::print(&overrides::scene_text(&file, args));
    }
    // A mistake in what the last frame's keys say is found now, not at night.
    for &frame in &frames {
        jobs.describe(frame)?;
    }
    if args.dry_run {
        return dry_run::run(&jobs, &frames);
    }
    Batch::new(args, &jobs, &frames, begin)?.run()
}

/// The frames to render; `None` is the one that the scene file says.
fn frames(args: &RenderArgs) -> Vec<Option<i32>> {
    match args.batch.frames() {
        None => vec![None],
        Some(range) => range.frames().iter().copied().map(Some).collect(),
    }
}

pub(super) fn start_threads(asked: Option<usize>) -> Result<(), Failure> {
    // Slurm confines a task by this number where it does not by affinity.
    let slurm = || std::env::var("SLURM_CPUS_PER_TASK").ok()?.parse().ok();
    let count = asked.or_else(slurm).unwrap_or(0);
    rayon::ThreadPoolBuilder::new()
        .num_threads(count)
        .build_global()
        .map_err(|e| {
            Failure::failed(format!(
                "cannot start {count} threads: {}",
                report::chain(&e)
            ))
        })
}

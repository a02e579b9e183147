//! `--dry-run`: which frames, files and how much memory, and what would be done; nothing is
//! rendered or written.

use std::fmt::Write as _;
use std::path::Path;

use majorant::plan::plan;

use super::job::{Described, Jobs};
use crate::cli::args::MissingArg;
use crate::cli::stats::Clock;
use crate::cli::{Failure, report};

/// Prints a line for each frame, then the plan of the first that can be loaded.
pub(super) fn run(jobs: &Jobs<'_>, frames: &[Option<i32>]) -> Result<(), Failure> {
    let mut text = String::new();
    let mut planned = None;
    for &frame in frames {
        let described = jobs.describe(frame)?;
        let number = described.frame;
        let state = state(&described, jobs);
        let paths = || described.checked.volume_paths();
        let volumes: Vec<_> = paths().map(|p| p.display().to_string()).collect();
        let image = described.outputs.image.display();
        let _ = writeln!(
            text,
            "frame {number}: {} -> {image}: {state}",
            volumes.join(", ")
        );
        if planned.is_none() && paths().all(Path::exists) {
            planned = Some(described);
        }
    }
    if let Some(described) = planned {
        let limit = jobs.max_memory_bytes();
        let ready = jobs.load(described, Clock::start(), limit)?;
        let mb = ready.memory_bytes() as f64 / 1e6;
        let limit = limit as f64 / 1e6;
        let _ = writeln!(
            text,
            "memory of frame {}: {mb:.1} MB of {limit:.1} MB",
            ready.scene.frame
        );
        for line in plan(&ready.scene, &ready.volumes) {
            let _ = writeln!(text, "{line}");
        }
    }
    report::print(&text)
}

fn state(described: &Described, jobs: &Jobs<'_>) -> String {
    let batch = &jobs.args().batch;
    if described.exists(batch.skip_existing) {
        return "complete, would be left as it is".to_owned();
    }
    if let Some(missing) = described.missing.first() {
        let path = missing.path.display();
        return match &missing.held {
            Some(held) => format!(
                "would be rendered; {path} is missing, {} held",
                held.display()
            ),
            None if batch.missing == MissingArg::Skip => {
                format!("would be left out; {path} is missing")
            }
            None => format!("would fail; {path} is missing"),
        };
    }
    if let Some(path) = described.checked.volume_paths().find(|path| !path.exists()) {
        return format!("would fail; {} is missing", path.display());
    }
    let checkpoint = &described.outputs.checkpoint;
    if batch.resume && checkpoint.exists() {
        return format!("would go on from {}", checkpoint.display());
    }
    "would be rendered".to_owned()
}

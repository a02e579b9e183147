//! What a frame was made of, and what is wrong with it, in lines.

use std::path::Path;

use crate::cli::stats::Stats;

/// The plan as text, for `--explain`.
pub(super) fn explanation(stats: &Stats) -> String {
    let lines = stats.plan.iter().map(|line| format!("{line}\n"));
    lines.collect()
}

pub(super) fn report_plan(stats: &Stats) {
    for grid in &stats.grids {
        let mb = grid.bytes as f64 / 1e6;
        let (file, bricks) = (&grid.file, grid.bricks);
        tracing::debug!("{file}: {bricks} bricks, {mb:.1} MB in memory");
    }
    tracing::debug!("{} threads", stats.threads);
    for line in &stats.plan {
        tracing::debug!("{line}");
    }
}

pub(super) fn warn_of_trouble(stats: &Stats) {
    let counts = &stats.counts;
    let warnings = [
        (
            counts.rays.bound_violations,
            "values above their bound: THE IMAGE IS BIASED, a bug",
        ),
        (
            counts.rays.non_finite_samples,
            "samples were not finite and left out: a bug",
        ),
        (counts.clamped_voxels, "negative voxels or tiles read as 0"),
        (
            counts.sanitized_voxels,
            "voxels or tiles not finite, read as 0",
        ),
        (
            counts.half_clamped_pixels,
            "pixels brighter than 65504, clamped in the EXR",
        ),
    ];
    for (count, what) in warnings {
        if count > 0 {
            tracing::warn!("{count} {what}");
        }
    }
}

pub(super) fn summarise(output: &Path, stats: &Stats) {
    let samples = stats.counts.rays.camera_rays as f64;
    let wall = stats.seconds.render.unwrap_or(0.0);
    let cpu = stats
        .cpu_seconds
        .render
        .map_or(String::new(), |cpu| format!(", {cpu:.2} CPU s"));
    let rate = samples / wall.max(1e-9) / 1e6;
    let before = stats.seconds.load.unwrap_or(0.0) + stats.seconds.build.unwrap_or(0.0);
    tracing::info!(
        "{}: loaded in {before:.2} s, rendered in {wall:.2} s{cpu}, {rate:.2} M samples/s",
        output.display()
    );
}

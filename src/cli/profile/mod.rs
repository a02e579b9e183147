//! `majorant profile`: where the time of a scene goes, as text, JSON and a page.
//!
//! * `measure`: what tiles of the image take, and what their events take.
//! * `replay`: rays walked again, to time events.
//! * `reuse`: the memory that rays come back to.
//! * `page`: all of it to look at.
//!
//! The whole image is rendered as `render` does it, for counts and maps; then some of its tiles are measured
//! on a thread of their own.

mod measure;
mod page;
mod replay;
mod reuse;

use std::fmt::Write as _;
use std::path::Path;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

use majorant::film::{Accumulation, Region};
use majorant::output;
use majorant::render::{Frame, NoProgress};
use majorant::scene::desc::unplaced;
use majorant::scene::{LoadOptions, SceneFile};
use serde_json::json;

use self::measure::{Measured, Work, measure};
use self::page::{Report, html};
use self::reuse::MEMORIES;
use super::args::ProfileArgs;
use super::render::{Stages, is_volume, start_threads};
use super::stats::{Clock, Stats};
use super::{Failure, memory, report};

/// Rendering of measured tiles goes on for this long, several times over.
const BUDGET: Duration = Duration::from_millis(600);

/// Samples a pixel, if the scene has more and nothing else is asked for.
const USUAL_SPP: u32 = 16;

pub(super) fn run(args: &ProfileArgs) -> Result<(), Failure> {
    let mut begin = Clock::start();
    start_threads(args.threads)?;
    let max_memory_bytes = memory::limit(args.max_memory);
    if is_volume(&args.scene) {
        let volume = args.scene.display();
        return Err(Failure::Usage(format!(
            "{volume}: expected a scene file; make one by `majorant render {volume} --print-scene \
             > scene.toml`"
        )));
    }
    if let Some(path) = &args.output {
        output::check_writable(path).map_err(Failure::failed)?;
    }
    let mut file = SceneFile::read(&args.scene)?;
    if let Some(resolution) = args.resolution {
        file.desc.image.resolution = unplaced(resolution);
    }
    let of_scene = *file.desc.render.spp.get_ref();
    let spp = args.spp.unwrap_or(of_scene.min(USUAL_SPP));
    file.desc.render.spp = unplaced(spp);
    let checked = file.check(max_memory_bytes)?;
    let options = LoadOptions {
        max_memory_bytes,
        sanitize: false,
    };
    let mut stages = Stages::default();
    let volumes = checked.load_volumes(&options, &mut |stage| stages.enter(stage))?;
    let scene = checked.into_scene(&volumes)?;
    stages.end();
    let mut stats = Stats::new(&args.scene, Path::new(""), &scene, &volumes);
    stages.write_to(&mut stats, begin.lap());

    let mut clock = Clock::start();
    let frame = Frame::new(&scene);
    let size = [scene.width, scene.height];
    let mut state = Accumulation::new(size, Region::whole(size[0], size[1]), 0);
    let never = AtomicBool::new(false);
    let pass = frame.advance(&mut state, [spp.into(); 2], &NoProgress, &never);
    let lap = clock.lap();
    stats.counts.rays = pass.counts;
    stats.seconds.render = Some(lap.wall);
    stats.cpu_seconds.render = lap.cpu;
    stats.peak_memory_bytes = memory::peak_bytes();
    let film = state.film();
    (stats.image_mean, stats.image_standard_error) = film.mean();

    let alone = rayon::ThreadPoolBuilder::new()
        .num_threads(1)
        .build()
        .map_err(Failure::failed)?;
    let measured = alone.install(|| measure(&scene, &frame, &pass.counts, BUDGET));

    let data = json!({
        "stats": stats,
        "measured": measured,
        "work": measured.work(),
        "nanoseconds_per_path": measured.nanoseconds_per_path(),
        "null_collision_ratio": Measured::null_ratio(&stats.counts.rays),
        "machine_counters": null_counters(),
    });
    if let Some(path) = &args.output {
        let title = args.scene.file_stem().unwrap_or_default().to_string_lossy();
        let page = html(&Report {
            title: &title,
            facts: &facts(&stats),
            film: &film,
            costs: &state.costs(),
            counts: &stats.counts.rays,
            cpu_secs: lap.cpu,
            measured: &measured,
            json: &data.to_string(),
        });
        output::write_text(path, &page).map_err(Failure::failed)?;
        tracing::info!("{}: the profile", path.display());
    }
    if args.json {
        let text = serde_json::to_string_pretty(&data).map_err(Failure::failed)?;
        return report::print(&format!("{text}\n"));
    }
    report::print(&table(&measured, &stats))
}

/// Counters of caches and instructions: none is read.
fn null_counters() -> serde_json::Value {
    json!({ "read": false, "why": "no counters of the machine are asked for" })
}

fn facts(stats: &Stats) -> Vec<(&'static str, String)> {
    let [width, height] = stats.resolution;
    let mut facts = vec![
        (
            "image",
            format!("{width}×{height}, {} samples a pixel", stats.spp),
        ),
        ("threads", stats.threads.to_string()),
    ];
    for grid in &stats.grids {
        let megabytes = grid.bytes as f64 * 1e-6;
        let (name, bricks, encoding) = (&grid.name, grid.bricks, grid.encoding);
        facts.push((
            "grid",
            format!("{name}: {bricks} bricks, {megabytes:.1} MB, {encoding}"),
        ));
    }
    let seconds = |s: Option<f64>| s.map_or("–".to_owned(), |s| format!("{s:.2} s"));
    facts.push(("loading", seconds(stats.seconds.load)));
    facts.push(("bounds", seconds(stats.seconds.build)));
    facts.push((
        "rendering",
        format!(
            "{}, {} of CPU time",
            seconds(stats.seconds.render),
            seconds(stats.cpu_seconds.render)
        ),
    ));
    facts.push(("version", format!("majorant {}", stats.version)));
    facts
}

/// The profile as text.
fn table(measured: &Measured, stats: &Stats) -> String {
    let mut out = String::new();
    let mut line = |text: String| writeln!(out, "{text}").expect("writing to a string cannot fail");
    line(format!(
        "{:.0} ns of CPU time a path: {} paths, {} of {} tiles, one thread",
        measured.nanoseconds_per_path(),
        measured.paths,
        measured.tiles[0],
        measured.tiles[1]
    ));
    line(format!(
        "{:<22}{:>8}{:>12}{:>12}{:>12}",
        "", "share", "ns a path", "in a path", "ns each"
    ));
    for work in measured.work() {
        let Work {
            name,
            event,
            events_per_path,
            nanoseconds,
            nanoseconds_per_path,
            share,
        } = work;
        line(format!(
            "{name:<22}{:>6.1} %{nanoseconds_per_path:>12.1}{events_per_path:>12.3}\
             {nanoseconds:>12.2}  a {event}",
            100.0 * share
        ));
    }
    let reuse = &measured.reuse;
    let per = |a: u64, b: u64| a as f64 / b.max(1) as f64;
    line(format!(
        "null collisions       {:>6.1} %",
        100.0 * Measured::null_ratio(&stats.counts.rays)
    ));
    line(format!(
        "bricks a path         {:>8.2}, a tile of the image {:.0}, reads for each {:.1}",
        per(reuse.bricks_of_paths, reuse.paths),
        per(reuse.bricks_of_tiles, reuse.tiles),
        per(reuse.reads, reuse.bricks_of_tiles)
    ));
    let found = reuse.found.iter().zip(MEMORIES);
    let found = found.map(|(&found, n)| format!("{n}: {:.1} %", 100.0 * per(found, reuse.reads)));
    line(format!(
        "brick among the last  {}",
        found.collect::<Vec<_>>().join(", ")
    ));
    line("cache misses          not read: no counters of the machine are asked for".to_owned());
    out
}

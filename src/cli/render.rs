//! `majorant render`: a scene file or a bare volume to an image.

use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;

use majorant::cache::is_cache;
use majorant::film::Film;
use majorant::grid::StorageKind;
use majorant::output::{self, Provenance};
use majorant::render::{Rendered, render};
use majorant::scene::default_look::{self, Wishes};
use majorant::scene::desc::unplaced;
use majorant::scene::{LoadOptions, LoadStage, LoadedVolume, Scene, SceneFile};
use majorant::vdb::Archive;

use super::args::{RenderArgs, TrackingArgs};
use super::progress::RenderProgress;
use super::stats::{Clock, Lap, Stats};
use super::{Failure, memory, report};

pub(super) fn run(args: &RenderArgs) -> Result<(), Failure> {
    let begin = Clock::start();
    let targets = Targets::new(args)?;
    start_threads(args.threads)?;
    let max_memory_bytes = memory::limit(args.max_memory);
    let options = LoadOptions {
        max_memory_bytes,
        sanitize: args.sanitize,
    };
    let mut stages = Stages::default();
    let (file, volumes) = if is_volume(&args.input) {
        let (file, volume) = default_scene(args, &options, &mut stages)?;
        (file, Some(vec![volume]))
    } else if args.up.is_some() {
        return Err(Failure::Usage(
            "--up is for bare .vdb files: set up in [camera]".to_owned(),
        ));
    } else {
        (SceneFile::read(&args.input)?, None)
    };
    let file = overridden(file, args);
    let checked = file.check(max_memory_bytes)?;
    if args.print_scene {
        return report::print(&scene_text(&file, args));
    }
    targets.check()?;
    let hash = file.hash(checked.volume_paths());
    let volumes = match volumes {
        Some(volumes) => volumes,
        None => checked.load_volumes(&options, &mut |stage| stages.enter(stage))?,
    };
    let scene = checked.into_scene(&volumes)?;
    stages.end();
    let mut stats = Stats::new(&args.input, &targets.image, &scene, &volumes);
    stages.write_to(&mut stats, begin);
    if args.explain {
        report::print(&explanation(&stats))?;
    }
    report_plan(&stats);
    let film = render_timed(&scene, begin, &mut stats)?;
    write(&targets, &scene, hash, &film, &mut stats)
}

/// The files to write.
#[derive(Debug)]
struct Targets {
    image: PathBuf,
    preview: Option<PathBuf>,
    stats: Option<PathBuf>,
}

impl Targets {
    /// Finds out whether all of them can be written.
    fn check(&self) -> Result<(), Failure> {
        let Self {
            image,
            preview,
            stats,
        } = self;
        let others = preview.iter().chain(stats);
        std::iter::once(image)
            .chain(others)
            .try_for_each(|path| output::check_writable(path).map_err(Failure::failed))
    }

    fn new(args: &RenderArgs) -> Result<Self, Failure> {
        let image = args.output.clone().unwrap_or_else(|| {
            // Not `with_extension`, which would take `cloud.0012` for a name in .0012.
            let mut name = args.input.file_stem().unwrap_or_default().to_owned();
            name.push(".exr");
            PathBuf::from(name)
        });
        let is_exr = |e: &std::ffi::OsStr| e.eq_ignore_ascii_case("exr");
        if !image.extension().is_some_and(is_exr) {
            let message = "images are OpenEXR, expected a name in .exr";
            return Err(Failure::Usage(format!(
                "--output {}: {message}",
                image.display()
            )));
        }
        let preview = args.preview_png.as_ref().map(|asked| {
            let beside = || image.with_extension("png");
            asked.clone().unwrap_or_else(beside)
        });
        let stats = args.stats_json.clone();
        if preview.as_ref() == Some(&image) || stats.as_ref() == Some(&image) {
            let message = "named for two outputs, expected a file for each";
            return Err(Failure::Usage(format!("{}: {message}", image.display())));
        }
        Ok(Self {
            image,
            preview,
            stats,
        })
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

pub(super) fn is_volume(path: &Path) -> bool {
    let is_vdb = |e: &std::ffi::OsStr| e.eq_ignore_ascii_case("vdb");
    path.extension().is_some_and(is_vdb) || is_cache(path)
}

fn default_scene(
    args: &RenderArgs,
    options: &LoadOptions,
    stages: &mut Stages,
) -> Result<(SceneFile, LoadedVolume), Failure> {
    stages.enter(LoadStage::Read);
    let wishes = Wishes {
        resolution: args.resolution,
        up: args.up.map(Into::into),
        encoding: args.encoding,
    };
    let (volume, why) = if is_cache(&args.input) {
        let volume = LoadedVolume::map(&args.input, options)?;
        check_cached(args, &volume)?;
        (volume, "the grid of the cache file".to_owned())
    } else {
        let archive = Archive::open(&args.input)?;
        let (index, why) = default_look::choose_grid(&archive, args.grid.as_deref())?;
        let storage = wishes.storage();
        let mut on_stage = |s| stages.enter(s);
        let volume = LoadedVolume::decode(&archive, index, options, &storage, &mut on_stage)?;
        (volume, why)
    };
    tracing::info!("rendering grid {:?}: {why}", volume.name);
    let file = default_look::describe(&volume, &why, wishes)?;
    Ok((file, volume))
}

/// Checks that the command line asks for nothing that a cache file cannot give.
fn check_cached(args: &RenderArgs, volume: &LoadedVolume) -> Result<(), Failure> {
    let (file, held) = (args.input.display(), &volume.name);
    if let Some(name) = args.grid.as_ref().filter(|name| *name != held) {
        let message = format!("{file}: no grid {name:?} in the cache file, it holds {held:?}");
        return Err(Failure::BadInput(message));
    }
    match args.encoding {
        None | Some(StorageKind::Auto) => Ok(()),
        Some(_) => Err(Failure::Usage(format!(
            "--encoding is for .vdb files: {file} holds {}",
            volume.stored.encoding
        ))),
    }
}

/// Puts what the command line says over what the file says.
fn overridden(mut file: SceneFile, args: &RenderArgs) -> SceneFile {
    let desc = &mut file.desc;
    if let Some(resolution) = args.resolution {
        desc.image.resolution = unplaced(resolution);
    }
    if let Some(spp) = args.spp {
        desc.render.spp = unplaced(spp);
    }
    if let Some(seed) = args.seed {
        desc.render.seed = unplaced(seed);
    }
    if let Some(integrator) = args.integrator {
        desc.render.integrator = unplaced(integrator.into());
    }
    let TrackingArgs {
        camera_ray,
        sampler,
        distance,
        transmittance,
        bounds,
        collision_rate,
        flight_rate,
        march_step,
    } = args.tracking;
    if let Some(camera_ray) = camera_ray {
        desc.render.camera_ray = camera_ray;
    }
    if let Some(sampler) = sampler {
        desc.render.sampler = sampler;
    }
    if let Some(distance) = distance {
        desc.render.distance = unplaced(distance);
    }
    if let Some(transmittance) = transmittance {
        desc.render.transmittance = unplaced(transmittance);
    }
    if let Some(bounds) = bounds {
        desc.render.bounds = bounds;
    }
    if let Some(rate) = collision_rate {
        desc.render.collision_rate = unplaced(rate);
    }
    if let Some(rate) = flight_rate {
        desc.render.flight_rate = unplaced(rate);
    }
    if let Some(step) = march_step {
        desc.render.march_step = unplaced(step);
    }
    if let Some(grid) = &args.grid {
        for volume in &mut desc.volume {
            volume.get_mut().density.grid = unplaced(grid.clone());
        }
    }
    if let Some(kind) = args.encoding {
        for volume in &mut desc.volume {
            volume.get_mut().encoding = unplaced(kind);
        }
    }
    file
}

/// The chosen scene with the reasons of its choice, or a clean copy of a scene file.
fn scene_text(file: &SceneFile, args: &RenderArgs) -> String {
    let comments = file.text().lines().map_while(|l| l.strip_prefix("# "));
    let header = if is_volume(&args.input) {
        comments.collect::<Vec<_>>().join("\n")
    } else {
        format!("{}, as the command line changes it.", args.input.display())
    };
    file.to_toml(&header)
}

/// Times the stages of loading.
#[derive(Debug, Default)]
pub(super) struct Stages {
    running: Option<(LoadStage, Clock)>,
    pub(super) read: Lap,
    pub(super) decode: Lap,
    pub(super) build: Lap,
}

impl Stages {
    pub(super) fn enter(&mut self, stage: LoadStage) {
        self.end();
        self.running = Some((stage, Clock::start()));
    }

    pub(super) fn end(&mut self) {
        if let Some((stage, mut clock)) = self.running.take() {
            let lap = clock.lap();
            match stage {
                LoadStage::Read => self.read = lap,
                LoadStage::Decode => self.decode = lap,
                LoadStage::Build => self.build = lap,
            }
        }
    }

    /// Everything since the program's start that was not building counts as loading.
    fn write_to(&self, stats: &mut Stats, mut since_start: Clock) {
        let total = since_start.lap();
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

/// The plan as text, for `--explain`.
fn explanation(stats: &Stats) -> String {
    let lines = stats.plan.iter().map(|line| format!("{line}\n"));
    lines.collect()
}

fn report_plan(stats: &Stats) {
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

fn render_timed(scene: &Scene, mut begin: Clock, stats: &mut Stats) -> Result<Film, Failure> {
    let before = begin.lap();
    let mut clock = Clock::start();
    let total = u64::from(scene.width) * u64::from(scene.height) * u64::from(scene.spp);
    let progress = RenderProgress::start(total);
    let rendered = render(scene, &progress, &AtomicBool::new(false));
    drop(progress);
    let lap = clock.lap();
    let Rendered {
        film,
        counts,
        first_tile_secs,
        complete,
    } = rendered;
    if !complete {
        return Err(Failure::failed("the render was cancelled"));
    }
    stats.seconds.first_sample = Some(before.wall + first_tile_secs);
    stats.seconds.render = Some(lap.wall);
    stats.cpu_seconds.render = lap.cpu;
    stats.counts.rays = counts;
    stats.counts.half_clamped_pixels = output::half_overflow_count(&film);
    (stats.image_mean, stats.image_standard_error) = film.mean();
    stats.peak_memory_bytes = memory::peak_bytes();
    warn_of_trouble(stats);
    Ok(film)
}

fn warn_of_trouble(stats: &Stats) {
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

fn write(
    targets: &Targets,
    scene: &Scene,
    scene_hash: u64,
    film: &Film,
    stats: &mut Stats,
) -> Result<(), Failure> {
    let mut clock = Clock::start();
    let command_line: Vec<_> = std::env::args_os().collect();
    let words = command_line.iter().map(|w| w.to_string_lossy());
    let provenance = Provenance {
        camera_from_world: scene.camera.camera_from_world(),
        half_size: scene.camera.half_size(),
        spp: scene.spp,
        seed: scene.seed,
        frame: scene.frame,
        scene_hash,
        command_line: words.collect::<Vec<_>>().join(" "),
        render_secs: stats.seconds.render.unwrap_or(0.0),
        peak_memory_bytes: stats.peak_memory_bytes,
        stats_json: serde_json::to_string(stats).map_err(Failure::failed)?,
    };
    output::write_exr(&targets.image, film, &provenance).map_err(Failure::failed)?;
    if let Some(path) = &targets.preview {
        output::write_png(path, film).map_err(Failure::failed)?;
    }
    let lap = clock.lap();
    stats.seconds.write = Some(lap.wall);
    stats.cpu_seconds.write = lap.cpu;
    if let Some(path) = &targets.stats {
        let json = serde_json::to_string_pretty(stats).map_err(Failure::failed)?;
        output::write_text(path, &format!("{json}\n")).map_err(Failure::failed)?;
    }
    summarise(&targets.image, stats);
    Ok(())
}

fn summarise(output: &Path, stats: &Stats) {
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

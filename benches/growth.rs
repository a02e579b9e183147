//! How time and memory grow with resolution, optical thickness, threads and bricks.
//!
//! Not a criterion bench: one frame of each point is a second or more, and what counts is a
//! curve. One procedural cloud ([`assets::cloud_field`]) fills the same place in the world at
//! every resolution, with the same light and camera, so at equal optical thickness all images
//! are of one picture. Points of a series are rendered in turn, several rounds, and the
//! median of the rounds is reported: a busy moment of the machine hits all alike.
//!
//! ```sh
//! cargo bench --bench growth                      # up to 512³: 1 GB, about 15 minutes
//! cargo bench --bench growth -- --to 1024         # 3 GB
//! cargo bench --bench growth -- --from 1024 --to 1024
//! cargo bench --bench growth -- --only threads    # one series
//! cargo bench --bench growth -- --spp 4           # a quick one
//! cargo bench --bench growth -- --svg docs/performance
//! ```
//!
//! Prints a line for each number, in the form that `benches/record.py` collects, and draws the
//! curves where `--svg` says. Each point asserts that no bound was violated, that
//! all samples are finite, and that the picture's mean is that of the other resolutions.

#![expect(clippy::print_stderr, reason = "a program that measures and prints")]

mod assets;

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};

use assets::cloud_field::cloud_tree;
use cpu_time::ProcessTime;
use glam::DVec3;
use majorant::camera::Camera;
use majorant::grid::brick::BRICK_LEN;
use majorant::grid::{DensityGrid, Encoding, Storage, StorageKind, Tree};
use majorant::integrator::{Context, TransportSettings};
use majorant::light::{DistantLight, Lights};
use majorant::medium::Medium;
use majorant::phase::Phase;
use majorant::plot::{Curve, CurvePoint, LogPlot};
use majorant::render::{NoProgress, render};
use majorant::scene::Scene;
use majorant::silhouette::Silhouette;
use majorant::space::IndexTransform;
use majorant::spectrum::Rgb;
use majorant::stats::Counts;
use majorant::tracking::{BoundsKind, Tracking};

/// Optical thickness of the cloud along its longest axis, where resolution varies.
const THICKNESS: f64 = 50.0;
/// Resolution, where other things vary.
const MIDDLE: i32 = 256;
/// Columns and rows of the frames.
const SIZE: [u32; 2] = [320, 180];

/// What was asked for on the command line.
struct Options {
    /// Lowest and highest resolution.
    from: i32,
    to: i32,
    rounds: usize,
    /// Samples a pixel. Few are a measure of first touches: with 4, each cell of 1024³ voxels is met
    /// about once.
    spp: u32,
    svg: Option<PathBuf>,
    /// The one series to measure: resolution, thickness, memory or threads.
    only: Option<String>,
}

impl Options {
    /// Reads the arguments; `None` if cargo only wants to see the program start.
    fn parse() -> Option<Self> {
        let mut options = Self {
            from: 64,
            to: 512,
            rounds: 5,
            spp: 64,
            svg: None,
            only: None,
        };
        let mut args = std::env::args().skip(1);
        while let Some(arg) = args.next() {
            let mut value = || args.next().expect("the option has a value");
            match arg.as_str() {
                "--from" => options.from = value().parse().expect("--from is a number"),
                "--to" => options.to = value().parse().expect("--to is a number"),
                "--rounds" => options.rounds = value().parse().expect("--rounds is a number"),
                "--spp" => options.spp = value().parse().expect("--spp is a number"),
                "--svg" => options.svg = Some(value().into()),
                "--only" => options.only = Some(value()),
                "--test" => return None,
                // What `cargo bench` itself passes, and names meant for other benches.
                _ => {}
            }
        }
        Some(options)
    }
}

/// A cloud of one resolution.
struct Cloud {
    resolution: i32,
    /// As a scene of [`THICKNESS`] stores it by default, and as f32.
    stored: [Stored; 2],
    /// Integral of the density along the longest axis, in world units.
    column: f64,
}

/// A grid in one encoding.
struct Stored {
    encoding: Encoding,
    grid: Arc<DensityGrid>,
    build: Duration,
}

impl Stored {
    fn new(tree: Tree<f32>, transform: IndexTransform, encoding: Encoding) -> Self {
        let start = ProcessTime::now();
        let grid = DensityGrid::encoded(tree, transform, encoding, usize::MAX);
        Self {
            encoding,
            build: start.elapsed(),
            grid: Arc::new(grid.expect("no limit was set")),
        }
    }
}

impl Cloud {
    fn new(resolution: i32) -> Self {
        let tree = cloud_tree(resolution);
        let transform = IndexTransform::uniform(1.0 / f64::from(resolution));
        let plain = Stored::new(tree.clone(), transform, Encoding::F32);
        let column = column(&plain.grid);
        let storage = Storage {
            kind: StorageKind::Auto,
            max_error: Storage::DEFAULT_ERROR,
            sigma_t_per_density: Some(scale(THICKNESS, column)),
        };
        let chosen = storage
            .choose(&tree, &transform)
            .expect("f16 is not asked for");
        Self {
            resolution,
            column,
            stored: [Stored::new(tree, transform, chosen.encoding), plain],
        }
    }

    /// Returns a scene of the cloud at `thickness`, measured along its longest axis.
    fn scene(&self, thickness: f64, kernel: Kernel, spp: u32) -> Scene {
        let Kernel { bounds, stored, .. } = kernel;
        let scale = scale(thickness, self.column);
        let grid = Arc::clone(&self.stored[stored].grid);
        let phase = Phase::HenyeyGreenstein { g: 0.85 };
        let medium = Medium::new(grid, scale, Rgb([0.99; 3]), phase);
        let aspect = f64::from(SIZE[0]) / f64::from(SIZE[1]);
        let camera = Camera::look_at(
            DVec3::new(0.8, -1.9, 0.4),
            DVec3::splat(0.5),
            DVec3::Z,
            24.0_f64.to_radians(),
            aspect,
        );
        let sun = DistantLight::new(DVec3::new(0.55, -0.45, 0.7), Rgb([6.0, 5.6, 5.0]), 0.0);
        Scene {
            width: SIZE[0],
            height: SIZE[1],
            spp,
            seed: 0,
            frame: 0,
            aovs: vec![],
            camera: camera.expect("a view"),
            media: vec![medium],
            lights: Lights {
                distant: vec![sun.expect("a direction")],
                environment: Rgb([0.3, 0.45, 0.75]),
                ..Lights::default()
            },
            transport: TransportSettings {
                tracking: Tracking {
                    bounds,
                    ..Tracking::default()
                },
                ..TransportSettings::default()
            },
        }
    }
}

/// What a series renders with.
#[derive(Clone, Copy)]
struct Kernel {
    name: &'static str,
    bounds: BoundsKind,
    /// Which of a cloud's grids.
    stored: usize,
}

const KERNELS: [Kernel; 3] = [
    Kernel {
        name: "auto",
        bounds: BoundsKind::Auto,
        stored: 0,
    },
    Kernel {
        name: "auto f32",
        bounds: BoundsKind::Auto,
        stored: 1,
    },
    Kernel {
        name: "hierarchy",
        bounds: BoundsKind::Hierarchy,
        stored: 0,
    },
];

/// Returns the extinction of a density of one for an optical thickness.
fn scale(thickness: f64, column: f64) -> f32 {
    #[expect(clippy::cast_possible_truncation, reason = "an extinction is f32")]
    let scale = (thickness / column) as f32;
    scale
}

/// Returns the integral of the density along the longest axis through the middle.
fn column(grid: &DensityGrid) -> f64 {
    const STEPS: u32 = 4096;
    let mut sampler = grid.sampler();
    let to_index = grid.transform().index_from_world();
    let at = |i: u32| DVec3::new((f64::from(i) + 0.5) / f64::from(STEPS), 0.5, 0.5);
    let sum: f64 = (0..STEPS)
        .map(|i| f64::from(sampler.trilinear(to_index.transform_point3(at(i)))))
        .sum();
    sum / f64::from(STEPS)
}

/// One frame: what it cost and what it did.
#[derive(Clone, Copy)]
struct Frame {
    cpu_secs: f64,
    wall_secs: f64,
    /// What is prepared once a frame, in CPU seconds: part of neither of the above.
    start_up_secs: f64,
    counts: Counts,
    mean: f64,
    standard_error: f64,
}

fn frame(scene: &Scene) -> Frame {
    // Done once more by itself, since it is part of a render.
    let (wall, cpu) = (Instant::now(), ProcessTime::now());
    std::hint::black_box((
        Context::new(&scene.media, &scene.lights, scene.transport),
        Silhouette::new(&scene.media, &scene.camera, scene.width, scene.height),
    ));
    let (start_up_secs, start_up_wall) = (cpu.elapsed().as_secs_f64(), wall.elapsed());
    let (wall, cpu) = (Instant::now(), ProcessTime::now());
    let rendered = render(scene, &NoProgress, &AtomicBool::new(false));
    let cpu_secs = cpu.elapsed().as_secs_f64() - start_up_secs;
    let wall_secs = (wall.elapsed().saturating_sub(start_up_wall)).as_secs_f64();
    let counts = rendered.counts;
    assert!(rendered.complete, "not all samples were taken");
    assert_eq!(counts.bound_violations, 0, "bound violations");
    assert_eq!(counts.non_finite_samples, 0, "samples that are not finite");
    let (mean, standard_error) = rendered.film.mean();
    Frame {
        cpu_secs,
        wall_secs,
        start_up_secs,
        counts,
        mean: mean[1],
        standard_error: standard_error[1],
    }
}

/// A point of a series: where it is, and the scene to render there.
struct Point {
    x: f64,
    scene: Scene,
    threads: usize,
}

/// Renders all points in turn, `rounds` times; returns for each the cheapest frame.
fn measure(points: &[Point], rounds: usize) -> Vec<Frame> {
    let mut frames: Vec<Vec<Frame>> = points.iter().map(|_| Vec::new()).collect();
    for round in 0..rounds {
        for (point, frames) in points.iter().zip(&mut frames) {
            let pool = rayon::ThreadPoolBuilder::new()
                .num_threads(point.threads)
                .build()
                .expect("a thread starts");
            let frame = pool.install(|| frame(&point.scene));
            frames.push(frame);
        }
        eprintln!("round {} of {rounds}", round + 1);
    }
    let cheapest = |frames: Vec<Frame>| {
        let least = frames
            .into_iter()
            .min_by(|a, b| a.cpu_secs.total_cmp(&b.cpu_secs));
        least.expect("at least one round")
    };
    frames.into_iter().map(cheapest).collect()
}

/// Prints and keeps the numbers of a series: name, x, value.
fn report(series: &str, points: &[Point], frames: &[Frame]) {
    for (point, frame) in points.iter().zip(frames) {
        let rays = frame.counts.camera_rays as f64;
        let name = format!("{series}/{}", point.x);
        let per_ray = |count: u64| count as f64 / rays;
        let start_up = frame.start_up_secs * 1e3;
        assets::note(&name, "start_up_cpu_time", start_up, "ms");
        assets::note(&name, "cpu_time", frame.cpu_secs / rays * 1e6, "us/sample");
        assets::note(
            &name,
            "wall_time",
            frame.wall_secs / rays * 1e6,
            "us/sample",
        );
        assets::note(
            &name,
            "segments",
            per_ray(frame.counts.segments),
            "1/sample",
        );
        assets::note(&name, "lookups", per_ray(frame.counts.lookups), "1/sample");
        assets::note(
            &name,
            "vertices",
            per_ray(frame.counts.scattered_rays),
            "1/sample",
        );
    }
}

/// Returns a curve of CPU microseconds a sample.
fn curve(name: &str, points: &[Point], frames: &[Frame]) -> Curve {
    let at = |(p, f): (&Point, &Frame)| CurvePoint {
        x: p.x,
        y: f.cpu_secs / f.counts.camera_rays as f64 * 1e6,
        error: 0.0,
    };
    Curve {
        name: name.to_owned(),
        points: points.iter().zip(frames).map(at).collect(),
        dashed: false,
    }
}

fn draw(options: &Options, file: &str, x: &str, y: &str, curves: Vec<Curve>) {
    let Some(folder) = &options.svg else { return };
    let plot = LogPlot {
        x_label: x.to_owned(),
        y_label: y.to_owned(),
        curves,
        guide_slope: Some(1.0),
        floor: None,
    };
    let svg = plot.to_svg().replacen(
        "<svg ",
        "<svg xmlns=\"http://www.w3.org/2000/svg\" style=\"background:#fff\" ",
        1,
    );
    std::fs::write(folder.join(file), svg + "\n").expect("the folder can be written to");
}

/// Time against resolution at constant optical thickness, for each kernel.
fn resolution(clouds: &[Cloud], options: &Options) {
    let mut curves = Vec::new();
    for kernel in KERNELS {
        let series = format!("growth/resolution/{}", kernel.name);
        let points: Vec<Point> = clouds
            .iter()
            .map(|cloud| Point {
                x: f64::from(cloud.resolution),
                scene: cloud.scene(THICKNESS, kernel, options.spp),
                threads: 1,
            })
            .collect();
        let frames = measure(&points, options.rounds);
        report(&series, &points, &frames);
        // From 128³ on the field is resolved: one picture.
        for pair in frames[1.min(frames.len())..].windows(2) {
            let noise = pair[0].standard_error.hypot(pair[1].standard_error);
            let difference = (pair[0].mean - pair[1].mean).abs();
            assert!(
                difference < 5.0 * noise + 0.01 * pair[0].mean,
                "{series}: means {} and {}",
                pair[0].mean,
                pair[1].mean
            );
        }
        curves.push(curve(kernel.name, &points, &frames));
    }
    let (x, y) = ("voxels along an edge", "CPU µs a sample");
    draw(options, "time-resolution.svg", x, y, curves);
}

/// Time against optical thickness, at one resolution.
fn thickness(cloud: &Cloud, options: &Options) {
    let mut curves = Vec::new();
    for kernel in KERNELS {
        let series = format!("growth/thickness/{}", kernel.name);
        let points: Vec<Point> = [0.1, 1.0, 10.0, 100.0, 1000.0]
            .map(|x| Point {
                x,
                scene: cloud.scene(x, kernel, options.spp),
                threads: 1,
            })
            .into();
        let frames = measure(&points, options.rounds);
        report(&series, &points, &frames);
        curves.push(curve(kernel.name, &points, &frames));
    }
    let (x, y) = ("optical thickness", "CPU µs a sample");
    draw(options, "time-thickness.svg", x, y, curves);
}

/// Time against threads. Wall time says something only where the machine is idle.
fn threads(cloud: &Cloud, options: &Options) {
    let available = std::thread::available_parallelism().map_or(1, usize::from);
    let points: Vec<Point> = std::iter::successors(Some(1), |n| Some(n * 2))
        .take_while(|&n| n <= available)
        .map(|threads| Point {
            x: threads as f64,
            scene: cloud.scene(THICKNESS, KERNELS[0], options.spp),
            threads,
        })
        .collect();
    let frames = measure(&points, options.rounds);
    report("growth/threads", &points, &frames);
}

/// Memory and the time to build the grid against the number of bricks.
fn memory(clouds: &[Cloud], options: &Options) {
    let mut curves = Vec::new();
    for kind in 0..2 {
        let (mut memory, mut build) = (Vec::new(), Vec::new());
        let name = ["auto", "f32"][kind];
        for cloud in clouds {
            let Stored {
                encoding,
                grid,
                build: built,
            } = &cloud.stored[kind];
            let bricks = grid.brick_count();
            let cells = f64::from(cloud.resolution / 8).powi(3);
            // What rays cross in one step, chosen for the medium.
            let voxels_an_edge = f64::from(cloud.resolution);
            let blocks = grid.blocks(scale(THICKNESS / voxels_an_edge, cloud.column));
            let bytes = (grid.memory_bytes() + blocks.memory_bytes()) as f64;
            let stored = (bricks * BRICK_LEN * encoding.value_bytes()) as f64;
            let voxels = (bricks * BRICK_LEN) as f64;
            let name = format!("growth/memory/{name}/{}", cloud.resolution);
            assets::note(&name, "bricks", bricks as f64, "1");
            assets::note(&name, "occupied", bricks as f64 / cells, "1");
            assets::note(&name, "bits", encoding.value_bytes() as f64 * 8.0, "1");
            assets::note(&name, "memory", bytes / 1e6, "MB");
            assets::note(&name, "memory_per_stored_byte", bytes / stored, "1");
            let nanoseconds = built.as_secs_f64() / voxels * 1e9;
            assets::note(&name, "build_cpu_time", nanoseconds, "ns/voxel");
            let at = |y| CurvePoint {
                x: bricks as f64,
                y,
                error: 0.0,
            };
            memory.push(at(bytes / 1e6));
            build.push(at(built.as_secs_f64()));
        }
        for (what, points) in [("memory, MB", memory), ("building, CPU s", build)] {
            curves.push(Curve {
                name: format!("{what}, {name}"),
                points,
                dashed: false,
            });
        }
    }
    let (x, y) = ("bricks of 8³ voxels", "MB, or CPU s");
    draw(options, "memory-bricks.svg", x, y, curves);
}

fn main() {
    let Some(options) = Options::parse() else {
        return;
    };
    let wants = |series: &str| options.only.as_deref().is_none_or(|only| only == series);
    if wants("memory") || wants("resolution") {
        let resolutions = std::iter::successors(Some(options.from), |n| Some(n * 2));
        let clouds: Vec<Cloud> = resolutions
            .take_while(|&n| n <= options.to)
            .map(Cloud::new)
            .collect();
        memory(&clouds, &options);
        if wants("resolution") {
            resolution(&clouds, &options);
        }
    }
    let middle = Cloud::new(MIDDLE);
    if wants("thickness") {
        thickness(&middle, &options);
    }
    if wants("threads") {
        threads(&middle, &options);
    }
}

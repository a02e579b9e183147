//! Where time and memory went, for `--stats-json` and the EXR's attribute.

use std::path::Path;
use std::time::{Duration, Instant};

use cpu_time::ProcessTime;
use majorant::grid::DepthError;
use majorant::medium::Medium;
use majorant::plan::PlanLine;
use majorant::scene::{LoadedVolume, Scene};
use majorant::stats::Counts;
use serde::Serialize;

use super::memory;

/// Wall-clock and processor time since a moment.
#[derive(Clone, Copy, Debug)]
pub(super) struct Clock {
    wall: Instant,
    /// `None` where the system has no such clock.
    cpu: Option<ProcessTime>,
}

/// Wall-clock and processor seconds.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Lap {
    pub(super) wall: f64,
    pub(super) cpu: Option<f64>,
}

impl Clock {
    pub(super) fn start() -> Self {
        Self {
            wall: Instant::now(),
            cpu: ProcessTime::try_now().ok(),
        }
    }

    /// Returns the time since the start or the last lap.
    pub(super) fn lap(&mut self) -> Lap {
        let now = Self::start();
        let cpu = self.cpu.zip(now.cpu);
        let lap = Lap {
            wall: now.wall.duration_since(self.wall).as_secs_f64(),
            cpu: cpu
                .map(|(from, to)| to.duration_since(from))
                .as_ref()
                .map(Duration::as_secs_f64),
        };
        *self = now;
        lap
    }
}

/// Seconds by stage. `null` where not measured: no clock, or not over when written.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub(super) struct Seconds {
    /// Scene file, and the volume's `read` and `decode`.
    pub(super) load: Option<f64>,
    /// Walking and checking the volume file.
    pub(super) read: Option<f64>,
    /// Decompressing voxels.
    pub(super) decode: Option<f64>,
    /// Computing bounds.
    pub(super) build: Option<f64>,
    /// From the program's start until the first tile was complete.
    pub(super) first_sample: Option<f64>,
    /// All rays.
    pub(super) render: Option<f64>,
    /// Writing images.
    pub(super) write: Option<f64>,
}

/// Processor seconds of all threads by stage.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub(super) struct CpuSeconds {
    pub(super) load: Option<f64>,
    pub(super) build: Option<f64>,
    pub(super) render: Option<f64>,
    pub(super) write: Option<f64>,
}

#[derive(Clone, Debug, Serialize)]
pub(super) struct AllCounts {
    #[serde(flatten)]
    pub(super) rays: Counts,
    /// Negative voxels and tiles read as 0.
    pub(super) clamped_voxels: u64,
    /// Voxels and tiles that were not finite, read as 0.
    pub(super) sanitized_voxels: u64,
    /// Pixels beyond the largest half.
    pub(super) half_clamped_pixels: u64,
}

#[derive(Clone, Debug, Serialize)]
pub(super) struct GridStats {
    pub(super) file: String,
    pub(super) name: String,
    pub(super) active_voxels: Option<u64>,
    pub(super) bricks: usize,
    pub(super) bytes: usize,
    /// How values are stored.
    pub(super) encoding: &'static str,
    /// Upper bounds of the error in optical depth of any ray: RMS, and the largest.
    pub(super) depth_error: [f64; 2],
}

impl GridStats {
    pub(super) fn new(volume: &LoadedVolume, medium: &Medium) -> Self {
        let sigma_t = medium.sigma_t_per_density();
        let DepthError { rms, worst } = volume.stored.error.scaled(sigma_t);
        Self {
            file: volume.path.display().to_string(),
            name: volume.name.clone(),
            active_voxels: volume.active_voxel_count,
            bricks: volume.brick_count,
            bytes: volume.grid.memory_bytes(),
            encoding: volume.stored.encoding.name(),
            depth_error: [rms, worst],
        }
    }
}

/// Everything about one render.
#[derive(Clone, Debug, Serialize)]
pub(super) struct Stats {
    pub(super) version: &'static str,
    pub(super) input: String,
    pub(super) output: String,
    pub(super) resolution: [u32; 2],
    pub(super) spp: u32,
    pub(super) seed: u64,
    pub(super) frame: i32,
    pub(super) threads: usize,
    pub(super) seconds: Seconds,
    pub(super) cpu_seconds: CpuSeconds,
    pub(super) peak_memory_bytes: Option<u64>,
    pub(super) counts: AllCounts,
    /// Mean of R, G and B over the image, and its standard error.
    pub(super) image_mean: [f64; 3],
    pub(super) image_standard_error: [f64; 3],
    /// Of each volume, in the order of the scene.
    pub(super) grids: Vec<GridStats>,
    pub(super) plan: Vec<PlanLine>,
}

impl Stats {
    pub(super) fn new(
        input: &Path,
        output: &Path,
        scene: &Scene,
        volumes: &[LoadedVolume],
    ) -> Self {
        Self {
            version: env!("CARGO_PKG_VERSION"),
            input: input.display().to_string(),
            output: output.display().to_string(),
            resolution: [scene.width, scene.height],
            spp: scene.spp,
            seed: scene.seed,
            frame: scene.frame,
            threads: rayon::current_num_threads(),
            seconds: Seconds::default(),
            cpu_seconds: CpuSeconds::default(),
            peak_memory_bytes: memory::peak_bytes(),
            counts: AllCounts {
                rays: Counts::default(),
                clamped_voxels: volumes
                    .iter()
                    .map(|v| v.report.clamped_negative_count)
                    .sum(),
                sanitized_voxels: volumes.iter().map(|v| v.report.sanitized_count).sum(),
                half_clamped_pixels: 0,
            },
            image_mean: [0.0; 3],
            image_standard_error: [0.0; 3],
            grids: volumes
                .iter()
                .zip(&scene.media)
                .map(|(volume, medium)| GridStats::new(volume, medium))
                .collect(),
            plan: majorant::plan::plan(scene, volumes),
        }
    }
}

//! What making a volume ready costs: reading, decoding, building the bounds.
//!
//! `read` maps the file and walks it with all checks, `decode` decompresses the values into
//! bricks, `build` adds the halo and computes the bounds; each on 1 and 2 threads but for
//! `read`, which has one. The file is in the system's cache: no disk is measured.
//!
//! The assets of `data` are Blosc files of half floats. Other codecs are measured on files that
//! OpenVDB wrote, in `../shared/vdb-matrix`, and skipped with a line where that is missing.
//! OpenVDB's own reader is timed on the same files, where its Python module is installed
//! (Debian: python3-openvdb; `PYTHON` names another interpreter), with delayed loading off:
//! every value is decoded, as here. It has no bounds to build.

#![allow(
    missing_docs,
    reason = "the criterion macros make undocumented functions"
)]
#![expect(clippy::print_stderr, reason = "says what is skipped")]

mod assets;

use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;

use criterion::{BatchSize, Criterion, Throughput, criterion_group, criterion_main};
use glam::DVec3;
use majorant::grid::{DensityGrid, Tree};
use majorant::vdb::{Archive, LoadOptions};
use rayon::ThreadPool;

/// A file, and what reading it must give.
struct Asset {
    name: &'static str,
    path: PathBuf,
    active_voxel_count: u64,
    /// Sum of all stored values, half floats: exact in `f64` in any order.
    sum: f64,
    /// Lengths of the box of occupied 8³ cells, in voxels.
    occupied: DVec3,
}

fn assets() -> Vec<Asset> {
    let data = |name: &str| Path::new(env!("CARGO_MANIFEST_DIR")).join(name);
    let mut assets = vec![
        Asset {
            name: "cloud",
            path: data("data/cloud.vdb"),
            active_voxel_count: 1_739_049,
            sum: 642_964.123_901_367_2,
            occupied: DVec3::new(232.0, 176.0, 152.0),
        },
        Asset {
            name: "smoke",
            path: data("data/smoke.vdb"),
            active_voxel_count: 499_882,
            sum: 72_164.763_570_785_52,
            occupied: DVec3::new(96.0, 104.0, 240.0),
        },
    ];
    for (name, file) in [
        ("blosc", "cloud_blosc_mask_half.vdb"),
        ("zip", "cloud_zip_mask_half.vdb"),
        ("none", "cloud_none_mask_half.vdb"),
    ] {
        let path = data("../shared/vdb-matrix").join(file);
        if !path.exists() {
            eprintln!("load/{name}: skipped, there is no {}", path.display());
            continue;
        }
        assets.push(Asset {
            name,
            path,
            active_voxel_count: CODEC_VOXEL_COUNT,
            sum: CODEC_SUM,
            occupied: DVec3::new(96.0, 96.0, 96.0),
        });
    }
    assets
}

/// Of the small cloud that is there in every codec.
const CODEC_VOXEL_COUNT: u64 = 163_876;
const CODEC_SUM: f64 = 43_050.543_681_681_156;

fn sum(tree: &Tree<f32>) -> f64 {
    let bricks = (0..tree.brick_count()).map(|i| tree.brick(i));
    bricks.flatten().copied().map(f64::from).sum()
}

/// Prints the seconds that OpenVDB takes to read the file, median of seven reads.
fn time_openvdb(asset: &Asset) {
    const PROGRAM: &str = "
import sys, time, resource
try:
    import openvdb as vdb
except ImportError:
    import pyopenvdb as vdb
taken = []
for _ in range(7):
    start, cpu = time.perf_counter(), time.process_time()
    grids, _ = vdb.readAll(sys.argv[1])
    taken.append((time.process_time() - cpu, time.perf_counter() - start))
    voxels = sum(g.activeVoxelCount() for g in grids)
print(voxels, *sorted(taken)[3])
";
    let asked = std::env::var("PYTHON").ok();
    let candidates = asked.as_deref().into_iter();
    for python in candidates.chain(["python3", "/usr/bin/python3"]) {
        let run = Command::new(python)
            .args(["-c", PROGRAM])
            .arg(&asset.path)
            .env("OPENVDB_DISABLE_DELAYED_LOAD", "1")
            .output();
        let Some(run) = run.ok().filter(|r| r.status.success()) else {
            continue;
        };
        let text = String::from_utf8_lossy(&run.stdout).into_owned();
        let numbers: Vec<f64> = text.split_whitespace().flat_map(str::parse).collect();
        let [voxels, cpu, wall] = numbers[..] else {
            continue;
        };
        let bench = format!("load/{}/OpenVDB read", asset.name);
        assets::note(&bench, "cpu_time", cpu / voxels * 1e9, "ns/voxel");
        assets::note(&bench, "wall_time", wall / voxels * 1e9, "ns/voxel");
        return;
    }
    eprintln!(
        "load/{}/OpenVDB read: skipped, no Python with its module (Debian: python3-openvdb)",
        asset.name
    );
}

fn pools() -> [(usize, ThreadPool); 2] {
    [1, 2].map(|threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
        (threads, pool.expect("threads start"))
    })
}

fn bench(c: &mut Criterion) {
    let pools = pools();
    let options = LoadOptions::default();
    for asset in assets() {
        let Asset {
            name,
            path,
            active_voxel_count,
            sum: expected_sum,
            occupied,
        } = &asset;
        time_openvdb(&asset);
        let mut group = c.benchmark_group(format!("load/{name}"));
        group
            .throughput(Throughput::Elements(*active_voxel_count))
            .sample_size(20)
            .warm_up_time(Duration::from_millis(200))
            .measurement_time(Duration::from_secs(1));

        let read = || Archive::open(path).expect("the file is valid");
        group.bench_function("read", |b| {
            b.iter(|| {
                let count = read().grids()[0].active_voxel_count;
                assert_eq!(count, Some(*active_voxel_count), "{name}");
            });
        });

        let archive = read();
        let decode = || {
            archive
                .load_density(0, &options)
                .expect("the volume is valid")
        };
        let data = decode();
        let total = sum(&data.tree);
        assert_eq!(total, *expected_sum, "{name}: sum of the stored values");
        let brick_count = data.tree.brick_count();
        let build = |tree| DensityGrid::new(tree, data.transform, usize::MAX).expect("no limit");
        let world = build(data.tree.clone())
            .world_bounds()
            .expect("the assets are not empty");
        let lengths = (world.max - world.min) / data.transform.voxel_size();
        assert_eq!(lengths.round(), *occupied, "{name}: occupied box");
        for (threads, pool) in &pools {
            group.bench_function(format!("decode, {threads} threads"), |b| {
                b.iter(|| {
                    let data = pool.install(decode);
                    assert_eq!(data.tree.brick_count(), brick_count, "{name}");
                });
            });
            group.bench_function(format!("build, {threads} threads"), |b| {
                let setup = || data.tree.clone();
                b.iter_batched(
                    setup,
                    |tree| pool.install(|| build(tree)),
                    BatchSize::LargeInput,
                );
            });
        }
        group.finish();
    }
}

criterion_group!(benches, bench);
criterion_main!(benches);

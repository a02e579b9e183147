//! What making a volume ready costs: reading, decoding, building the bounds.
//!
//! `read` maps the file and walks it with all checks, `decode` decompresses the values into
//! bricks, `build` adds the halo and computes the bounds. All on one thread, so that wall time
//! on an idle machine is CPU time. The file is in the system's cache: no disk is measured.

#![allow(
    missing_docs,
    reason = "the criterion macros make undocumented functions"
)]

use std::path::Path;
use std::time::Duration;

use criterion::{BatchSize, Criterion, Throughput, criterion_group, criterion_main};
use glam::DVec3;
use majorant::grid::{DensityGrid, Tree};
use majorant::vdb::{Archive, LoadOptions};

/// A file of `data`, and what reading it must give.
struct Asset {
    name: &'static str,
    active_voxel_count: u64,
    /// Sum of all stored values, half floats: exact in `f64` in any order.
    sum: f64,
    /// Lengths of the box of occupied 8³ cells, in voxels.
    occupied: DVec3,
}

const ASSETS: [Asset; 2] = [
    Asset {
        name: "cloud",
        active_voxel_count: 1_739_049,
        sum: 642_964.123_901_367_2,
        occupied: DVec3::new(232.0, 176.0, 152.0),
    },
    Asset {
        name: "smoke",
        active_voxel_count: 499_882,
        sum: 72_164.763_570_785_52,
        occupied: DVec3::new(96.0, 104.0, 240.0),
    },
];

fn sum(tree: &Tree<f32>) -> f64 {
    let bricks = (0..tree.brick_count()).map(|i| tree.brick(i));
    bricks.flatten().copied().map(f64::from).sum()
}

fn bench(c: &mut Criterion) {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1);
    pool.build_global()
        .expect("no other pool was started before");
    for asset in ASSETS {
        let Asset {
            name,
            active_voxel_count,
            sum: expected_sum,
            occupied,
        } = asset;
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("data/{name}.vdb"));
        let options = LoadOptions::default();
        let mut group = c.benchmark_group(format!("load/{name}"));
        group
            .throughput(Throughput::Elements(active_voxel_count))
            .sample_size(20)
            .warm_up_time(Duration::from_millis(300))
            .measurement_time(Duration::from_secs(2));

        let read = || Archive::open(&path).expect("the volume is part of the project");
        group.bench_function("read", |b| {
            b.iter(|| {
                let count = read().grids()[0].active_voxel_count;
                assert_eq!(count, Some(active_voxel_count), "{name}");
            });
        });

        let archive = read();
        let decode = || {
            archive
                .load_density(0, &options)
                .expect("the volume is valid")
        };
        let data = decode();
        assert_eq!(
            sum(&data.tree),
            expected_sum,
            "{name}: sum of the stored values"
        );
        let brick_count = data.tree.brick_count();
        group.bench_function("decode", |b| {
            b.iter(|| assert_eq!(decode().tree.brick_count(), brick_count, "{name}"));
        });

        let build = |tree| DensityGrid::new(tree, data.transform, usize::MAX).expect("no limit");
        let world = build(data.tree.clone())
            .world_bounds()
            .expect("the assets are not empty");
        let lengths = (world.max - world.min) / data.transform.voxel_size();
        assert_eq!(lengths.round(), occupied, "{name}: occupied box");
        group.bench_function("build", |b| {
            b.iter_batched(|| data.tree.clone(), build, BatchSize::LargeInput);
        });
        group.finish();
    }
}

criterion_group!(benches, bench);
criterion_main!(benches);

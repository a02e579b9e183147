//! What walking a ray through the hierarchy costs, for each 8³ cell of space it crosses.
//!
//! Three kinds of rays: through density (`crossing`), through the box of the density without
//! meeting any (`missing`), and through 4096³ voxels of empty space to a brick in the corner
//! (`sparse`), where nearly all steps are large. The number of cells is a property of the
//! ray and the box, not of the walk: a walk that leaps over empty nodes pays less per cell.
//!
//! Lookups are not timed. Printed once: tentative collisions per unit of optical thickness,
//! the price of loose bounds, which a faster walk must not raise.

#![allow(
    missing_docs,
    reason = "the criterion macros make undocumented functions"
)]
#![expect(
    clippy::print_stderr,
    reason = "numbers that are not times are printed once"
)]

mod assets;

use std::time::Duration;

use criterion::measurement::WallTime;
use criterion::{BenchmarkGroup, Criterion, Throughput, criterion_group, criterion_main};
use glam::{DVec3, IVec3};
use majorant::grid::brick::BRICK_DIM;
use majorant::grid::{DensityGrid, Tree};
use majorant::sampling::{Stream, StreamKey, sample_cone};
use majorant::space::{Aabb, IndexTransform, floor_to_voxel};

const RAY_COUNT: usize = 512;

/// A ray in index space, of unit direction: `t` is in voxels.
#[derive(Clone, Copy)]
struct Chord {
    origin: DVec3,
    direction: DVec3,
    t0: f64,
    t1: f64,
}

/// Segments and the sums over them, in density times voxels.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Walked {
    segment_count: u64,
    length: f64,
    min: f64,
    max: f64,
}

/// Draws a ray through a uniform point of `bounds` in a uniform direction.
fn draw_chord(bounds: Aabb, stream: &mut Stream) -> Chord {
    let mut draw = || f64::from(stream.uniform());
    let through = bounds.min + (bounds.max - bounds.min) * DVec3::new(draw(), draw(), draw());
    let direction = sample_cone(DVec3::Z, 2.0, stream);
    let origin = through - direction * (bounds.max - bounds.min).length();
    let (t0, t1) = bounds
        .intersect(origin, direction)
        .expect("the point is in the box");
    Chord {
        origin,
        direction,
        t0,
        t1,
    }
}

/// Counts the 8³ cells that the chords cross: one, and one for each plane between.
fn cell_count(chords: &[Chord]) -> u64 {
    let cells = chords.iter().map(|c| {
        let cell = |t| floor_to_voxel((c.origin + c.direction * t) / f64::from(BRICK_DIM));
        let planes = (cell(c.t1) - cell(c.t0)).abs().element_sum();
        u64::from(planes.cast_unsigned()) + 1
    });
    cells.sum()
}

fn walk(grid: &DensityGrid, chords: &[Chord]) -> Walked {
    let mut walked = Walked::default();
    for c in chords {
        for s in grid.traverse(c.origin, c.direction, f64::INFINITY) {
            let length = s.t1 - s.t0;
            walked.segment_count += 1;
            walked.length += length;
            walked.min += f64::from(s.bound.min) * length;
            walked.max += f64::from(s.bound.max) * length;
        }
    }
    walked
}

/// Integrates the trilinear density along the chords by midpoints half a voxel apart.
fn integrate(grid: &DensityGrid, chords: &[Chord]) -> f64 {
    const STEP: f64 = 0.5;
    let mut sampler = grid.sampler();
    let mut sum = 0.0;
    for c in chords {
        let mut t = c.t0 + STEP / 2.0;
        while t < c.t1 {
            sum += f64::from(sampler.trilinear(c.origin + c.direction * t)) * STEP;
            t += STEP;
        }
    }
    sum
}

/// Times the walk of `chords` and asserts that it is the same each time.
fn time(
    group: &mut BenchmarkGroup<'_, WallTime>,
    name: &str,
    grid: &DensityGrid,
    chords: &[Chord],
) {
    let expected = walk(grid, chords);
    let cells = cell_count(chords);
    eprintln!(
        "traversal/{name}: {} rays, {:.1} cells and {:.2} segments a ray",
        chords.len(),
        cells as f64 / chords.len() as f64,
        expected.segment_count as f64 / chords.len() as f64,
    );
    group.throughput(Throughput::Elements(cells));
    group.bench_function(name, |b| {
        b.iter(|| {
            let walked = walk(grid, chords);
            assert_eq!(walked, expected, "{name}");
        });
    });
}

fn bench(c: &mut Criterion) {
    let mut group = c.benchmark_group("traversal");
    group
        .sample_size(20)
        .warm_up_time(Duration::from_millis(300))
        .measurement_time(Duration::from_secs(1));
    let mut stream = Stream::new(StreamKey::default());

    for name in assets::SCENES {
        let scene = assets::scene(name);
        let grid = scene
            .medium
            .as_ref()
            .expect("the scene has a medium")
            .grid();
        let bounds = assets::index_bounds(grid);
        let (mut crossing, mut missing) = (Vec::new(), Vec::new());
        while crossing.len() < RAY_COUNT || missing.len() < RAY_COUNT {
            let chord = draw_chord(bounds, &mut stream);
            let kind = match walk(grid, &[chord]).segment_count {
                0 => &mut missing,
                _ => &mut crossing,
            };
            if kind.len() < RAY_COUNT {
                kind.push(chord);
            }
        }

        // No density is missed, and the bounds hold on both sides.
        assert_eq!(
            integrate(grid, &missing),
            0.0,
            "{name}: density between segments"
        );
        let (thickness, walked) = (integrate(grid, &crossing), walk(grid, &crossing));
        assert!(
            walked.min <= thickness && thickness <= walked.max,
            "{name}: {thickness} outside of {walked:?}"
        );
        eprintln!(
            "traversal/{name}: {:.2} tentative collisions per unit of optical thickness",
            walked.max / thickness
        );
        time(&mut group, &format!("{name}/crossing"), grid, &crossing);
        time(&mut group, &format!("{name}/missing"), grid, &missing);
    }

    let corners = [IVec3::ZERO, IVec3::splat(4095)];
    let tree = Tree::from_voxels(0.0, corners.map(|p| (p, 1.0)));
    let grid = DensityGrid::new(tree, IndexTransform::uniform(1.0), usize::MAX)
        .expect("two bricks fit into memory");
    let bounds = assets::index_bounds(&grid);
    let to_brick = |origin: DVec3| {
        // Not zero: the brick is one of 2^27.
        let direction = (DVec3::splat(4092.0) - origin) / (DVec3::splat(4092.0) - origin).length();
        let (t0, t1) = bounds
            .intersect(origin, direction)
            .expect("the origin is in the box");
        Chord {
            origin,
            direction,
            t0,
            t1,
        }
    };
    let mut draw = || f64::from(stream.uniform());
    let sparse: Vec<Chord> = (0..RAY_COUNT)
        .map(|_| to_brick(DVec3::new(draw(), draw(), draw()) * 4096.0))
        .collect();
    assert!(
        sparse.iter().all(|&c| walk(&grid, &[c]).segment_count > 0),
        "a ray leaps over the brick that it points at"
    );
    time(&mut group, "sparse", &grid, &sparse);
    group.finish();
}

criterion_group!(benches, bench);
criterion_main!(benches);

//! What a step of a ray through the bounds costs, and how many steps and collisions there are.
//!
//! CPU times are for each 8³ cell of space that a ray crosses: a property of ray and box, not of
//! the walk, so a walk that leaps over empty space, or takes large cells, pays less per cell.
//! Rays come in three kinds, one for each level at which a step can be taken: through density
//! (`crossing`: bricks), through the box of the density without meeting any (`missing`: bricks
//! and empty nodes), and through 4096³ voxels of empty space to a brick in the corner (`sparse`:
//! nodes of 128³ and 4096³). `blocks` is the walk of renders, which crosses thin and empty cells
//! several at a time; the others take every brick. `flat` is the floor: the same rays through an array of the
//! maxima of 8³ cells, step by step, no hierarchy.
//!
//! Lookups are not timed. Printed: segments and tentative collisions for each unit of optical
//! thickness, for cells of 4³ to 64³ voxels, for 64 cells along each axis, for one bound for all,
//! and for each kind of cells that the library walks. Looser bounds cost collisions, tighter ones steps.

#![allow(
    missing_docs,
    reason = "the criterion macros make undocumented functions"
)]

mod assets;

use std::time::Duration;

use assets::arrays::Dense;
use assets::cpu_clock::CpuClock;
use assets::walk::{Chord, FlatBounds};
use criterion::{BenchmarkGroup, Criterion, Throughput, criterion_group, criterion_main};
use glam::{DVec3, IVec3};
use majorant::grid::brick::BRICK_DIM;
use majorant::grid::{Cells, DensityGrid, Tree};
use majorant::sampling::{Stream, StreamKey, sample_cone};
use majorant::space::{Aabb, IndexTransform, floor_to_voxel};

const RAY_COUNT: usize = 512;

/// Segments that are not empty, and sums over them, in density times voxels.
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
    chord_in(
        bounds,
        through - direction * (bounds.max - bounds.min).length(),
        direction,
    )
}

fn chord_in(bounds: Aabb, origin: DVec3, direction: DVec3) -> Chord {
    let (t0, t1) = bounds
        .intersect(origin, direction)
        .expect("the ray meets the box");
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

fn walk(grid: &DensityGrid, chords: &[Chord], cells: Cells<'_>) -> Walked {
    let mut walked = Walked::default();
    for c in chords {
        for s in grid.traverse_cells(c.origin, c.direction, f64::INFINITY, cells) {
            let length = s.t1 - s.t0;
            walked.segment_count += 1;
            walked.length += length;
            walked.min += f64::from(s.bound.min) * length;
            walked.max += f64::from(s.bound.max) * length;
        }
    }
    walked
}

/// Walks a flat grid; every cell is a step, and those that are not empty are segments.
fn walk_flat(bounds: &FlatBounds, chords: &[Chord]) -> (Walked, u64) {
    let (mut walked, mut step_count) = (Walked::default(), 0);
    for c in chords {
        bounds.walk(c, |max, t0, t1| {
            step_count += 1;
            if max > 0.0 && t1 > t0 {
                walked.segment_count += 1;
                walked.length += t1 - t0;
                walked.max += f64::from(max) * (t1 - t0);
            }
        });
    }
    (walked, step_count)
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

type Group<'a> = BenchmarkGroup<'a, CpuClock>;

/// Times the walk of `chords` over `cells` and asserts that it is the same each time.
fn time(
    group: &mut Group<'_>,
    name: &str,
    (grid, cells): (&DensityGrid, Cells<'_>),
    chords: &[Chord],
) {
    let expected = walk(grid, chords, cells);
    let cell_count = cell_count(chords);
    let rays = chords.len() as f64;
    let bench = format!("traversal/{name}");
    assets::note(&bench, "cells", cell_count as f64 / rays, "1/ray");
    let segments = expected.segment_count as f64 / rays;
    assets::note(&bench, "segments", segments, "1/ray");
    group.throughput(Throughput::Elements(cell_count));
    group.bench_function(name, |b| {
        b.iter(|| assert_eq!(walk(grid, chords, cells), expected, "{name}"));
    });
}

/// Times the plain walk of `chords` through 8³ cells.
fn time_flat(group: &mut Group<'_>, name: &str, bounds: &FlatBounds, chords: &[Chord]) {
    let expected = walk_flat(bounds, chords);
    group.throughput(Throughput::Elements(cell_count(chords)));
    group.bench_function(name, |b| {
        b.iter(|| assert_eq!(walk_flat(bounds, chords), expected, "{name}"));
    });
}

/// Prints what each kind of bounds makes of the rays of a scene, at its optical thickness.
fn count(
    name: &str,
    grid: &DensityGrid,
    dense: &Dense,
    chords: &[Chord],
    depth_per_density_voxel: f64,
) {
    let thickness = integrate(grid, chords);
    let say = |cells: &str, walked: &Walked, steps: Option<u64>| {
        // Midpoints half a voxel apart miss the integral by less than this.
        assert!(
            walked.max >= 0.999 * thickness,
            "{name}/{cells}: the bounds are below the density"
        );
        let bench = format!("traversal/{name}/{cells}");
        let per_depth = 1.0 / (thickness * depth_per_density_voxel);
        let collisions = walked.max / thickness;
        let segments = walked.segment_count as f64 * per_depth;
        assets::note(&bench, "collisions_per_optical_thickness", collisions, "1");
        assets::note(&bench, "segments_per_optical_thickness", segments, "1");
        if let Some(steps) = steps {
            let steps = steps as f64 * per_depth;
            assets::note(&bench, "steps_per_optical_thickness", steps, "1");
        }
    };
    let size = (dense.dim - 1).as_dvec3();
    let edges = [4.0, 8.0, 16.0, 32.0, 64.0];
    let cubes = edges.map(|e| (format!("{e} voxels"), DVec3::splat(e)));
    let others = [
        ("64 an axis".to_owned(), size / 64.0),
        ("global".to_owned(), size),
    ];
    for (cells, edge) in cubes.into_iter().chain(others) {
        let (walked, steps) = walk_flat(&FlatBounds::new(dense, edge), chords);
        say(&cells, &walked, Some(steps));
    }
    #[expect(clippy::cast_possible_truncation, reason = "an estimate")]
    let blocks = grid.blocks(depth_per_density_voxel as f32);
    for (cells, kind) in [
        ("library, bricks", Cells::Bricks),
        ("library, hierarchy", Cells::Blocks(&blocks)),
        ("library, whole", Cells::Whole),
    ] {
        say(cells, &walk(grid, chords, kind), None);
    }
}

fn bench_scene(group: &mut Group<'_>, name: &str, stream: &mut Stream) {
    let scene = assets::scene(name);
    let medium = scene.media.first().expect("the scene has a medium");
    let grid = medium.grid();
    let bounds = assets::index_bounds(grid);
    let (mut crossing, mut missing) = (Vec::new(), Vec::new());
    while crossing.len() < RAY_COUNT || missing.len() < RAY_COUNT {
        let chord = draw_chord(bounds, stream);
        let kind = match walk(grid, &[chord], Cells::Bricks).segment_count {
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
    let (thickness, walked) = (
        integrate(grid, &crossing),
        walk(grid, &crossing, Cells::Bricks),
    );
    assert!(
        walked.min <= thickness && thickness <= walked.max,
        "{name}: {thickness} outside of {walked:?}"
    );

    let dense = Dense::new(&assets::tree(name), bounds);
    let voxel = grid.transform().voxel_size().x;
    let scale = f64::from(medium.sigma_t_per_density()) * voxel;
    count(name, grid, &dense, &crossing, scale);
    let flat = FlatBounds::new(&dense, DVec3::splat(f64::from(BRICK_DIM)));
    // The floor walks the same cells and finds the same bounds.
    let (floor, _) = walk_flat(&flat, &crossing);
    assert!(
        (floor.max / walked.max - 1.0).abs() < 1e-9,
        "{name}: the flat walk finds {} and the library {}",
        floor.max,
        walked.max
    );
    #[expect(clippy::cast_possible_truncation, reason = "a threshold")]
    let blocks = grid.blocks(scale as f32);
    for (kind, chords) in [("crossing", &crossing), ("missing", &missing)] {
        let bench = format!("{name}/{kind}");
        time(group, &bench, (grid, Cells::Bricks), chords);
        let cells = Cells::Blocks(&blocks);
        time(group, &format!("{bench}, blocks"), (grid, cells), chords);
        time_flat(group, &format!("{bench}, flat"), &flat, chords);
    }
}

/// Two bricks in 4096³ voxels, and rays from all over towards the second.
fn bench_sparse(group: &mut Group<'_>, stream: &mut Stream) {
    let corners = [IVec3::ZERO, IVec3::splat(4095)];
    let tree = Tree::from_voxels(0.0, corners.map(|p| (p, 1.0)));
    let grid = DensityGrid::new(tree, IndexTransform::uniform(1.0), usize::MAX)
        .expect("two bricks fit into memory");
    let bounds = assets::index_bounds(&grid);
    let mut draw = || f64::from(stream.uniform());
    let sparse: Vec<Chord> = (0..RAY_COUNT)
        .map(|_| {
            let origin = DVec3::new(draw(), draw(), draw()) * 4096.0;
            // Not zero: the brick is one of 2^27.
            let towards = DVec3::splat(4092.0) - origin;
            chord_in(bounds, origin, towards / towards.length())
        })
        .collect();
    let meets = |&c: &Chord| walk(&grid, &[c], Cells::Bricks).segment_count > 0;
    assert!(
        sparse.iter().all(meets),
        "a ray leaps over the brick that it points at"
    );
    time(group, "sparse", (&grid, Cells::Bricks), &sparse);
}

fn bench(c: &mut Criterion<CpuClock>) {
    let mut group = c.benchmark_group("traversal");
    group
        .sample_size(20)
        .warm_up_time(Duration::from_millis(200))
        .measurement_time(Duration::from_millis(800));
    let mut stream = Stream::new(StreamKey::default());
    for name in assets::SCENES {
        bench_scene(&mut group, name, &mut stream);
    }
    bench_sparse(&mut group, &mut stream);
    group.finish();
}

criterion_group!(
    name = benches;
    config = assets::cpu_clock::criterion();
    targets = bench
);
criterion_main!(benches);

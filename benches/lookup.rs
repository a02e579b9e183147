//! What reading one value of the field costs, beside the floors: a dense array and flat bricks.
//!
//! * Ways to read: the stored value at a voxel, the trilinear value from eight, and one voxel
//!   drawn with its trilinear weight.
//! * Places (`cloud/…`): at random in the occupied box (`uniform`: every lookup in another
//!   brick), at steps of one voxel along camera rays (`ray`), and at the tentative collisions of
//!   scattering paths, as a render does (`path`).
//! * Sizes (`size/…`): full cubes of 16 KB to 618 MB as f32, so that all is in the first cache,
//!   the second, the third, or none; read at random and along jumps of 8 voxels (`jumps`).
//! * Storage: every encoding of the library ([`ENCODINGS`]), in memory and, where no cache holds
//!   it, as a mapped cache file; flat bricks of 8³ values, and with
//!   an apron of 9³, in f32, f16, u16 and u8; the dense array.
//! * Throughput: lookups do not wait for each other. `latency`: the place of each lookup is found
//!   by the value of the one before.
//!
//! Times are CPU times. Places are drawn before the clock starts: no walk, no logarithm and no random number is timed.
//! The sums are asserted: all storages agree to within their encoding, one tap agrees with
//! eight within 5 standard errors.
//!
//! `MAJORANT_BENCH_LARGE=0` leaves out the cube that fits no cache, which takes 1.5 GB.

#![allow(
    missing_docs,
    reason = "the criterion macros make undocumented functions"
)]

mod assets;

use std::hint::black_box;
use std::ops::ControlFlow;
use std::time::Duration;

use assets::arrays::{Bricks, Dense};
use assets::cpu_clock::CpuClock;
use criterion::{BenchmarkGroup, Criterion, Throughput, criterion_group, criterion_main};
use glam::{DVec2, DVec3, IVec3};
use half::f16;
use majorant::cache::{self, CacheFile, Contents, Source};
use majorant::grid::brick::{BRICK_DIM, BRICK_LEN, voxel_at};
use majorant::grid::{DensityGrid, Encoding, Tree, TreeBuilder};
use majorant::medium::{BoundSegment, Medium, MediumRay};
use majorant::sampling::{Stream, StreamKey};
use majorant::scene::Scene;
use majorant::space::{Aabb, IndexTransform, Ray, floor_to_voxel};
use majorant::tracking::collision::{Collision, Visitor, walk};

/// Lookups of one timed pass: 32 bytes each, 1 MiB in all, read in order.
const QUERY_COUNT: usize = 1 << 15;

/// A way in which the library can store a tree.
#[derive(Clone, Copy)]
struct Kind {
    name: &'static str,
    encoding: Encoding,
    /// Written to a cache file and mapped, instead of held in memory.
    is_mapped: bool,
    /// Largest relative error of a sum.
    tolerance: f64,
}

const fn kind(name: &'static str, encoding: Encoding, is_mapped: bool, tolerance: f64) -> Kind {
    Kind {
        name,
        encoding,
        is_mapped,
        tolerance,
    }
}

/// Half a step of the code at most, of values up to the brick's largest; f16 has 11 bits.
const ENCODINGS: [Kind; 6] = [
    kind("f32", Encoding::F32, false, 1e-6),
    kind("f16", Encoding::F16, false, 5e-4),
    kind("u16", Encoding::U16, false, 2e-5),
    kind("u8", Encoding::U8, false, 4e-3),
    kind("f32 mapped", Encoding::F32, true, 1e-6),
    kind("u8 mapped", Encoding::U8, true, 4e-3),
];

/// Voxels along the edge of the full cubes, and the smallest cache that holds them as f32.
const CUBES: [(i32, &str); 4] = [
    (16, "16 KB, L1"),
    (40, "256 KB, L2"),
    (160, "16 MB, L3"),
    (536, "616 MB, memory"),
];

impl Kind {
    fn grid(self, mut tree: Tree<f32>) -> DensityGrid {
        let transform = IndexTransform::uniform(1.0);
        if !self.is_mapped {
            let grid = DensityGrid::encoded(tree, transform, self.encoding, usize::MAX);
            return grid.expect("no limit was set");
        }
        let folder = tempfile::tempdir().expect("a folder for the cache file");
        let path = folder.path().join("cube.mjc");
        let values = tree.take_values();
        let contents = Contents {
            nodes: tree,
            transform,
            encoding: self.encoding,
            source: Source::default(),
            brick: |b: usize, _origin, out: &mut [f32]| {
                out.copy_from_slice(&values[b * BRICK_LEN..][..BRICK_LEN]);
            },
        };
        cache::write(&path, contents, usize::MAX).expect("the folder has room");
        let file = CacheFile::open(&path, usize::MAX).expect("just written");
        // The mapping outlives the file's name. Its pages are in the system's cache.
        file.grid().expect("just written")
    }
}

/// One lookup.
#[derive(Clone, Copy)]
struct Query {
    p_index: DVec3,
    bits: u64,
}

/// Reads every query and returns the sum.
fn sum(queries: &[Query], mut read: impl FnMut(&Query) -> f32) -> f64 {
    queries.iter().map(|q| f64::from(read(q))).sum()
}

/// As [`sum`], but each place is known only once the value before has arrived.
fn chained_sum(queries: &[Query], mut read: impl FnMut(&Query) -> f32) -> f64 {
    // Zero, which the compiler does not know.
    let nothing = black_box(0_u32);
    let (mut sum, mut last) = (0.0, 0_u32);
    for i in 0..queries.len() {
        let value = read(&queries[i ^ (last & nothing) as usize]);
        sum += f64::from(value);
        last = value.to_bits();
    }
    sum
}

/// Points drawn uniformly in `bounds`.
fn uniform(bounds: Aabb, stream: &mut Stream) -> Vec<Query> {
    let mut draw = || f64::from(stream.uniform());
    let points: Vec<DVec3> = (0..QUERY_COUNT)
        .map(|_| bounds.min + (bounds.max - bounds.min) * DVec3::new(draw(), draw(), draw()))
        .collect();
    with_bits(points, stream)
}

/// Points 8 voxels from each other in random directions, reflected into `bounds`.
fn jumps(bounds: Aabb, stream: &mut Stream) -> Vec<Query> {
    let mut p = bounds.center();
    let mut points = Vec::with_capacity(QUERY_COUNT);
    for _ in 0..QUERY_COUNT {
        let direction = majorant::sampling::sample_cone(DVec3::Z, 2.0, stream);
        let next = p + direction * 8.0;
        // Reflected at a face, and in a cube narrower than a jump clamped as well.
        let folded = (2.0 * bounds.max - next).min(next);
        p = (2.0 * bounds.min - folded)
            .max(folded)
            .clamp(bounds.min, bounds.max - 1e-6);
        points.push(p);
    }
    with_bits(points, stream)
}

/// Points one voxel apart along camera rays.
fn along_rays(scene: &Scene, medium: &Medium, bounds: Aabb, stream: &mut Stream) -> Vec<Query> {
    let to_index = medium.grid().transform().index_from_world();
    let mut points = Vec::with_capacity(QUERY_COUNT);
    for ray in camera_rays(scene) {
        let origin = to_index.transform_point3(ray.origin);
        let direction = to_index.transform_vector3(ray.direction);
        let Some((mut t, t1)) = bounds.intersect(origin, direction) else {
            continue;
        };
        let step = direction.length().recip();
        while t < t1 && points.len() < QUERY_COUNT {
            points.push((origin + direction * t).clamp(bounds.min, bounds.max));
            t += step;
        }
    }
    with_bits(points, stream)
}

/// The tentative collisions of a ray, and whether the last was real.
struct Collisions {
    ts: Vec<f64>,
    is_real: bool,
}

impl Visitor for Collisions {
    fn enter(
        &mut self,
        _ray: &mut MediumRay<'_>,
        segment: &BoundSegment,
        _depth: &mut f32,
        _stream: &mut Stream,
    ) -> ControlFlow<(), f32> {
        ControlFlow::Continue(segment.sigma_maj)
    }

    fn collide(
        &mut self,
        ray: &mut MediumRay<'_>,
        _segment: &BoundSegment,
        collision: &Collision,
        stream: &mut Stream,
    ) -> ControlFlow<()> {
        self.ts.push(collision.t);
        let sigma_t = ray.estimate_sigma_t(collision.t, stream.bits());
        self.is_real = stream.uniform() * collision.rate < sigma_t;
        if self.is_real {
            ControlFlow::Break(())
        } else {
            ControlFlow::Continue(())
        }
    }
}

/// The tentative collisions of paths from the camera, in the order a render meets them.
///
/// Shadow rays are left out: they read like camera rays do.
fn along_paths(scene: &Scene, medium: &Medium, bounds: Aabb, stream: &mut Stream) -> Vec<Query> {
    let to_index = medium.grid().transform().index_from_world();
    let mut points = Vec::with_capacity(QUERY_COUNT);
    for mut ray in camera_rays(scene) {
        loop {
            let mut met = Collisions {
                ts: Vec::new(),
                is_real: false,
            };
            let mut walked = medium.ray(&ray, f64::INFINITY);
            walk(&mut walked, stream, &mut met);
            // Rounding may leave a point on a face just outside.
            let point = |&t: &f64| {
                let p = to_index.transform_point3(ray.at(t));
                p.clamp(bounds.min, bounds.max)
            };
            points.extend(met.ts.iter().map(point));
            let Some(&t) = met.ts.last() else { break };
            if !met.is_real || stream.uniform() >= medium.albedo().max_channel() {
                break;
            }
            let direction = medium.phase().sample(ray.direction, stream);
            ray = Ray {
                origin: ray.at(t),
                direction,
            };
        }
        if points.len() >= QUERY_COUNT {
            break;
        }
    }
    points.truncate(QUERY_COUNT);
    with_bits(points, stream)
}

/// One ray through the middle of each pixel, row by row from the middle of the image down.
fn camera_rays(scene: &Scene) -> impl Iterator<Item = Ray> {
    let size = DVec2::new(f64::from(scene.width), f64::from(scene.height));
    (scene.height / 2..scene.height).flat_map(move |y| {
        (0..scene.width).map(move |x| {
            let pixel = DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5);
            scene.camera.ray(pixel / size)
        })
    })
}

fn with_bits(points: Vec<DVec3>, stream: &mut Stream) -> Vec<Query> {
    assert_eq!(points.len(), QUERY_COUNT, "there are enough places to read");
    let query = |p_index| Query {
        p_index,
        bits: stream.bits(),
    };
    points.into_iter().map(query).collect()
}

/// Asserts that one tap has the mean of eight within 5 standard errors of their differences.
fn assert_unbiased(queries: &[Query], dense: &Dense) {
    let difference = queries
        .iter()
        .map(|q| f64::from(dense.stochastic(q.p_index, q.bits) - dense.trilinear(q.p_index)));
    let (total, squares) = difference.fold((0.0, 0.0), |(s, s2), d| (s + d, s2 + d * d));
    assert!(
        total.abs() <= 5.0 * f64::sqrt(squares),
        "one tap is biased: sum of differences {total}, its standard error {}",
        squares.sqrt()
    );
}

/// The sums that the dense array gives, for each way to read.
struct Expected {
    stored: f64,
    trilinear: f64,
    one_tap: f64,
}

/// Benchmarks of one set of places.
struct Places<'a, 'b> {
    group: &'a mut BenchmarkGroup<'b, CpuClock>,
    queries: &'a [Query],
    expected: Expected,
}

impl Places<'_, '_> {
    /// Times `read`, whose sum may be off by `tolerance`, by throughput and, if asked, by latency.
    fn time(
        &mut self,
        name: &str,
        (expected, tolerance): (f64, f64),
        has_latency: bool,
        mut read: impl FnMut(&Query) -> f32,
    ) {
        let queries = black_box(self.queries);
        let total = sum(queries, &mut read);
        assert!(expected > 0.0, "{name}: the places hold density");
        assert!(
            (total / expected - 1.0).abs() <= tolerance,
            "{name}: sum {total}, expected {expected}"
        );
        self.group
            .bench_function(name, |b| b.iter(|| sum(queries, &mut read)));
        if has_latency {
            let chained = chained_sum(queries, &mut read);
            assert_eq!(chained, total, "{name}: the chain reads the same places");
            self.group.bench_function(format!("{name}, latency"), |b| {
                b.iter(|| chained_sum(queries, &mut read));
            });
        }
    }

    fn library(&mut self, grids: &[(Kind, DensityGrid)]) {
        let Expected {
            stored,
            trilinear,
            one_tap,
        } = self.expected;
        for (kind, grid) in grids {
            let Kind {
                name, tolerance, ..
            } = kind;
            let mut sampler = grid.sampler();
            self.time(
                &format!("{name}, stored"),
                (stored, *tolerance),
                false,
                |q| sampler.value(floor_to_voxel(q.p_index)),
            );
            self.time(
                &format!("{name}, trilinear"),
                (trilinear, *tolerance),
                true,
                |q| sampler.trilinear(q.p_index),
            );
            self.time(
                &format!("{name}, one tap"),
                (one_tap, *tolerance),
                true,
                |q| sampler.stochastic(q.p_index, q.bits),
            );
        }
    }

    fn dense(&mut self, dense: &Dense) {
        let Expected {
            stored,
            trilinear,
            one_tap,
        } = self.expected;
        self.time("dense, stored", (stored, 0.0), false, |q| {
            dense.value(floor_to_voxel(q.p_index))
        });
        self.time("dense, trilinear", (trilinear, 0.0), true, |q| {
            dense.trilinear(q.p_index)
        });
        self.time("dense, one tap", (one_tap, 0.0), true, |q| {
            dense.stochastic(q.p_index, q.bits)
        });
    }

    fn flat_bricks(&mut self, flat: &Flat) {
        let Expected {
            trilinear, one_tap, ..
        } = self.expected;
        let Flat {
            plain,
            apron,
            half,
            short,
            byte,
            byte_apron,
        } = flat;
        // As for the library's encodings.
        let (bits8, bits11, bits16) = (4e-3, 5e-4, 2e-5);
        self.time("flat f32, trilinear", (trilinear, 1e-6), false, |q| {
            plain.trilinear(q.p_index)
        });
        self.time("flat f32 apron, trilinear", (trilinear, 1e-6), true, |q| {
            apron.trilinear(q.p_index)
        });
        self.time("flat u8 apron, trilinear", (trilinear, bits8), true, |q| {
            byte_apron.trilinear(q.p_index)
        });
        self.time("flat f32, one tap", (one_tap, 0.0), true, |q| {
            plain.stochastic(q.p_index, q.bits)
        });
        self.time("flat f16, one tap", (one_tap, bits11), true, |q| {
            half.stochastic(q.p_index, q.bits)
        });
        self.time("flat u16, one tap", (one_tap, bits16), true, |q| {
            short.stochastic(q.p_index, q.bits)
        });
        self.time("flat u8, one tap", (one_tap, bits8), true, |q| {
            byte.stochastic(q.p_index, q.bits)
        });
    }
}

/// The same values in flat bricks of several kinds.
struct Flat {
    plain: Bricks<f32, 8>,
    apron: Bricks<f32, 9>,
    half: Bricks<f16, 8>,
    short: Bricks<u16, 8>,
    byte: Bricks<u8, 8>,
    byte_apron: Bricks<u8, 9>,
}

impl Flat {
    fn new(dense: &Dense) -> Self {
        Self {
            plain: Bricks::new(dense),
            apron: Bricks::new(dense),
            half: Bricks::new(dense),
            short: Bricks::new(dense),
            byte: Bricks::new(dense),
            byte_apron: Bricks::new(dense),
        }
    }
}

/// The library's grids of `tree`, by encoding.
fn grids(tree: &Tree<f32>) -> Vec<(Kind, DensityGrid)> {
    let in_memory = ENCODINGS.into_iter().filter(|kind| !kind.is_mapped);
    in_memory.map(|k| (k, k.grid(tree.clone()))).collect()
}

fn bench_places(
    c: &mut Criterion<CpuClock>,
    name: &str,
    queries: &[Query],
    dense: &Dense,
    run: impl FnOnce(&mut Places<'_, '_>),
) {
    assert_unbiased(queries, dense);
    let mut group = c.benchmark_group(format!("lookup/{name}"));
    group
        .throughput(Throughput::Elements(QUERY_COUNT as u64))
        .sample_size(20)
        .warm_up_time(Duration::from_millis(150))
        .measurement_time(Duration::from_millis(600));
    let expected = Expected {
        stored: sum(queries, |q| dense.value(floor_to_voxel(q.p_index))),
        trilinear: sum(queries, |q| dense.trilinear(q.p_index)),
        one_tap: sum(queries, |q| dense.stochastic(q.p_index, q.bits)),
    };
    run(&mut Places {
        group: &mut group,
        queries,
        expected,
    });
    group.finish();
}

fn bench_cloud(c: &mut Criterion<CpuClock>) {
    let scene = assets::scene("cloud");
    let medium = scene.media.first().expect("the scene has a medium");
    let bounds = assets::index_bounds(medium.grid());
    let tree = assets::tree("cloud");
    let dense = Dense::new(&tree, bounds);
    let (grids, flat) = (grids(&tree), Flat::new(&dense));

    let mut stream = Stream::new(StreamKey::default());
    let patterns = [
        ("uniform", uniform(bounds, &mut stream)),
        ("ray", along_rays(&scene, medium, bounds, &mut stream)),
        ("path", along_paths(&scene, medium, bounds, &mut stream)),
    ];
    for (pattern, queries) in &patterns {
        bench_places(c, &format!("cloud/{pattern}"), queries, &dense, |places| {
            places.library(&grids);
            places.dense(&dense);
            places.flat_bricks(&flat);
        });
    }
}

/// A cube full of bricks, no two values alike.
fn full_cube(edge: i32) -> Tree<f32> {
    let mut builder = TreeBuilder::new(0.0);
    let cells = edge / BRICK_DIM;
    let mut values = Vec::new();
    for cell in 0..cells * cells * cells {
        let origin = IVec3::new(cell / (cells * cells), cell / cells % cells, cell % cells);
        let origin = origin * BRICK_DIM;
        builder.add_brick(origin);
        values.extend((0..BRICK_LEN).map(|i| {
            let p = origin + voxel_at(i);
            0.5 + ((p.x * 7 + p.y * 13 + p.z * 29) & 1023) as f32 / 2048.0
        }));
    }
    let active = vec![[u64::MAX; BRICK_LEN / 64]; builder.brick_count()];
    let mut tree = builder.finish(values, active);
    tree.drop_active_masks();
    tree
}

fn bench_sizes(c: &mut Criterion<CpuClock>) {
    let has_large = std::env::var("MAJORANT_BENCH_LARGE").as_deref() != Ok("0");
    for (edge, size) in CUBES {
        if edge > 500 && !has_large {
            continue;
        }
        let tree = full_cube(edge);
        let bounds = Aabb {
            min: DVec3::ZERO,
            max: DVec3::splat(f64::from(edge)),
        };
        let dense = Dense::new(&tree, bounds);
        let mut stream = Stream::new(StreamKey::default());
        let patterns = [
            ("uniform", uniform(bounds, &mut stream)),
            ("jumps", jumps(bounds, &mut stream)),
        ];
        for kind in ENCODINGS {
            // A mapping that is in the caches is memory like any other.
            if kind.is_mapped && edge < 500 {
                continue;
            }
            let grids = [(kind, kind.grid(tree.clone()))];
            for (pattern, queries) in &patterns {
                let name = format!("size/{size}/{pattern}");
                bench_places(c, &name, queries, &dense, |places| places.library(&grids));
            }
        }
        drop(tree);
        for (pattern, queries) in &patterns {
            let name = format!("size/{size}/{pattern}");
            bench_places(c, &name, queries, &dense, |places| places.dense(&dense));
        }
    }
}

criterion_group!(
    name = benches;
    config = assets::cpu_clock::criterion();
    targets = bench_cloud, bench_sizes
);
criterion_main!(benches);

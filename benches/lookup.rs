//! What reading one value of the field costs, beside a dense array as the floor.
//!
//! Ways to read: the stored value at a voxel, the trilinear value from eight, and one voxel
//! drawn with its trilinear weight. Places to read: at random in the occupied box (every
//! lookup in another brick), at steps of one voxel along camera rays, and at the tentative
//! collisions of scattering paths, as a render does.
//!
//! Places are drawn before the clock starts: no walk, no logarithm and no random number is
//! timed. Lookups do not depend on each other, so this is throughput, not latency. The sums
//! are asserted: sparse and dense agree, one tap agrees with eight within 5 standard errors.

#![allow(
    missing_docs,
    reason = "the criterion macros make undocumented functions"
)]

mod assets;

use std::hint::black_box;
use std::ops::ControlFlow;
use std::path::Path;
use std::time::Duration;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use glam::{DVec2, DVec3, IVec3};
use majorant::grid::brick::BRICK_DIM;
use majorant::grid::{DensityGrid, Tile, Tree};
use majorant::medium::{BoundSegment, Medium, MediumRay};
use majorant::sampling::{Stream, StreamKey};
use majorant::scene::Scene;
use majorant::space::{Aabb, Ray, floor_to_voxel};
use majorant::stats::Counts;
use majorant::tracking::collision::{Collision, Visitor, walk};
use majorant::vdb::{Archive, LoadOptions};

/// Lookups of one timed pass: 32 bytes each, 1 MiB in all, read in order.
const QUERY_COUNT: usize = 1 << 15;

/// One lookup.
#[derive(Clone, Copy)]
struct Query {
    p_index: DVec3,
    bits: u64,
}

/// A dense copy of the occupied box and one layer above it, `[x][y][z]`, z fastest.
struct Dense {
    low: IVec3,
    dim: IVec3,
    values: Vec<f32>,
}

impl Dense {
    /// Copies the bricks of `tree` into an array that covers `bounds` and all its taps.
    fn new(tree: &Tree<f32>, bounds: Aabb) -> Self {
        let low = bounds.min.as_ivec3();
        let dim = bounds.max.as_ivec3() - low + IVec3::ONE;
        let len = dim.as_u64vec3().element_product();
        let len = usize::try_from(len).expect("the assets are small");
        let mut dense = Self {
            low,
            dim,
            values: vec![tree.background(); len],
        };
        let has_value = |t: (IVec3, i32, Tile<f32>)| t.2.value > 0.0;
        assert!(
            !tree.stored_tiles().any(has_value),
            "only bricks are copied"
        );
        for (brick, &origin) in tree.brick_origins().iter().enumerate() {
            for (o, &value) in (0..).zip(tree.brick(brick)) {
                let p = origin + (IVec3::new(o >> 6, o >> 3, o) & (BRICK_DIM - 1));
                if (p - low).cmpge(IVec3::ZERO).all() && (p - low).cmplt(dim).all() {
                    let index = dense.index(p);
                    dense.values[index] = value;
                }
            }
        }
        dense
    }

    fn index(&self, p: IVec3) -> usize {
        let q = p - self.low;
        ((q.x * self.dim.y + q.y) * self.dim.z + q.z).cast_unsigned() as usize
    }

    fn value(&self, p: IVec3) -> f32 {
        self.values[self.index(p)]
    }

    fn trilinear(&self, p_index: DVec3) -> f32 {
        let lo = floor_to_voxel(p_index);
        let f = (p_index - lo.as_dvec3()).as_vec3();
        let base = self.index(lo);
        let (dx, dy) = (
            self.index(lo + IVec3::X) - base,
            self.index(lo + IVec3::Y) - base,
        );
        let lerp = |a: f32, b: f32, t: f32| a + (b - a) * t;
        let along_z = |i: usize| lerp(self.values[i], self.values[i + 1], f.z);
        let low = lerp(along_z(base), along_z(base + dy), f.y);
        let high = lerp(along_z(base + dx), along_z(base + dx + dy), f.y);
        lerp(low, high, f.x)
    }

    fn stochastic(&self, p_index: DVec3, bits: u64) -> f32 {
        let u = |shift: u32| (bits >> shift & 0x1f_ffff) as f64 * (1.0 / 2_097_152.0);
        self.value(floor_to_voxel(p_index + DVec3::new(u(0), u(21), u(42))))
    }
}

/// Reads every query and returns the sum.
fn sum(queries: &[Query], mut read: impl FnMut(&Query) -> f32) -> f64 {
    queries.iter().map(|q| f64::from(read(q))).sum()
}

/// Points drawn uniformly in `bounds`.
fn uniform(bounds: Aabb, stream: &mut Stream) -> Vec<Query> {
    let mut draw = || f64::from(stream.uniform());
    let points: Vec<DVec3> = (0..QUERY_COUNT)
        .map(|_| bounds.min + (bounds.max - bounds.min) * DVec3::new(draw(), draw(), draw()))
        .collect();
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

/// The tentative collisions of paths from the camera, in the order a render meets them.
///
/// Shadow rays are left out: they read like camera rays do.
fn along_paths(scene: &Scene, medium: &Medium, stream: &mut Stream) -> Vec<Query> {
    struct Record {
        ts: Vec<f64>,
        real: bool,
    }
    impl Visitor for Record {
        fn enter(
            &mut self,
            _ray: &mut MediumRay<'_>,
            segment: &BoundSegment,
            _depth: &mut f32,
            _stream: &mut Stream,
            _counts: &mut Counts,
        ) -> ControlFlow<(), f32> {
            ControlFlow::Continue(segment.sigma_maj)
        }
        fn collide(
            &mut self,
            ray: &mut MediumRay<'_>,
            _segment: &BoundSegment,
            collision: &Collision,
            stream: &mut Stream,
            _counts: &mut Counts,
        ) -> ControlFlow<()> {
            self.ts.push(collision.t);
            let sigma_t = ray.estimate_sigma_t(collision.t, stream.bits());
            self.real = stream.uniform() * collision.rate < sigma_t;
            if self.real {
                ControlFlow::Break(())
            } else {
                ControlFlow::Continue(())
            }
        }
    }
    let to_index = medium.grid().transform().index_from_world();
    let mut points = Vec::with_capacity(QUERY_COUNT);
    for mut ray in camera_rays(scene) {
        loop {
            let mut record = Record {
                ts: Vec::new(),
                real: false,
            };
            let mut walked = medium.ray(&ray, f64::INFINITY);
            walk(&mut walked, stream, &mut Counts::default(), &mut record);
            points.extend(
                record
                    .ts
                    .iter()
                    .map(|&t| to_index.transform_point3(ray.at(t))),
            );
            let Some(&t) = record.ts.last() else { break };
            if !record.real || stream.uniform() >= medium.albedo().max_channel() {
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
    assert_eq!(
        points.len(),
        QUERY_COUNT,
        "the scene has enough places to read"
    );
    let query = |p_index| Query {
        p_index,
        bits: stream.bits(),
    };
    points.into_iter().map(query).collect()
}

/// Asserts that one tap has the mean of eight within 5 standard errors of their differences.
fn assert_unbiased(queries: &[Query], grid: &DensityGrid) {
    let mut sampler = grid.sampler();
    let difference = queries
        .iter()
        .map(|q| f64::from(sampler.stochastic(q.p_index, q.bits) - sampler.trilinear(q.p_index)));
    let (total, squares) = difference.fold((0.0, 0.0), |(s, s2), d| (s + d, s2 + d * d));
    assert!(
        total.abs() <= 5.0 * f64::sqrt(squares),
        "one tap is biased: sum of differences {total}, its standard error {}",
        squares.sqrt()
    );
}

fn bench(c: &mut Criterion) {
    let scene = assets::scene("cloud");
    let medium = scene.medium.as_ref().expect("the scene has a medium");
    let grid = medium.grid();
    let bounds = assets::index_bounds(grid);
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("data/cloud.vdb");
    let archive = Archive::open(&path).expect("the volume is part of the project");
    let tree = archive
        .load_density(0, &LoadOptions::default())
        .expect("the volume is valid")
        .tree;
    let dense = Dense::new(&tree, bounds);

    let mut stream = Stream::new(StreamKey::default());
    let patterns = [
        ("uniform", uniform(bounds, &mut stream)),
        ("ray", along_rays(&scene, medium, bounds, &mut stream)),
        ("path", along_paths(&scene, medium, &mut stream)),
    ];
    for (pattern, queries) in &patterns {
        let mut group = c.benchmark_group(format!("lookup/cloud/{pattern}"));
        group
            .throughput(Throughput::Elements(QUERY_COUNT as u64))
            .sample_size(20)
            .warm_up_time(Duration::from_millis(300))
            .measurement_time(Duration::from_secs(1));
        let mut sampler = grid.sampler();
        let mut time = |name: &str, expected: f64, read: &mut dyn FnMut() -> f64| {
            let total = read();
            assert!(expected > 0.0, "{pattern}/{name}: the places hold density");
            // The dense filter does not clamp: a few roundings of 2^-24 for each value.
            assert!(
                (total / expected - 1.0).abs() < 1e-6,
                "{pattern}/{name}: sum {total}, expected {expected}"
            );
            group.bench_function(name, |b| b.iter(&mut *read));
        };

        let queries = black_box(queries.as_slice());
        let stored = |q: &Query| dense.value(floor_to_voxel(q.p_index));
        let eight = |q: &Query| dense.trilinear(q.p_index);
        let one = |q: &Query| dense.stochastic(q.p_index, q.bits);
        let expected = [sum(queries, stored), sum(queries, eight), sum(queries, one)];
        assert_unbiased(queries, grid);
        time("stored", expected[0], &mut || {
            sum(queries, |q| sampler.value(floor_to_voxel(q.p_index)))
        });
        time("trilinear", expected[1], &mut || {
            sum(queries, |q| sampler.trilinear(q.p_index))
        });
        time("one tap", expected[2], &mut || {
            sum(queries, |q| sampler.stochastic(q.p_index, q.bits))
        });
        time("dense stored", expected[0], &mut || sum(queries, stored));
        time("dense trilinear", expected[1], &mut || sum(queries, eight));
        time("dense one tap", expected[2], &mut || sum(queries, one));
        group.finish();
    }
}

criterion_group!(benches, bench);
criterion_main!(benches);

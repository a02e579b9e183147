//! Encodings of values: what they cost in memory and in optical depth, and that bounds hold.

use std::path::Path;
use std::sync::atomic::AtomicBool;

use glam::{DVec3, IVec3};
use majorant::cache::{self, CacheFile, Contents, Source};
use majorant::grid::brick::{BRICK_DIM, BRICK_LEN, voxel_at};
use majorant::grid::{DensityGrid, Encoding, Storage, StorageKind, Tree, TreeBuilder, VoxelWalk};
use majorant::render::{NoProgress, render};
use majorant::scene::desc::unplaced;
use majorant::scene::{LoadOptions, LoadedVolume, SceneFile};
use majorant::space::IndexTransform;
use rand_core::{Rng as _, SeedableRng as _};
use rand_pcg::Pcg64Mcg;

const ENCODINGS: [(StorageKind, Encoding); 4] = [
    (StorageKind::F32, Encoding::F32),
    (StorageKind::F16, Encoding::F16),
    (StorageKind::U16, Encoding::U16),
    (StorageKind::U8, Encoding::U8),
];

/// A dense cube of `bricks`³ bricks from the origin on.
fn cube(bricks: i32, value: impl Fn(IVec3) -> f32) -> Tree<f32> {
    let mut builder = TreeBuilder::new(0.0);
    let mut values = Vec::new();
    for b in 0..bricks.pow(3) {
        let cell = IVec3::new(b / (bricks * bricks), b / bricks % bricks, b % bricks);
        builder.add_brick(cell * BRICK_DIM);
        values.extend((0..BRICK_LEN).map(|i| value(cell * BRICK_DIM + voxel_at(i))));
    }
    let active = vec![[u64::MAX; BRICK_LEN / 64]; builder.brick_count()];
    let mut tree = builder.finish(values, active);
    tree.drop_active_masks();
    tree
}

/// A number in [0, 1) for each voxel, and a wave: neighbouring bricks differ in range.
fn field(p: IVec3) -> f32 {
    let n = p.x.wrapping_mul(7919) ^ p.y.wrapping_mul(104_729) ^ p.z.wrapping_mul(1_299_709);
    let noise = (n.wrapping_mul(1_103_515_245) >> 8 & 0xffff) as f32 / 65536.0;
    let wave = (p.as_vec3() * 0.05).element_sum().sin();
    (noise + 2.0 * wave).max(0.0)
}

/// A direction and a start outside of a cube of edge `n`, so that the ray crosses it.
fn ray(rng: &mut Pcg64Mcg, n: f64) -> (DVec3, DVec3) {
    let mut u = || f64::from(rng.next_u32()) / 4_294_967_296.0;
    let through = DVec3::new(u(), u(), u()) * n;
    let direction = (DVec3::new(u(), u(), u()) - 0.5).normalize_or(DVec3::X);
    (through - direction * 4.0 * n, direction)
}

#[test]
fn no_lookup_leaves_its_bound_in_any_encoding() {
    for (_, encoding) in ENCODINGS {
        let transform = IndexTransform::uniform(1.0);
        let grid = DensityGrid::encoded(cube(4, field), transform, encoding, usize::MAX);
        let grid = grid.expect("no limit was set");
        let mut rng = Pcg64Mcg::seed_from_u64(1);
        let mut lookups = 0;
        for _ in 0..200 {
            let (origin, direction) = ray(&mut rng, 32.0);
            let mut sampler = grid.sampler();
            for segment in grid.traverse(origin, direction, f64::INFINITY) {
                for i in 0..4 {
                    let t = segment.t0 + (segment.t1 - segment.t0) * (f64::from(i) + 0.5) / 4.0;
                    let p = (origin + direction * t)
                        .max(segment.first.as_dvec3())
                        .min(segment.last.as_dvec3() + 1.0);
                    for value in [sampler.trilinear(p), sampler.stochastic(p, rng.next_u64())] {
                        let bound = segment.bound;
                        assert!(
                            (bound.min..=bound.max).contains(&value),
                            "{encoding}: {value} at {p}, bound {bound:?}"
                        );
                        lookups += 1;
                    }
                }
            }
        }
        assert!(lookups > 5000, "{lookups} lookups prove little");
    }
}

/// The depth along random rays, by exact integration of what is stored.
fn depths(grid: &DensityGrid, n: f64) -> Vec<f64> {
    let mut rng = Pcg64Mcg::seed_from_u64(2);
    let mut depth = |_| {
        let (origin, direction) = ray(&mut rng, n);
        let mut sampler = grid.sampler();
        let mut walk = grid.traverse(origin, direction, f64::INFINITY);
        let mut sum = 0.0;
        while walk.next().is_some() {
            let cells = VoxelWalk::new(&mut sampler, &walk);
            sum += cells.map(|c| c.integral()).sum::<f64>();
        }
        sum
    };
    (0..4000).map(&mut depth).collect()
}

/// 4000 rays measure an RMS to 2 %; the bounds are above by what rays and bricks differ.
#[test]
fn depths_are_off_by_no_more_than_is_said() {
    let transform = IndexTransform::uniform(1.0);
    let build = |encoding| {
        DensityGrid::encoded(cube(4, field), transform, encoding, usize::MAX).expect("no limit")
    };
    let exact = depths(&build(Encoding::F32), 32.0);
    for (kind, encoding) in &ENCODINGS[1..] {
        let storage = Storage {
            kind: *kind,
            ..Storage::lossless()
        };
        let stored = storage
            .choose(&cube(4, field), &transform)
            .expect("small values");
        let got = depths(&build(*encoding), 32.0);
        let errors = exact.iter().zip(&got).map(|(a, b)| (a - b).abs());
        let worst = errors.clone().fold(0.0, f64::max);
        let rms = (errors.map(|e| e * e).sum::<f64>() / 4000.0).sqrt();
        let said = stored.error;
        assert!(rms <= said.rms, "{encoding}: RMS {rms:e}, said {said:?}");
        assert!(worst <= said.worst, "{encoding}: worst {worst:e}, {said:?}");
        // A bound that is ten times too high would cost a factor of ten in memory.
        assert!(
            rms > said.rms / 10.0,
            "{encoding}: RMS {rms:e}, said {said:?}"
        );
    }
}

#[test]
fn nodes_and_bounds_take_a_quarter_of_the_values_at_most() {
    let ratio = |bricks: i32, encoding: Encoding| {
        let tree = cube(bricks, |p| (p.x & 15) as f32);
        let values = tree.brick_count() * BRICK_LEN * encoding.value_bytes();
        let transform = IndexTransform::uniform(1.0);
        let grid = DensityGrid::encoded(tree, transform, encoding, usize::MAX);
        grid.expect("no limit").memory_bytes() as f64 / values as f64
    };
    for (_, encoding) in ENCODINGS {
        // The seven empty nodes below a lone cube of 128³ weigh as much as a quarter of its
        // values in eight bits, so those get there at 256³.
        let bricks = if encoding == Encoding::U8 { 32 } else { 16 };
        let ratio = ratio(bricks, encoding);
        assert!(ratio <= 1.25, "{encoding}: {ratio}");
    }
}

fn write_cache(path: &Path, volume: &Path, kind: StorageKind) -> CacheFile {
    let archive = majorant::vdb::Archive::open(volume).expect("a volume of ours");
    let index = archive.find("density").expect("it has a density");
    let mut data = archive
        .load_density(index, &LoadOptions::default())
        .expect("it loads");
    let storage = Storage {
        kind,
        ..Storage::lossless()
    };
    let stored = storage.choose(&data.tree, &data.transform).expect("fits");
    let values = data.tree.take_values();
    let contents = Contents {
        nodes: data.tree,
        transform: data.transform,
        encoding: stored.encoding,
        source: Source {
            grid: "density".to_owned(),
            ..Source::default()
        },
        brick: |b: usize, _, out: &mut [f32]| {
            out.copy_from_slice(&values[b * BRICK_LEN..][..BRICK_LEN]);
        },
    };
    let bytes = cache::write(path, contents, usize::MAX).expect("temporary files can be written");
    let len = std::fs::metadata(path).expect("written").len();
    assert_eq!(len, bytes, "the length it says");
    CacheFile::open(path, usize::MAX).expect("as it was written")
}

#[test]
fn a_cache_file_renders_the_same_bits() {
    let scenes = Path::new(env!("CARGO_MANIFEST_DIR")).join("data/scenes");
    let folder = tempfile::tempdir().expect("room for temporary files");
    for (name, kind) in [
        ("cloud.toml", StorageKind::Lossless),
        ("smoke.toml", StorageKind::F32),
        ("smoke.toml", StorageKind::U16),
        ("smoke.toml", StorageKind::U8),
    ] {
        let mut file = SceneFile::read(&scenes.join(name)).expect("a scene of ours");
        file.desc.image.resolution = unplaced([48, 27]);
        file.desc.render.spp = unplaced(4);
        let volume = file.desc.volume[0].get_mut();
        volume.encoding = unplaced(kind);
        let vdb = scenes.join(volume.file.get_ref());
        let render_it = |file: &SceneFile| {
            let checked = file.check(u64::MAX).expect("right");
            let volumes: Vec<LoadedVolume> = checked
                .load_volumes(&LoadOptions::default(), &mut |_| {})
                .expect("loads");
            let scene = checked.into_scene(&volumes).expect("fits");
            let rendered = render(&scene, &NoProgress, &AtomicBool::new(false));
            assert_eq!(rendered.counts.bound_violations, 0, "bounds hold");
            (rendered.film.mean(), volumes[0].stored, rendered.counts)
        };
        let (from_vdb, stored, counts) = render_it(&file);
        let path = folder.path().join("volume.mjc");
        let cached = write_cache(&path, &vdb, kind);
        cached.verify_payload().expect("whole");
        assert_eq!(cached.stored().encoding, stored.encoding);
        let said = cached.stored().error.rms;
        assert!((said - stored.error.rms).abs() <= 1e-12 * said, "{said:e}");
        file.desc.volume[0].get_mut().file = unplaced(path);
        let (from_cache, _, cache_counts) = render_it(&file);
        assert_eq!(from_cache, from_vdb, "{name}, {kind:?}");
        assert_eq!(cache_counts, counts, "{name}, {kind:?}: the same walks");
    }
}

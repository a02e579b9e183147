//! Bounds and traversal against naive oracles, on random trees with tiles of all sizes.
//!
//! A tree is random voxels and tiles near a random corner of the index range; a ray is random,
//! or aligned with axes and lattice points on purpose. The oracle reads the tree voxel by voxel.

#![allow(
    clippy::cast_possible_truncation,
    clippy::cast_possible_wrap,
    clippy::cast_sign_loss,
    clippy::print_stdout,
    reason = "small numbers; what a test can see is printed"
)]

use crate::support::integrate;
use std::ops::ControlFlow;

use glam::{DAffine3, DVec3, IVec3};
use majorant::grid::{Bound, Cells, DensityGrid, Segment, Tree, TreeBuilder, VoxelWalk};
use majorant::space::IndexTransform;
use proptest::prelude::*;
use proptest::test_runner::RngSeed;

const NO_LIMIT: usize = usize::MAX;

/// What a random tree is made of; coordinates are relative to `base`.
#[derive(Clone, Debug)]
struct Recipe {
    base: IVec3,
    voxels: Vec<(IVec3, f32)>,
    /// (position, level 0..3, value): tiles of 8³, 128³ and 4096³ voxels.
    tiles: Vec<(IVec3, u8, f32)>,
}

fn build(recipe: &Recipe) -> Tree<f32> {
    let mut b = TreeBuilder::new(0.0_f32);
    for &(p, level, value) in &recipe.tiles {
        let p = recipe.base + p;
        // Slots by hand: the builder's own slot functions are not public.
        let slot = |cell_log2: i32, node_log2: i32| {
            let q = (p >> cell_log2) & ((1 << node_log2) - 1);
            ((q.x << (2 * node_log2)) | (q.y << node_log2) | q.z) as usize
        };
        match level {
            0 => {
                let node = b.lower_node(p);
                b.set_lower_tile(node, slot(3, 4), value, true);
            }
            1 => {
                let node = b.upper_node(p);
                b.set_upper_tile(node, slot(7, 5), value, true);
            }
            _ => b.set_root_tile(p, value, true),
        }
    }
    let (mut values, mut masks) = (Vec::new(), Vec::new());
    for &(p, value) in &recipe.voxels {
        let p = recipe.base + p;
        let i = b.add_brick(p);
        values.resize(b.brick_count() * 512, 0.0);
        masks.resize(b.brick_count(), [0; 8]);
        let q = p & 7;
        values[i * 512 + (q.x << 6 | q.y << 3 | q.z) as usize] = value;
    }
    b.finish(values, masks)
}

fn recipe() -> impl Strategy<Value = Recipe> {
    let near = || (-20..40_i32, -20..40_i32, -20..40_i32).prop_map(IVec3::from);
    let on_lattice = || {
        let c = || {
            prop_oneof![
                Just(-8),
                Just(-1),
                Just(0),
                Just(7),
                Just(8),
                Just(127),
                Just(128)
            ]
        };
        (c(), c(), c()).prop_map(IVec3::from)
    };
    let base = prop_oneof![
        Just(IVec3::ZERO),
        Just(IVec3::splat(1 << 30)),
        Just(IVec3::new(-(1 << 30), 4096, -128)),
        (-300..300_i32, -5000..5000_i32, -9..9_i32).prop_map(IVec3::from),
    ];
    let voxels = prop::collection::vec((prop_oneof![near(), on_lattice()], 0.1_f32..2.0), 0..12);
    let tiles = prop::collection::vec(
        (
            prop_oneof![near(), on_lattice()],
            0..3_u8,
            prop_oneof![Just(0.0_f32), 0.1_f32..2.0],
        ),
        0..4,
    );
    (base, voxels, tiles).prop_map(|(base, voxels, tiles)| Recipe {
        base,
        voxels,
        tiles,
    })
}

fn rays() -> impl Strategy<Value = (DVec3, DVec3)> {
    let component = || {
        prop_oneof![
            4 => -1.0..1.0_f64,
            1 => Just(0.0),
            1 => Just(-0.0),
            1 => Just(1.0),
            1 => Just(-1.0),
            1 => Just(1e-310),
            1 => Just(-1e-300),
            1 => Just(1e-9),
        ]
    };
    let start = || prop_oneof![2 => -60.0..80.0_f64, 1 => (-60..80_i32).prop_map(f64::from), 1 => (-8..10_i32).prop_map(|i| f64::from(i * 8))];
    (
        (start(), start(), start()),
        (component(), component(), component()),
    )
        .prop_map(|(o, d)| (DVec3::from(o), DVec3::from(d)))
        .prop_filter("a direction", |(_, d)| d.length() > 1e-3)
}

/// The eight values that a lookup at `p` can return.
fn taps(tree: &Tree<f32>, p: DVec3) -> [f32; 8] {
    let lo = p.floor().as_ivec3();
    std::array::from_fn(|i| {
        let corner = IVec3::new(i as i32 >> 2, i as i32 >> 1 & 1, i as i32 & 1);
        // A corner without weight is not read.
        let read = |axis: usize| corner[axis] == 0 || p[axis] > f64::from(lo[axis]);
        if read(0) && read(1) && read(2) {
            tree.probe(lo + corner).value
        } else {
            0.0
        }
    })
}

fn grid(tree: Tree<f32>) -> DensityGrid {
    DensityGrid::new(tree, IndexTransform::uniform(1.0), NO_LIMIT).expect("no limit was set")
}

fn clamp_to_cell(p: DVec3, s: &Segment) -> DVec3 {
    p.clamp(s.first.as_dvec3(), s.last.as_dvec3() + 1.0)
}

proptest! {
    #![proptest_config(ProptestConfig {
        cases: 256,
        rng_seed: RngSeed::Fixed(1),
        ..ProptestConfig::default()
    })]

    /// Segments are ordered and disjoint, lie in their cell, bound what can be read there, and
    /// leave out only what reads zero.
    #[test]
    fn segments_cover_everything_that_is_not_zero(recipe in recipe(), (start, d) in rays()) {
        let tree = build(&recipe);
        let o = recipe.base.as_dvec3() + start;
        let grid = grid(tree.clone());
        // Blocks where nothing is, where little is, and wherever they can be.
        let blocks = [f32::INFINITY, 0.0].map(|depth| grid.blocks(depth));
        let blocks: Vec<_> = blocks.into_iter().chain(grid.blocks_of_all_sizes(0.02)).collect();
        let kinds = [Cells::Bricks, Cells::Whole].into_iter().chain(blocks.iter().map(Cells::Blocks));
        for cells in kinds {
            let mut at = 0.0;
            let mut gaps = Vec::new();
            for (count, s) in grid.traverse_cells(o, d, f64::INFINITY, cells).enumerate() {
                prop_assert!(s.t0 >= at && s.t1 > s.t0, "order: {s:?} after {at}");
                prop_assert!(count < 10_000, "a walk of this size ends sooner");
                if s.t0 > at {
                    gaps.push((at, s.t0));
                }
                at = s.t1;
                let (lo, hi) = (s.first.as_dvec3(), s.last.as_dvec3() + 1.0);
                // A position has a rounding error of some ulps of the largest number involved.
                let ulp = 1e-14 * (1.0 + o.abs().max_element() + s.t1 * d.abs().max_element());
                for k in 1..8 {
                    let p = o + d * (s.t0 + (s.t1 - s.t0) * f64::from(k) / 8.0);
                    let inside = p.cmpge(lo - ulp).all()
                        && p.cmple(hi + ulp).all();
                    prop_assert!(inside, "{p} is not in the cell of {s:?}");
                    let p = clamp_to_cell(p, &s);
                    for v in taps(&tree, p).into_iter().filter(|&v| v != 0.0) {
                        prop_assert!(v <= s.bound.max && v >= s.bound.min, "{v} at {p} in {s:?}");
                    }
                    let v = grid.sampler().trilinear(p);
                    prop_assert!(v <= s.bound.max && v >= s.bound.min, "{v} at {p} in {s:?}");
                }
            }
            gaps.push((at, at + 50.0));
            for (a, b) in gaps {
                for k in 1..32 {
                    let p = o + d * (a + (b - a) * f64::from(k) / 32.0);
                    // At large offsets a point a rounding error inside a cell may read its face.
                    let v = grid.sampler().trilinear(p);
                    prop_assert!(v < 1e-5, "{v} at {p} in the gap {a} to {b}");
                }
            }
        }
    }

    /// A walk that turns goes on as a new walk from there does.
    #[test]
    fn a_turn_is_a_new_start(recipe in recipe(), (start, d) in rays(), (_, next) in rays(), part in 0.0..1.0_f64) {
        let grid = grid(build(&recipe));
        let o = recipe.base.as_dvec3() + start;
        let blocks = grid.blocks_of_all_sizes(0.02);
        let kinds = [Cells::Bricks, Cells::Whole].into_iter();
        for cells in kinds.chain(blocks.iter().map(Cells::Blocks)) {
            let mut walk = grid.traverse_cells(o, d, 1e4, cells);
            while let Some(s) = walk.next() {
                let t = s.t0 + part * (s.t1 - s.t0);
                let mut turned = walk.clone();
                turned.turn(t, next, 100.0);
                let fresh = grid.traverse_cells(o + d * t, next, 100.0, cells);
                // Lengths up to rounding at the start, where one may see a sliver of another cell.
                let ulp = 1e-12 * (1.0 + o.abs().max_element() + s.t1 * d.abs().max_element());
                let slivers = 20.0 * ulp / next.abs().min_element().max(1e-12);
                // A new walk begins and ends at the box of all that is not zero; one that turns goes on to
                // the end of its cell, which may be larger.
                let clip = grid.occupied().and_then(|b| b.intersect(o + d * t, next));
                let (enter, leave) = clip.unwrap_or((0.0, 0.0));
                let measure = |walk: &mut dyn Iterator<Item = Segment>| {
                    walk.fold((0.0, 0.0), |(length, depth), s| {
                        let l = (s.t1.min(leave) - s.t0.max(enter)).max(0.0);
                        (length + l, depth + l * f64::from(s.bound.max))
                    })
                };
                let (a, b) = (measure(&mut turned), measure(&mut fresh.into_iter()));
                if slivers < 1e-3 {
                    prop_assert!((a.0 - b.0).abs() <= slivers + 1e-9, "lengths {a:?} and {b:?} after {s:?}");
                    prop_assert!((a.1 - b.1).abs() <= 100.0 * slivers + 1e-7, "depths {a:?} and {b:?} after {s:?}");
                }
            }
        }
    }

    /// What is decided by a cell's bounds is what its value decides, at thresholds that are values, next
    /// to them, and between.
    #[test]
    fn decisions_by_bounds_are_those_by_values(recipe in recipe(), (start, d) in rays(), seed in any::<u64>()) {
        let grid = grid(build(&recipe));
        let o = recipe.base.as_dvec3() + start;
        let blocks = grid.blocks_of_all_sizes(0.0);
        let kinds = [Cells::Bricks, Cells::Whole].into_iter();
        for cells in kinds.chain(blocks.iter().map(Cells::Blocks)) {
            let mut walk = grid.traverse_cells(o, d, 1e4, cells);
            let mut sampler = grid.sampler();
            let mut bits = seed;
            for _ in 0..20 {
                let Some(s) = walk.next() else { break };
                for k in 0..8 {
                    bits = bits.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
                    let t = s.t0 + (s.t1 - s.t0) * f64::from(k) / 8.0;
                    let value = sampler.stochastic_at(&walk, t, bits);
                    let Bound { min, max, .. } = s.bound;
                    for threshold in [min, max, value, value.next_down(), value.next_up(), 0.5 * (min + max)] {
                        let accepts = |v: f32| threshold <= v;
                        match sampler.stochastic_decision(&walk, t, bits, accepts) {
                            ControlFlow::Break(decided) => prop_assert_eq!(decided, accepts(value), "{} at {}", value, t),
                            ControlFlow::Continue(read) => prop_assert_eq!(read, value),
                        }
                    }
                }
            }
        }
    }

    /// The cubics of all voxel cells add up to the naive integral, and tile their segments.
    #[test]
    fn voxel_cells_add_up_to_the_naive_integral(recipe in recipe(), (start, d) in rays()) {
        let tree = build(&recipe);
        let o = recipe.base.as_dvec3() + start;
        let grid = grid(tree.clone());
        let mut walk = grid.traverse(o, d, 100.0);
        for _ in 0..40 {
            let Some(s) = walk.next() else { break };
            let mut sampler = grid.sampler();
            let (mut at, mut sum) = (s.t0, 0.0);
            for cubic in VoxelWalk::new(&mut sampler, &walk) {
                prop_assert!(cubic.t0 == at && cubic.t1 >= at, "{cubic:?} after {at}");
                at = cubic.t1;
                sum += cubic.integral();
            }
            prop_assert_eq!(at, s.t1);
            let expected = integrate(&tree, (o, d), (s.t0, s.t1));
            // Far from the origin a point is known to some ulps; values are below 10.
            let ulp = 1e-13 * (1.0 + o.abs().max_element() + s.t1 * d.abs().max_element());
            prop_assert!((sum - expected).abs() < 100.0 * ulp * (1.0 + s.t1 - s.t0), "{sum}, not {expected}, in {s:?}");
        }
    }

    /// Each cell's minimum and maximum are attained by a value that its filter reads, if the
    /// cell is an 8³ one: the bounds are tight as well as safe.
    #[test]
    fn bounds_of_small_cells_are_tight(recipe in recipe(), (start, d) in rays()) {
        let tree = build(&recipe);
        let grid = grid(tree.clone());
        let o = recipe.base.as_dvec3() + start;
        for s in grid.traverse(o, d, 200.0).filter(|s| s.last - s.first == IVec3::splat(7)).take(4) {
            let mut range = (f32::INFINITY, f32::NEG_INFINITY);
            for i in 0..9 * 9 * 9 {
                let v = tree.probe(s.first + IVec3::new(i / 81, i / 9 % 9, i % 9)).value;
                range = (range.0.min(v), range.1.max(v));
            }
            prop_assert_eq!((s.bound.min, s.bound.max), range);
        }
    }

    /// An affine map changes where a ray is, not what it meets.
    #[test]
    fn parameters_are_shared_between_maps(recipe in recipe(), (start, d) in rays()) {
        let map = DAffine3::from_scale_rotation_translation(
            DVec3::new(0.5, -2.0, 0.25),
            glam::DQuat::from_rotation_y(0.7),
            DVec3::new(10.0, -3.0, 2.0),
        );
        let transform = IndexTransform::from_world_from_index(map).expect("invertible");
        let grid = DensityGrid::new(build(&recipe), transform, NO_LIMIT).expect("no limit");
        let o = recipe.base.as_dvec3() + start;
        let o_again = transform.index_from_world().transform_point3(map.transform_point3(o));
        let d_again = transform.index_from_world().transform_vector3(map.transform_vector3(d));
        let length = |o, d| grid.traverse(o, d, 1e4).map(|s| s.t1 - s.t0).sum::<f64>();
        // Compared only where the map's rounding cannot move the ray across a face.
        if recipe.base.abs().max_element() < 10_000 && d.abs().min_element() > 1e-3 {
            let (a, b) = (length(o, d), length(o_again, d_again));
            prop_assert!((a - b).abs() <= 1e-6 * (1.0 + a) || start.fract().min_element() == 0.0,
                "{a} against {b}");
        }
    }
}

#[test]
fn an_axis_aligned_ray_crosses_a_brick_where_one_expects() {
    let tree = Tree::from_voxels(
        0.0,
        (0..512).map(|i| (IVec3::new(i / 64, i / 8 % 8, i % 8), 1.0)),
    );
    let grid = grid(tree);
    let s: Vec<_> = grid
        .traverse(DVec3::new(-20.0, 3.0, 3.0), DVec3::X, 1e9)
        .collect();
    // The cell below reads the first layer: density rises from 0 at -1 to 1 at 0.
    let expected = [(12.0, 20.0, 0.0), (20.0, 28.0, 0.0)];
    let got: Vec<_> = s.iter().map(|s| (s.t0, s.t1, s.bound.min)).collect();
    assert_eq!(got, expected, "two cells of 8, both with minimum 0");
    assert_eq!(
        s[1].bound,
        Bound {
            min: 0.0,
            max: 1.0,
            mean: 1.0
        }
    );
}

#[test]
fn empty_space_is_crossed_in_large_steps() {
    // A voxel, then 40,000 empty voxels, then another: 13 root cells, not 5,000 bricks.
    let far = IVec3::new(40_000, 4, 4);
    let tree = Tree::from_voxels(0.0, [(IVec3::new(4, 4, 4), 1.0), (far, 2.0)]);
    let grid = grid(tree);
    let o = DVec3::new(-5.0, 4.0, 4.0);
    let s: Vec<_> = grid.traverse(o, DVec3::X, f64::INFINITY).collect();
    // The far voxel is the first of its brick, so the cell below reads it, too.
    let bounds: Vec<_> = s.iter().map(|s| (s.first.x, s.bound.max)).collect();
    assert_eq!(bounds, [(0, 1.0), (39_992, 2.0), (40_000, 2.0)]);
}

#[test]
fn a_limit_is_an_error_before_memory_is_taken() {
    let tree = Tree::from_voxels(0.0, [(IVec3::ZERO, 1.0)]);
    let error = DensityGrid::new(tree, IndexTransform::uniform(1.0), 1 << 20).unwrap_err();
    assert_eq!(error.limit, 1 << 20);
    assert!(
        error.needed > 1 << 20,
        "a lone voxel at the origin touches eight root cells"
    );
}

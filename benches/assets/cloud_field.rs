//! A procedural cloud at any resolution: one field, sampled more or less finely.
//!
//! An ellipsoid with a fractal edge: a quadratic profile plus six octaves of value noise, the
//! finest with 128 periods across the unit cube, cut at zero. About a quarter of the 8³ bricks
//! are occupied at any resolution. Bricks are made directly, never a dense array, so 1024³
//! takes 1.2 GB and not 4.

use glam::{DVec3, IVec3};
use majorant::grid::brick::{BRICK_DIM, BRICK_LEN, voxel_at};
use majorant::grid::{Tree, TreeBuilder};
use rayon::prelude::*;

/// Half axes of the ellipsoid, in the unit cube.
const RADII: DVec3 = DVec3::new(0.43, 0.35, 0.29);
/// Noise is added up to this much, in units of the profile's peak.
const NOISE: f64 = 0.55;
const OCTAVE_COUNT: u32 = 6;
const FIRST_FREQUENCY: f64 = 4.0;

/// Returns the density at a point of the unit cube, in [0, 1].
fn density(p: DVec3) -> f64 {
    let q = (p - 0.5) / RADII;
    let profile = 1.0 - q.length_squared();
    // The noise is in (-1, 1): nothing is left to decide.
    if profile <= -NOISE {
        return 0.0;
    }
    (profile + NOISE * fractal_noise(p)).clamp(0.0, 1.0)
}

/// Returns value noise in (-1, 1), each octave half as strong as the one before.
fn fractal_noise(p: DVec3) -> f64 {
    let (mut sum, mut weight, mut total) = (0.0, 1.0, 0.0);
    for octave in 0..OCTAVE_COUNT {
        let frequency = FIRST_FREQUENCY * f64::from(1 << octave);
        sum += weight * value_noise(p * frequency, octave);
        total += weight;
        weight *= 0.5;
    }
    sum / total
}

/// Interpolates random numbers in (-1, 1) at the integer points.
fn value_noise(p: DVec3, octave: u32) -> f64 {
    let floor = p.floor();
    let f = p - floor;
    let f = f * f * (3.0 - 2.0 * f);
    let corner = |i: i32| {
        let at = floor.as_ivec3() + IVec3::new(i >> 2, i >> 1 & 1, i & 1);
        let packed = u64::from(at.x.cast_unsigned()) << 42
            ^ u64::from(at.y.cast_unsigned()) << 21
            ^ u64::from(at.z.cast_unsigned());
        let hash = (packed ^ u64::from(octave) << 60).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        let hash = (hash ^ hash >> 29).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        (hash >> 32) as f64 * (2.0 / 4_294_967_296.0) - 1.0
    };
    let lerp = |a: f64, b: f64, t: f64| a + (b - a) * t;
    let along_z = |i: i32| lerp(corner(i), corner(i + 1), f.z);
    let along_yz = |i: i32| lerp(along_z(i), along_z(i + 2), f.y);
    lerp(along_yz(0), along_yz(4), f.x)
}

/// Samples the cloud with `resolution`³ voxels, a multiple of 8; voxel `i` is at `i / resolution`.
pub(crate) fn cloud_tree(resolution: i32) -> Tree<f32> {
    let cells = resolution / BRICK_DIM;
    let mut builder = TreeBuilder::new(0.0);
    let mut values = Vec::new();
    for x in 0..cells {
        // A layer at a time, so that no second copy of the whole is ever held.
        let layer: Vec<_> = (0..cells * cells)
            .into_par_iter()
            .filter_map(|yz| {
                let origin = IVec3::new(x, yz / cells, yz % cells) * BRICK_DIM;
                brick(origin, resolution).map(|brick| (origin, brick))
            })
            .collect();
        for (origin, brick) in layer {
            builder.add_brick(origin);
            values.extend_from_slice(&brick);
        }
    }
    values.shrink_to_fit();
    let active = vec![[u64::MAX; BRICK_LEN / 64]; builder.brick_count()];
    let mut tree = builder.finish(values, active);
    tree.drop_active_masks();
    tree
}

/// Returns the values of the brick at `origin`; `None` where all are zero.
fn brick(origin: IVec3, resolution: i32) -> Option<[f32; BRICK_LEN]> {
    let spacing = 1.0 / f64::from(resolution);
    // Anything in the ellipsoid that the noise can reach?
    let (low, high) = (origin.as_dvec3(), (origin + BRICK_DIM).as_dvec3());
    let nearest = DVec3::splat(0.5).clamp(low * spacing, high * spacing);
    if ((nearest - 0.5) / RADII).length_squared() >= 1.0 + NOISE {
        return None;
    }
    #[expect(clippy::cast_possible_truncation, reason = "densities are f32")]
    let value = |i| density((origin + voxel_at(i)).as_dvec3() * spacing) as f32;
    let values: [f32; BRICK_LEN] = std::array::from_fn(value);
    values.iter().any(|&v| v > 0.0).then_some(values)
}

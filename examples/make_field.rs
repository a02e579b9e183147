//! Writes a cache file of a procedural cloud of any size, brick by brick: it is never in memory.
//!
//! ```sh
//! cargo run --release --example make_field -- 1024 f16 /scratch/field.mjc
//! ```
//!
//! For trying out volumes that are larger than memory (`tests/larger_than_memory.sh`). The cloud is a
//! ball of diameter 1 in world units, with lumps; its density is at most 1 and the same function of
//! space at every resolution.

use std::path::Path;

use glam::{DAffine3, DVec3, IVec3};
use majorant::cache::{Contents, Source, write};
use majorant::grid::brick::{BRICK_DIM, voxel_at};
use majorant::grid::{StorageKind, TreeBuilder};
use majorant::space::IndexTransform;

const USAGE: &str = "usage: make_field RESOLUTION f32|f16|u16|u8 OUT.mjc";

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let args: Vec<_> = std::env::args().skip(1).collect();
    let [resolution, encoding, path] = &args[..] else {
        return Err(USAGE.into());
    };
    let resolution: i32 = resolution.parse()?;
    let named = StorageKind::ALL.iter().find(|k| k.name() == encoding);
    let encoding = named.and_then(|k| k.fixed()).ok_or(USAGE)?;
    let voxel_size = f64::from(resolution).recip();

    // Bricks that the ball reaches, in layers across x as files have them.
    let mut builder = TreeBuilder::new(0.0);
    let bricks = 0..(resolution / BRICK_DIM).max(1);
    for (x, y) in bricks
        .clone()
        .flat_map(|x| bricks.clone().map(move |y| (x, y)))
    {
        for z in bricks.clone() {
            let origin = IVec3::new(x, y, z) * BRICK_DIM;
            let (low, high) = (origin.as_dvec3(), (origin + BRICK_DIM).as_dvec3());
            let nearest = DVec3::splat(0.5).clamp(low * voxel_size, high * voxel_size);
            if nearest.distance_squared(DVec3::splat(0.5)) < 0.25 {
                builder.add_brick(origin);
            }
        }
    }
    let placed = DAffine3::from_translation(DVec3::splat(-0.5))
        * DAffine3::from_scale(DVec3::splat(voxel_size));
    let contents = Contents {
        nodes: builder.finish_nodes(),
        transform: IndexTransform::from_world_from_index(placed).ok_or(USAGE)?,
        encoding,
        source: Source {
            file: format!("make_field {resolution}"),
            grid: "density".to_owned(),
            ..Source::default()
        },
        brick: |_index: usize, origin: IVec3, out: &mut [f32]| {
            for (i, value) in out.iter_mut().enumerate() {
                *value = density((origin + voxel_at(i)).as_dvec3() * voxel_size);
            }
        },
    };
    write(Path::new(path), contents, usize::MAX)?;
    Ok(())
}

/// Returns the density at a point of the unit cube.
#[expect(clippy::cast_possible_truncation, reason = "densities are f32")]
fn density(p: DVec3) -> f32 {
    let q = 2.0 * p - 1.0;
    let lumps = |frequency: f64| {
        let w = q * frequency;
        (w.x + w.y.cos()).sin() * (w.y + w.z.cos()).sin() * (w.z + w.x.cos()).sin()
    };
    let ball = 1.0 - q.length_squared();
    (ball * (0.5 + 0.35 * lumps(9.0) + 0.15 * lumps(31.0))).max(0.0) as f32
}

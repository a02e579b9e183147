//! Writes what the comparison with other renderers needs of a scene: its grid as a dense array,
//! and the exact optical depth of each pixel.
//!
//! ```sh
//! cargo run --release --example peers_export -- data/scenes/cloud.toml FOLDER
//! ```
//!
//! * `density.vol`: Mitsuba's grid format, version 3: one channel of `f32`, x fastest. The box
//!   is that of the cells around the samples, in world space: sample i sits at (i + ½) / n.
//! * `depth.f32`: optical depth along the ray through the middle of each pixel, row by row from
//!   the top, `f32`, little-endian: which pixels see the medium.
//!
//! Assumes that the transform is a scale and a shift, as in all comparison scenes; refuses others.

#![expect(clippy::print_stderr, reason = "a program for the command line")]

use std::fs::File;
use std::io::{BufWriter, Write as _};
use std::path::Path;
use std::process::ExitCode;

use glam::{DMat3, DVec2, IVec3};
use majorant::medium::Medium;
use majorant::scene::{LoadOptions, Scene, SceneFile};
use majorant::space::{Aabb, floor_to_voxel};
use majorant::stats::Counts;

type Outcome<T> = Result<T, Box<dyn std::error::Error>>;

fn main() -> ExitCode {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let [scene, folder] = &args[..] else {
        eprintln!("usage: peers_export SCENE.toml FOLDER");
        return ExitCode::from(2);
    };
    match export(scene.as_ref(), folder.as_ref()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(e) => {
            eprintln!("{scene}: {e}");
            ExitCode::FAILURE
        }
    }
}

fn export(scene: &Path, folder: &Path) -> Outcome<()> {
    let scene = load(scene)?;
    let medium = scene.media.first().ok_or("the scene has no medium")?;
    std::fs::create_dir_all(folder)?;
    write_dense(medium, &folder.join("density.vol"))?;
    write_depth(&scene, medium, &folder.join("depth.f32"))
}

fn load(path: &Path) -> Outcome<Scene> {
    let options = LoadOptions::default();
    let checked = SceneFile::read(path)?.check(options.max_memory_bytes)?;
    let volumes = checked.load_volumes(&options, &mut |_| {})?;
    Ok(checked.into_scene(&volumes)?)
}

/// Writes the stored values of the occupied box.
fn write_dense(medium: &Medium, path: &Path) -> Outcome<()> {
    let grid = medium.grid();
    let transform = grid.transform();
    let to_world = transform.world_from_index();
    let size = transform.voxel_size();
    let scale = DMat3::from_diagonal(size);
    if !to_world
        .matrix3
        .abs_diff_eq(scale, 1e-12 * size.max_element())
    {
        return Err("its grid is rotated or sheared, expected a scale and a shift".into());
    }
    let world = grid.world_bounds().ok_or("its grid is empty")?;
    let to_index = transform.index_from_world();
    let low = floor_to_voxel(to_index.transform_point3(world.min).round());
    let high = floor_to_voxel(to_index.transform_point3(world.max).round());
    // The cells of the box read one layer beyond it, which is zero or outside of the medium.
    let dim = high - low + IVec3::ONE;
    let bounds = Aabb {
        min: to_world.transform_point3(low.as_dvec3() - 0.5),
        max: to_world.transform_point3(high.as_dvec3() + 0.5),
    };

    let mut out = BufWriter::new(File::create(path)?);
    out.write_all(b"VOL\x03")?;
    for n in [1, dim.x, dim.y, dim.z, 1] {
        out.write_all(&n.to_le_bytes())?;
    }
    let corners = [bounds.min.as_vec3(), bounds.max.as_vec3()];
    for x in corners.iter().flat_map(glam::Vec3::to_array) {
        out.write_all(&x.to_le_bytes())?;
    }
    let mut sampler = grid.sampler();
    for z in 0..dim.z {
        for y in 0..dim.y {
            for x in 0..dim.x {
                let value = sampler.value(low + IVec3::new(x, y, z));
                out.write_all(&value.to_le_bytes())?;
            }
        }
    }
    Ok(out.flush()?)
}

/// Writes the optical depth of the ray through the middle of each pixel.
fn write_depth(scene: &Scene, medium: &Medium, path: &Path) -> Outcome<()> {
    let mut out = BufWriter::new(File::create(path)?);
    let size = DVec2::new(f64::from(scene.width), f64::from(scene.height));
    let mut counts = Counts::default();
    for y in 0..scene.height {
        for x in 0..scene.width {
            let middle = DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5);
            let ray = scene.camera.ray(middle / size);
            let mut walk = medium.ray(&ray, f64::INFINITY);
            let mut depth = 0.0;
            while walk.next_segment().is_some() {
                depth += walk.optical_depth(&mut counts);
            }
            #[expect(clippy::cast_possible_truncation, reason = "a threshold reads it")]
            out.write_all(&(depth as f32).to_le_bytes())?;
        }
    }
    Ok(out.flush()?)
}

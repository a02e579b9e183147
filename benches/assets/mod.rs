//! The named assets that the benches measure: scenes of the project's own data.
//!
//! Everything is part of the repository; a missing file is a panic.

#![allow(dead_code, reason = "no bench uses all of it")]
#![allow(
    clippy::print_stderr,
    reason = "numbers that are not times are printed once"
)]

pub(crate) mod arrays;
pub(crate) mod cloud_field;
pub(crate) mod cpu_clock;
pub(crate) mod walk;

use std::path::Path;

use majorant::grid::{DensityGrid, Tree};
use majorant::scene::{LoadOptions, Scene, SceneFile};
use majorant::space::Aabb;
use majorant::vdb::Archive;

/// Scenes in `data/scenes`, whose volumes are `data/<name>.vdb`: a dense cloud of scattered
/// light, optical thickness up to 59, and a thin plume, optical thickness up to 3.
pub(crate) const SCENES: [&str; 2] = ["cloud", "smoke"];

/// Loads `data/scenes/<name>.toml` with its volume.
pub(crate) fn scene(name: &str) -> Scene {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("data/scenes/{name}.toml"));
    let file = SceneFile::read(&path).expect("the scene is part of the project");
    let checked = file.check(u64::MAX).expect("the scene is valid");
    let volumes = checked
        .load_volumes(&LoadOptions::default(), &mut |_| {})
        .expect("the volume is part of the project");
    checked
        .into_scene(&volumes)
        .expect("the scene fits its volume")
}

/// Loads the values of `data/<name>.vdb`.
pub(crate) fn tree(name: &str) -> Tree<f32> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("data/{name}.vdb"));
    let archive = Archive::open(&path).expect("the volume is part of the project");
    let data = archive.load_density(0, &LoadOptions::default());
    data.expect("the volume is valid").tree
}

/// The box that holds all density, in index space; its corners are multiples of 8.
pub(crate) fn index_bounds(grid: &DensityGrid) -> Aabb {
    let to_index = grid.transform().index_from_world();
    let world = grid.world_bounds().expect("the assets are not empty");
    let index = world
        .corners()
        .map(|p| to_index.transform_point3(p).round());
    index.into_iter().fold(Aabb::EMPTY, Aabb::including)
}

/// Prints a number that criterion does not measure, in the form that `benches/record.py` collects.
pub(crate) fn note(bench: &str, metric: &str, value: f64, unit: &str) {
    eprintln!("note\t{bench}\t{metric}\t{value:.6}\t{unit}");
}

//! Albedo from grids.
//!
//! * A field of one value is that albedo, bit by bit.
//! * An albedo that varies: the path integrator against the analog one, with a field of other
//!   resolution than the density's, and moved with it.
//! * From scene files: what three scalar grids hold is what is read; components of vectors are those
//!   of the exact values, none below zero.

#![allow(clippy::print_stdout, reason = "what a test can see is printed")]

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use crate::agreement::agree;
use glam::{DAffine3, DVec3, IVec3};
use majorant::camera::Camera;
use majorant::field::Field;
use majorant::film::Film;
use majorant::grid::{DensityGrid, Tree};
use majorant::integrator::{IntegratorKind, TransportSettings};
use majorant::light::Lights;
use majorant::medium::Medium;
use majorant::phase::Phase;
use majorant::render::{NoProgress, render};
use majorant::sampling::SamplerKind;
use majorant::scene::{LoadOptions, Scene, SceneFile};
use majorant::space::IndexTransform;
use majorant::spectrum::Rgb;
use majorant::vdb::{Archive, Grid};

fn grid(r: i32, size: f64, value: impl Fn(IVec3) -> f32) -> Arc<DensityGrid> {
    let n = 2 * r;
    let at = |i: i32| IVec3::new(i / (n * n), i / n % n, i % n) - r;
    let voxels = (0..n * n * n).map(at).map(|p| (p, value(p)));
    let tree = Tree::from_voxels(0.0, voxels.filter(|(_, v)| *v > 0.0));
    let transform = IndexTransform::uniform(size);
    Arc::new(DensityGrid::new(tree, transform, usize::MAX).expect("no limit was set"))
}

fn cloud(albedo: Rgb) -> Medium {
    let density = grid(20, 0.06, |p| 1.0 - p.as_vec3().length() / 17.0);
    Medium::new(density, 8.0, albedo, Phase::HenyeyGreenstein { g: 0.4 })
}

fn film(medium: Medium, integrator: IntegratorKind, spp: u32, seed: u64) -> Film {
    let eye = DVec3::new(0.5, -4.5, 0.8);
    let scene = Scene {
        width: 48,
        height: 32,
        spp,
        seed,
        frame: 0,
        aovs: vec![],
        camera: Camera::look_at(eye, DVec3::ZERO, DVec3::Z, 0.6, 1.5).expect("a view"),
        media: vec![medium],
        lights: Lights {
            environment: Rgb([0.5, 0.8, 1.0]),
            ..Lights::default()
        },
        transport: TransportSettings {
            integrator,
            // Its variance is that of the noise.
            sampler: SamplerKind::Independent,
            ..TransportSettings::default()
        },
    };
    let rendered = render(&scene, &NoProgress, &AtomicBool::new(false));
    assert_eq!(rendered.counts.non_finite_samples, 0, "samples are finite");
    rendered.film
}

#[test]
fn a_constant_field_is_a_constant() {
    let field = Field::colour([0.9, 0.5, 0.25].map(|a| grid(24, 0.06, move |_| a)));
    for kind in [IntegratorKind::Path, IntegratorKind::Analog] {
        let constant = film(cloud(Rgb([0.9, 0.5, 0.25])), kind, 16, 1);
        let coloured = film(cloud(Rgb::BLACK).coloured(field.clone(), 1.0), kind, 16, 1);
        for (p, q) in constant.pixels().iter().zip(coloured.pixels()) {
            for c in 0..3 {
                assert!(
                    (p.mean[c] - q.mean[c]).abs() < 1e-5,
                    "{kind:?}: {p:?}, {q:?}"
                );
            }
        }
    }
}

#[test]
fn path_and_analog_agree_where_the_albedo_varies() {
    let wave = |shift: f32| {
        grid(16, 0.1, move |p| {
            0.5 + 0.5 * (p.as_vec3() * 0.4).element_sum().sin().abs() - 0.2 * shift
        })
    };
    let field = Field::colour([0.0, 1.0, 2.0].map(wave));
    let map = DAffine3::from_rotation_x(0.5) * DAffine3::from_scale(DVec3::new(1.0, 1.2, 0.9));
    for medium in [
        cloud(Rgb::WHITE).coloured(field.clone(), 1.2),
        cloud(Rgb::WHITE)
            .coloured(field, 0.7)
            .moved(map)
            .expect("a map"),
    ] {
        let analog = film(medium.clone(), IntegratorKind::Analog, 1024, 1);
        let path = film(medium, IntegratorKind::Path, 256, 2);
        agree("a varying albedo", 0.02, &path, &analog);
    }
}

#[test]
fn grids_of_a_file_are_its_albedo() {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("data/fire/campfire_0026.vdb");
    let archive = Archive::open(&file).expect("the project's file");
    let options = LoadOptions::default();
    let value = |name: &str, p: IVec3| {
        let index = archive.find(name).expect("a grid of the file");
        let data = archive.load_density(index, &options).expect("it loads");
        let world = data
            .transform
            .world_from_index()
            .transform_point3(p.as_dvec3());
        (data.tree.probe(p).value, world)
    };
    let scene = |albedo: &str| {
        let text = format!(
            "[camera]\nposition = [1, -7, 1.5]\nlook_at = [1, 1, 1.5]\n[[volume]]\n\
             file = \"fire/campfire_0026.vdb\"\nalbedo = {albedo}\n"
        );
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("data/scene.toml");
        let checked = SceneFile::parse(&path, text)
            .expect("TOML")
            .check(u64::MAX)
            .expect("right");
        let volumes = checked
            .load_volumes(&options, &mut |_| {})
            .expect("it loads");
        checked.into_scene(&volumes).expect("it fits")
    };
    let p = IVec3::new(28, 28, 12);
    let three = scene("{ grids = [\"density\", \"flame\", \"temperature\"], scale = 0.1 }");
    for c in 0..3 {
        let (expected, world) = value(["density", "flame", "temperature"][c], p);
        let got = three.media[0].albedo_at(world).0[c];
        // Voxels of 16 bit between the least and the largest of a brick.
        assert!(
            (got - 0.1 * expected).abs() < 1e-4,
            "channel {c}: {got}, not {expected} / 10"
        );
        assert!(expected > 0.0, "something is there");
    }
}

#[test]
fn components_are_those_of_the_vectors() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures/vdb");
    let archive = Archive::open(&folder.join("vec3s_only_zip.vdb")).expect("a fixture");
    let options = LoadOptions::default();
    let Ok(Grid::Vec3F(exact)) = archive.load(0, &options) else {
        panic!("vectors");
    };
    for c in 0..3 {
        let component = archive.load_component(0, c, &options).expect("it loads");
        for &origin in exact.tree.brick_origins() {
            for i in 0..64 {
                let p = origin + IVec3::new(i / 16, i / 4 % 4, i % 4);
                let expected = exact.tree.probe(p).value[c].max(0.0);
                assert_eq!(
                    component.tree.probe(p).value,
                    expected,
                    "component {c} at {p}"
                );
            }
        }
    }
}

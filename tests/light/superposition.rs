//! Several media in one scene.
//!
//! * Two copies of half the density are one of the full: sun, sky, thick and thin.
//! * Media that differ in everything and overlap, and one nested in another: the path integrator
//!   against the analog one, and exact camera rays where nothing scatters.
//! * A medium that is turned, stretched and mirrored is the same as the grid so transformed.
//! * From a scene file: a file that occurs twice is loaded once, and stands where it should.
//!
//! Blocks of 8 × 8 pixels, |z| < 5, and the mean of z² is 1: the smallest bias of the image's mean
//! that is seen is printed, and below 5 %.

#![allow(clippy::print_stdout, reason = "what a test can see is printed")]

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use crate::agreement::agree;
use glam::{DAffine3, DQuat, DVec3, IVec3};
use majorant::camera::Camera;
use majorant::film::Film;
use majorant::grid::{DensityGrid, Tree};
use majorant::integrator::{IntegratorKind, TransportSettings};
use majorant::light::{DistantLight, Lights};
use majorant::medium::Medium;
use majorant::phase::Phase;
use majorant::render::{NoProgress, render};
use majorant::sampling::SamplerKind;
use majorant::scene::{LoadOptions, Scene, SceneFile};
use majorant::space::IndexTransform;
use majorant::spectrum::Rgb;

fn tree() -> Tree<f32> {
    let mut voxels = Vec::new();
    for i in 0..40 * 40 * 40 {
        let p = IVec3::new(i / 1600, i / 40 % 40, i % 40) - 20;
        let q = p.as_vec3();
        let lumps = (q.x * 0.5).sin() * (q.y * 0.4).cos() + (q.z * 0.6).sin();
        let density = 1.0 - q.length() / 17.0 + 0.4 * lumps;
        if density > 0.0 {
            voxels.push((p, density));
        }
    }
    Tree::from_voxels(0.0, voxels)
}

fn grid() -> Arc<DensityGrid> {
    let transform = IndexTransform::uniform(0.06);
    Arc::new(DensityGrid::new(tree(), transform, usize::MAX).expect("no limit was set"))
}

fn scene(media: Vec<Medium>, lights: &Lights, integrator: IntegratorKind) -> Scene {
    let eye = DVec3::new(0.5, -4.5, 0.8);
    Scene {
        width: 48,
        height: 32,
        spp: 256,
        seed: 0,
        frame: 0,
        aovs: vec![],
        camera: Camera::look_at(eye, DVec3::ZERO, DVec3::Z, 0.7, 1.5).expect("a view"),
        media,
        lights: lights.clone(),
        transport: TransportSettings {
            integrator,
            // Its variance is that of the noise.
            sampler: SamplerKind::Independent,
            ..TransportSettings::default()
        },
    }
}

fn film(mut scene: Scene, seed: u64) -> Film {
    scene.seed = seed;
    let rendered = render(&scene, &NoProgress, &AtomicBool::new(false));
    assert_eq!(rendered.counts.bound_violations, 0, "bounds hold");
    assert_eq!(rendered.counts.non_finite_samples, 0, "samples are finite");
    rendered.film
}

fn lights(diameter: f64) -> Lights {
    let towards = DVec3::new(0.5, -0.5, 0.7);
    Lights {
        distant: vec![DistantLight::new(towards, Rgb([3.0, 2.5, 2.0]), diameter).expect("a sun")],
        environment: Rgb([0.2, 0.3, 0.5]),
        ..Lights::default()
    }
}

#[test]
fn two_halves_are_a_whole() {
    let grid = grid();
    let phase = Phase::HenyeyGreenstein { g: 0.6 };
    for (sigma_t, albedo) in [
        (1.0, Rgb::splat(0.9)),
        (12.0, Rgb([0.95, 0.8, 0.4])),
        (3.0, Rgb::BLACK),
    ] {
        let medium = |part: f32| Medium::new(Arc::clone(&grid), part * sigma_t, albedo, phase);
        for kind in [IntegratorKind::Path, IntegratorKind::Analog] {
            // A disk wide enough for analog paths.
            let lights = lights(if kind == IntegratorKind::Path {
                0.0
            } else {
                2.2
            });
            let one = film(scene(vec![medium(1.0)], &lights, kind), 1);
            let two = film(scene(vec![medium(0.5), medium(0.5)], &lights, kind), 2);
            agree(&format!("halves of {sigma_t}, {kind:?}"), 0.02, &two, &one);
            let three = vec![medium(0.25), medium(0.0), medium(0.75)];
            let three = film(scene(three, &lights, kind), 3);
            agree(
                &format!("a quarter, nothing and the rest of {sigma_t}, {kind:?}"),
                0.02,
                &three,
                &one,
            );
        }
    }
}

/// A ball of constant density and `radius` voxels.
fn ball(radius: i32) -> Arc<DensityGrid> {
    let n = 2 * radius + 1;
    let at = |i: i32| IVec3::new(i / (n * n), i / n % n, i % n) - radius;
    let inside = (0..n * n * n)
        .map(at)
        .filter(|p| p.length_squared() <= radius * radius);
    let tree = Tree::from_voxels(0.0, inside.map(|p| (p, 1.0)));
    let transform = IndexTransform::uniform(0.05);
    Arc::new(DensityGrid::new(tree, transform, usize::MAX).expect("no limit was set"))
}

#[test]
fn different_media_across_and_inside_each_other() {
    let lights = lights(2.2);
    let forward = Phase::HenyeyGreenstein { g: 0.7 };
    let backward = Phase::HenyeyGreenstein { g: -0.5 };
    let cloud = Medium::new(grid(), 8.0, Rgb([0.98, 0.9, 0.7]), forward);
    let moved = DAffine3::from_translation(DVec3::new(0.4, -0.3, 0.2));
    let soot = Medium::new(ball(10), 3.0, Rgb([0.2, 0.3, 0.5]), backward);
    let soot = soot.moved(moved).expect("a shift");
    let nested = Medium::new(ball(6), 20.0, Rgb([0.9, 0.2, 0.1]), Phase::Isotropic);
    for (name, media) in [
        ("across", vec![cloud.clone(), soot.clone()]),
        ("nested", vec![cloud.clone(), nested.clone()]),
        ("three", vec![nested, soot, cloud]),
    ] {
        let mut analog = scene(media.clone(), &lights, IntegratorKind::Analog);
        analog.spp = 1024;
        let a = film(analog, 1);
        let b = film(scene(media, &lights, IntegratorKind::Path), 2);
        agree(name, 0.02, &b, &a);
    }
}

#[test]
fn a_moved_medium_is_its_grid_moved() {
    let map = DAffine3::from_scale_rotation_translation(
        DVec3::new(0.7, -1.2, 0.9),
        DQuat::from_rotation_z(0.4) * DQuat::from_rotation_x(1.1),
        DVec3::new(0.1, 0.2, -0.1),
    );
    let transform = map * DAffine3::from_scale(DVec3::splat(0.06));
    let transform = IndexTransform::from_world_from_index(transform).expect("a map");
    let transformed = DensityGrid::new(tree(), transform, usize::MAX).expect("no limit was set");
    let optics = |grid| {
        Medium::new(
            grid,
            6.0,
            Rgb::splat(0.9),
            Phase::HenyeyGreenstein { g: 0.5 },
        )
    };
    let moved = optics(grid()).moved(map).expect("it can be inverted");
    let lights = lights(0.0);
    let a = film(scene(vec![moved], &lights, IntegratorKind::Path), 1);
    let b = film(
        scene(
            vec![optics(Arc::new(transformed))],
            &lights,
            IntegratorKind::Path,
        ),
        1,
    );
    // The same numbers but for the rounding of products of maps: the same seed follows the same
    // paths until a rounding falls the other way.
    agree("moved", 0.02, &a, &b);
    let same = a.pixels().iter().zip(b.pixels()).filter(|(p, q)| {
        (0..3).all(|c| (p.mean[c] - q.mean[c]).abs() <= 1e-4 * (p.mean[c] + 1e-3))
    });
    let share = same.count() as f64 / a.pixels().len() as f64;
    assert!(
        share > 0.5,
        "{share} of the pixels are the same but for rounding"
    );
}

#[test]
fn a_file_that_occurs_twice_is_loaded_once() {
    let text = "[camera]\nposition = [1, -7, 1.5]\nlook_at = [1, 1, 1.5]\n\
                [[volume]]\nfile = \"tower.vdb\"\n\
                [[volume]]\nfile = \"tower.vdb\"\ntranslate = [0, 0, 10]\nscale = 2\nrotate = [0, 0, 90]\n\
                [[volume]]\nfile = \"tower.vdb\"\nencoding = \"f32\"\n\
                matrix = [[0, -2, 0, 0], [2, 0, 0, 0], [0, 0, 2, 10], [0, 0, 0, 1]]\n";
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("data/scene.toml");
    let checked = SceneFile::parse(&path, text.to_owned())
        .expect("TOML")
        .check(u64::MAX)
        .expect("right");
    let mut stages = 0;
    let volumes = checked
        .load_volumes(&LoadOptions::default(), &mut |_| stages += 1)
        .expect("the volume is the project's");
    assert!(Arc::ptr_eq(&volumes[0].grid, &volumes[1].grid), "shared");
    assert!(
        !Arc::ptr_eq(&volumes[0].grid, &volumes[2].grid),
        "kept in another encoding"
    );
    let scene = checked.into_scene(&volumes).expect("fits");
    let [first, second, third] = &scene.media[..] else {
        panic!("three media");
    };
    let p = DVec3::new(1.0, 2.0, 3.0);
    let world = |m: &Medium| m.transform().world_from_index().transform_point3(p);
    let at = world(first);
    let expected = DVec3::new(-2.0 * at.y, 2.0 * at.x, 2.0 * at.z + 10.0);
    assert!(
        (world(second) - expected).length() < 1e-9,
        "{} for {expected}",
        world(second)
    );
    assert!(
        (world(third) - expected).length() < 1e-9,
        "{} for {expected}",
        world(third)
    );
}

//! Output variables: parts of the light add up to the image, and the rest is what it is called.
//!
//! * Light not scattered, scattered once and more often adds up to the image, pixel by pixel, to
//!   rounding; so does light by where it comes from. The image is the same bits with them and
//!   without.
//! * Each part is what the image would be with only that: bounces cut off, lights put out.
//! * Transmittance, depths, albedo and normals of a cube are what geometry says.
//! * A checkpoint keeps them.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use glam::{DVec3, IVec3};
use majorant::aov::Aov;
use majorant::camera::Camera;
use majorant::emission::Glow;
use majorant::field::Field;
use majorant::film::Film;
use majorant::grid::{DensityGrid, Tree};
use majorant::integrator::{CameraRay, TransportSettings};
use majorant::light::{DistantLight, EnvironmentMap, Lights, LocalLight, Orientation};
use majorant::medium::Medium;
use majorant::phase::Phase;
use majorant::render::{NoProgress, render};
use majorant::scene::Scene;
use majorant::space::IndexTransform;
use majorant::spectrum::Rgb;

/// A cube of 2 units an edge, in voxels of a sixteenth.
fn cube() -> Arc<DensityGrid> {
    let at = |i: i32| IVec3::new(i / 1024, i / 32 % 32, i % 32) - 16;
    let tree = Tree::from_voxels(0.0, (0..32 * 32 * 32).map(|i| (at(i), 1.0)));
    let transform = IndexTransform::uniform(1.0 / 16.0);
    Arc::new(DensityGrid::new(tree, transform, usize::MAX).expect("no limit was set"))
}

fn scene(sigma_t: f32, camera_ray: CameraRay, aovs: &[Aov]) -> Scene {
    let glow = Glow::direct(Field::scalar(cube()), Rgb([0.3, 0.2, 0.1]));
    let medium = Medium::new(cube(), sigma_t, Rgb([0.9, 0.7, 0.5]), Phase::Isotropic);
    let sun = DistantLight::new(DVec3::new(0.5, -0.5, 0.7), Rgb([3.0, 2.5, 2.0]), 0.0);
    let eye = DVec3::new(0.0, -8.0, 0.0);
    Scene {
        width: 24,
        height: 24,
        spp: 64,
        seed: 0,
        frame: 0,
        aovs: aovs.to_vec(),
        camera: Camera::look_at(eye, DVec3::ZERO, DVec3::Z, 0.4, 1.0).expect("a view"),
        media: vec![medium.glowing(glow)],
        lights: Lights {
            distant: vec![sun.expect("a sun")],
            environment: Rgb([0.2, 0.3, 0.5]),
            ..Lights::default()
        },
        transport: TransportSettings {
            camera_ray,
            ..TransportSettings::default()
        },
    }
}

fn film(scene: &Scene) -> Film {
    let rendered = render(scene, &NoProgress, &AtomicBool::new(false));
    assert_eq!(rendered.counts.non_finite_samples, 0, "samples are finite");
    rendered.film
}

/// The values of a channel.
fn plane(film: &Film, name: &str) -> Vec<f64> {
    let planes = film.planes();
    let at = planes.channels().iter().position(|channel| channel == name);
    let at = at.unwrap_or_else(|| panic!("no channel {name}"));
    planes.plane(at).map(f64::from).collect()
}

/// The mean over the image of three channels.
fn mean(film: &Film, name: &str) -> [f64; 3] {
    ["R", "G", "B"].map(|c| {
        let values = plane(film, &format!("{name}.{c}"));
        values.iter().sum::<f64>() / values.len() as f64
    })
}

/// What the channels of the lights of `scene` are called, without their colours.
fn plain_names(scene: &Scene) -> Vec<String> {
    let names = scene.lights.names();
    names.iter().map(|name| format!("light.{name}")).collect()
}

#[test]
fn parts_add_up_to_the_image() {
    for (sigma_t, camera_ray) in [
        (3.0, CameraRay::Analog),
        (3.0, CameraRay::Expected),
        (0.2, CameraRay::Auto),
    ] {
        let asked = [Aov::Emission, Aov::Direct, Aov::Indirect, Aov::Lights];
        let parts = film(&scene(sigma_t, camera_ray, &asked));
        let plain = film(&scene(sigma_t, camera_ray, &[]));
        assert_eq!(parts.pixels(), plain.pixels(), "the same bits");
        assert_eq!(plain.planes().channels().len(), 0, "none were asked for");
        let orders = ["emission", "direct", "indirect"];
        let sources = plain_names(&scene(sigma_t, camera_ray, &asked));
        for (c, channel) in ["R", "G", "B"].into_iter().enumerate() {
            for names in [&orders.map(str::to_owned)[..], &sources] {
                let planes: Vec<_> = names
                    .iter()
                    .map(|name| plane(&parts, &format!("{name}.{channel}")))
                    .collect();
                for (i, pixel) in parts.pixels().iter().enumerate() {
                    let sum: f64 = planes.iter().map(|plane| plane[i]).sum();
                    let off = (sum - pixel.mean[c]).abs();
                    assert!(
                        off < 1e-5,
                        "pixel {i} of {names:?}: {sum}, not {}",
                        pixel.mean[c]
                    );
                }
            }
        }
    }
}

#[test]
fn parts_are_what_they_say() {
    let all = [Aov::Emission, Aov::Direct, Aov::Indirect, Aov::Lights];
    let parts = film(&scene(3.0, CameraRay::Analog, &all));
    let with = |change: &dyn Fn(&mut Scene)| {
        let mut scene = scene(3.0, CameraRay::Analog, &[]);
        scene.seed = 1;
        change(&mut scene);
        film(&scene).mean()
    };
    let seen = mean(&parts, "emission");
    let once = mean(&parts, "direct").map(|x| x);
    let black = |scene: &mut Scene| scene.lights = Lights::default();
    for (name, found, (expected, error)) in [
        (
            "not scattered",
            seen,
            with(&|s| s.transport.max_bounces = Some(0)),
        ),
        (
            "scattered at most once",
            std::array::from_fn(|c| seen[c] + once[c]),
            with(&|s| s.transport.max_bounces = Some(1)),
        ),
        (
            "of the medium",
            mean(&parts, "light.emission"),
            with(&black),
        ),
        (
            "of the sky",
            mean(&parts, "light.constant"),
            with(&|s| {
                s.lights.distant.clear();
                s.media = vec![s.media[0].with_optics(3.0, s.media[0].albedo(), Phase::Isotropic)];
                let bare = Medium::new(cube(), 3.0, s.media[0].albedo(), Phase::Isotropic);
                s.media = vec![bare];
            }),
        ),
    ] {
        for c in 0..3 {
            // Both have about this error; the sequence makes it an overestimate.
            let z = (found[c] - expected[c]) / (2.0_f64.sqrt() * error[c]);
            assert!(
                z.abs() < 5.0,
                "{name}: {found:?}, not {expected:?} ± {error:?}"
            );
            assert!(
                error[c] < 0.02 * expected[c],
                "{name}: a bias of 15 % would be missed"
            );
        }
    }
}

/// Two suns, two skies from images, two spheres, the constant sky and what the cube emits, in one gray
/// volume, in two and in a dyed one: each light's group is the image with that light alone, and the
/// groups add up to the image.
///
/// The image with one light is another render: a bias of 5 to 10 % of a light would be seen.
#[test]
fn each_light_has_a_group_of_its_own() {
    let sun = |x: f64, colour| DistantLight::new(DVec3::new(x, -0.5, 0.7), Rgb(colour), 0.2);
    let suns = [([3.0, 2.5, 2.0], 0.5), ([0.2, 0.3, 1.0], -0.9)];
    let suns = suns.map(|(colour, x)| sun(x, colour.map(|c: f32| 2.0 * c)).expect("a sun"));
    let sky = |bright: usize, colour: Rgb| {
        let texels = (0..32).map(|i| {
            if i == bright {
                colour * 20.0
            } else {
                colour * 0.1
            }
        });
        let upright = Orientation::new(DVec3::Z, 0.0);
        EnvironmentMap::new((8, 4), texels.collect(), 1.0, upright).expect("a map")
    };
    let skies = [(9, Rgb([0.3, 0.2, 0.1])), (20, Rgb([0.1, 0.2, 0.3]))];
    let skies = skies.map(|(bright, colour)| Arc::new(sky(bright, colour)));
    let sphere = |x, colour| LocalLight::sphere(DVec3::new(x, -1.5, 0.3), 0.3, Rgb(colour));
    let lamps = [(-1.0, [5.0, 1.0, 1.0]), (1.0, [1.0, 5.0, 2.0])];
    let lamps = lamps.map(|(x, colour)| sphere(x, colour).expect("a sphere"));
    let all = Lights {
        distant: suns.to_vec(),
        environment: Rgb([0.2, 0.3, 0.5]),
        maps: skies.to_vec(),
        local: lamps.to_vec(),
    };
    let names = all.names();
    assert_eq!(
        names.join(" "),
        "sun0 sun1 constant sky0 sky1 lamp0 lamp1 emission"
    );
    let only = |name: &str| {
        let number = name.bytes().last().map_or(0, |b| usize::from(b == b'1'));
        let mut lights = Lights::default();
        match name.trim_end_matches(['0', '1']) {
            "sun" => lights.distant.push(suns[number]),
            "sky" => lights.maps.push(Arc::clone(&skies[number])),
            "lamp" => lights.local.push(lamps[number]),
            "constant" => lights.environment = all.environment,
            _ => {}
        }
        lights
    };
    let scene = |kind: usize, lights: &Lights, glows: bool, aovs: &[Aov]| {
        let mut scene = scene(2.0, CameraRay::Auto, aovs);
        scene.lights = lights.clone();
        (scene.width, scene.height, scene.spp) = (12, 12, 512);
        let bare = Medium::new(cube(), 2.0, scene.media[0].albedo(), Phase::Isotropic);
        if !glows {
            scene.media[0] = bare.clone();
        }
        match kind {
            0 => {}
            1 => scene.media.push(bare),
            _ => {
                let dye = Rgb([1.0, 0.5, 0.1]);
                scene.media[0] = scene.media[0].with_extinction_color(dye);
            }
        }
        scene
    };
    for kind in 0..3 {
        let together = film(&scene(kind, &all, true, &[Aov::Lights]));
        let plain = film(&scene(kind, &all, true, &[]));
        assert_eq!(together.pixels(), plain.pixels(), "the same bits");
        let mut sum = [0.0; 3];
        for name in &names {
            let group = mean(&together, &format!("light.{name}"));
            let mut alone = scene(kind, &only(name), name == "emission", &[]);
            alone.seed = 1;
            let (expected, error) = film(&alone).mean();
            for c in 0..3 {
                sum[c] += group[c];
                // Beside others a light may be sampled less: twice the error of the light alone.
                let error = 3.0 * error[c];
                let z = (group[c] - expected[c]) / error;
                assert!(
                    z.abs() < 5.0,
                    "{kind}, {name}: {group:?}, not {expected:?}, z {z}"
                );
                assert!(
                    5.0 * error < 0.15 * expected[c],
                    "{kind}, {name}: a bias of 15 % would be missed: {error}"
                );
            }
        }
        let image = plain.mean().0;
        for c in 0..3 {
            let off = (sum[c] / image[c] - 1.0).abs();
            assert!(off < 1e-5, "{kind}: {sum:?}, not {image:?}");
        }
    }
}

#[test]
fn a_cube_is_where_it_is() {
    let asked = [
        Aov::Transmittance,
        Aov::Depth,
        Aov::Albedo,
        Aov::Normal,
        Aov::Lookups,
    ];
    let film = film(&scene(40.0, CameraRay::Auto, &asked));
    let middle = 12 * 24 + 12;
    let at = |name: &str, i: usize| plane(&film, name)[i];
    // The face is half a voxel before the first voxel's ramp is over; from 1/16 before the cube.
    assert!(
        (at("depth.front", middle) - 7.0).abs() < 0.1,
        "{}",
        at("depth.front", middle)
    );
    assert!(
        (at("depth.back", middle) - 9.0).abs() < 0.1,
        "{}",
        at("depth.back", middle)
    );
    assert!(
        at("depth.front", 0).is_infinite(),
        "the corner sees the sky"
    );
    assert_eq!(at("transmittance", 0), 1.0);
    assert!(at("transmittance", middle) < 1e-6, "opaque");
    assert!(
        (at("albedo.G", middle) - 0.7).abs() < 1e-3,
        "{}",
        at("albedo.G", middle)
    );
    assert_eq!(at("albedo.R", 0), 0.0, "nothing was met");
    let towards = -at("normal.Y", middle);
    assert!(towards > 0.5, "the face looks at the camera: {towards}");
    assert!(at("lookups", middle) > 0.0, "values were read");
    assert_eq!(at("lookups", 0), 0.0, "nothing was read");
    assert_eq!(film.planes().channels().len(), 1 + 2 + 3 + 3 + 1);
}

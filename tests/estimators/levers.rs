//! What makes the path integrator fast leaves its images as they are.
//!
//! Each lever is taken away by itself, and all of them at once with exact transmittances: the oracle.
//! Images are compared pixel by pixel: the squared z-scores of all pixels add up to a chi-square,
//! and their sum, over bright and dark pixels, shows a bias that has one sign. Scenes have the sun
//! in front of, beside and behind the cloud, and phase functions from isotropic to narrow.

#![allow(
    clippy::print_stdout,
    reason = "what a test can see and the table of efficiencies are printed"
)]

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use cpu_time::ProcessTime;
use glam::{DVec3, IVec3};
use majorant::camera::Camera;
use majorant::film::{Film, Pixel};
use majorant::grid::{DensityGrid, Tree};
use majorant::integrator::{Levers, TransportSettings};
use majorant::light::{DistantLight, Lights};
use majorant::medium::Medium;
use majorant::phase::Phase;
use majorant::render::{NoProgress, render};
use majorant::scene::{LoadOptions, Scene, SceneFile};
use majorant::space::IndexTransform;
use majorant::spectrum::Rgb;
use majorant::tracking::{Tracking, TransmittanceEstimator};

/// Sets of levers by name; the first is what everybody renders with.
fn variants() -> [(&'static str, Levers); 5] {
    let all = Levers::default();
    let none = Levers {
        guide: false,
        light_roulette: false,
        path_roulette: false,
        equiangular: false,
        emission_light: false,
    };
    [
        ("all", all),
        (
            "no guide",
            Levers {
                guide: false,
                ..all
            },
        ),
        (
            "no light roulette",
            Levers {
                light_roulette: false,
                ..all
            },
        ),
        (
            "no path roulette",
            Levers {
                path_roulette: false,
                ..all
            },
        ),
        ("none", none),
    ]
}

/// A lumpy ball of radius about 20 voxels around the origin, with holes.
fn cloud() -> Arc<DensityGrid> {
    let mut voxels = Vec::new();
    for i in 0..48 * 48 * 48 {
        let p = IVec3::new(i / 2304, i / 48 % 48, i % 48) - 24;
        let q = p.as_vec3();
        let lumps = (q.x * 0.5).sin() * (q.y * 0.4).cos() + (q.z * 0.6).sin();
        let density = 1.0 - q.length() / 20.0 + 0.4 * lumps;
        if density > 0.0 {
            voxels.push((p, density));
        }
    }
    let tree = Tree::from_voxels(0.0, voxels);
    Arc::new(DensityGrid::new(tree, IndexTransform::uniform(0.05), usize::MAX).expect("no limit"))
}

/// A view in the direction of y; the sun is `degrees` from it.
fn scene(grid: &Arc<DensityGrid>, degrees: f64, g: f32, sky: f32) -> Scene {
    let (sin, cos) = degrees.to_radians().sin_cos();
    let sun = DistantLight::new(
        DVec3::new(0.6 * sin, cos, 0.8 * sin),
        Rgb([6.0, 5.6, 5.0]),
        0.0,
    );
    let eye = DVec3::new(0.0, -4.0, 0.0);
    Scene {
        width: 12,
        height: 12,
        spp: 512,
        seed: 0,
        frame: 0,
        aovs: vec![],
        camera: Camera::look_at(eye, DVec3::ZERO, DVec3::Z, 0.5, 1.0).expect("a view"),
        media: vec![Medium::new(
            Arc::clone(grid),
            20.0,
            Rgb([0.99, 0.97, 0.9]),
            Phase::HenyeyGreenstein { g },
        )],
        lights: Lights {
            distant: vec![sun.expect("a sun")],
            environment: Rgb::splat(sky),
            ..Lights::default()
        },
        transport: TransportSettings::default(),
    }
}

fn load(path: &Path) -> Scene {
    let options = LoadOptions::default();
    let file = SceneFile::read(path).expect("a scene file");
    let checked = file.check(options.max_memory_bytes).expect("a right one");
    let volumes = checked.load_volumes(&options, &mut |_| {});
    checked
        .into_scene(&volumes.expect("its volumes load"))
        .expect("the scene fits its volume")
}

fn film(scene: &Scene) -> Film {
    let rendered = render(scene, &NoProgress, &AtomicBool::new(false));
    assert_eq!(
        rendered.counts.non_finite_samples, 0,
        "all samples are finite"
    );
    rendered.film
}

/// Returns the sum of squared z-scores of the pixels' green as a standard normal number, and the
/// z-score of the mean with the smallest relative bias of it that 5 standard errors show.
fn compare(a: &Film, b: &Film) -> (f64, f64, f64) {
    let (mut chi2, mut pixels) = (0.0, 0.0_f64);
    for (p, q) in a.pixels().iter().zip(b.pixels()) {
        let variance = p.variance_of_mean()[1] + q.variance_of_mean()[1];
        // Zero: the sky alone.
        if variance > 0.0 {
            chi2 += (p.mean[1] - q.mean[1]).powi(2) / variance;
            pixels += 1.0;
        }
    }
    assert!(pixels > 50.0, "the cloud fills the view");
    let ((ma, ea), (mb, eb)) = (a.mean(), b.mean());
    let error = ea[1].hypot(eb[1]);
    (
        (chi2 - pixels) / (2.0 * pixels).sqrt(),
        (ma[1] - mb[1]) / error,
        5.0 * error / ma[1],
    )
}

#[test]
fn no_lever_changes_a_pixel() {
    let grid = cloud();
    for (degrees, g, sky) in [
        (30.0, 0.6, 0.0),
        (90.0, 0.0, 0.5),
        (90.0, 0.75, 0.0),
        (150.0, 0.8, 0.5),
    ] {
        let exact = Tracking {
            transmittance: TransmittanceEstimator::Exact,
            ..Tracking::default()
        };
        let films = variants().map(|(name, levers)| {
            let mut scene = scene(&grid, degrees, g, sky);
            scene.transport.levers = levers;
            if name == "none" {
                scene.transport.tracking = exact;
            }
            // Of their own, so that variants are independent.
            scene.seed = name.len() as u64;
            film(&scene)
        });
        let oracle = &films[films.len() - 1];
        for ((name, _), film) in variants().iter().zip(&films).take(films.len() - 1) {
            let (pixels, mean, power) = compare(film, oracle);
            println!(
                "sun at {degrees}, g {g}, sky {sky}, {name}: pixels {pixels:+.2}, mean {mean:+.2}, \
                 smallest bias seen {power:.1e}"
            );
            // Radiance is heavy-tailed: the variance of a pixel is itself uncertain.
            assert!(
                pixels.abs() < 8.0,
                "{name}: squared z-scores are off by {pixels} deviations"
            );
            assert!(
                mean.abs() < 5.0,
                "{name}: the mean is off by {mean} standard errors"
            );
            assert!(power < 0.1, "{name}: this test cannot see a bias of 10 %");
        }
    }
}

/// Prints the parts of the image's mean that sun and sky make, with all levers, beside those without
/// any and with exact transmittances. `LEVER_SPP` samples a pixel, `LEVER_ORACLE_SPP` those of the
/// latter (as many if unset: a sample of theirs costs ten times as much), `LEVER_PARTS` in place of
/// both, `LEVER_SEED` for another run that is independent of the usual one; scenes as below.
#[test]
#[ignore = "measures, minutes"]
fn slow_sun_and_sky_parts() {
    let (Ok(paths), Ok(spp)) = (std::env::var("LEVER_SCENES"), std::env::var("LEVER_SPP")) else {
        println!("LEVER_SCENES names no scenes, or LEVER_SPP no number of samples");
        return;
    };
    let oracle_spp = std::env::var("LEVER_ORACLE_SPP").unwrap_or_else(|_unset| spp.clone());
    let seed: u64 = std::env::var("LEVER_SEED").map_or(11, |n| n.parse().expect("a seed"));
    let parts = std::env::var("LEVER_PARTS").unwrap_or_else(|_unset| "sun,sky".to_owned());
    for path in paths.split(',') {
        for part in parts.split(',') {
            let run = |levers, transmittance, spp: &str, seed| {
                let mut scene = load(path.as_ref());
                match part {
                    "sun" => scene.lights.environment = Rgb::BLACK,
                    "sky" => scene.lights.distant.clear(),
                    _ => panic!("a part is sun or sky, not {part}"),
                }
                (scene.width, scene.height, scene.seed) = (96, 54, seed);
                scene.spp = spp.parse().expect("a number of samples");
                scene.transport.levers = levers;
                scene.transport.tracking.transmittance = transmittance;
                film(&scene).mean()
            };
            let [(_, all), .., (_, none)] = variants();
            let (ma, ea) = run(all, TransmittanceEstimator::Auto, &spp, seed);
            let (mb, eb) = run(none, TransmittanceEstimator::Exact, &oracle_spp, seed + 1);
            let error = ea[1].hypot(eb[1]);
            let z = (ma[1] - mb[1]) / error;
            println!(
                "{path}, {part}: {:.6} +- {:.6}, oracle {:.6} +- {:.6}, off by {:+.3} %, z {z:+.2}",
                ma[1],
                ea[1],
                mb[1],
                eb[1],
                100.0 * (ma[1] / mb[1] - 1.0)
            );
            assert!(z.abs() < 5.0, "{path}, {part}: z {z}");
        }
    }
}

/// Prints what each lever is worth: the efficiency `1 / (relMSE · CPU s)` without it over that
/// with all of them, with its standard error. Run it in a release build, with one thread, on scene
/// files of your own: `LEVER_SCENES=a.toml,b.toml RAYON_NUM_THREADS=1 cargo test --release --test
/// estimators levers -- --ignored --nocapture table`. Sets of levers take turns, `LEVER_ROUNDS` times (1
/// if unset; without any lever once), each a render of 64 samples with its own seed.
#[test]
#[ignore = "measures, minutes"]
fn slow_table_of_efficiencies() {
    let Ok(paths) = std::env::var("LEVER_SCENES") else {
        println!("LEVER_SCENES names no scenes: nothing to measure");
        return;
    };
    let rounds = std::env::var("LEVER_ROUNDS").map_or(1, |n| n.parse().expect("a number"));
    println!("scene,levers,samples,relmse_n,cpu_us_per_ray,mean,efficiency,error");
    for path in paths.split(',') {
        let mut scene = load(path.as_ref());
        (scene.width, scene.height, scene.spp) = (96, 54, 64);
        let rays = f64::from(scene.width * scene.height * scene.spp);
        let mut runs: [Vec<(Film, f64)>; 5] = Default::default();
        for round in 0..rounds {
            for ((name, levers), runs) in variants().into_iter().zip(&mut runs) {
                if round > 0 && name == "none" {
                    continue;
                }
                scene.transport.levers = levers;
                scene.seed += 1;
                let start = ProcessTime::now();
                let film = film(&scene);
                runs.push((film, start.elapsed().as_secs_f64() * 1e6 / rays));
            }
        }
        // One mean for all: that of few samples is low where their variance is.
        let films: Vec<&Film> = runs.iter().flatten().map(|(film, _)| film).collect();
        let mean = |i: usize, c: usize| {
            films.iter().map(|f| f.pixels()[i].mean[c]).sum::<f64>() / films.len() as f64
        };
        let means: Vec<[f64; 3]> = (0..films[0].pixels().len())
            .map(|i| [0, 1, 2].map(|c| mean(i, c)))
            .collect();
        let relmse = |film: &Film| {
            let seen = film.pixels().iter().zip(&means);
            let seen: Vec<_> = seen.filter(|(p, _)| p.alpha() > 0.01).collect();
            let of = |(p, mean): &(&Pixel, &[f64; 3])| {
                let parts = p.variance_of_mean().into_iter().zip(*mean);
                parts.map(|(v, mean)| v / (mean * mean + 0.01)).sum::<f64>()
            };
            let sum: f64 = seen.iter().map(of).sum();
            sum * f64::from(scene.spp) / (3 * seen.len()) as f64
        };
        let mut all = (1.0, 0.0);
        for ((name, _), runs) in variants().iter().zip(&runs) {
            let count = runs.len() as f64;
            let errors: Vec<f64> = runs.iter().map(|(film, _)| relmse(film)).collect();
            let error = errors.iter().sum::<f64>() / count;
            let scatter = errors.iter().map(|e| (e - error).powi(2)).sum::<f64>();
            // Relative, of the mean; one round has none.
            let scatter = (scatter / (count - 1.0).max(1.0) / count).sqrt() / error;
            // What else the machine did only adds.
            let us = runs.iter().map(|&(_, us)| us).fold(f64::INFINITY, f64::min);
            if *name == "all" {
                all = (error * us, scatter);
            }
            let efficiency = all.0 / (error * us);
            println!(
                "{path},{name},{},{error:.4},{us:.3},{:.4},{efficiency:.3},{:.3}",
                u64::from(scene.spp) * runs.len() as u64,
                runs[0].0.mean().0[1],
                efficiency * scatter.hypot(all.1)
            );
        }
    }
}

//! The scenes that the project carries, rendered small: whole, bright where they should be, and
//! in the white furnace white.

use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;

use majorant::integrator::IntegratorKind;
use majorant::phase::Phase;
use majorant::render::{NoProgress, Rendered, render};
use majorant::scene::{LoadOptions, Scene, SceneFile};
use majorant::spectrum::Rgb;

fn scenes() -> Vec<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("data/scenes");
    let entries = std::fs::read_dir(folder).expect("data/scenes is part of the project");
    let mut paths: Vec<_> = entries.map(|e| e.expect("listed").path()).collect();
    paths.sort();
    paths
}

fn load(path: &Path) -> Scene {
    let file = SceneFile::read(path).expect("a scene of ours is right");
    let options = LoadOptions::default();
    let checked = file
        .check(options.max_memory_bytes)
        .expect("a scene of ours is right");
    let volumes = checked
        .load_volumes(&options, &mut |_| {})
        .expect("its volumes load");
    checked
        .into_scene(&volumes)
        .expect("the scene fits its volumes")
}

fn run(scene: &Scene) -> Rendered {
    let rendered = render(scene, &NoProgress, &AtomicBool::new(false));
    assert!(rendered.complete, "nobody cancelled");
    assert_eq!(rendered.counts.bound_violations, 0, "bounds hold");
    assert_eq!(
        rendered.counts.non_finite_samples, 0,
        "all samples are finite"
    );
    rendered
}

#[test]
fn every_scene_renders() {
    let paths = scenes();
    assert!(paths.len() >= 5, "{paths:?}");
    for path in paths {
        let scene = Scene {
            width: 48,
            height: 27,
            spp: 4,
            ..load(&path)
        };
        let rendered = run(&scene);
        let hit = rendered
            .film
            .pixels()
            .iter()
            .filter(|p| p.opacity > 0.0)
            .count();
        let share = hit as f64 / rendered.film.pixels().len() as f64;
        assert!(
            (0.05..0.95).contains(&share),
            "{path:?} is framed badly: {share} sees it"
        );
        let (mean, _) = rendered.film.mean();
        // All channels, but of a fire in the night, whose blue is a twentieth of its red.
        let glows = scene.media.iter().any(|m| m.emission().is_some());
        let least = if glows { 0.002 } else { 0.02 };
        let brightest = mean.into_iter().fold(0.0, f64::max);
        assert!(
            mean.iter().all(|c| (least..3.0).contains(c)) && brightest > 0.02,
            "{path:?} is badly lit: {mean:?}"
        );
    }
}

/// Albedo 1 in a sky of 1 shows 1 in every pixel: no path is lost in a real cloud or smoke.
#[test]
fn real_volumes_are_white_in_the_white_furnace() {
    for (name, scale) in [("cloud.toml", 84.0), ("smoke.toml", 21.7)] {
        let path = Path::new(env!("CARGO_MANIFEST_DIR"))
            .join("data/scenes")
            .join(name);
        for g in [0.0, 0.85] {
            for integrator in [IntegratorKind::Analog, IntegratorKind::Path] {
                let mut scene = Scene {
                    width: 32,
                    height: 18,
                    spp: 4,
                    ..load(&path)
                };
                let phase = Phase::HenyeyGreenstein { g };
                scene.media = vec![scene.media[0].with_optics(scale, Rgb::WHITE, phase)];
                scene.lights.distant.clear();
                scene.lights.environment = Rgb::WHITE;
                scene.transport.integrator = integrator;
                let (mean, error) = run(&scene).film.mean();
                for c in 0..3 {
                    let off = (mean[c] - 1.0).abs();
                    assert!(
                        off <= 4.0 * error[c] + 1e-12,
                        "{name}, g {g}: {mean:?} ± {error:?}"
                    );
                    assert!(error[c] < 2e-3, "{name}, g {g}: standard error {error:?}");
                }
            }
        }
    }
}

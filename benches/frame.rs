//! What whole images cost: 96 × 54 pixels at 2 samples, on one thread.
//!
//! * `path`: the scene as it is, sun and sky, with the production integrator.
//! * `path sky`, `analog sky`: without the sun, which the analog integrator cannot see.
//!
//! Each frame's mean is asserted against a long run within 5 standard errors of this frame.
//! That guards against timing a broken picture; it does not see a bias below 5 %, which the
//! statistical tests do. Printed once: what a camera sample makes the kernel do.

#![allow(
    missing_docs,
    reason = "the criterion macros make undocumented functions"
)]
#![expect(
    clippy::print_stderr,
    reason = "numbers that are not times are printed once"
)]

mod assets;

use std::sync::atomic::AtomicBool;
use std::time::Duration;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use majorant::integrator::IntegratorKind;
use majorant::render::{NoProgress, Rendered, render};
use majorant::scene::Scene;

/// Means of the green channel over the image, from 512 samples a pixel: standard errors below
/// 0.0006. Those of the sky alone come from the analog integrator.
struct Reference {
    scene: &'static str,
    sun_and_sky: f64,
    sky: f64,
}

const REFERENCES: [Reference; 2] = [
    Reference {
        scene: "cloud",
        sun_and_sky: 0.5442,
        sky: 0.4256,
    },
    Reference {
        scene: "smoke",
        sun_and_sky: 0.4519,
        sky: 0.4390,
    },
];

/// Asserts that the frame is complete, has no bound violation and the right mean.
fn check(name: &str, rendered: &Rendered, expected: f64) {
    let Rendered {
        film,
        counts,
        complete,
        ..
    } = rendered;
    assert!(complete, "{name}: not all samples were taken");
    assert_eq!(counts.bound_violations, 0, "{name}: bound violations");
    assert_eq!(
        counts.non_finite_samples, 0,
        "{name}: samples that are not finite"
    );
    let (mean, standard_error) = film.mean();
    assert!(
        (mean[1] - expected).abs() < 5.0 * standard_error[1],
        "{name}: mean {} ± {}, expected {expected}",
        mean[1],
        standard_error[1]
    );
}

fn bench(c: &mut Criterion) {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1);
    pool.build_global()
        .expect("no other pool was started before");
    for Reference {
        scene: name,
        sun_and_sky,
        sky,
    } in REFERENCES
    {
        let mut group = c.benchmark_group(format!("frame/{name}"));
        group
            .sample_size(10)
            .warm_up_time(Duration::from_millis(300))
            .measurement_time(Duration::from_secs(2));
        let mut scene: Scene = assets::scene(name);
        (scene.width, scene.height, scene.spp) = (96, 54, 2);
        let mut time = |scene: &Scene, variant: &str, expected: f64| {
            let frame = || render(scene, &NoProgress, &AtomicBool::new(false));
            let counts = frame().counts;
            let rays = counts.camera_rays as f64;
            eprintln!(
                "frame/{name}/{variant}: a camera sample takes {:.2} scatterings, {:.1} segments, \
                 {:.1} lookups",
                counts.scattered_rays as f64 / rays,
                counts.segments as f64 / rays,
                counts.lookups as f64 / rays,
            );
            group.throughput(Throughput::Elements(counts.camera_rays));
            group.bench_function(variant, |b| b.iter(|| check(variant, &frame(), expected)));
        };
        time(&scene, "path", sun_and_sky);
        scene.lights.distant.clear();
        time(&scene, "path sky", sky);
        scene.transport.integrator = IntegratorKind::Analog;
        time(&scene, "analog sky", sky);
        group.finish();
    }
}

criterion_group!(benches, bench);
criterion_main!(benches);

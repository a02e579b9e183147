//! What whole images cost in CPU time: 128 × 72 pixels at 4 samples, on one thread, scene by
//! scene.
//!
//! One row for each variant of the kernel ([`VARIANTS`]): what `auto` makes of the scene, and
//! one choice of estimator or bounds changed at a time. A variant that is slower here may have
//! less variance: `majorant converge` weighs both. `analog sky` is the short reference, without the sun that
//! it cannot see.
//!
//! Each frame's mean is asserted against a long run within 5 standard errors of this frame.
//! That guards against timing a broken picture; it does not see a bias below 2 %, which the
//! statistical tests do. Printed once: what a camera sample makes the kernel do.

#![allow(
    missing_docs,
    reason = "the criterion macros make undocumented functions"
)]

mod assets;

use std::sync::atomic::AtomicBool;
use std::time::Duration;

use assets::cpu_clock::CpuClock;
use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use majorant::integrator::IntegratorKind;
use majorant::render::{NoProgress, Rendered, render};
use majorant::scene::Scene;
use majorant::tracking::{BoundsKind, DistanceEstimator, TransmittanceEstimator};

/// Mean of the green channel over the whole image; the same at any resolution of its shape.
/// Standard errors are below 0.0006.
struct Reference {
    scene: &'static str,
    mean: f64,
    /// Without suns, from the analog integrator.
    sky: f64,
}

const REFERENCES: [Reference; 4] = [
    Reference {
        scene: "cloud",
        mean: 0.5442,
        sky: 0.4256,
    },
    Reference {
        scene: "cloud_a999",
        mean: 0.5942,
        sky: 0.0,
    },
    Reference {
        scene: "smoke",
        mean: 0.4519,
        sky: 0.4390,
    },
    Reference {
        scene: "absorb",
        mean: 0.68767,
        sky: 0.68767,
    },
];

/// A change of the scene.
type Change = fn(&mut Scene);

/// Kernels: a name, and what differs from the scene as it is.
const VARIANTS: [(&str, Change); 7] = [
    ("auto", |_| {}),
    ("delta", |s| {
        s.transport.tracking.distance = DistanceEstimator::Delta;
    }),
    ("regular", |s| {
        s.transport.tracking.distance = DistanceEstimator::Regular;
    }),
    ("ratio", |s| {
        s.transport.tracking.transmittance = TransmittanceEstimator::Ratio;
    }),
    ("exact", |s| {
        s.transport.tracking.transmittance = TransmittanceEstimator::Exact;
    }),
    ("global", |s| {
        s.transport.tracking.bounds = BoundsKind::Global;
    }),
    ("hierarchy", |s| {
        s.transport.tracking.bounds = BoundsKind::Hierarchy;
    }),
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

fn bench(c: &mut Criterion<CpuClock>) {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1);
    pool.build_global()
        .expect("no other pool was started before");
    for Reference {
        scene: name,
        mean,
        sky,
    } in REFERENCES
    {
        let mut group = c.benchmark_group(format!("frame/{name}"));
        group
            .sample_size(10)
            .warm_up_time(Duration::from_millis(200))
            .measurement_time(Duration::from_secs(2));
        let mut time = |variant: &str, change: Change, expected: f64| {
            let mut scene = assets::scene(name);
            (scene.width, scene.height, scene.spp) = (128, 72, 4);
            change(&mut scene);
            let frame = || render(&scene, &NoProgress, &AtomicBool::new(false));
            let counts = frame().counts;
            let rays = counts.camera_rays as f64;
            let bench = format!("frame/{name}/{variant}");
            for (what, count) in [
                ("scatterings", counts.scattered_rays),
                ("shadow_rays", counts.shadow_rays),
                ("segments", counts.segments),
                ("lookups", counts.lookups),
                ("voxel_cells", counts.voxel_cells),
            ] {
                assets::note(&bench, what, count as f64 / rays, "1/sample");
            }
            group.throughput(Throughput::Elements(counts.camera_rays));
            group.bench_function(variant, |b| b.iter(|| check(variant, &frame(), expected)));
        };
        for (variant, change) in VARIANTS {
            time(variant, change, mean);
        }
        if sky > 0.0 {
            let analog: Change = |s| {
                s.lights.distant.clear();
                s.transport.integrator = IntegratorKind::Analog;
            };
            time("analog sky", analog, sky);
        }
        group.finish();
    }
}

criterion_group!(
    name = benches;
    config = assets::cpu_clock::criterion();
    targets = bench
);
criterion_main!(benches);

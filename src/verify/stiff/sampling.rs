//! The ends of the uniform numbers, peaked phase functions, long paths, neighbouring streams.

use std::sync::atomic::AtomicBool;

use glam::{DVec3, IVec3};

use crate::camera::Camera;
use crate::film::Film;
use crate::grid::TreeBuilder;
use crate::integrator::{Context, IntegratorKind};
use crate::phase::Phase;
use crate::render::{NoProgress, render};
use crate::space::Ray;
use crate::spectrum::Rgb;
use crate::tracking::Tracking;
use crate::verify::furnace::{Body, scene};
use crate::verify::measure::{Moments, Seen, measure, stream};
use crate::verify::paths::{self, sky, transport};
use crate::verify::row::{Group, Row};
use crate::verify::volumes::{self, Volume, box_of};
use crate::verify::{Check, Rows};

const ENDS: Group = Group {
    name: "ends of the uniform numbers",
    oracle: "-ln u in f64, for the draws of 2^26 streams nearest to 0 and to 1",
};

const PHASE: Group = Group {
    name: "g near 1 and -1",
    oracle: "the distribution function in closed form: chi-square of 64 cells",
};

const LONG_PATHS: Group = Group {
    name: "albedo 1, thousands of bounces",
    oracle: "1 in a white furnace; (4/S) times the integral of sigma_s; unit length",
};

const STREAMS: Group = Group {
    name: "independent pixels",
    oracle: "no correlation; variance over pixels as estimated within them",
};

pub(super) fn checks(out: &mut Vec<Check>) {
    out.push(Check::new(&ENDS, "free flight", ends));
    for g in [0.999_f32, 0.999_999, -0.999, -0.999_999] {
        out.push(Check::new(&PHASE, format!("g {g}"), move |rows| {
            angles(rows, g);
        }));
    }
    for (g, sigma_t, n) in [(0.0, 300.0, 30_000), (0.999, 5000.0, 5_000)] {
        let name = format!("cloud, sigma_t {sigma_t}, g {g}");
        out.push(Check::new(&LONG_PATHS, name, move |rows| {
            long_paths(rows, g, sigma_t, n);
        }));
    }
    out.push(Check::new(&LONG_PATHS, "direction, 10000 bounces", lengths));
    out.push(Check::new(
        &LONG_PATHS,
        "albedo 0, 0.5, 1 by channel",
        channels,
    ));
    out.push(Check::new(&STREAMS, "64 x 64", neighbours));
}

/// Draws of the streams nearest to both ends, forced through a homogeneous medium and through
/// one whose density reaches its bound.
fn ends(rows: &mut Rows) {
    const STREAMS: u64 = 1 << 26;
    let seed = rows.seed();
    let first = |i| stream(seed, i).bits();
    let lowest = (0..STREAMS).min_by_key(|&i| first(i)).unwrap_or(0);
    let highest = (0..STREAMS).max_by_key(|&i| first(i)).unwrap_or(0);
    let mut b = TreeBuilder::new(0.0_f32);
    for i in 0..8 {
        b.set_root_tile(IVec3::new(i >> 2 & 1, i >> 1 & 1, i & 1) * 4096, 1.0, true);
    }
    let tile = Volume::uniform(b.finish(Vec::new(), Vec::new()), 1.0);
    let brick = Volume::uniform(box_of(IVec3::ZERO, IVec3::splat(8), |_| 1.0), 1.0);
    let ray = Ray {
        origin: DVec3::splat(2.5),
        direction: DVec3::X,
    };
    let tracking = Tracking::default();
    for (name, index) in [("longest", lowest), ("shortest", highest)] {
        let u = (first(index) | 1) as f64 / 2.0_f64.powi(64);
        let depth = -u.ln();
        let mut draw = stream(seed, index);
        let medium = tile.attenuating(0.05);
        let end = f64::INFINITY;
        let flight = tracking.sample_collision(&medium, &ray, end, &mut draw);
        let mut seen = Seen::default();
        seen.add(&draw.counts);
        let reached = flight.map_or(f64::NAN, |t| t * f64::from(0.05_f32));
        let row = Row::exact(format!("{name} path"), depth, reached, &seen);
        let extreme = !(1e-7..16.7).contains(&depth);
        rows.push(
            row.tolerance(1e-6 * depth + 1e-7, "f32 logarithm; u rounds to 1")
                .demanding(extreme, "no stream comes near the end")
                .steps_within(5),
        );
        // A brick at its bound, up to its ramp.
        let medium = brick.attenuating(1.0);
        let measured = measure(seed, 1, |both| {
            let mut draw = stream(seed, index);
            let t = tracking.estimate_transmittance(&medium, &ray, 4.5, 0.0, &mut draw);
            both.counts.add(&draw.counts);
            let mut draw = stream(seed, index);
            let flight = tracking.sample_collision(&medium, &ray, 4.5, &mut draw);
            both.counts.add(&draw.counts);
            let bounded = (0.0..=1.0).contains(&t);
            let inside = flight.is_none_or(|t| (0.0..=4.5).contains(&t));
            [f64::from(u8::from(bounded && inside))]
        });
        let (inside, seen) = (measured.moments[0].mean(), &measured.seen);
        let row = Row::exact(format!("{name} path, at the bound"), 1.0, inside, seen);
        rows.push(row.steps_within(100));
    }
}

/// The distribution function of Henyey and Greenstein, without cancellation: with e = 1 − |g|,
/// x = 1 − cos and D = e² + 2|g|x it is (1 + |g|) x / ((√D + e) √D).
fn angles(rows: &mut Rows, g: f32) {
    const CELLS: usize = 64;
    let (a, phase) = (f64::from(g.abs()), Phase::HenyeyGreenstein { g });
    let e = 1.0 - a;
    let direction = DVec3::new(0.6, 0.0, -0.8);
    let peak = direction * f64::from(g.signum());
    let mut cells = [0_u32; CELLS];
    let measured = measure(rows.seed(), 1_000_000, |stream| {
        let out = phase.sample(direction, stream);
        // Half the square of the difference: small angles keep their digits.
        let x = (out - peak).length_squared() / 2.0;
        let root = (e * e + 2.0 * a * x).sqrt();
        let u = (1.0 + a) * x / ((root + e) * root);
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "an index, saturating"
        )]
        let cell = (u * CELLS as f64) as usize;
        cells[cell.min(CELLS - 1)] += 1;
        [out.length()]
    });
    rows.push(Row::chi_square("angles", &cells, &measured.seen));
    let length = measured.moments[0].mean();
    let row = Row::exact("length", 1.0, length, &measured.seen);
    rows.push(row.tolerance(1e-9, "one Newton step from 1e-7"));
}

fn long_paths(rows: &mut Rows, g: f32, sigma_t: f32, n: u64) {
    let cloud = volumes::cloud();
    let medium = cloud.medium(sigma_t, Rgb::WHITE, paths::phase(g));
    let lights = sky(Rgb::WHITE);
    let context = Context::new(
        std::slice::from_ref(&medium),
        &lights,
        transport(IntegratorKind::Path, None),
    );
    let body = Body::Cube(1.25);
    let measured = measure(rows.seed(), n, |stream| {
        let ray = body.enter(stream);
        let sample = context.sample_radiance(ray, stream);
        [
            f64::from(sample.radiance.0[0]),
            stream.counts.scattered_rays as f64,
        ]
    });
    let [radiance, bounces] = measured.moments;
    let row = Row::exact("white furnace", 1.0, radiance.mean(), &measured.seen);
    rows.push(row.steps_within(10_000_000));
    let expected = 4.0 / body.surface() * f64::from(sigma_t) * cloud.mass();
    let row = Row::mean("bounces", expected, &bounces, &measured.seen);
    rows.push(row.steps_within(10_000_000));
}

fn lengths(rows: &mut Rows) {
    for phase in [Phase::Isotropic, Phase::HenyeyGreenstein { g: 0.999 }] {
        let mut stream = stream(rows.seed(), 0);
        let mut direction = DVec3::Z;
        for _ in 0..10_000 {
            direction = phase.sample(direction, &mut stream);
        }
        let name = format!("g {}", phase.mean_cosine());
        let row = Row::exact(name, 1.0, direction.length(), &Seen::default());
        rows.push(row.tolerance(1e-12, "one Newton step a bounce"));
    }
}

/// A channel that is black must not disturb the others, nor they it.
fn channels(rows: &mut Rows) {
    let cloud = volumes::cloud();
    let one = |albedo: Rgb, seed| {
        let medium = cloud.medium(8.0, albedo, Phase::Isotropic);
        let lights = sky(Rgb::WHITE);
        let settings = transport(IntegratorKind::Path, None);
        paths::radiance(&medium, &lights, settings, (seed, 150_000), |_| {
            super::middle()
        })
    };
    let together = one(Rgb([0.0, 0.5, 1.0]), rows.seed());
    let tau = 8.0 * cloud.column(&super::middle(), (0.0, 4.0));
    let [black, grey, white] = &together.moments;
    let row = Row::mean("albedo 0", (-tau).exp(), black, &together.seen);
    rows.push(row.steps_within(20_000));
    let alone = one(Rgb::splat(0.5), rows.seed());
    let seen = together.seen.and(&alone.seen);
    let row = Row::same_mean("albedo 0.5", &alone.moments[0], grey, &seen);
    rows.push(row.steps_within(20_000));
    let row = Row::exact("albedo 1", 1.0, white.mean(), &together.seen);
    rows.push(row.steps_within(20_000));
}

/// All pixels look at the same point: they differ by their noise alone.
fn neighbours(rows: &mut Rows) {
    const EDGE: u32 = 64;
    let cloud = volumes::cloud();
    let picture = |spp, frame| -> (Film, Seen) {
        let mut scene = scene(&cloud, 8.0, Rgb::splat(0.8), 0.0, sky(Rgb::WHITE));
        (scene.width, scene.height) = (EDGE, EDGE);
        (scene.spp, scene.frame) = (spp, frame);
        let eye = DVec3::new(0.5, -4.0, 0.8);
        if let Some(camera) = Camera::look_at(eye, DVec3::ZERO, DVec3::Z, 1e-6, 1.0) {
            scene.camera = camera;
        }
        let rendered = render(&scene, &NoProgress, &AtomicBool::new(false));
        let seen = Seen {
            counts: rendered.counts,
            ..Seen::default()
        };
        (rendered.film, seen)
    };
    let values = |film: &Film| -> Vec<f64> { film.pixels().iter().map(|p| p.mean[0]).collect() };
    for spp in [4, 64] {
        let (film, seen) = picture(spp, 0);
        let mut moments = Moments::default();
        for x in values(&film) {
            moments.add(x);
        }
        let within = film.pixels().iter().map(|p| p.variance_of_mean()[0]);
        let within = within.sum::<f64>() / f64::from(EDGE * EDGE);
        let row = Row::variance(format!("variance at {spp} spp"), within, &moments, &seen);
        rows.push(row);
    }
    let (film, seen) = picture(16, 0);
    let (next, _) = picture(16, 1);
    let (a, b) = (values(&film), values(&next));
    let edge = EDGE as usize;
    let pairs = |other: &[f64], shift: usize| {
        let mean = a.iter().sum::<f64>() / a.len() as f64;
        let variance = a.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / a.len() as f64;
        let products = (0..a.len()).map(|i| {
            let j = (i + shift) % a.len();
            (a[i] - mean) * (other[j] - mean)
        });
        products.sum::<f64>() / a.len() as f64 / variance
    };
    let error = 1.0 / f64::from(EDGE);
    for (name, correlation) in [
        ("with the pixel to the right", pairs(&a, 1)),
        ("with the pixel below", pairs(&a, edge)),
        ("with the next frame", pairs(&b, 0)),
    ] {
        let name = format!("correlation {name}");
        rows.push(Row::statistical(name, 0.0, correlation, error, &seen));
    }
}

//! Symmetries: what must not matter does not.

use std::sync::atomic::AtomicBool;

use glam::{DAffine3, DMat3, DVec3, IVec3};

use super::furnace::scene;
use super::measure::Seen;
use super::paths::{self, only, phase, sky, sun, transport};
use super::row::{Group, Row};
use super::volumes::{self, Volume, trilinear};
use super::{Check, Rows};
use crate::film::Film;
use crate::grid::Tree;
use crate::integrator::IntegratorKind;
use crate::light::{DistantLight, Lights};
use crate::render::{NoProgress, Rendered, render};
use crate::sampling::Stream;
use crate::scene::Scene;
use crate::space::{Ray, orthonormal_frame};
use crate::spectrum::Rgb;

const RECIPROCITY: Group = Group {
    name: "reciprocity",
    oracle: "the same with camera and light exchanged",
};

const SAME_BITS: Group = Group {
    name: "the same bits",
    oracle: "the image of another order, scale or number of threads: pixels that differ",
};

const SAME_FIELD: Group = Group {
    name: "the same field, stored otherwise",
    oracle: "the radiance of the coarse grid",
};

const AFFINE: Group = Group {
    name: "affine maps",
    oracle: "exp(-tau) of the unmapped grid by quadrature; its radiance",
};

pub(super) fn checks(out: &mut Vec<Check>) {
    for g in [0.0, 0.7, -0.4] {
        out.push(Check::new(
            &RECIPROCITY,
            format!("sun and camera, cloud, g {g}"),
            move |rows| {
                reciprocity(rows, g);
            },
        ));
    }
    out.push(Check::new(&SAME_BITS, "1 thread and 3", threads));
    out.push(Check::new(&SAME_BITS, "voxels in another order", permuted));
    out.push(Check::new(&SAME_BITS, "density x 4, sigma_t / 4", denser));
    out.push(Check::new(&SAME_BITS, "lengths x 8, sigma_t / 8", larger));
    out.push(Check::new(&SAME_FIELD, "voxels of half the size", refined));
    for (name, map) in maps() {
        out.push(Check::new(
            &AFFINE,
            format!("transmittance, {name}"),
            move |rows| {
                transmittance(rows, map);
            },
        ));
    }
    for (name, map) in maps().into_iter().take(2) {
        out.push(Check::new(
            &AFFINE,
            format!("radiance, {name}"),
            move |rows| {
                radiance(rows, map);
            },
        ));
    }
}

/// The first two keep lengths.
fn maps() -> [(&'static str, DMat3); 6] {
    let rotation = DMat3::from_axis_angle(DVec3::new(0.6, 0.0, 0.8), 1.1);
    let stretch = |x, y, z| DMat3::from_diagonal(DVec3::new(x, y, z));
    [
        ("rotated", rotation),
        ("mirrored", rotation * stretch(1.0, -1.0, 1.0)),
        (
            "sheared",
            DMat3::from_cols(
                DVec3::X,
                DVec3::new(1.5, 1.0, 0.0),
                DVec3::new(0.0, -0.6, 1.0),
            ),
        ),
        ("stretched 1000:1", stretch(1000.0, 1.0, 30.0)),
        (
            "flattened 1:1000, rotated",
            rotation * stretch(0.001, 1.0, 1.0),
        ),
        ("all of it", rotation * stretch(20.0, -1.0, 0.1) * rotation),
    ]
}

/// Rays in a bundle as wide as the cloud.
fn bundle(direction: DVec3, stream: &mut Stream) -> Ray {
    const HALF: f64 = 2.2;
    let (s, t) = orthonormal_frame(direction);
    let mut at = || HALF * (2.0 * f64::from(stream.uniform()) - 1.0);
    Ray {
        origin: s * at() + t * at() - direction * 5.0,
        direction,
    }
}

/// Light that comes from `a` and leaves towards `b` is as much as light that comes from −`b` and
/// leaves towards −`a`, summed over the whole cloud.
fn reciprocity(rows: &mut Rows, g: f32) {
    let cloud = volumes::cloud();
    let medium = cloud.medium(10.0, Rgb([1.0, 0.9, 0.5]), phase(g));
    let settings = transport(IntegratorKind::Path, None);
    let (look, to_sun) = (DVec3::new(0.0, 0.6, -0.8), DVec3::new(0.8, -0.6, 0.0));
    let there = paths::radiance(
        &medium,
        &only([sun(to_sun)]),
        settings,
        (rows.seed(), 400_000),
        |stream| bundle(look, stream),
    );
    let back = paths::radiance(
        &medium,
        &only([sun(-look)]),
        settings,
        (rows.seed(), 400_000),
        |stream| bundle(-to_sun, stream),
    );
    let seen = there.seen.and(&back.seen);
    for (i, albedo) in [1.0, 0.9, 0.5].into_iter().enumerate() {
        let (a, b) = (&there.moments[i], &back.moments[i]);
        rows.push(Row::same_mean(format!("albedo {albedo}"), a, b, &seen));
    }
}

fn lights() -> Lights {
    let sun = DistantLight::new(DVec3::new(0.5, -0.5, 0.7), Rgb([3.0, 2.5, 2.0]), 0.01);
    Lights {
        environment: Rgb([0.1, 0.2, 0.3]),
        ..only([sun.expect("a sun")])
    }
}

/// A lit picture of a volume.
fn picture(volume: &Volume, sigma_t: f32) -> Scene {
    scene(volume, sigma_t, Rgb([0.95, 0.9, 0.8]), 0.7, lights())
}

fn run(scene: &Scene) -> Rendered {
    render(scene, &NoProgress, &AtomicBool::new(false))
}

/// Adds a row about the number of pixels that are not the same bits in both.
fn same_bits(rows: &mut Rows, a: &Rendered, b: &Rendered) {
    let differ = |a: &Film, b: &Film| {
        let pairs = a.pixels().iter().zip(b.pixels());
        pairs
            .filter(|(a, b)| a.mean != b.mean || a.m2 != b.m2)
            .count()
    };
    let seen = Seen {
        counts: a.counts,
        ..Seen::default()
    };
    let row = Row::exact(
        "pixels that differ",
        0.0,
        differ(&a.film, &b.film) as f64,
        &seen,
    );
    let lit = a
        .film
        .pixels()
        .iter()
        .any(|p| p.mean[0] > 0.1 && p.m2[0] > 0.0);
    rows.push(
        row.demanding(a.counts == b.counts, "other events were counted")
            .demanding(lit, "the picture is black or even"),
    );
}

fn threads(rows: &mut Rows) {
    let scene = picture(&volumes::cloud(), 12.0);
    let with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
        pool.map(|pool| pool.install(|| run(&scene)))
    };
    match (with(1), with(3)) {
        (Ok(one), Ok(three)) => same_bits(rows, &one, &three),
        _ => rows.push(
            Row::exact("pixels that differ", 0.0, 1.0, &Seen::default())
                .demanding(false, "no threads to be had"),
        ),
    }
}

fn permuted(rows: &mut Rows) {
    let order: Vec<IVec3> = volumes::lump_voxels().collect();
    let n = order.len();
    // A step prime to the number of voxels visits each of them once.
    let mixed = (0..n).map(|i| order[i * 61_813 % n]);
    let voxels = mixed.map(|p| (p, volumes::lumps(p)));
    let tree = Tree::from_voxels(0.0, voxels.filter(|&(_, v)| v > 0.0));
    let cloud = volumes::cloud();
    let moved = tree.brick_origins() != cloud.tree().brick_origins();
    let other = Volume::uniform(tree, 0.05);
    same_bits(
        rows,
        &run(&picture(&cloud, 12.0)),
        &run(&picture(&other, 12.0)),
    );
    if let Some(row) = rows.rows.pop() {
        rows.push(row.demanding(moved, "the bricks are in the same order"));
    }
}

fn denser(rows: &mut Rows) {
    let voxels = volumes::lump_voxels().map(|p| (p, 4.0 * volumes::lumps(p)));
    let tree = Tree::from_voxels(0.0, voxels.filter(|&(_, v)| v > 0.0));
    let other = Volume::uniform(tree, 0.05);
    same_bits(
        rows,
        &run(&picture(&volumes::cloud(), 12.0)),
        &run(&picture(&other, 3.0)),
    );
}

fn larger(rows: &mut Rows) {
    let other = Volume::uniform(volumes::cloud_tree(), 0.4);
    let mut large = picture(&other, 1.5);
    let eye = DVec3::new(4.0, -32.0, 6.4);
    if let Some(camera) = crate::camera::Camera::look_at(eye, DVec3::ZERO, DVec3::Z, 0.6, 1.5) {
        large.camera = camera;
    }
    same_bits(rows, &run(&picture(&volumes::cloud(), 12.0)), &run(&large));
}

/// Twice the voxels an axis, each with the trilinear value of the coarse grid: the same function.
fn refined(rows: &mut Rows) {
    let coarse = volumes::cloud();
    #[expect(clippy::cast_possible_truncation, reason = "voxels are f32")]
    let at = |p: IVec3| trilinear(coarse.tree(), p.as_dvec3() * 0.5) as f32;
    let corner = IVec3::splat(52);
    let fine = volumes::box_of(-corner, corner, at);
    let fine = Volume::uniform(fine, 0.025);
    let settings = transport(IntegratorKind::Path, None);
    let lights = lights();
    let measure = |volume: &Volume, seed| {
        let medium = volume.medium(12.0, Rgb([0.95, 0.9, 0.8]), phase(0.7));
        let look = DVec3::new(0.0, 0.6, -0.8);
        paths::radiance(&medium, &lights, settings, (seed, 200_000), |stream| {
            bundle(look, stream)
        })
    };
    let (a, b) = (measure(&coarse, rows.seed()), measure(&fine, rows.seed()));
    let seen = a.seen.and(&b.seen);
    for (i, name) in ["red", "green", "blue"].into_iter().enumerate() {
        rows.push(Row::same_mean(name, &a.moments[i], &b.moments[i], &seen));
    }
}

fn transmittance(rows: &mut Rows, map: DMat3) {
    const SIGMA_T: f64 = 2.0;
    let cloud = volumes::cloud();
    let direction = DVec3::new(0.48, 0.36, 0.8);
    let ray = Ray {
        origin: DVec3::new(0.1, 0.2, 0.1) - direction * 4.0,
        direction,
    };
    let tau = SIGMA_T * cloud.column(&ray, (0.0, 8.0));
    let along = map * direction;
    // A unit of the ray is this long once mapped.
    let stretch = along.length();
    let mapped = Volume::new(
        cloud.tree().clone(),
        DAffine3::from_mat3(map) * cloud.world_from_index(),
    );
    #[expect(clippy::cast_possible_truncation, reason = "rounding is 6e-8 of it")]
    let sigma_t = (SIGMA_T / stretch) as f32;
    let ray = Ray {
        origin: map * ray.origin,
        direction: along / stretch,
    };
    // The sky through a black cloud.
    let medium = mapped.medium(sigma_t, Rgb::BLACK, phase(0.0));
    let settings = transport(IntegratorKind::Analog, None);
    let lights = sky(Rgb::WHITE);
    let measured = paths::radiance(&medium, &lights, settings, (rows.seed(), 500_000), |_| ray);
    let row = Row::fraction("", (-tau).exp(), &measured.moments[0], &measured.seen);
    rows.push(row.tolerance(1e-6, "rounding of sigma_t"));
}

/// Camera, sun and cloud turned or mirrored together.
fn radiance(rows: &mut Rows, map: DMat3) {
    let cloud = volumes::cloud();
    let mapped = Volume::new(
        cloud.tree().clone(),
        DAffine3::from_mat3(map) * cloud.world_from_index(),
    );
    let settings = transport(IntegratorKind::Path, None);
    let (look, to_sun) = (DVec3::new(0.0, 0.6, -0.8), DVec3::new(0.8, -0.6, 0.0));
    let measure = |volume: &Volume, map: DMat3, seed| {
        let medium = volume.medium(10.0, Rgb([1.0, 0.9, 0.5]), phase(0.7));
        let lights = only([sun(map * to_sun)]);
        paths::radiance(&medium, &lights, settings, (seed, 400_000), |stream| {
            let Ray { origin, direction } = bundle(look, stream);
            Ray {
                origin: map * origin,
                direction: map * direction,
            }
        })
    };
    let (a, b) = (
        measure(&cloud, DMat3::IDENTITY, 85),
        measure(&mapped, map, 86),
    );
    let seen = a.seen.and(&b.seen);
    for (i, albedo) in [1.0, 0.9, 0.5].into_iter().enumerate() {
        let (a, b) = (&a.moments[i], &b.moments[i]);
        rows.push(Row::same_mean(format!("albedo {albedo}"), a, b, &seen));
    }
}

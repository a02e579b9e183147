//! Cameras far away, rays along faces and edges, stretched voxels, huge coordinates.

use glam::{DAffine3, DMat3, DVec3, IVec3};

use super::coefficients::STEPS;
use super::{along, exact, middle};
use crate::grid::Tree;
use crate::integrator::IntegratorKind;
use crate::space::Ray;
use crate::spectrum::Rgb;
use crate::tracking::Tracking;
use crate::verify::furnace::Body;
use crate::verify::measure::{Measured, Seen, measure, stream};
use crate::verify::paths::{self, only, phase, sky, sun, transport};
use crate::verify::row::{Group, Row};
use crate::verify::volumes::{self, Volume};
use crate::verify::{Check, Rows};

const FAR: Group = Group {
    name: "cameras far away",
    oracle: "exp(-tau) by quadrature; the radiance from near by",
};

const LATTICE: Group = Group {
    name: "rays on faces, edges and corners",
    oracle: "exp(-tau) by quadrature",
};

const MAPS: Group = Group {
    name: "voxels of 1e7:1, sheared, rotated, mirrored",
    oracle: "exp(-tau) of the unmapped grid; 1 in a white furnace",
};

const COORDINATES: Group = Group {
    name: "coordinates near 2^30",
    oracle: "exp(-tau) of the grid at 0; its radiance",
};

pub(super) fn checks(out: &mut Vec<Check>) {
    for distance in [1e4, 1e5, 1e6, 1e7] {
        out.push(Check::new(
            &FAR,
            format!("{distance:e} units"),
            move |rows| {
                far(rows, distance);
            },
        ));
    }
    out.push(Check::new(&LATTICE, "26 directions, 9 points", |rows| {
        many(rows, &lattice_rays());
    }));
    out.push(Check::new(&LATTICE, "components -0 and denormal", |rows| {
        many(rows, &degenerate_rays());
    }));
    out.push(Check::new(&LATTICE, "2000 rays at random", |rows| {
        many(rows, &random_rays());
    }));
    for (name, map, shortest) in maps() {
        out.push(Check::new(&MAPS, name, move |rows| {
            mapped(rows, map, shortest);
        }));
    }
    for (name, offset) in [
        ("2^30", IVec3::splat(1 << 30) - IVec3::new(77, 5, 4099)),
        ("-2^30", IVec3::splat(-(1 << 30)) + IVec3::new(3, -19, 2051)),
        ("mixed", IVec3::new(1 << 30, -(1 << 30), 12_345)),
    ] {
        out.push(Check::new(&COORDINATES, name, move |rows| {
            moved(rows, offset);
        }));
    }
}

/// The radiance of a sun-lit cloud along a ray.
fn lit(volume: &Volume, ray: Ray, seed: u64) -> Measured<3> {
    let medium = volume.medium(6.0, Rgb::splat(0.95), phase(0.5));
    let lights = only([sun(DVec3::new(0.5, -0.5, 0.7))]);
    let settings = transport(IntegratorKind::Path, None);
    paths::radiance(&medium, &lights, settings, (seed, 100_000), |_| ray)
}

/// Adds a row: the same radiance as the cloud seen from near by.
fn as_from_near(rows: &mut Rows, volume: &Volume, ray: Ray) {
    let near = lit(&volumes::cloud(), middle(), rows.seed());
    let measured = lit(volume, ray, rows.seed());
    let seen = near.seen.and(&measured.seen);
    let row = Row::same_mean("radiance", &near.moments[0], &measured.moments[0], &seen);
    // A path of some hundred bounces, with shadow rays.
    rows.push(row.steps_within(20_000));
}

fn far(rows: &mut Rows, distance: f64) {
    let cloud = volumes::cloud();
    let near = middle();
    let tau = 2.0 * cloud.column(&near, (0.0, 4.0));
    let ray = Ray {
        origin: near.origin - near.direction * distance,
        direction: near.direction,
    };
    along(rows, &cloud.attenuating(2.0), &ray, tau, 100_000, STEPS);
    as_from_near(rows, &cloud, ray);
}

/// A voxel is a world unit here, and bricks begin at multiples of 8.
fn unit_cloud() -> Volume {
    Volume::uniform(volumes::cloud_tree(), 1.0)
}

fn lattice_rays() -> Vec<Ray> {
    let points = [
        (0.0, 0.0, 0.0),
        (8.0, 8.0, 8.0),
        (-8.0, 0.0, 8.0),
        (4.0, 4.0, 4.0),
        (8.0, 3.0, -3.0),
        (8.0, -8.0, 3.0),
        (8.5, 8.0, 0.5),
        (-8.0, 3.5, 0.0),
        (7.999999999999999, 8.000000000000002, 0.0),
    ];
    let directions = (0..27).map(|i| IVec3::new(i / 9, i / 3 % 3, i % 3) - 1);
    let directions = directions.filter_map(|d| d.as_dvec3().try_normalize());
    let aimed = directions.flat_map(|direction| {
        points.map(|(x, y, z)| Ray {
            origin: DVec3::new(x, y, z) - direction * 64.0,
            direction,
        })
    });
    aimed.collect()
}

fn degenerate_rays() -> Vec<Ray> {
    let smalls = [0.0, -0.0, 1e-320, -1e-320, 1e-300, -1e-17, 1e-9];
    let origins = [(8.0, 8.0), (0.0, -8.0), (3.5, 8.0), (-7.999999, 0.0)];
    let mut rays = Vec::new();
    for axis in 0..3 {
        for sign in [1.0, -1.0] {
            for small in smalls {
                for (y, z) in origins {
                    let turn = |v: DVec3| match axis {
                        0 => v,
                        1 => DVec3::new(v.z, v.x, v.y),
                        _ => DVec3::new(v.y, v.z, v.x),
                    };
                    rays.push(Ray {
                        origin: turn(DVec3::new(-64.0 * sign, y, z)),
                        direction: turn(DVec3::new(sign, small, -small)),
                    });
                }
            }
        }
    }
    rays
}

fn random_rays() -> Vec<Ray> {
    let ray = |i| {
        let mut stream = stream(9, i);
        let mut signed = || 2.0 * f64::from(stream.uniform()) - 1.0;
        let direction = DVec3::new(signed(), signed(), signed() + 2.0);
        let direction = direction / direction.length();
        let p = DVec3::new(signed(), signed(), signed()) * 20.0;
        Ray {
            origin: p - direction * 64.0,
            direction,
        }
    };
    (0..2000).map(ray).collect()
}

/// Adds rows: exact integration of each ray, and flights along all of them in turn.
fn many(rows: &mut Rows, rays: &[Ray]) {
    const SIGMA_T: f32 = 0.08;
    let volume = unit_cloud();
    let medium = volume.attenuating(SIGMA_T);
    let expected = |ray: &Ray| (-f64::from(SIGMA_T) * volume.column(ray, (0.0, 128.0))).exp();
    let expected: Vec<f64> = rays.iter().map(expected).collect();
    let (mut worst, mut seen) = (0.0_f64, Seen::default());
    for (ray, expected) in rays.iter().zip(&expected) {
        let measured = measure(0, 1, |stream| {
            let end = f64::INFINITY;
            let t = exact().estimate_transmittance(&medium, ray, end, 0.0, stream);
            [f64::from(t)]
        });
        worst = worst.max((measured.moments[0].mean() - expected).abs());
        seen = seen.and(&measured.seen);
    }
    let row = Row::exact("T, exact, farthest off by", 0.0, worst, &seen);
    rows.push(
        row.tolerance(3e-7, "f32 of a transmittance")
            .steps_within(STEPS),
    );
    let tracking = Tracking::default();
    let mut turn = rays.iter().cycle();
    let turns = 200_000 / rays.len() as u64;
    let measured = measure(rows.seed(), turns * rays.len() as u64, |stream| {
        let flight = turn
            .next()
            .map(|ray| tracking.sample_collision(&medium, ray, f64::INFINITY, stream));
        [flight.map_or(f64::NAN, |t| f64::from(u8::from(t.is_none())))]
    });
    let mean = expected.iter().sum::<f64>() / expected.len() as f64;
    let row = Row::fraction("escape", mean, &measured.moments[0], &measured.seen);
    rows.push(row.steps_within(STEPS));
}

/// Maps, and by how much they shrink the shortest axis.
fn maps() -> [(&'static str, DMat3, f64); 5] {
    let rotation = DMat3::from_axis_angle(DVec3::new(0.6, 0.0, 0.8), 1.1);
    let stretch = |x, y, z| DMat3::from_diagonal(DVec3::new(x, y, z));
    let shear = DMat3::from_cols(
        DVec3::X,
        DVec3::new(30.0, 1.0, 0.0),
        DVec3::new(0.0, -0.6, 1.0),
    );
    let squeezed = rotation * stretch(1.0, 1e-7, 1.0);
    let mirrored = rotation * stretch(-1.0, -1.0, -1.0);
    let everything = rotation * stretch(1e3, -1.0, 1e-2) * shear;
    [
        ("1e7:1", stretch(1e7, 1.0, 1.0), 1.0),
        ("1:1e7, rotated", squeezed, 1e-7),
        ("sheared by 30", shear, 0.03),
        ("mirrored, three times", mirrored, 1.0),
        ("all of it", everything, 1e-2),
    ]
}

fn mapped(rows: &mut Rows, map: DMat3, shortest: f64) {
    const SIGMA_T: f64 = 2.0;
    let cloud = volumes::cloud();
    let ray = middle();
    let tau = SIGMA_T * cloud.column(&ray, (0.0, 4.0));
    let world = DAffine3::from_mat3(map) * cloud.world_from_index();
    let volume = Volume::new(cloud.tree().clone(), world);
    let along_ray = map * ray.direction;
    let stretch = along_ray.length();
    #[expect(clippy::cast_possible_truncation, reason = "rounding is 6e-8 of it")]
    let medium = volume.attenuating((SIGMA_T / stretch) as f32);
    let ray = Ray {
        origin: map * ray.origin,
        direction: along_ray / stretch,
    };
    along(rows, &medium, &ray, tau, 100_000, STEPS);
    // Thick across its shortest axis.
    #[expect(clippy::cast_possible_truncation, reason = "any thickness will do")]
    let medium = volume.medium((5.0 / shortest) as f32, Rgb::WHITE, phase(0.5));
    let settings = transport(IntegratorKind::Path, None);
    let budget = (rows.seed(), 3_000);
    let white = paths::radiance(&medium, &sky(Rgb::WHITE), settings, budget, |stream| {
        let Ray { origin, direction } = Body::Cube(1.25).enter(stream);
        let direction = map * direction;
        Ray {
            origin: map * origin,
            direction: direction / direction.length(),
        }
    });
    let counts = white.seen.counts;
    let thick = counts.scattered_rays > counts.camera_rays / 2;
    let row = Row::exact("white furnace", 1.0, white.moments[0].mean(), &white.seen);
    rows.push(row.demanding(thick, "less than one scattering for two paths"));
}

fn moved(rows: &mut Rows, offset: IVec3) {
    let voxels = volumes::lump_voxels().map(|p| (p + offset, volumes::lumps(p)));
    let tree = Tree::from_voxels(0.0, voxels.filter(|&(_, v)| v > 0.0));
    let cloud = volumes::cloud();
    let back = DAffine3::from_translation(-offset.as_dvec3());
    let volume = Volume::new(tree, cloud.world_from_index() * back);
    let ray = middle();
    let tau = 2.0 * cloud.column(&ray, (0.0, 4.0));
    along(rows, &volume.attenuating(2.0), &ray, tau, 100_000, STEPS);
    as_from_near(rows, &volume, ray);
}

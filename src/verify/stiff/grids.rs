//! Empty, tiny and constant grids, tiles of all levels, voxels that are no numbers.

use glam::{DVec3, IVec3};

use super::coefficients::STEPS;
use super::{ROUNDING, along, exact_transmittance, file};
use crate::grid::{Tree, TreeBuilder};
use crate::integrator::IntegratorKind;
use crate::space::Ray;
use crate::spectrum::Rgb;
use crate::tracking::{Tracking, TransmittanceEstimator};
use crate::vdb::{Archive, LoadOptions};
use crate::verify::measure::{Seen, measure};
use crate::verify::paths::{self, phase, sky, transport};
use crate::verify::row::{Group, Row};
use crate::verify::volumes::{Volume, box_of};
use crate::verify::{Check, Rows};

const EMPTY: Group = Group {
    name: "empty space",
    oracle: "nothing is in the way",
};

const ONE_VOXEL: Group = Group {
    name: "one voxel",
    oracle: "a tent of half-width 1 around the index point",
};

const TILES: Group = Group {
    name: "grids of tiles",
    oracle: "sigma_t 1/N over N voxels gives 1/e",
};

const CONSTANT: Group = Group {
    name: "constant bricks",
    oracle: "exp(-sigma_t L), without variance",
};

const VOXELS: Group = Group {
    name: "voxels that are no densities",
    oracle: "refused; or read as 0, and counted",
};

pub(super) fn checks(out: &mut Vec<Check>) {
    out.push(Check::new(&EMPTY, "no voxel at all", |rows| {
        nothing(rows, &Volume::uniform(Tree::from_voxels(0.0, []), 1.0));
    }));
    out.push(Check::new(&EMPTY, "4096 bricks of zeros", |rows| {
        let zeros = (0..4096).map(|i| (IVec3::new(i * 8, 0, 0), 0.0));
        nothing(rows, &Volume::uniform(Tree::from_voxels(0.0, zeros), 1.0));
    }));
    out.push(Check::new(
        &EMPTY,
        "100000 bricks between two voxels",
        between,
    ));
    out.push(Check::new(&ONE_VOXEL, "tent", one_voxel));
    for (name, log2, active) in [
        ("8 voxels", 3, true),
        ("128 voxels", 7, true),
        ("128 voxels, inactive", 7, false),
        ("4096 voxels", 12, true),
    ] {
        out.push(Check::new(&TILES, name, move |rows| {
            tile(rows, log2, active);
        }));
    }
    out.push(Check::new(&CONSTANT, "f32", constant));
    out.push(Check::new(&VOXELS, "NaN, Inf, -1, denormal", not_finite));
}

fn along_x(y: f64, z: f64) -> Ray {
    Ray {
        origin: DVec3::new(-50.0, y, z),
        direction: DVec3::X,
    }
}

/// An empty volume is not there.
fn nothing(rows: &mut Rows, volume: &Volume) {
    let ray = along_x(0.5, 0.5);
    along(rows, &volume.attenuating(1e8), &ray, 0.0, 1000, 0);
    let medium = volume.medium(1e8, Rgb::WHITE, phase(0.0));
    let settings = transport(IntegratorKind::Path, None);
    let budget = (rows.seed(), 1000);
    let measured = paths::radiance(&medium, &sky(Rgb::WHITE), settings, budget, |_| ray);
    let row = Row::exact("sky", 1.0, measured.moments[0].mean(), &measured.seen);
    rows.push(row.steps_within(0));
}

fn between(rows: &mut Rows) {
    let ends = [(IVec3::ZERO, 1.0), (IVec3::new(800_000, 0, 0), 1.0)];
    let volume = Volume::uniform(Tree::from_voxels(0.0, ends), 1.0);
    let ray = along_x(0.0, 0.0);
    along(rows, &volume.attenuating(0.5), &ray, 1.0, 100_000, 100);
    // From behind the first voxel to before the second.
    let inside = Ray {
        origin: DVec3::new(9.0, 0.0, 0.0),
        direction: DVec3::X,
    };
    let medium = volume.attenuating(1e8);
    let measured = measure(rows.seed(), 1000, |stream| {
        let end = 799_980.0;
        let t = Tracking::default().estimate_transmittance(&medium, &inside, end, 0.0, stream);
        [f64::from(t)]
    });
    let row = Row::exact(
        "T between them",
        1.0,
        measured.moments[0].mean(),
        &measured.seen,
    );
    rows.push(row.steps_within(0));
}

fn one_voxel(rows: &mut Rows) {
    const DENSITY: f64 = 1.5;
    const RASTER: i32 = 32;
    let tree = Tree::from_voxels(0.0, [(IVec3::new(7, -8, 0), 1.5)]);
    let volume = Volume::uniform(tree, 1.0);
    let medium = volume.attenuating(1.0);
    for (name, dy, dz) in [
        ("through the middle", 0.0, 0.0),
        ("half a voxel off", 0.5, 0.0),
        ("off on two axes", -0.75, 0.25),
        ("past it", 1.0, 0.0),
    ] {
        let ray = along_x(-8.0 + dy, dz);
        let expected = (-DENSITY * (1.0 - f64::abs(dy)) * (1.0 - f64::abs(dz))).exp();
        let measured = exact_transmittance(&medium, &ray);
        let row = Row::exact(name, expected, measured.moments[0].mean(), &measured.seen);
        rows.push(row.tolerance(2e-7, ROUNDING).steps_within(40));
    }
    // The trapezoidal rule is exact for a tent whose kinks are on its raster.
    let (mut mass, mut seen) = (0.0, Seen::default());
    for i in 0..RASTER * RASTER {
        let at = |k: i32| 2.0 * f64::from(k) / f64::from(RASTER) - 1.0;
        let ray = along_x(-8.0 + at(i % RASTER), at(i / RASTER));
        let measured = exact_transmittance(&medium, &ray);
        mass -= measured.moments[0].mean().ln() * 4.0 / f64::from(RASTER * RASTER);
        seen = seen.and(&measured.seen);
    }
    let row = Row::exact("integral of the density", DENSITY, mass, &seen);
    rows.push(row.tolerance(1e-6, ROUNDING).steps_within(40));
}

fn tile(rows: &mut Rows, log2: u32, active: bool) {
    let mut b = TreeBuilder::new(0.0_f32);
    match log2 {
        3 => {
            let node = b.lower_node(IVec3::ZERO);
            b.set_lower_tile(node, 0, 1.0, active);
        }
        7 => {
            let node = b.upper_node(IVec3::ZERO);
            b.set_upper_tile(node, 0, 1.0, active);
        }
        _ => b.set_root_tile(IVec3::ZERO, 1.0, active),
    }
    let volume = Volume::uniform(b.finish(Vec::new(), Vec::new()), 1.0);
    let n = f64::from(1 << log2);
    #[expect(clippy::cast_possible_truncation, reason = "a power of two")]
    let medium = volume.attenuating((1.0 / n) as f32);
    let ray = along_x(n / 2.0 + 0.3, n / 2.0 - 0.2);
    // Exact integration visits each voxel; all else a few cells.
    let steps = 80 + (1 << log2);
    along(rows, &medium, &ray, 1.0, 100_000, steps);
}

fn constant(rows: &mut Rows) {
    let tree = box_of(IVec3::ZERO, IVec3::splat(24), |_| 0.7);
    let volume = Volume::uniform(tree, 1.0);
    let medium = volume.attenuating(0.3);
    // Inside the bricks whose neighbours are the same.
    let ray = Ray {
        origin: DVec3::splat(0.5),
        direction: DVec3::new(0.6, 0.0, 0.8),
    };
    let expected = (-f64::from(0.7_f32) * f64::from(0.3_f32) * 15.0).exp();
    for transmittance in [
        TransmittanceEstimator::Ratio,
        TransmittanceEstimator::ResidualRatio,
        TransmittanceEstimator::Exact,
        TransmittanceEstimator::Auto,
    ] {
        let tracking = Tracking {
            transmittance,
            ..Tracking::default()
        };
        let measured = measure(rows.seed(), 1000, |stream| {
            let t = tracking.estimate_transmittance(&medium, &ray, 15.0, 0.0, stream);
            [f64::from(t)]
        });
        let moments = &measured.moments[0];
        let row = Row::exact(
            transmittance.name(),
            expected,
            moments.mean(),
            &measured.seen,
        );
        // Zero: the same closed form each time.
        let still = moments.variance() == 0.0;
        rows.push(
            row.tolerance(2e-7, ROUNDING)
                .demanding(still, "estimates differ")
                .steps_within(STEPS),
        );
    }
}

/// A file with bad voxels: nothing of it is read silently.
fn not_finite(rows: &mut Rows) {
    let seen = Seen::default();
    let mut values = [1.0_f32; 512];
    let bad = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, -1.0, 1e-40];
    values[100..105].copy_from_slice(&bad);
    let archive = Archive::from_bytes("voxels.vdb", file::of_one_leaf(&values));
    let load = |sanitize| {
        let options = LoadOptions {
            sanitize,
            ..LoadOptions::default()
        };
        let archive = archive.as_ref().ok()?;
        archive.load_density(0, &options).ok()
    };
    let refused = archive.is_ok() && load(false).is_none();
    let row = Row::exact("refused", 1.0, f64::from(u8::from(refused)), &seen);
    rows.push(row);
    let Some(data) = load(true) else {
        let row = Row::exact("read as 0", 1.0, 0.0, &seen);
        rows.push(row.demanding(false, "the file cannot be read"));
        return;
    };
    let (report, tree) = (data.report, data.tree);
    let not_finite = report.sanitized_count as f64;
    rows.push(Row::exact("read as 0: not finite", 3.0, not_finite, &seen));
    let negative = report.clamped_negative_count as f64;
    rows.push(Row::exact("read as 0: negative", 1.0, negative, &seen));
    // Voxels 100 to 104 are at x 1, y 4, z 4 to 7 and y 5, z 0; the ray runs through the first.
    let volume = Volume::new(tree, data.transform.world_from_index());
    let ray = Ray {
        origin: DVec3::new(1.0, 4.0, -5.0),
        direction: DVec3::Z,
    };
    // Four of eight voxels are left.
    along(rows, &volume.attenuating(0.25), &ray, 1.0, 100_000, STEPS);
}

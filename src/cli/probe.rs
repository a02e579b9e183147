//! `majorant probe`: single values of a grid, as stored and as filtered.

use std::fmt::Write as _;
use std::path::Path;

use glam::{DVec3, IVec3};
use majorant::grid::{Tile, Tree};
use majorant::space::floor_to_voxel;
use majorant::vdb::{Archive, Grid, LoadOptions, TypedGrid};
use serde::Serialize;

use super::args::ProbeArgs;
use super::json::{Number, Shown, Value};
use super::parse::parse_index_line;
use super::{Failure, memory, report};

/// What was found at one place.
#[derive(Debug, Serialize)]
#[serde(untagged)]
enum Found {
    /// A stored value.
    Voxel {
        index: [i32; 3],
        active: bool,
        value: Value,
        /// The value in words, where it is not finite.
        #[serde(skip_serializing_if = "Option::is_none")]
        not_finite: Option<String>,
    },
    /// The trilinearly filtered value at a point.
    Point {
        world: [f64; 3],
        /// The point in index space.
        index: [f64; 3],
        value: Value,
        #[serde(skip_serializing_if = "Option::is_none")]
        not_finite: Option<String>,
    },
}

pub(super) fn run(args: &ProbeArgs) -> Result<(), Failure> {
    let mut voxels = args.at.clone();
    if let Some(path) = &args.at_file {
        voxels.extend(read_indices(path)?);
    }
    if voxels.is_empty() && args.world.is_empty() {
        let message = "nothing to probe: give --at I,J,K, --at-file FILE or --world X,Y,Z";
        return Err(Failure::Usage(message.to_owned()));
    }
    let archive = Archive::open(&args.file)?;
    let options = LoadOptions {
        max_memory_bytes: memory::limit(args.max_memory),
        sanitize: false,
    };
    let grid = archive.load(archive.find(&args.grid)?, &options)?;
    let found = match &grid {
        Grid::F32(g) => probe(g, &voxels, &args.world),
        Grid::F64(g) => probe(g, &voxels, &args.world),
        Grid::I32(g) => probe(g, &voxels, &args.world),
        Grid::I64(g) => probe(g, &voxels, &args.world),
        Grid::Vec3F(g) => probe(g, &voxels, &args.world),
        Grid::Vec3D(g) => probe(g, &voxels, &args.world),
        Grid::Vec3I(g) => probe(g, &voxels, &args.world),
        other => {
            return Err(Failure::failed(format!(
                "{other:?} has a type without probe"
            )));
        }
    };
    let text = if args.json {
        let json = serde_json::to_string(&found).map_err(Failure::failed)?;
        format!("{json}\n")
    } else {
        in_words(&found)
    };
    report::print(&text)
}

fn read_indices(path: &Path) -> Result<Vec<IVec3>, Failure> {
    let shown = path.display();
    let text = std::fs::read_to_string(path)
        .map_err(|e| Failure::BadInput(format!("{shown}: cannot be read: {e}")))?;
    let numbered = text.lines().zip(1..);
    let lines = numbered.filter(|(line, _)| !line.trim().is_empty());
    lines
        .map(|(line, number)| {
            parse_index_line(line).ok_or_else(|| {
                let message = format!("{shown}:{number}: {line:?}, expected three integers i j k");
                Failure::BadInput(message)
            })
        })
        .collect()
}

fn probe<V: Shown>(grid: &TypedGrid<V>, voxels: &[IVec3], points: &[DVec3]) -> Vec<Found> {
    let stored = voxels.iter().map(|&p| {
        let Tile { value, active } = grid.tree.probe(p);
        let value = Value(value.numbers());
        Found::Voxel {
            index: p.to_array(),
            active,
            not_finite: value.not_finite(),
            value,
        }
    });
    let filtered = points.iter().map(|&p_world| {
        let p_index = grid.transform.index_from_world().transform_point3(p_world);
        let value = Value(trilinear(&grid.tree, p_index));
        Found::Point {
            world: p_world.to_array(),
            index: p_index.to_array(),
            not_finite: value.not_finite(),
            value,
        }
    });
    stored.chain(filtered).collect()
}

/// Interpolates between the eight voxels around `p_index`, each component in `f64`.
///
/// The slow and obvious form, apart from the renderer's sampler on purpose: either checks the
/// other.
fn trilinear<V: Shown>(tree: &Tree<V>, p_index: DVec3) -> Vec<Number> {
    let base = floor_to_voxel(p_index);
    let f = p_index - base.as_dvec3();
    let mut sums = Vec::new();
    for corner in 0..8 {
        let step = IVec3::new(corner >> 2 & 1, corner >> 1 & 1, corner & 1);
        let weight = |axis: usize| {
            if step[axis] == 1 {
                f[axis]
            } else {
                1.0 - f[axis]
            }
        };
        let w = weight(0) * weight(1) * weight(2);
        let values = tree.probe(base.saturating_add(step)).value.numbers();
        sums.resize(values.len(), 0.0);
        // Zero: a voxel that the filter does not touch may be NaN.
        if w != 0.0 {
            for (sum, value) in sums.iter_mut().zip(values) {
                *sum += w * value.as_f64();
            }
        }
    }
    sums.into_iter().map(Number::F64).collect()
}

fn in_words(found: &[Found]) -> String {
    let mut out = String::new();
    for entry in found {
        let line = match entry {
            Found::Voxel {
                index: [i, j, k],
                active,
                value,
                ..
            } => {
                let state = if *active { "active" } else { "inactive" };
                writeln!(out, "{i},{j},{k}  {value}  {state}")
            }
            Found::Point {
                world: [x, y, z],
                index: [i, j, k],
                value,
                ..
            } => writeln!(out, "{x},{y},{z}  {value}  filtered at index {i},{j},{k}"),
        };
        line.expect("writing to a string cannot fail");
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn filtering_is_exact_for_trilinear_functions() {
        // a + b x + c y + d z + e x y z is reproduced exactly between its samples.
        let f = |p: DVec3| 1.0 + 2.0 * p.x - 3.0 * p.y + 0.5 * p.z + p.x * p.y * p.z;
        let corners = (0..8).map(|i| IVec3::new(i >> 2 & 1, i >> 1 & 1, i & 1) - IVec3::ONE);
        let tree = Tree::from_voxels(0.0_f64, corners.map(|p| (p, f(p.as_dvec3()))));
        for p in [DVec3::new(-0.25, -0.75, -0.5), DVec3::new(-1.0, -0.1, -0.9)] {
            let got = trilinear(&tree, p)[0].as_f64();
            assert!((got - f(p)).abs() < 1e-12, "at {p}: {got}, not {}", f(p));
        }
    }

    #[test]
    fn the_filter_does_not_read_voxels_it_does_not_touch() {
        let tree = Tree::from_voxels(f32::NAN, [(IVec3::ZERO, 3.0)]);
        assert_eq!(trilinear(&tree, DVec3::ZERO), [Number::F64(3.0)]);
    }
}

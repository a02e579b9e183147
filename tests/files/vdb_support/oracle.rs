//! Oracles: text files with what OpenVDB itself reads back from a .vdb file, and the comparison.
//!
//! A vector's sum is written as x + 2 y + 3 z. `at` lines are spot checks, `xf` lines are images
//! of index points under the grid's map.

use std::collections::HashMap;
use std::path::Path;

use glam::{DVec3, IVec3};
use majorant::grid::Tree;
use majorant::vdb::{
    Archive, Components, Grid, GridInfo, LoadOptions, Refusal, TypedGrid, VdbError,
};

/// What OpenVDB says of one grid.
#[derive(Debug, Default)]
pub(crate) struct GridOracle {
    name: String,
    tree_type: String,
    class: String,
    half: bool,
    lines: Vec<String>,
}

/// What came of one grid.
#[derive(Debug)]
pub(crate) enum Outcome {
    Exact,
    Refused(Refusal),
    Wrong(String),
}

impl GridOracle {
    /// Parses an oracle file; grids come in order of their names.
    pub(crate) fn parse(text: &str) -> Vec<Self> {
        let mut grids: Vec<Self> = Vec::new();
        for line in text.lines() {
            if let Some(head) = line.strip_prefix("grid|") {
                let f: Vec<_> = head.split('|').collect();
                grids.push(Self {
                    name: f[0].to_owned(),
                    tree_type: f[1].to_owned(),
                    class: f[2].to_owned(),
                    half: f[3] == "half=1",
                    lines: Vec::new(),
                });
            } else if let Some(grid) = grids.last_mut() {
                grid.lines.push(line.to_owned());
            }
        }
        grids
    }

    fn values(&self, key: &str) -> impl Iterator<Item = Vec<&str>> {
        let of_key = move |l: &'_ String| l.split(' ').next() == Some(key);
        self.lines
            .iter()
            .filter(move |l| of_key(l))
            .map(|l| l.split(' ').skip(1).collect())
    }

    /// The refusal that this grid deserves, if any.
    fn expected_refusal(&self) -> Option<Refusal> {
        let map = self.values("map").next().map(|m| m[0].to_owned());
        match (self.tree_type.as_str(), map.as_deref()) {
            ("Tree_bool_5_4_3", _) => Some(Refusal::Bool),
            ("Tree_mask_5_4_3", _) => Some(Refusal::Mask),
            ("Tree_ptdataidx32_5_4_3", _) => Some(Refusal::Points),
            ("Tree_float_4_3_3", _) => Some(Refusal::Tree("4_3_3".to_owned())),
            (_, Some("NonlinearFrustumMap")) => Some(Refusal::FrustumMap),
            _ => None,
        }
    }
}

/// Compares every grid of `path` with `path.oracle`; returns addresses and outcomes.
pub(crate) fn compare_file(path: &Path) -> Vec<(String, Outcome)> {
    let text = std::fs::read_to_string(path.with_extension("vdb.oracle"));
    let text = text.expect("each file of the matrix has an oracle beside it");
    let archive = match Archive::open(path) {
        Ok(archive) => archive,
        Err(e) => return vec![("(file)".to_owned(), Outcome::Wrong(e.to_string()))],
    };
    let mut outcomes = Vec::new();
    let mut seen: HashMap<String, usize> = HashMap::new();
    for oracle in GridOracle::parse(&text) {
        let nth = seen.entry(oracle.name.clone()).or_default();
        let mut of_name = archive
            .grids()
            .iter()
            .enumerate()
            .filter(|(_, g)| g.name == oracle.name);
        let found = of_name.nth(*nth);
        *nth += 1;
        let outcome = match found {
            None => Outcome::Wrong("not listed".to_owned()),
            Some((i, _)) => compare_grid(&archive, i, &oracle).unwrap_or_else(Outcome::Wrong),
        };
        outcomes.push((oracle.name, outcome));
    }
    if seen.values().sum::<usize>() != archive.grids().len() {
        outcomes.push((
            "(file)".to_owned(),
            Outcome::Wrong("more grids listed".to_owned()),
        ));
    }
    outcomes
}

fn compare_grid(archive: &Archive, i: usize, oracle: &GridOracle) -> Result<Outcome, String> {
    let info = &archive.grids()[i];
    if info.refused != oracle.expected_refusal() {
        return Err(format!("refused: {:?}", info.refused));
    }
    compare_info(info, oracle)?;
    let options = LoadOptions::default();
    if let Some(reason) = &info.refused {
        return match archive.load(i, &options) {
            Err(VdbError::Refused { .. }) => Ok(Outcome::Refused(reason.clone())),
            other => Err(format!("a refused grid gave {other:?}")),
        };
    }
    match archive.load(i, &options).map_err(|e| e.to_string())? {
        Grid::F32(g) => compare_values(&g, oracle),
        Grid::F64(g) => compare_values(&g, oracle),
        Grid::I32(g) => compare_values(&g, oracle),
        Grid::I64(g) => compare_values(&g, oracle),
        Grid::Vec3F(g) => compare_values(&g, oracle),
        Grid::Vec3D(g) => compare_values(&g, oracle),
        Grid::Vec3I(g) => compare_values(&g, oracle),
        _ => Err("a grid of unknown type".to_owned()),
    }?;
    match (archive.load_density(i, &options), info.background.len()) {
        (Err(VdbError::NotScalar { .. }), 3) => {}
        (Ok(density), 1) => compare_density(&density.tree, oracle)?,
        (other, _) => return Err(format!("density: {other:?}")),
    }
    Ok(Outcome::Exact)
}

/// Compares what is known without decoding.
fn compare_info(info: &GridInfo, oracle: &GridOracle) -> Result<(), String> {
    let of_type = format!("Tree_{}_", info.type_name);
    let is_points = info.type_name == "points";
    check(
        "type",
        is_points || oracle.tree_type.starts_with(&of_type),
        true,
    )?;
    if oracle.class != "other" {
        check("class", info.class.as_str(), oracle.class.as_str())?;
        check("half", info.half, oracle.half)?;
    }
    if info.active_voxel_count.is_none() {
        return check("listed only", info.refused.is_some(), true);
    }
    for v in oracle.values("active") {
        check("active voxels", info.active_voxel_count, v[0].parse().ok())?;
        check("leaves", Some(info.brick_count), v[2].parse().ok())?;
    }
    let bbox = oracle.values("bbox").next().map(|v| {
        let n: Vec<i32> = v.iter().filter_map(|s| s.parse().ok()).collect();
        (IVec3::from_slice(&n), IVec3::from_slice(&n[3..]))
    });
    check("box", info.index_bbox, bbox)?;
    for v in oracle.values("background") {
        let expected: Vec<f64> = v[0].split(',').filter_map(|s| s.parse().ok()).collect();
        // The oracle has 9 digits of an f32.
        let close = |(a, b): (&f64, &f64)| (a - b).abs() <= 1e-8 * b.abs();
        let same = info.background.len() == expected.len()
            && info.background.iter().zip(&expected).all(close);
        check("background", same, true)?;
    }
    if let Some(transform) = &info.transform {
        for v in oracle.values("xf") {
            let n: Vec<f64> = v.iter().filter_map(|s| s.parse().ok()).collect();
            let found = transform
                .world_from_index()
                .transform_point3(DVec3::from_slice(&n));
            let expected = DVec3::from_slice(&n[3..]);
            // A few roundings of 17-digit numbers.
            if (found - expected).length() > 1e-13 * (1.0 + expected.length()) {
                return Err(format!("index {n:?} lies at {found}"));
            }
        }
    }
    Ok(())
}

/// A value that oracles spell.
trait Spelled: Components {
    fn parse(text: &str) -> Option<Self>;
}

macro_rules! spelled {
    ($($t:ty),*) => {$(
        impl Spelled for $t {
            fn parse(text: &str) -> Option<Self> {
                text.parse().ok()
            }
        }
        impl Spelled for [$t; 3] where [$t; 3]: Components {
            fn parse(text: &str) -> Option<Self> {
                let parts: Option<Vec<$t>> = text.split(',').map(|s| s.parse().ok()).collect();
                parts?.try_into().ok()
            }
        }
    )*};
}
spelled!(f32, f64, i32);
impl Spelled for i64 {
    fn parse(text: &str) -> Option<Self> {
        text.parse().ok()
    }
}

fn compare_values<V: Spelled>(grid: &TypedGrid<V>, oracle: &GridOracle) -> Result<(), String> {
    let stats = grid.statistics();
    for v in oracle.values("sum") {
        let expected: f64 = v[0].parse().map_err(|e| format!("sum {v:?}: {e}"))?;
        let weights = [1.0, 2.0, 3.0];
        let found: f64 = stats.sum.iter().zip(weights).map(|(s, w)| s * w).sum();
        if (found - expected).abs() > 1e-6 * expected.abs() {
            return Err(format!("sum is {found}, expected {expected}"));
        }
    }
    let background = V::parse(oracle.values("background").next().ok_or("no background")?[0]);
    check("background", Some(grid.tree.background()), background)?;
    for (p, active, text) in spots(oracle) {
        let found = grid.tree.probe(p);
        if Some(found.value) != V::parse(text) || found.active != active {
            return Err(format!(
                "at {p}: {found:?}, expected {text}, active {active}"
            ));
        }
    }
    Ok(())
}

fn compare_density(tree: &Tree<f32>, oracle: &GridOracle) -> Result<(), String> {
    for (p, _, text) in spots(oracle) {
        #[expect(clippy::cast_possible_truncation, reason = "density is f32")]
        let expected = text.parse::<f64>().map_err(|e| e.to_string())?.max(0.0) as f32;
        check("density", tree.probe(p).value, expected)?;
    }
    Ok(())
}

fn spots(oracle: &GridOracle) -> impl Iterator<Item = (IVec3, bool, &str)> {
    oracle.values("at").map(|v| {
        let n = |i: usize| v[i].parse().expect("an oracle's coordinates are integers");
        (IVec3::new(n(0), n(1), n(2)), v[3] == "1", v[4])
    })
}

#[expect(
    clippy::needless_pass_by_value,
    reason = "literals and temporaries read better"
)]
fn check<T: PartialEq + std::fmt::Debug>(what: &str, found: T, expected: T) -> Result<(), String> {
    if found == expected {
        Ok(())
    } else {
        Err(format!("{what}: found {found:?}, expected {expected:?}"))
    }
}

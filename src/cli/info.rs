//! `majorant info`: what the grids of volume files are.
//!
//! Whatever the checked walk knows is shown at once; minimum, maximum and sum of the active
//! values need decoding, which `--quick` leaves out.

use std::fmt::Write as _;
use std::path::Path;

use glam::{DAffine3, DVec3, IVec3};
use majorant::space::IndexTransform;
use majorant::vdb::{
    Archive, Components, Grid, GridInfo, LoadOptions, Statistics, TypedGrid, VdbError,
};
use serde::Serialize;

use super::args::InfoArgs;
use super::json::{Number, Value};
use super::{Failure, memory, report};

#[derive(Debug, Serialize)]
struct Listing {
    files: Vec<FileEntry>,
}

#[derive(Debug, Serialize)]
struct FileEntry {
    path: String,
    version: u32,
    /// Grids behind one that can neither be read nor skipped, which happens in streams only.
    unreachable_grid_count: u32,
    grids: Vec<GridEntry>,
}

/// One grid; `None` is unknown. Vectors have arrays where scalars have numbers.
#[derive(Debug, Serialize)]
struct GridEntry {
    name: String,
    /// What `--grid` takes for this one.
    address: String,
    #[serde(rename = "type")]
    type_name: String,
    class: String,
    half: bool,
    codec: String,
    /// Whether `render` takes it as density.
    renderable: bool,
    refused: Option<String>,
    active_voxel_count: Option<u64>,
    active_tile_count: Option<u64>,
    index_bbox: Option<[[i32; 3]; 2]>,
    min: Option<Value>,
    max: Option<Value>,
    sum: Option<Value>,
    /// Least and largest value of a grid whose name speaks of heat, taken as kelvin.
    kelvin: Option<[f64; 2]>,
    background: Option<Value>,
    voxel_size: Option<[f64; 3]>,
    /// Rows of the matrix that acts on column vectors: the translation is the last column.
    world_from_index: Option<[[f64; 4]; 4]>,
    map: String,
    instance_of: Option<String>,
    bytes_in_file: u64,
    /// Estimated peak of loading the grid for rendering.
    bytes_in_memory: u64,
}

/// Gives numbers that the library holds as `f64` the digits of the grid's own type; `None` if
/// there are none.
fn typed(type_name: &str, values: &[f64]) -> Option<Value> {
    #[expect(
        clippy::cast_possible_truncation,
        reason = "the values came from these types"
    )]
    let number = |&x: &f64| match type_name {
        "float" | "vec3s" => Number::F32(x as f32),
        "int32" | "int64" | "vec3i" => Number::Int(x as i64),
        _ => Number::F64(x),
    };
    (!values.is_empty()).then(|| Value(values.iter().map(number).collect()))
}

pub(super) fn run(args: &InfoArgs) -> Result<(), Failure> {
    let options = LoadOptions {
        max_memory_bytes: memory::limit(args.max_memory),
        sanitize: false,
    };
    let mut all_good = true;
    let mut files = Vec::new();
    for path in &args.files {
        match describe_file(path, &options, args.quick, &mut all_good) {
            Ok(entry) if args.json => files.push(entry),
            Ok(entry) => report::print(&in_words(&entry, args.quick))?,
            Err(e) => {
                report::failure(&Failure::Vdb(e));
                all_good = false;
            }
        }
    }
    if args.json {
        let json = serde_json::to_string(&Listing { files }).map_err(Failure::failed)?;
        report::print(&format!("{json}\n"))?;
    }
    // What was wrong has been said, file by file.
    if all_good {
        Ok(())
    } else {
        Err(Failure::Reported)
    }
}

fn describe_file(
    path: &Path,
    options: &LoadOptions,
    quick: bool,
    all_good: &mut bool,
) -> Result<FileEntry, VdbError> {
    let archive = Archive::open(path)?;
    let mut grids = Vec::new();
    for (index, info) in archive.grids().iter().enumerate() {
        let decodable = !quick && info.refused.is_none();
        let statistics = match decodable.then(|| archive.load(index, options)).transpose() {
            Ok(grid) => grid.map(|g| statistics(&g)),
            Err(e) => {
                report::failure(&Failure::Vdb(e));
                *all_good = false;
                None
            }
        };
        grids.push(describe_grid(info, statistics));
    }
    Ok(FileEntry {
        path: path.display().to_string(),
        version: archive.version(),
        unreachable_grid_count: archive.unreachable_grid_count(),
        grids,
    })
}

fn statistics(grid: &Grid) -> Statistics {
    fn of<V: Components>(grid: &TypedGrid<V>) -> Statistics {
        let mut statistics = grid.statistics();
        if grid.active_voxel_count == 0 {
            // Of nothing, the sum is 0 and the extremes are unknown.
            statistics.min.clear();
            statistics.max.clear();
        }
        statistics
    }
    match grid {
        Grid::F32(g) => of(g),
        Grid::F64(g) => of(g),
        Grid::I32(g) => of(g),
        Grid::I64(g) => of(g),
        Grid::Vec3F(g) => of(g),
        Grid::Vec3D(g) => of(g),
        Grid::Vec3I(g) => of(g),
        _ => Statistics::default(),
    }
}

fn describe_grid(info: &GridInfo, statistics: Option<Statistics>) -> GridEntry {
    let Statistics { sum, min, max } = statistics.unwrap_or_default();
    let name = info.name.to_lowercase();
    let is_hot = ["temperature", "heat"]
        .iter()
        .any(|word| name.contains(word));
    GridEntry {
        name: info.name.clone(),
        address: info.address.clone(),
        type_name: info.type_name.clone(),
        class: info.class.clone(),
        half: info.half,
        codec: info.codec.clone(),
        renderable: info.refused.is_none(),
        refused: info.refused.as_ref().map(ToString::to_string),
        active_voxel_count: info.active_voxel_count,
        active_tile_count: info.active_tile_count,
        index_bbox: info
            .index_bbox
            .map(|(lo, hi)| [lo, hi].map(|p: IVec3| p.to_array())),
        min: typed(&info.type_name, &min),
        max: typed(&info.type_name, &max),
        sum: typed("double", &sum),
        kelvin: match (&min[..], &max[..]) {
            (&[min], &[max]) if is_hot => Some([min, max]),
            _ => None,
        },
        background: typed(&info.type_name, &info.background),
        voxel_size: info.transform.as_ref().map(|t| t.voxel_size().to_array()),
        world_from_index: info.transform.as_ref().map(matrix_rows),
        map: info.map_type.clone(),
        instance_of: info.instance_of.clone(),
        bytes_in_file: info.bytes_in_file,
        bytes_in_memory: info.estimated_memory_bytes,
    }
}

fn matrix_rows(transform: &IndexTransform) -> [[f64; 4]; 4] {
    let DAffine3 {
        matrix3: m,
        translation: t,
    } = transform.world_from_index();
    let row = |v: DVec3, w: f64| [v.x, v.y, v.z, w];
    [
        row(m.row(0), t.x),
        row(m.row(1), t.y),
        row(m.row(2), t.z),
        [0.0, 0.0, 0.0, 1.0],
    ]
}

fn in_words(file: &FileEntry, quick: bool) -> String {
    let mut out = format!("{}: version {}\n", file.path, file.version);
    for grid in &file.grids {
        push_grid(&mut out, grid, quick).expect("writing to a string cannot fail");
    }
    if file.unreachable_grid_count > 0 {
        out.push_str("  further grids cannot be reached in this stream\n");
    }
    out
}

/// Says which temperatures the values of a grid are, and at which scale they would be a fire's.
fn in_kelvin(min: f64, max: f64) -> String {
    let as_is = format!("{min:.4} to {max:.4} K");
    // Hotter than an ember, and colder than the hottest stars.
    if (798.0..50_000.0).contains(&max) || max <= 0.0 {
        return as_is;
    }
    // The power of ten that comes nearest to a flame.
    let scale = 10_f64.powf((2000.0 / max).log10().round());
    let scaled = format!("{:.0} to {:.0} K", min * scale, max * scale);
    format!("{as_is}, too cold or too hot; {scaled} with scale = {scale}")
}

fn push_grid(out: &mut String, grid: &GridEntry, quick: bool) -> std::fmt::Result {
    let half = if grid.half { ", half" } else { "" };
    let (address, kind, class, codec) = (&grid.address, &grid.type_name, &grid.class, &grid.codec);
    writeln!(out, "  {address}: {kind}{half}, {class}, {codec}")?;
    if let Some(reason) = &grid.refused {
        writeln!(out, "    not loadable: {reason}")?;
    }
    if let Some(parent) = &grid.instance_of {
        writeln!(out, "    shares the tree of {parent}")?;
    }
    if let Some(count) = grid.active_voxel_count {
        let tiles = grid.active_tile_count.unwrap_or(0);
        writeln!(out, "    active        {count} voxels, {tiles} tiles")?;
    }
    if let Some([[a, b, c], [d, e, f]]) = grid.index_bbox {
        writeln!(out, "    active box    [{a}, {b}, {c}] to [{d}, {e}, {f}]")?;
    }
    let shown = |v: &Option<Value>| match v {
        Some(value) => value.to_string(),
        None => "unknown".to_owned(),
    };
    if !quick && grid.refused.is_none() {
        let (min, max, sum) = (shown(&grid.min), shown(&grid.max), shown(&grid.sum));
        writeln!(out, "    values        {min} to {max}, sum {sum}")?;
    }
    if let Some([min, max]) = grid.kelvin {
        writeln!(out, "    as emission   {}", in_kelvin(min, max))?;
    }
    writeln!(out, "    background    {}", shown(&grid.background))?;
    if let Some([x, y, z]) = grid.voxel_size {
        writeln!(out, "    voxel size    {x} {y} {z}, {}", grid.map)?;
    }
    let (file, memory) = (
        grid.bytes_in_file as f64 / 1e6,
        grid.bytes_in_memory as f64 / 1e6,
    );
    writeln!(
        out,
        "    size          {file:.2} MB in the file, {memory:.1} MB to load"
    )
}

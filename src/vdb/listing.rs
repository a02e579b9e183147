//! One grid of a file: its descriptor, what is known of it without decoding, and its walk.
//!
//! ```text
//! grid   name │ type │ instance parent │ grid, block, end position 3 i64
//!        │ compression u32 │ metadata │ map type, map │ topology │ buffers
//! ```
//!
//! A grid that cannot be loaded is described as far as it can be, with the reason. Nothing
//! here knows of the other grids: instances are resolved in `archive`.

use glam::IVec3;

use super::cursor::Cursor;
use super::error::{Damage, Refusal};
use super::memory;
use super::metadata;
use super::record::{Encoding, ValueType, codec_name};
use super::topology::Topology;
use super::transform::{self, Map};
use crate::space::IndexTransform;

/// Separates a name from the number that OpenVDB adds to make it unique.
const NAME_SEPARATOR: u8 = 0x1e;

/// What is known of a grid without decoding its values.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct GridInfo {
    /// The name as people see it; may be empty and may occur twice.
    pub name: String,
    /// What [`super::Archive::find`] takes for this grid: the name, with `[n]` where it is not unique.
    pub address: String,
    /// `float`, `vec3s`, `bool`, `points`, … as OpenVDB names value types.
    pub type_name: String,
    /// `fog volume`, `level set`, `staggered` or `unknown`.
    pub class: String,
    /// Whether values are stored as 16-bit floats.
    pub half: bool,
    /// `none`, `active mask`, `zip`, `blosc + active mask`, …
    pub codec: String,
    /// Why the grid cannot be loaded, if so.
    pub refused: Option<Refusal>,
    /// The map between index and world space, where there is an affine one.
    pub transform: Option<IndexTransform>,
    /// `UniformScaleMap`, `AffineMap`, …
    pub map_type: String,
    /// Active voxels, those of tiles included; `None` where the tree could not be walked.
    pub active_voxel_count: Option<u64>,
    /// Active tiles of all levels.
    pub active_tile_count: Option<u64>,
    /// Lowest and highest active voxel, found from the masks; `None` also for empty grids.
    pub index_bbox: Option<(IVec3, IVec3)>,
    /// Bricks of 8³ voxels.
    pub brick_count: u64,
    /// The background value, one number a component; empty where it could not be read.
    pub background: Vec<f64>,
    /// Bytes that the grid takes in the file.
    pub bytes_in_file: u64,
    /// Estimated peak memory of loading the grid and preparing it for rendering.
    pub estimated_memory_bytes: u64,
    /// Metadata in file order, as text.
    pub metadata: Vec<(String, String)>,
    /// Address of the grid whose tree this one shares.
    pub instance_of: Option<String>,
}

/// A grid whose tree has been walked.
#[derive(Clone, Debug)]
pub(super) struct Walked {
    pub(super) encoding: Encoding,
    pub(super) topology: Topology,
}

/// One grid on its way from the file to [`GridInfo`].
pub(super) struct Entry {
    pub(super) info: GridInfo,
    /// Position in the file.
    pub(super) at: usize,
    pub(super) tree_of: usize,
    pub(super) raw_name: Vec<u8>,
    pub(super) parent: Vec<u8>,
    pub(super) walked: Option<Walked>,
}

/// What stands in front of each grid.
pub(super) struct Descriptor<'a> {
    pub(super) name: &'a [u8],
    type_name: &'a [u8],
    parent: &'a [u8],
    /// Of the grid, its buffers and its end; meaningless in files without offsets.
    positions: [i64; 3],
    positions_at: usize,
}

impl<'a> Descriptor<'a> {
    pub(super) fn read(c: &mut Cursor<'a>) -> Result<Self, Damage> {
        Ok(Self {
            name: c.string("a grid name")?,
            type_name: c.string("a grid type")?,
            parent: c.string("an instance parent")?,
            positions_at: c.at(),
            positions: c.pod("a grid's positions")?,
        })
    }

    /// Returns where the grid begins and ends, for a file with offsets.
    ///
    /// Grids must follow each other without overlap: no writer does otherwise, and it keeps the
    /// walk linear in the file's size whatever the file says.
    fn extent(&self, c: &Cursor<'_>) -> Result<(usize, usize), Damage> {
        let [grid, _, end] = self.positions.map(usize::try_from);
        match (grid, end) {
            (Ok(grid), Ok(end)) if c.at() <= grid && grid < end && end <= c.bytes().len() => {
                Ok((grid, end))
            }
            _ => {
                let [grid, _, end] = self.positions;
                let (at, len) = (c.at(), c.bytes().len());
                let what = format!(
                    "a grid is said to lie from {grid} to {end}, expected a range within {at} to {len}"
                );
                Err(Damage::new(self.positions_at, what))
            }
        }
    }

    /// Returns where the leaves' values begin; `c` stands behind the topology.
    fn buffers_at(&self, c: &Cursor<'_>) -> Result<usize, Damage> {
        let at = usize::try_from(self.positions[1]).ok();
        at.filter(|at| (c.at()..=c.bytes().len()).contains(at))
            .ok_or_else(|| {
                let what = format!(
                    "a grid's values are said to begin at {}, expected {} or later",
                    self.positions[1],
                    c.at()
                );
                Damage::new(self.positions_at, what)
            })
    }
}

/// Walks one grid; `c` stands behind its descriptor. Returns where the next one begins, if known.
pub(super) fn walk_grid(
    c: &Cursor<'_>,
    descriptor: &Descriptor<'_>,
    has_offsets: bool,
) -> Result<(Entry, Option<usize>), Damage> {
    let (start, end) = if has_offsets {
        descriptor
            .extent(c)
            .map(|(start, end)| (start, Some(end)))?
    } else {
        (c.at(), None)
    };
    let limit = end.unwrap_or(c.bytes().len());
    let mut c = Cursor::new(&c.bytes()[..limit], start);
    let flags = c.u32("a grid's compression")?;
    let metadata = metadata::read(&mut c)?;
    let map_type = c.string("a map type")?;
    let map = transform::read(&mut c, map_type)?;
    let half = metadata::get(&metadata, "is_saved_as_half_float") == Some("true");
    let (type_name, value) = parse_type(descriptor.type_name);
    let is_instance = !descriptor.parent.is_empty();

    let mut walked = None;
    // Known once everything of the grid has been walked over, refused or not.
    let mut walked_end = is_instance.then(|| c.at());
    if let (Ok(value), false, false) = (&value, is_instance, map == Map::Unknown) {
        let encoding = Encoding::new(flags, half, *value).ok_or_else(|| {
            Damage::new(
                start,
                format!("compression flags {flags:#x}, expected 0 to 7"),
            )
        })?;
        let mut topology = Topology::walk(&mut c, encoding)?;
        if has_offsets {
            c = Cursor::new(c.bytes(), descriptor.buffers_at(&c)?);
        }
        topology.walk_buffers(&mut c, encoding)?;
        walked_end = Some(c.at());
        walked = Some(Walked { encoding, topology });
    }
    let end = end.or(walked_end);
    let transform = match map {
        Map::Affine(m) => IndexTransform::from_world_from_index(m),
        Map::Frustum | Map::Unknown => None,
    };
    let refused = value.err().or(match map {
        Map::Affine(_) if transform.is_some() => None,
        Map::Affine(_) => Some(Refusal::SingularMap),
        Map::Frustum => Some(Refusal::FrustumMap),
        Map::Unknown => Some(Refusal::UnknownMap(metadata::text(map_type))),
    });
    let class = metadata::get(&metadata, "class")
        .unwrap_or("unknown")
        .to_owned();
    let mut info = GridInfo {
        name: metadata::text(display_name(descriptor.name)),
        address: String::new(),
        type_name,
        class,
        half,
        codec: codec_name(flags),
        refused,
        transform,
        map_type: metadata::text(map_type),
        active_voxel_count: None,
        active_tile_count: None,
        index_bbox: None,
        brick_count: 0,
        background: Vec::new(),
        bytes_in_file: (end.unwrap_or(c.at()) - start) as u64,
        estimated_memory_bytes: 0,
        metadata,
        instance_of: None,
    };
    if let Some(walked) = &walked {
        describe_tree(&mut info, c.bytes(), walked)?;
    }
    let entry = Entry {
        info,
        at: start,
        tree_of: 0,
        raw_name: descriptor.name.to_owned(),
        parent: descriptor.parent.to_owned(),
        walked,
    };
    Ok((entry, end))
}

fn describe_tree(info: &mut GridInfo, bytes: &[u8], walked: &Walked) -> Result<(), Damage> {
    let Walked { encoding, topology } = walked;
    info.active_voxel_count = Some(topology.active_voxel_count);
    info.active_tile_count = Some(topology.active_tile_count);
    info.index_bbox = topology.active_box;
    info.brick_count = topology.leaves.len() as u64;
    info.estimated_memory_bytes = memory::estimate(topology, encoding.value.size());
    let mut c = Cursor::new(bytes, topology.background_at);
    info.background = match encoding.value {
        ValueType::F32 => vec![c.pod::<f32>("a background")?.into()],
        ValueType::F64 => vec![c.pod("a background")?],
        ValueType::I32 => vec![c.pod::<i32>("a background")?.into()],
        ValueType::I64 => vec![c.i64("a background")? as f64],
        ValueType::Vec3F => c.pod::<[f32; 3]>("a background")?.map(f64::from).into(),
        ValueType::Vec3D => c.pod::<[f64; 3]>("a background")?.into(),
        ValueType::Vec3I => c.pod::<[i32; 3]>("a background")?.map(f64::from).into(),
    };
    Ok(())
}

/// Splits `Tree_float_5_4_3_HalfFloat` into the value type's name and what can be done with it.
fn parse_type(raw: &[u8]) -> (String, Result<ValueType, Refusal>) {
    let full = metadata::text(raw);
    let parts = full
        .strip_suffix("_HalfFloat")
        .unwrap_or(&full)
        .strip_prefix("Tree_")
        .and_then(|t| t.split_once('_'));
    let Some((name, layout)) = parts else {
        return (full.clone(), Err(Refusal::ValueType(full)));
    };
    let value = match (name, ValueType::from_name(name)) {
        ("bool", _) => Err(Refusal::Bool),
        ("mask", _) => Err(Refusal::Mask),
        ("ptdataidx32" | "ptidx32", _) => {
            return ("points".to_owned(), Err(Refusal::Points));
        }
        (_, None) => Err(Refusal::ValueType(name.to_owned())),
        _ if layout != "5_4_3" => Err(Refusal::Tree(layout.to_owned())),
        (_, Some(value)) => Ok(value),
    };
    (name.to_owned(), value)
}

/// Returns a raw name without the number that made it unique in the file.
pub(super) fn display_name(raw: &[u8]) -> &[u8] {
    let end = raw.iter().position(|&b| b == NAME_SEPARATOR);
    &raw[..end.unwrap_or(raw.len())]
}

impl GridInfo {
    /// Describes this instance by its own map and metadata and the tree of `shared`.
    pub(super) fn with_tree_of(self, shared: &Entry) -> Self {
        let tree = &shared.info;
        // A frustum or singular map of the other grid is no obstacle: the instance has its own.
        let refused_tree = tree.refused.clone().filter(|_| shared.walked.is_none());
        Self {
            refused: refused_tree.or(self.refused),
            half: tree.half,
            codec: tree.codec.clone(),
            active_voxel_count: tree.active_voxel_count,
            active_tile_count: tree.active_tile_count,
            index_bbox: tree.index_bbox,
            brick_count: tree.brick_count,
            background: tree.background.clone(),
            estimated_memory_bytes: tree.estimated_memory_bytes,
            instance_of: Some(tree.address.clone()),
            ..self
        }
    }
}

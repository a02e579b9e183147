//! An opened file: which grids it holds and where everything about them lies.
//!
//! ```text
//! file   magic 20 42 44 56 00 00 00 00 │ version u32 │ library 2 u32 │ has offsets u8 │ id 36 B
//!        │ metadata │ grid count u32 │ grids …
//! grid   name │ type │ instance parent │ grid, block, end position 3 i64
//!        │ compression u32 │ metadata │ map type, map │ topology │ buffers
//! ```
//!
//! [`Archive::open`] walks all of that with checks and decodes nothing: about 0.05 s for
//! 120,000 leaves. Grids that cannot be loaded are listed with the reason and do not stand in
//! the way of others. Damage anywhere makes the whole file an error: a truncated frame should
//! be noticed, not rendered in part.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use glam::IVec3;

use super::cursor::Cursor;
use super::error::{Damage, Refusal, VdbError};
use super::file::Bytes;
use super::memory;
use super::metadata;
use super::record::{Encoding, ValueType, codec_name};
use super::topology::Topology;
use super::transform::{self, Map};
use crate::space::IndexTransform;

/// `" BDV"` and four zero bytes.
pub(super) const MAGIC: u64 = 0x5644_4220;
/// Versions whose layout is the one above; 222 is of 2013, OpenVDB 13 writes 225.
const VERSIONS: std::ops::RangeInclusive<u32> = 222..=225;
/// Separates a name from the number that OpenVDB adds to make it unique.
const NAME_SEPARATOR: u8 = 0x1e;

/// A .vdb file whose structure has been checked; nothing is decoded yet.
#[derive(Debug)]
pub struct Archive {
    path: PathBuf,
    bytes: Bytes,
    version: u32,
    grids: Vec<GridInfo>,
    trees: Vec<GridTree>,
    unreachable_grid_count: u32,
}

/// What is known of a grid without decoding its values.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct GridInfo {
    /// The name as people see it; may be empty and may occur twice.
    pub name: String,
    /// What [`Archive::find`] takes for this grid: the name, with `[n]` where it is not unique.
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

/// A grid's own walked tree, and the index of the grid whose tree it uses (mostly its own).
#[derive(Debug)]
struct GridTree {
    walked: Option<Walked>,
    tree_of: usize,
}

/// One grid on its way from the file to [`GridInfo`].
struct Entry {
    info: GridInfo,
    /// Position in the file.
    at: usize,
    tree_of: usize,
    raw_name: Vec<u8>,
    parent: Vec<u8>,
    walked: Option<Walked>,
}

impl Archive {
    /// Opens and walks the file at `path`.
    ///
    /// # Errors
    /// If the file cannot be read, is not a .vdb file of version 222 to 225, or is damaged.
    pub fn open(path: &Path) -> Result<Self, VdbError> {
        let bytes = Bytes::map(path).map_err(|source| VdbError::Io {
            path: path.to_owned(),
            source,
        })?;
        Self::walk(path.to_owned(), bytes)
    }

    /// Walks a file that is already in memory; `name` stands for its path in messages.
    ///
    /// # Errors
    /// As [`Archive::open`].
    pub fn from_bytes(name: impl Into<PathBuf>, bytes: Vec<u8>) -> Result<Self, VdbError> {
        Self::walk(name.into(), Bytes::Owned(bytes))
    }

    /// Returns the path the file was opened by.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Returns the file's format version.
    pub fn version(&self) -> u32 {
        self.version
    }

    /// Returns the grids in file order.
    pub fn grids(&self) -> &[GridInfo] {
        &self.grids
    }

    /// Returns how many grids lie behind one that can neither be read nor skipped.
    ///
    /// Not zero only for files without grid offsets (streams) that hold a refused grid.
    pub fn unreachable_grid_count(&self) -> u32 {
        self.unreachable_grid_count
    }

    /// Returns the index of the grid called `name`.
    ///
    /// Where a name occurs more than once, `name` alone is the first and `name[1]` the second.
    ///
    /// # Errors
    /// If there is none; the error suggests the nearest name and lists all.
    pub fn find(&self, name: &str) -> Result<usize, VdbError> {
        let by_name = self.grids.iter().position(|g| g.name == name);
        let by_address = || self.grids.iter().position(|g| g.address == name);
        by_name.or_else(by_address).ok_or_else(|| {
            let names: Vec<_> = self.grids.iter().map(|g| g.address.clone()).collect();
            let similarity =
                |n: &String| strsim::jaro_winkler(&n.to_lowercase(), &name.to_lowercase());
            let nearest = names
                .iter()
                .map(|n| (similarity(n), n))
                .filter(|(s, _)| *s > 0.7)
                .max_by(|a, b| a.0.total_cmp(&b.0))
                .map(|(_, n)| n.clone());
            VdbError::NoSuchGrid {
                path: self.path.clone(),
                name: name.to_owned(),
                nearest,
                names,
            }
        })
    }

    pub(super) fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    /// Returns the walked tree of a grid, its own or the one it shares.
    pub(super) fn walked(&self, index: usize) -> Result<&Walked, VdbError> {
        let info = &self.grids[index];
        let source = self.trees[index].tree_of;
        match (&info.refused, &self.trees[source].walked) {
            (None, Some(walked)) => Ok(walked),
            (Some(reason), _) => Err(VdbError::Refused {
                path: self.path.clone(),
                grid: info.address.clone(),
                reason: reason.clone(),
            }),
            (None, None) => Err(self.damaged(
                index,
                Damage::new(0, "the grid's tree was not found by the walk"),
            )),
        }
    }

    /// Gives `damage` its file and grid.
    pub(super) fn damaged(&self, index: usize, damage: Damage) -> VdbError {
        VdbError::Damaged {
            path: self.path.clone(),
            grid: Some(self.grids[index].address.clone()),
            damage,
        }
    }

    fn walk(path: PathBuf, bytes: Bytes) -> Result<Self, VdbError> {
        let damaged = |grid: Option<String>, damage| VdbError::Damaged {
            path: path.clone(),
            grid,
            damage,
        };
        let mut c = Cursor::new(&bytes, 0);
        if !matches!(c.pod::<u64>("a magic number"), Ok(MAGIC)) {
            let shown: Vec<_> = bytes.iter().take(4).map(|b| format!("{b:02x}")).collect();
            return Err(VdbError::NotVdb {
                found: shown.join(" "),
                path,
            });
        }
        let head = read_head(&mut c).map_err(|d| damaged(None, d))?;
        if !VERSIONS.contains(&head.version) {
            return Err(VdbError::Version {
                path,
                found: head.version,
            });
        }
        let grid_count = read_grid_count(&mut c).map_err(|d| damaged(None, d))?;
        let mut entries = Vec::new();
        let mut unreachable_grid_count = 0;
        for n in 0..grid_count {
            let descriptor = Descriptor::read(&mut c).map_err(|d| damaged(None, d))?;
            let name = Some(metadata::text(display_name(descriptor.name)));
            let (entry, end) =
                walk_grid(&c, &descriptor, head.has_offsets).map_err(|d| damaged(name, d))?;
            entries.push(Entry {
                tree_of: entries.len(),
                ..entry
            });
            match end {
                Some(end) => c = Cursor::new(&bytes, end),
                None => {
                    unreachable_grid_count = grid_count - n - 1;
                    break;
                }
            }
        }
        name_addresses(&mut entries);
        resolve_instances(&mut entries).map_err(|(name, d)| damaged(Some(name), d))?;
        let (grids, trees) = entries
            .into_iter()
            .map(
                |Entry {
                     info,
                     walked,
                     tree_of,
                     ..
                 }| (info, GridTree { walked, tree_of }),
            )
            .unzip();
        Ok(Self {
            path,
            version: head.version,
            grids,
            trees,
            unreachable_grid_count,
            bytes,
        })
    }
}

struct Head {
    version: u32,
    has_offsets: bool,
}

/// Reads what follows the magic number, up to the metadata.
fn read_head(c: &mut Cursor<'_>) -> Result<Head, Damage> {
    let version = c.u32("a version")?;
    c.take(8, "a library version")?;
    let [has_offsets] = c.pod::<[u8; 1]>("a header")?;
    Ok(Head {
        version,
        has_offsets: has_offsets != 0,
    })
}

fn read_grid_count(c: &mut Cursor<'_>) -> Result<u32, Damage> {
    c.take(36, "a file id")?;
    metadata::read(c)?;
    c.u32("a grid count")
}

/// What stands in front of each grid.
struct Descriptor<'a> {
    name: &'a [u8],
    type_name: &'a [u8],
    parent: &'a [u8],
    /// Of the grid, its buffers and its end; meaningless in files without offsets.
    positions: [i64; 3],
    positions_at: usize,
}

impl<'a> Descriptor<'a> {
    fn read(c: &mut Cursor<'a>) -> Result<Self, Damage> {
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
fn walk_grid(
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
        let mut topology = Topology::walk(&mut c, &encoding)?;
        if has_offsets {
            c = Cursor::new(c.bytes(), descriptor.buffers_at(&c)?);
        }
        topology.walk_buffers(&mut c, &encoding)?;
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
fn display_name(raw: &[u8]) -> &[u8] {
    let end = raw.iter().position(|&b| b == NAME_SEPARATOR);
    &raw[..end.unwrap_or(raw.len())]
}

fn name_addresses(entries: &mut [Entry]) {
    let mut occurrences = HashMap::<String, usize>::new();
    for e in &*entries {
        *occurrences.entry(e.info.name.clone()).or_default() += 1;
    }
    let mut seen = HashMap::<String, usize>::new();
    for Entry { info, .. } in entries {
        let n = seen.entry(info.name.clone()).or_default();
        info.address = match occurrences[&info.name] {
            1 => info.name.clone(),
            _ => format!("{}[{n}]", info.name),
        };
        *n += 1;
    }
}

/// Gives each instance the tree of the grid it names.
///
/// Writers name the grid that holds the tree, so an instance of an instance is damage.
fn resolve_instances(entries: &mut [Entry]) -> Result<(), (String, Damage)> {
    let mut by_raw_name = HashMap::new();
    for (i, e) in entries.iter().enumerate() {
        by_raw_name.entry(e.raw_name.clone()).or_insert(i);
    }
    for i in 0..entries.len() {
        if entries[i].parent.is_empty() {
            continue;
        }
        let own = &entries[i];
        let fail = |what: &str| {
            let parent = metadata::text(display_name(&own.parent));
            let what = format!("an instance of grid {parent:?}, {what}");
            Err((own.info.address.clone(), Damage::new(own.at, what)))
        };
        let Some(&source) = by_raw_name.get(&own.parent) else {
            return fail("which the file does not hold");
        };
        let shared = &entries[source];
        if !shared.parent.is_empty() {
            return fail("which is an instance itself");
        }
        if shared.info.type_name != own.info.type_name {
            return fail("whose values have another type");
        }
        let merged = own.info.clone().with_tree_of(shared);
        (entries[i].info, entries[i].tree_of) = (merged, source);
    }
    Ok(())
}

impl GridInfo {
    /// Describes this instance by its own map and metadata and the tree of `shared`.
    fn with_tree_of(self, shared: &Entry) -> Self {
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

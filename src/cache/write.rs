//! Writing a cache file, brick by brick: only nodes and bounds are ever in memory.
//!
//! Bricks go to a temporary file first. Then it is mapped and the bounds are computed from what was
//! written, by the code that bounds any grid, and the file gets its name last: it is there whole
//! or not at all.

use std::fs::File;
use std::io::{self, BufWriter, Read as _, Seek as _, SeekFrom, Write};
use std::path::Path;

use glam::IVec3;
use rayon::prelude::*;
use tempfile::NamedTempFile;

use super::error::CacheError;
use super::format::{Checksum, Header, PAGE, Source};
use crate::grid::brick::{BRICK_LEN, BRICK_LOG2};
use crate::grid::{BrickSpan, Encoding, Layers, Range, Tree, Values, encode_brick, sections};
use crate::space::IndexTransform;
use crate::vdb::map_part;

/// Bricks that are encoded at a time, in parallel: 8 MB of `f32`.
const BATCH: usize = 4096;

/// What goes into a cache file.
#[derive(Debug)]
pub struct Contents<B> {
    /// The nodes; their values have been taken out.
    pub nodes: Tree<f32>,
    /// Where the grid lies in the world.
    pub transform: IndexTransform,
    /// How values are stored.
    pub encoding: Encoding,
    /// Where it comes from.
    pub source: Source,
    /// Fills the 512 values of a brick, asked by its index in `nodes` and its lowest voxel: finite
    /// and not negative.
    pub brick: B,
}

/// Writes a cache file to `path`, whole or not at all; returns its length in bytes.
///
/// # Errors
/// If the file cannot be written, or nodes and bounds take more than `max_bytes`.
pub fn write<B>(path: &Path, contents: Contents<B>, max_bytes: usize) -> Result<u64, CacheError>
where
    B: Fn(usize, IVec3, &mut [f32]) + Sync,
{
    let failed = |source| CacheError::Write {
        path: path.to_owned(),
        source,
    };
    let mut temporary = temporary_beside(path).map_err(failed)?;
    let mut header = Header::new(contents.encoding, &contents.transform);
    header.brick_count = contents.nodes.brick_count() as u64;
    header.source_bytes = contents.source.bytes;
    header.source_checksum = contents.source.checksum;
    let Contents {
        mut nodes,
        transform,
        encoding,
        source,
        brick,
    } = contents;

    let order = along_a_curve(nodes.brick_origins());
    let file = temporary.as_file_mut();
    let Payload {
        ranges,
        spans,
        checksum,
    } = write_payload(file, &order, &nodes, encoding, &brick).map_err(failed)?;
    header.payload_checksum = checksum;
    let too_long = || failed(io::ErrorKind::FileTooLarge.into());
    let (payload, resident_at) = header.extents(encoding).ok_or_else(too_long)?;

    nodes.renumber_bricks(&order);
    let origins = nodes.brick_origins().iter().copied();
    let error = Layers::new(spans.iter().zip(origins), &transform).error(encoding);
    header.depth_error = [error.rms, error.worst];
    drop(spans);
    let map = map_part(file, PAGE, payload).map_err(failed)?;
    // A range for each brick was collected: never the error.
    let values = Values::from_encoded(encoding, map, ranges).ok_or_else(too_long)?;
    let mut resident = Vec::new();
    write_names(&mut resident, &source);
    let nodes_and_bounds = sections::write(nodes, values, max_bytes);
    resident.append(
        &mut nodes_and_bounds.map_err(|source| CacheError::TooLarge {
            path: path.to_owned(),
            source,
        })?,
    );
    header.resident_bytes = resident.len() as u64;
    header.resident_checksum = Checksum::of(&resident);

    let mut finish = || {
        file.seek(SeekFrom::Start(resident_at))?;
        file.write_all(&resident)?;
        file.seek(SeekFrom::Start(0))?;
        file.write_all(bytemuck::bytes_of(&header.sealed()))?;
        file.sync_all()
    };
    finish().map_err(failed)?;
    temporary.persist(path).map_err(|e| failed(e.error))?;
    Ok(resident_at + resident.len() as u64)
}

/// What is kept of bricks once they are written.
struct Payload {
    ranges: Vec<Range>,
    spans: Vec<BrickSpan>,
    checksum: u64,
}

/// Writes an empty header and all bricks in `order`.
fn write_payload<B>(
    file: &mut File,
    order: &[usize],
    nodes: &Tree<f32>,
    encoding: Encoding,
    brick: &B,
) -> io::Result<Payload>
where
    B: Fn(usize, IVec3, &mut [f32]) + Sync,
{
    let mut out = BufWriter::with_capacity(1 << 20, file);
    fill_up(&mut out, PAGE)?;
    let size = encoding.brick_bytes();
    let mut codes = vec![0; BATCH.min(order.len()) * size];
    let mut ranges = Vec::with_capacity(encoding.range_count(order.len()));
    let mut spans = Vec::with_capacity(order.len());
    let mut checksum = Checksum::new();
    for batch in order.chunks(BATCH) {
        let codes = &mut codes[..batch.len() * size];
        let found = batch
            .par_iter()
            .zip(codes.par_chunks_exact_mut(size))
            .map(|(&b, codes)| {
                let mut values = [0.0; BRICK_LEN];
                brick(b, nodes.brick_origins()[b], &mut values);
                let range = encode_brick(encoding, &values, codes);
                (range, BrickSpan::new(&values))
            });
        for (range, span) in found.collect::<Vec<_>>() {
            ranges.extend(range);
            spans.push(span);
        }
        checksum.update(codes);
        out.write_all(codes)?;
    }
    let payload = (order.len() * size) as u64;
    fill_up(&mut out, payload.next_multiple_of(PAGE) - payload)?;
    out.flush()?;
    Ok(Payload {
        ranges,
        spans,
        checksum: checksum.value(),
    })
}

/// Writes zeros.
fn fill_up(out: &mut impl Write, count: u64) -> io::Result<()> {
    io::copy(&mut io::repeat(0).take(count), out).map(drop)
}

/// Writes the number of names, and for each its length and letters, filled up to eight bytes.
fn write_names(out: &mut Vec<u8>, source: &Source) {
    let pairs = source.metadata.iter().flat_map(|(key, value)| [key, value]);
    let names: Vec<_> = [&source.file, &source.grid]
        .into_iter()
        .chain(pairs)
        .collect();
    out.extend_from_slice(&(names.len() as u64).to_ne_bytes());
    for name in names {
        out.extend_from_slice(&(name.len() as u64).to_ne_bytes());
        out.extend_from_slice(name.as_bytes());
        out.resize(out.len().next_multiple_of(8), 0);
    }
}

/// Returns the order of bricks along a Morton curve, on which neighbours in space are mostly
/// neighbours in the file: a page of the system then holds bricks that rays meet together.
fn along_a_curve(origins: &[IVec3]) -> Vec<usize> {
    let first = origins.iter().fold(IVec3::MAX, |lo, o| lo.min(*o));
    let key = |&b: &usize| {
        let cell = (origins[b].as_i64vec3() - first.as_i64vec3()) >> BRICK_LOG2;
        let spread = |x: i64, shift: u32| {
            (0..30).fold(0_u128, |key, bit| {
                key | u128::from(x >> bit & 1 == 1) << (3 * bit + shift)
            })
        };
        spread(cell.x, 2) | spread(cell.y, 1) | spread(cell.z, 0)
    };
    let mut order: Vec<_> = (0..origins.len()).collect();
    order.sort_by_cached_key(key);
    order
}

/// Makes a temporary file in the folder of `path`, and the folder if it is missing.
fn temporary_beside(path: &Path) -> io::Result<NamedTempFile> {
    let folder = match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    };
    std::fs::create_dir_all(folder)?;
    let mut builder = tempfile::Builder::new();
    builder.prefix(".majorant-").suffix(".part");
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt as _;
        // The default of a temporary file is 0600; the umask is taken off this.
        builder.permissions(std::fs::Permissions::from_mode(0o666));
    }
    builder.tempfile_in(folder)
}

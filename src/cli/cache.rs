//! `majorant cache`: a grid of a volume file to a cache file.

use std::fs::File;
use std::path::{Path, PathBuf};

use majorant::cache::{self, CacheFile, Checksum, Contents, Source};
use majorant::grid::brick::BRICK_LEN;
use majorant::grid::{Storage, StorageKind};
use majorant::output;
use majorant::scene::{SceneError, default_look};
use majorant::vdb::{Archive, DensityData, LoadOptions};

use super::args::CacheArgs;
use super::{Failure, memory, render, report};

pub(super) fn run(args: &CacheArgs) -> Result<(), Failure> {
    render::start_threads(args.threads)?;
    let max_memory_bytes = memory::limit(args.max_memory);
    let max_bytes = usize::try_from(max_memory_bytes).unwrap_or(usize::MAX);
    if args.check {
        return check(&args.input, max_bytes);
    }
    if args.encoding == StorageKind::Auto {
        let message = "--encoding auto needs a scene's scale: name an encoding, or lossless";
        return Err(Failure::Usage(message.to_owned()));
    }
    let output = args.output.clone().unwrap_or_else(|| {
        // Not `with_extension`, which would take `cloud.0012` for a name in .0012.
        let mut name = args.input.file_stem().unwrap_or_default().to_owned();
        name.push(".mjc");
        PathBuf::from(name)
    });
    output::check_writable(&output).map_err(Failure::failed)?;
    let archive = Archive::open(&args.input)?;
    let (index, why) = default_look::choose_grid(&archive, args.grid.as_deref())?;
    let info = &archive.grids()[index];
    tracing::info!("grid {:?}: {why}", info.address);
    let options = LoadOptions {
        max_memory_bytes,
        sanitize: args.sanitize,
    };
    let DensityData {
        mut tree,
        transform,
        report,
    } = archive.load_density(index, &options)?;
    let storage = Storage {
        kind: args.encoding,
        ..Storage::lossless()
    };
    let stored =
        storage
            .choose(&tree, &transform)
            .map_err(|source| SceneError::TooLargeForHalf {
                path: args.input.clone(),
                grid: info.address.clone(),
                source,
            })?;
    for (count, what) in [
        (report.clamped_negative_count, "negative"),
        (report.sanitized_count, "not finite"),
    ] {
        if count > 0 {
            tracing::warn!("{count} {what} voxels or tiles written as 0");
        }
    }
    let values = tree.take_values();
    let contents = Contents {
        nodes: tree,
        transform,
        encoding: stored.encoding,
        source: source(&args.input, info.address.clone(), info.metadata.clone())?,
        brick: |b: usize, _origin, out: &mut [f32]| {
            out.copy_from_slice(&values[b * BRICK_LEN..][..BRICK_LEN]);
        },
    };
    let bytes = cache::write(&output, contents, max_bytes)?;
    let megabytes = bytes as f64 / 1e6;
    let shown = output.display();
    tracing::info!(
        "{shown}: {megabytes:.1} MB, values as {}: {}",
        stored.encoding,
        stored.explain(1.0)
    );
    Ok(())
}

/// Says where a grid comes from.
fn source(path: &Path, grid: String, metadata: Vec<(String, String)>) -> Result<Source, Failure> {
    let read = File::open(path).and_then(Checksum::of_reader);
    let (bytes, checksum) =
        read.map_err(|e| Failure::BadInput(format!("{}: cannot be read: {e}", path.display())))?;
    let name = path.file_name().unwrap_or_default();
    Ok(Source {
        file: name.to_string_lossy().into_owned(),
        bytes,
        checksum,
        grid,
        metadata,
    })
}

fn check(path: &Path, max_bytes: usize) -> Result<(), Failure> {
    let file = CacheFile::open(path, max_bytes)?;
    let grid = file.grid()?;
    file.verify_payload()?;
    let Source {
        file: origin,
        bytes,
        checksum,
        grid: name,
        ..
    } = file.source();
    report::print(&format!(
        "{}: whole\n  grid      {name}, {} bricks as {}\n  memory    {:.1} MB resident, {:.1} MB mapped\n  \
         made of   {origin}, {bytes} bytes, checksum {checksum:016x}\n",
        path.display(),
        grid.brick_count(),
        file.stored().encoding,
        grid.resident_bytes() as f64 / 1e6,
        (grid.memory_bytes() - grid.resident_bytes()) as f64 / 1e6,
    ))
}

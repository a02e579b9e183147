//! `majorant merge`: parts of frames, rendered by `render --samples A..B`, to whole frames.
//!
//! Means and second moments are merged by Chan's formula, weighted by the sample counts of each
//! pixel; parts are taken in the order of their samples, whatever the order they are named in, so
//! the result does not depend on it.

use std::path::{Path, PathBuf};

use majorant::film::Region;
use majorant::output::{self, Identity, Part, SampleRanges, read_identity, read_part};
use majorant::sequence::Pattern;

use super::args::MergeArgs;
use super::{Failure, report};

pub(super) fn run(args: &MergeArgs) -> Result<(), Failure> {
    let Some(range) = args.frames.as_ref().or(args.frames_openjd.as_ref()) else {
        return merge(&args.parts, &args.output);
    };
    let frames = range.frames();
    for path in args.parts.iter().chain(std::iter::once(&args.output)) {
        if frames.len() > 1 && Pattern::of(path).is_none() {
            return Err(Failure::Usage(format!(
                "{}: one name for {} frames, expected #### in it where the frame's number goes",
                path.display(),
                frames.len()
            )));
        }
    }
    let mut failed = Vec::new();
    for &frame in frames {
        let numbered = |path: &PathBuf| Pattern::of(path).map_or(path.clone(), |p| p.path(frame));
        let parts: Vec<_> = args.parts.iter().map(numbered).collect();
        if let Err(failure) = merge(&parts, &numbered(&args.output)) {
            report::error(&format!("frame {frame} failed:"));
            report::failure(&failure);
            failed.push(frame);
        }
    }
    if failed.is_empty() {
        return Ok(());
    }
    let list: Vec<_> = failed.iter().map(ToString::to_string).collect();
    report::error(&format!(
        "{} of {} frames failed: {}",
        failed.len(),
        frames.len(),
        list.join(", ")
    ));
    Err(Failure::SomeFrames)
}

/// Merges the parts of one frame.
fn merge(parts: &[PathBuf], target: &Path) -> Result<(), Failure> {
    let mut known = Vec::new();
    for path in parts {
        known.push(Known::read(path)?);
    }
    let samples = check(&known)?;
    known.sort_by_key(|part| part.identity.samples.ranges()[0].start);
    let mut whole: Option<Part> = None;
    let mut secs = 0.0;
    for Known { path, .. } in &known {
        let part = read(read_part(path))?;
        secs += part.origin.render_secs().unwrap_or(0.0);
        match &mut whole {
            None => whole = Some(part),
            Some(whole) => {
                if !whole.film.merge(&part.film) {
                    let message = "changed while it was read";
                    return Err(Failure::BadInput(format!("{}: {message}", path.display())));
                }
            }
        }
    }
    let whole = whole.expect("the command line takes one part or more");
    let command: Vec<_> = std::env::args_os().collect();
    let words: Vec<_> = command.iter().map(|w| w.to_string_lossy()).collect();
    let command = words.join(" ");
    let Part { film, origin, .. } = &whole;
    output::write_merged_exr(target, film, origin, &samples, secs, &command)
        .map_err(Failure::failed)?;
    tracing::info!(
        "{}: samples {samples} of {} parts",
        target.display(),
        known.len()
    );
    Ok(())
}

/// What is known of a part before its pixels are merged.
struct Known<'a> {
    path: &'a Path,
    identity: Identity,
    size: [u32; 2],
    region: Region,
}

impl<'a> Known<'a> {
    fn read(path: &'a Path) -> Result<Self, Failure> {
        let (identity, size, region) = read(read_identity(path))?;
        Ok(Self {
            path,
            identity,
            size,
            region,
        })
    }
}

fn read<T>(result: Result<T, output::OutputError>) -> Result<T, Failure> {
    result.map_err(|e| Failure::BadInput(report::chain(&e)))
}

/// Checks that the parts are of one frame and share no sample; returns all their samples.
fn check(parts: &[Known<'_>]) -> Result<SampleRanges, Failure> {
    let (first, others) = parts
        .split_first()
        .expect("the command line takes one part or more");
    let mut samples = first.identity.samples.clone();
    for part in others {
        let (a, b) = (&first.identity, &part.identity);
        let differs = |what: &str, was: String, is: String| {
            let (path, first) = (part.path.display(), first.path.display());
            let message = format!("{path}: {what} {is}, expected {was} as in {first}");
            Err(Failure::BadInput(message))
        };
        let hash = |identity: &Identity| format!("{:016x}", identity.scene_hash);
        if a.scene_hash != b.scene_hash {
            return differs("of the scene", hash(a), hash(b));
        }
        if a.version != b.version {
            return differs("of version", a.version.clone(), b.version.clone());
        }
        let place = |part: &Known<'_>| {
            let ([w, h], Region { min, max }) = (part.size, part.region);
            format!("{},{} to {},{} of {w}x{h}", min[0], min[1], max[0], max[1])
        };
        if (first.size, first.region) != (part.size, part.region) {
            return differs("of the pixels", place(first), place(part));
        }
        samples = samples.union(&b.samples).map_err(|e| {
            let path = part.path.display();
            Failure::BadInput(format!(
                "{path}: {e}: expected samples that no other part has"
            ))
        })?;
    }
    if samples.ranges().len() > 1 {
        tracing::warn!("samples between are missing: {samples}");
    }
    Ok(samples)
}

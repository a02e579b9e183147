//! The files that a render writes, for each of its frames.

use std::path::{Path, PathBuf};

use majorant::output;
use majorant::sequence::Pattern;

use crate::cli::Failure;
use crate::cli::args::RenderArgs;

/// The files of all frames.
#[derive(Debug)]
pub(super) struct Targets {
    image: PathBuf,
    preview: Option<PathBuf>,
    stats: Option<PathBuf>,
}

/// The files of one frame.
#[derive(Clone, Debug)]
pub(super) struct Outputs {
    pub(super) image: PathBuf,
    pub(super) preview: Option<PathBuf>,
    pub(super) stats: Option<PathBuf>,
    /// The frame while it is in progress.
    pub(super) checkpoint: PathBuf,
    /// The image so far, on request.
    pub(super) snapshot: PathBuf,
}

impl Targets {
    /// Names the files; with several frames, each name needs a number.
    pub(super) fn new(args: &RenderArgs, frame_count: usize) -> Result<Self, Failure> {
        let is_sequence = args.batch.frames().is_some();
        let image = args.output.clone().unwrap_or_else(|| {
            // Not `with_extension`, which would take `cloud.0012` for a name in .0012.
            let mut name = args.input.file_stem().unwrap_or_default().to_owned();
            if is_sequence && Pattern::of(name.as_ref()).is_none() {
                name.push(".####");
            }
            name.push(".exr");
            PathBuf::from(name)
        });
        let is_exr = |e: &std::ffi::OsStr| e.eq_ignore_ascii_case("exr");
        if !image.extension().is_some_and(is_exr) {
            let message = "images are OpenEXR, expected a name in .exr";
            return Err(Failure::Usage(format!(
                "--output {}: {message}",
                image.display()
            )));
        }
        let preview = args.preview_png.as_ref().map(|asked| {
            let beside = || image.with_extension("png");
            asked.clone().unwrap_or_else(beside)
        });
        let targets = Self {
            image,
            preview,
            stats: args.stats_json.clone(),
        };
        targets.check_names(frame_count)?;
        Ok(targets)
    }

    fn check_names(&self, frame_count: usize) -> Result<(), Failure> {
        let all: Vec<&Path> = self.all().collect();
        for (i, path) in all.iter().enumerate() {
            let shown = path.display();
            if all[..i].contains(path) {
                let message = "named for two outputs, expected a file for each";
                return Err(Failure::Usage(format!("{shown}: {message}")));
            }
            if frame_count > 1 && Pattern::of(path).is_none() {
                return Err(Failure::Usage(format!(
                    "{shown}: one name for {frame_count} frames, expected #### in it where the \
                     frame's number goes"
                )));
            }
        }
        Ok(())
    }

    fn all(&self) -> impl Iterator<Item = &Path> {
        let Self {
            image,
            preview,
            stats,
        } = self;
        let others = preview.iter().chain(stats);
        std::iter::once(image).chain(others).map(PathBuf::as_path)
    }

    /// Returns the files of a frame; marks of a number are left alone without one.
    pub(super) fn of(&self, frame: Option<i32>) -> Outputs {
        let numbered = |path: &PathBuf| match (frame, Pattern::of(path)) {
            (Some(frame), Some(pattern)) => pattern.path(frame),
            _ => path.clone(),
        };
        let image = numbered(&self.image);
        let mut checkpoint = image.clone().into_os_string();
        checkpoint.push(".checkpoint");
        Outputs {
            preview: self.preview.as_ref().map(numbered),
            stats: self.stats.as_ref().map(numbered),
            checkpoint: checkpoint.into(),
            snapshot: image.with_extension("snapshot.exr"),
            image,
        }
    }
}

impl Outputs {
    /// Finds out whether all of them can be written.
    pub(super) fn check(&self) -> Result<(), Failure> {
        let others = self.preview.iter().chain(&self.stats);
        std::iter::once(&self.image)
            .chain(others)
            .try_for_each(|path| output::check_writable(path).map_err(Failure::failed))
    }
}

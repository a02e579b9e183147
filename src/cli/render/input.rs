//! From what the command line names to scenes: a scene file, or the default look of a volume.

use std::path::Path;

use majorant::cache::is_cache;
use majorant::grid::StorageKind;
use majorant::scene::default_look::{self, Wishes};
use majorant::scene::desc::unplaced;
use majorant::scene::{LoadOptions, LoadStage, LoadedVolume, SceneFile, SceneTemplate};
use majorant::sequence::Pattern;
use majorant::vdb::Archive;

use super::stages::Stages;
use crate::cli::Failure;
use crate::cli::args::RenderArgs;

/// What frames are made of.
pub(super) struct Input {
    pub(super) template: SceneTemplate,
    /// Of a bare volume: it was loaded to choose its look.
    pub(super) volume: Option<LoadedVolume>,
    pub(super) stages: Stages,
}

impl Input {
    /// Reads the scene file, or chooses the look of a volume by its first frame.
    pub(super) fn new(
        args: &RenderArgs,
        options: &LoadOptions,
        first: Option<i32>,
    ) -> Result<Self, Failure> {
        let mut stages = Stages::default();
        let mut volume = None;
        let mut template = if is_volume(&args.input) {
            let pattern = Pattern::of(&args.input).filter(|_| !args.input.exists());
            let path = match &pattern {
                Some(pattern) => pattern.path(first.unwrap_or(0)),
                None => args.input.clone(),
            };
            let (file, loaded) = default_scene(&path, args, options, &mut stages)?;
            let text = if pattern.is_some() {
                // The look of the first frame is that of all.
                with_file(file, &args.input)
            } else {
                volume = Some(loaded);
                file.text().to_owned()
            };
            // Files are relative to the current folder, as on the command line.
            let name = args.input.file_name().unwrap_or_default().to_string_lossy();
            SceneTemplate::new(format!("default look of {name}").as_ref(), text)
        } else if args.up.is_some() {
            return Err(Failure::Usage(
                "--up is for bare .vdb files: set up in [camera]".to_owned(),
            ));
        } else {
            SceneTemplate::read(&args.input)?
        };
        for (path, value) in &args.set {
            template.set(path, value);
        }
        Ok(Self {
            template,
            volume,
            stages,
        })
    }
}

/// Returns the text of a scene with its volume's file replaced.
fn with_file(mut file: SceneFile, input: &Path) -> String {
    for volume in &mut file.desc.volume {
        volume.get_mut().file = unplaced(input.to_owned());
    }
    let comments = file.text().lines().map_while(|l| l.strip_prefix("# "));
    let header = comments.collect::<Vec<_>>().join("\n");
    file.to_toml(&header)
}

/// Returns whether `path` is a volume and not a scene file.
pub(in crate::cli) fn is_volume(path: &Path) -> bool {
    let is_vdb = |e: &std::ffi::OsStr| e.eq_ignore_ascii_case("vdb");
    path.extension().is_some_and(is_vdb) || is_cache(path)
}

fn default_scene(
    path: &Path,
    args: &RenderArgs,
    options: &LoadOptions,
    stages: &mut Stages,
) -> Result<(SceneFile, LoadedVolume), Failure> {
    stages.enter(LoadStage::Read);
    let wishes = Wishes {
        resolution: args.resolution,
        up: args.up.map(Into::into),
        encoding: args.encoding,
    };
    let (volume, why) = if is_cache(path) {
        let volume = LoadedVolume::map(path, options)?;
        check_cached(args, &volume)?;
        (volume, "the grid of the cache file".to_owned())
    } else {
        let archive = Archive::open(path)?;
        let (index, why) = default_look::choose_grid(&archive, args.grid.as_deref())?;
        let storage = wishes.storage();
        let mut on_stage = |s| stages.enter(s);
        let volume = LoadedVolume::decode(&archive, index, options, &storage, &mut on_stage)?;
        (volume, why)
    };
    stages.end();
    tracing::info!("rendering grid {:?}: {why}", volume.name);
    let file = default_look::describe(&volume, &why, wishes)?;
    Ok((file, volume))
}

/// Checks that the command line asks for nothing that a cache file cannot give.
fn check_cached(args: &RenderArgs, volume: &LoadedVolume) -> Result<(), Failure> {
    let (file, held) = (args.input.display(), &volume.name);
    if let Some(name) = args.grid.as_ref().filter(|name| *name != held) {
        let message = format!("{file}: no grid {name:?} in the cache file, it holds {held:?}");
        return Err(Failure::BadInput(message));
    }
    match args.encoding {
        None | Some(StorageKind::Auto) => Ok(()),
        Some(_) => Err(Failure::Usage(format!(
            "--encoding is for .vdb files: {file} holds {}",
            volume.stored.encoding
        ))),
    }
}

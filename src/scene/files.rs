//! The files of a frame: numbers in names, and what stands in for files that are not there.

use std::fs::File;
use std::io::{self, Read as _, Seek as _, SeekFrom};
use std::path::{Path, PathBuf};

use super::desc::VolumeDesc;
use super::{SceneFile, fnv1a};
use crate::sequence::Pattern;

/// A volume file of a sequence that is not there.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct MissingFile {
    /// The file that the frame names.
    pub path: PathBuf,
    /// The file that is taken in its place, if one was to be.
    pub held: Option<PathBuf>,
}

impl SceneFile {
    /// Puts the numbers of this scene's frame into the names of its volume files, and returns which
    /// of those files are missing.
    ///
    /// With `hold`, a missing file is replaced by that of the nearest earlier frame that is there,
    /// or else of the first. A name that is a file as it stands is left alone, whatever marks of a
    /// number it has; so are names without one.
    pub fn number_files(&mut self, hold: bool) -> Vec<MissingFile> {
        let folder = self.source.folder().to_owned();
        let frame = self.desc.render.frame;
        let mut missing = Vec::new();
        for volume in &mut self.desc.volume {
            let VolumeDesc {
                file, frame_offset, ..
            } = volume.get_mut();
            if folder.join(file.get_ref()).exists() {
                continue;
            }
            let Some(pattern) = Pattern::of(file.get_ref()) else {
                continue;
            };
            let number = frame.saturating_add(*frame_offset);
            let mut name = pattern.path(number);
            let path = folder.join(&name);
            if !path.exists() {
                let held = hold.then(|| nearest(&folder, &pattern, number)).flatten();
                if let Some(held) = &held {
                    name.clone_from(held);
                }
                missing.push(MissingFile {
                    path,
                    held: held.map(|name| folder.join(name)),
                });
            }
            *file.get_mut() = name;
        }
        missing
    }
}

/// Bytes at either end of a file that count for its fingerprint.
const ENDS: u64 = 1 << 16;

/// Returns a text that differs, but by chance, for files that differ in length or at their ends;
/// empty if the file cannot be read.
pub(super) fn fingerprint(path: &Path) -> String {
    let read = || -> io::Result<String> {
        let mut file = File::open(path)?;
        let length = file.metadata()?.len();
        let mut bytes = Vec::new();
        file.by_ref().take(ENDS).read_to_end(&mut bytes)?;
        file.seek(SeekFrom::Start(length.saturating_sub(ENDS)))?;
        file.take(ENDS).read_to_end(&mut bytes)?;
        Ok(format!("{length} {:016x}", fnv1a(&bytes)))
    };
    read().unwrap_or_default()
}

/// Returns the name of the frame that stands in for frame `number`.
fn nearest(folder: &Path, pattern: &Pattern, number: i32) -> Option<PathBuf> {
    let name = pattern.path(number);
    let parent = name.parent().unwrap_or(Path::new(""));
    let list = match folder.join(parent) {
        here if here.as_os_str().is_empty() => PathBuf::from("."),
        there => there,
    };
    let entries = std::fs::read_dir(list).ok()?;
    let names = entries.flatten().map(|e| parent.join(e.file_name()));
    let frames: Vec<i32> = names.filter_map(|name| pattern.frame(&name)).collect();
    let earlier = frames.iter().filter(|&&f| f < number).max();
    let frame = earlier.or(frames.iter().min())?;
    Some(pattern.path(*frame))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::SceneTemplate;

    fn scene(folder: &Path, file: &str, frame: i32) -> SceneFile {
        let text = format!(
            "[camera]\nposition = [0, -3, 0]\nlook_at = [0, 0, 0]\n[[volume]]\nfile = {file:?}\n\
             frame_offset = 10\n"
        );
        let template = SceneTemplate::new(&folder.join("a.toml"), text);
        template.at(Some(frame)).unwrap()
    }

    fn file(scene: &SceneFile) -> String {
        scene.desc.volume[0]
            .get_ref()
            .file
            .get_ref()
            .display()
            .to_string()
    }

    #[test]
    fn files_are_numbered_and_held() {
        let folder = tempfile::tempdir().unwrap();
        let root = folder.path();
        std::fs::create_dir(root.join("v")).unwrap();
        for name in ["v/a.0012.vdb", "v/a.0014.vdb", "v/b.0011.vdb", "v/c#.vdb"] {
            std::fs::write(root.join(name), "").unwrap();
        }
        let number = |frame: i32, hold: bool| {
            let mut scene = scene(root, "v/a.####.vdb", frame);
            let missing = scene.number_files(hold);
            (file(&scene), missing)
        };
        assert_eq!(number(2, false), ("v/a.0012.vdb".to_owned(), vec![]));
        let gap = |held: Option<&str>| MissingFile {
            path: root.join("v/a.0013.vdb"),
            held: held.map(|name| root.join(name)),
        };
        assert_eq!(
            number(3, false),
            ("v/a.0013.vdb".to_owned(), vec![gap(None)])
        );
        let held = vec![gap(Some("v/a.0012.vdb"))];
        assert_eq!(number(3, true), ("v/a.0012.vdb".to_owned(), held));
        assert_eq!(number(99, true).0, "v/a.0014.vdb");
        assert_eq!(number(0, true).0, "v/a.0012.vdb", "the first, before all");
        for plain in ["v/c#.vdb", "v/none.vdb"] {
            let mut scene = scene(root, plain, 3);
            assert_eq!(scene.number_files(true), [], "{plain}");
            assert_eq!(file(&scene), plain);
        }
    }
}

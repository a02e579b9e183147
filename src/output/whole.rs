//! Files that appear whole or not at all.
//!
//! Everything is written to a temporary file in the target's folder, `.NAME.….part`, synced, and
//! renamed over the target, whose folder is synced too. Existing files are replaced. A process
//! that is killed leaves such a file behind and nothing else.

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};
use std::time::Duration;

use tempfile::NamedTempFile;

use super::OutputError;

/// A temporary file that nobody wrote to for so long belongs to a process that is no more.
const REMNANT_AGE: Duration = Duration::from_hours(1);

/// A temporary file, buffered.
pub(super) type Target<'a> = BufWriter<&'a mut File>;

/// Writes a text, such as statistics, with the same care as images.
///
/// # Errors
/// If the folder cannot be made or the file not be written; no part of it is then left.
pub fn write_text(path: &Path, text: &str) -> Result<(), OutputError> {
    write_bytes(path, text.as_bytes())
}

/// Writes bytes with the same care as images.
///
/// # Errors
/// If the folder cannot be made or the file not be written; no part of it is then left.
pub fn write_bytes(path: &Path, bytes: &[u8]) -> Result<(), OutputError> {
    write_with(path, |file| file.write_all(bytes))
}

/// Writes what `fill` does, with the same care as images.
///
/// # Errors
/// If the folder cannot be made or the file not be written; no part of it is then left.
pub fn write_with(
    path: &Path,
    fill: impl FnOnce(&mut dyn Write) -> io::Result<()>,
) -> Result<(), OutputError> {
    write_whole(path, |file| fill(file).map_err(|e| io_error(path, e)))
}

fn io_error(path: &Path, source: io::Error) -> OutputError {
    OutputError::Io {
        path: path.to_owned(),
        source,
    }
}

/// Finds out whether `path` can be written, before hours of work depend on it.
///
/// Makes the folder if it is missing and leaves nothing else behind.
///
/// # Errors
/// If the folder cannot be made, no file can be made in it, or `path` is a folder itself.
pub fn check_writable(path: &Path) -> Result<(), OutputError> {
    if path.is_dir() {
        let source = io::ErrorKind::IsADirectory.into();
        let path = path.to_owned();
        return Err(OutputError::Io { path, source });
    }
    temporary_beside(path).map(drop)
}

/// Removes the temporary files that processes left which were killed while they wrote `path`, an
/// hour ago or longer.
pub fn remove_remnants(path: &Path) {
    let prefix = temporary_prefix(path);
    let Ok(entries) = std::fs::read_dir(folder_of(path)) else {
        return;
    };
    for entry in entries.flatten() {
        let name = entry.file_name();
        let name = name.to_string_lossy();
        let age = entry.metadata().and_then(|m| m.modified());
        let age = age.ok().and_then(|at| at.elapsed().ok());
        let is_old = age.is_some_and(|age| age > REMNANT_AGE);
        if is_old && name.starts_with(&prefix) && name.ends_with(SUFFIX) {
            // Another process may have been faster.
            let _ = std::fs::remove_file(entry.path());
        }
    }
}

/// Fills a temporary file beside `path` by `fill`, then renames it to `path`.
pub(super) fn write_whole(
    path: &Path,
    fill: impl FnOnce(&mut Target<'_>) -> Result<(), OutputError>,
) -> Result<(), OutputError> {
    let failed = |e| io_error(path, e);
    // Removed on drop, so an error on any of the following lines leaves nothing behind.
    let mut file = temporary_beside(path)?;
    let mut buffered = BufWriter::new(file.as_file_mut());
    fill(&mut buffered)?;
    // Explicitly: a buffer that is dropped swallows the error of a full disk.
    buffered.flush().map_err(failed)?;
    drop(buffered);
    file.as_file().sync_all().map_err(failed)?;
    file.persist(path).map_err(|e| failed(e.error))?;
    // Some systems cannot sync a folder; the file is there all the same.
    if let Ok(folder) = File::open(folder_of(path)) {
        let _ = folder.sync_all();
    }
    Ok(())
}

fn folder_of(path: &Path) -> PathBuf {
    match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent.to_owned(),
        _ => PathBuf::from("."),
    }
}

const SUFFIX: &str = ".part";

fn temporary_prefix(path: &Path) -> String {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    format!(".{name}.")
}

/// Makes a temporary file in the folder of `path`, and the folder if it is missing.
///
/// The umask applies as for any new file: a frame that a farm's other machines cannot read is
/// of no use.
fn temporary_beside(path: &Path) -> Result<NamedTempFile, OutputError> {
    let folder = folder_of(path);
    std::fs::create_dir_all(&folder).map_err(|e| io_error(path, e))?;
    let prefix = temporary_prefix(path);
    let mut builder = tempfile::Builder::new();
    builder.prefix(&prefix).suffix(SUFFIX);
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt as _;
        // The default of a temporary file is 0600; the umask is taken off this.
        builder.permissions(std::fs::Permissions::from_mode(0o666));
    }
    builder.tempfile_in(&folder).map_err(|e| io_error(path, e))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_is_there_when_it_is_whole() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("deep/a.bin");
        let names = || {
            let entries = std::fs::read_dir(folder.path().join("deep")).unwrap();
            let names = entries.map(|e| e.unwrap().file_name().into_string().unwrap());
            names.collect::<Vec<_>>()
        };
        write_with(&path, |out| {
            out.write_all(b"half")?;
            assert!(
                !names().contains(&"a.bin".to_owned()),
                "not yet: {:?}",
                names()
            );
            assert!(names()[0].starts_with(".a.bin."), "{:?}", names());
            out.write_all(b" and half")
        })
        .unwrap();
        assert_eq!(names(), ["a.bin"]);
        assert_eq!(std::fs::read(&path).unwrap(), b"half and half");
        let failure = write_with(&path, |_| Err(io::ErrorKind::StorageFull.into()));
        assert!(failure.is_err(), "a full disk is an error");
        assert_eq!(names(), ["a.bin"], "nothing left, the old file kept");
        assert_eq!(std::fs::read(&path).unwrap(), b"half and half");
    }

    #[test]
    fn only_old_remnants_of_the_same_file_are_removed() {
        let folder = tempfile::tempdir().unwrap();
        let make = |name: &str, age: u64| {
            let file = File::create(folder.path().join(name)).unwrap();
            let then = std::time::SystemTime::now() - Duration::from_secs(age);
            file.set_modified(then).unwrap();
        };
        for (name, age) in [
            (".a.exr.123.part", 7200),
            (".a.exr.456.part", 60),
            (".b.exr.123.part", 7200),
            ("a.exr.123.part", 7200),
        ] {
            make(name, age);
        }
        remove_remnants(&folder.path().join("a.exr"));
        let entries = std::fs::read_dir(folder.path()).unwrap();
        let mut left: Vec<_> = entries.map(|e| e.unwrap().file_name()).collect();
        left.sort();
        assert_eq!(
            left,
            [".a.exr.456.part", ".b.exr.123.part", "a.exr.123.part"]
        );
    }
}

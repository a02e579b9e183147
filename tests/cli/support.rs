//! Runs the program and holds its files.
#![allow(dead_code, reason = "each test file uses its own part")]

use std::path::{Path, PathBuf};
use std::process::Output;

/// A temporary folder, gone when dropped.
pub(crate) struct Folder(tempfile::TempDir);

impl Folder {
    pub(crate) fn new() -> Self {
        Self(tempfile::tempdir().expect("the system has room for temporary files"))
    }

    pub(crate) fn root(&self) -> &Path {
        self.0.path()
    }

    pub(crate) fn path(&self, name: &str) -> String {
        self.0.path().join(name).display().to_string()
    }

    pub(crate) fn write(&self, name: &str, text: &str) -> String {
        let path = self.path(name);
        std::fs::write(&path, text).expect("temporary files can be written");
        path
    }
}

/// Returns the path of a committed volume.
pub(crate) fn fixture(name: &str) -> PathBuf {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    root.join("tests/fixtures/vdb").join(name)
}

/// Runs the program in the temporary folder, without colours.
pub(crate) fn majorant(args: &[&str]) -> Output {
    let mut command = assert_cmd::Command::cargo_bin("majorant").expect("the program is built");
    command.current_dir(std::env::temp_dir());
    command.env_remove("SLURM_CPUS_PER_TASK").args(args);
    command.output().expect("the program runs")
}

pub(crate) fn code(run: &Output) -> i32 {
    run.status.code().expect("not killed by a signal")
}

pub(crate) fn stdout(run: &Output) -> String {
    String::from_utf8(run.stdout.clone()).expect("text")
}

pub(crate) fn stderr(run: &Output) -> String {
    String::from_utf8(run.stderr.clone()).expect("text")
}

/// Returns the channels of an image, bit by bit.
pub(crate) fn pixels(path: &str) -> Vec<(String, Vec<u32>)> {
    let image = exr::prelude::read_first_flat_layer_from_file(path)
        .unwrap_or_else(|e| panic!("{path}: {e}"));
    let channels = image.layer_data.channel_data.list.iter();
    channels
        .map(|c| {
            let bits = c.sample_data.values_as_f32().map(f32::to_bits).collect();
            (c.name.to_string(), bits)
        })
        .collect()
}

/// Returns an attribute of an image, a text.
pub(crate) fn attribute(path: &str, name: &str) -> String {
    let image = exr::prelude::read_first_flat_layer_from_file(path).expect("an image");
    match image.layer_data.attributes.other.get(name.as_bytes()) {
        Some(exr::prelude::AttributeValue::Text(text)) => text.to_string(),
        other => panic!("{name} is {other:?}"),
    }
}

/// Returns the names of the files of a folder, in order.
pub(crate) fn names(folder: &str) -> Vec<String> {
    let entries = std::fs::read_dir(folder).expect("the folder is there");
    let name = |e: std::io::Result<std::fs::DirEntry>| {
        e.expect("listed").file_name().into_string().expect("plain")
    };
    let mut names: Vec<_> = entries.map(name).collect();
    names.sort();
    names
}

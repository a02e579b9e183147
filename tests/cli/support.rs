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

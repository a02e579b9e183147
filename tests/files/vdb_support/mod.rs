//! What the .vdb tests share: oracles, a tiny writer, and the files of `../shared`.

#![allow(
    dead_code,
    clippy::print_stdout,
    reason = "each test program uses its own part; what is skipped is said"
)]

pub(crate) mod oracle;
pub(crate) mod writer;

use std::path::{Path, PathBuf};

/// Returns a path relative to the crate's root.
pub(crate) fn in_crate(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(path)
}

/// Returns all .vdb files below `folder`, sorted; prints a line where the folder is absent.
pub(crate) fn vdb_files(folder: &str) -> Vec<PathBuf> {
    let root = in_crate(folder);
    if !root.is_dir() {
        println!("skipped: {folder} is not here");
        return Vec::new();
    }
    let mut files = Vec::new();
    let mut folders = vec![root];
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(&folder).expect("a folder of test files is readable") {
            let path = entry.expect("its entries are readable").path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|e| e == "vdb") {
                files.push(path);
            }
        }
    }
    files.sort();
    files
}

//! Every file of data/hostile does what its table there says, to the listing and to the renderer.
//!
//! The table is the expectation: `error`, `listed` (with a reason why it cannot be rendered) or
//! `ok`. That no file panics, hangs or exhausts memory is proved by this test ending.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use majorant::vdb::{Archive, LoadOptions, VdbError};

/// Far above what any of these files needs, far below what the damaged counts ask for.
const MAX_MEMORY_BYTES: u64 = 256 << 20;

/// One row: file, expected outcome of listing it, expected outcome of rendering it.
struct Row {
    file: String,
    info: String,
    render: String,
}

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("data/hostile")
}

fn is_vdb(name: &str) -> bool {
    Path::new(name).extension().is_some_and(|e| e == "vdb")
}

fn table() -> Vec<Row> {
    let text = std::fs::read_to_string(folder().join("README.md"))
        .expect("the table is part of the project");
    text.lines()
        .map(|line| line.split('|').map(str::trim).collect::<Vec<_>>())
        .filter(|cells| cells.len() == 7 && is_vdb(cells[1]))
        .map(|cells| Row {
            file: cells[1].to_owned(),
            info: cells[4].to_owned(),
            render: cells[5].to_owned(),
        })
        .collect()
}

/// Lists a file as `info` does, with the values of every grid that is not refused.
fn list(path: &Path, options: &LoadOptions) -> Result<&'static str, VdbError> {
    let archive = Archive::open(path)?;
    let mut outcome = "ok";
    for (i, grid) in archive.grids().iter().enumerate() {
        if grid.refused.is_some() {
            outcome = "listed";
        } else {
            archive.load(i, options)?;
        }
    }
    Ok(outcome)
}

/// Loads the first grid for rendering; `None` if there is none.
fn first_density(path: &Path, options: &LoadOptions) -> Option<Result<(), VdbError>> {
    match Archive::open(path) {
        Err(e) => Some(Err(e)),
        Ok(archive) if archive.grids().is_empty() => None,
        Ok(archive) => Some(archive.load_density(0, options).map(|_| ())),
    }
}

#[test]
fn damaged_files_end_as_their_table_says() {
    let options = LoadOptions {
        max_memory_bytes: MAX_MEMORY_BYTES,
        ..LoadOptions::default()
    };
    let mut wrong = Vec::new();
    for Row { file, info, render } in table() {
        let path = folder().join(&file);
        let mut check = |what: &str, expected: &str, found: Result<&str, VdbError>| {
            let (found, message) = match found {
                Ok(outcome) => (outcome, String::new()),
                Err(e) => ("error", e.to_string()),
            };
            if found != expected {
                wrong.push(format!(
                    "{file}: {what}: {found}, expected {expected}: {message}"
                ));
            }
            if found == "error" && !message.is_empty() && !message.contains(&file) {
                wrong.push(format!(
                    "{file}: {what}: the message does not name it: {message}"
                ));
            }
        };
        check("info", &info, list(&path, &options));
        let rendered = first_density(&path, &options);
        check(
            "render",
            &render,
            rendered.map_or(Ok("error"), |r| r.map(|()| "ok")),
        );
    }
    assert!(wrong.is_empty(), "\n{}", wrong.join("\n"));
}

#[test]
fn the_table_and_the_folder_hold_the_same_files() {
    let listed: BTreeSet<_> = table().into_iter().map(|row| row.file).collect();
    let found: BTreeSet<_> = std::fs::read_dir(folder())
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .filter(|name| is_vdb(name))
        .collect();
    assert_eq!(listed, found, "run data/hostile/make.py");
    assert!(listed.len() >= 40, "the table was not found: {listed:?}");
}

#[test]
fn what_the_voxel_policy_changes_is_counted() {
    let report = |file: &str| {
        let options = LoadOptions {
            max_memory_bytes: MAX_MEMORY_BYTES,
            sanitize: true,
        };
        let archive = Archive::open(&folder().join(file)).unwrap();
        archive.load_density(0, &options).unwrap().report
    };
    assert_eq!(
        report("nan_values.vdb").sanitized_count,
        2,
        "one NaN, one infinity"
    );
    assert_eq!(
        report("negative_values.vdb").clamped_negative_count,
        2,
        "two of four"
    );
    assert_eq!(report("valid.vdb").sanitized_count, 0, "nothing to change");
}

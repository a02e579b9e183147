//! Every file of the matrix loads exactly as OpenVDB reads it, or is refused by name.
//!
//! The fixtures of this repository always run. The full matrix and the real volumes run where
//! `../shared` is present; further matrices where `MAJORANT_VDB_MATRIX` names a folder of files
//! with oracles.

#![expect(clippy::print_stdout, reason = "the table is for people")]

use std::path::{Path, PathBuf};

use crate::vdb_support::oracle::{Outcome, compare_file};
use crate::vdb_support::{in_crate, vdb_files};
use majorant::vdb::{Archive, GridInfo, LoadOptions};

/// Compares all files, prints the table and fails if anything is wrong.
fn compare_all(title: &str, files: &[PathBuf]) -> usize {
    let (mut exact, mut refused, mut wrong) = (0, 0, 0);
    for path in files {
        let file = path.file_name().unwrap_or_default().to_string_lossy();
        for (grid, outcome) in compare_file(path) {
            match outcome {
                Outcome::Exact => exact += 1,
                Outcome::Refused(reason) => {
                    refused += 1;
                    println!("  {file} {grid}: refused: {reason}");
                }
                Outcome::Wrong(what) => {
                    wrong += 1;
                    println!("  {file} {grid}: WRONG: {what}");
                }
            }
        }
    }
    println!(
        "{title}: {} files, exact {exact}, refused by name {refused}, wrong {wrong}",
        files.len()
    );
    assert_eq!(wrong, 0, "grids of {title} differ from OpenVDB's reading");
    exact + refused
}

#[test]
fn fixtures_are_exact() {
    let grids = compare_all("fixtures", &vdb_files("tests/fixtures/vdb"));
    assert!(grids >= 10, "the fixtures are part of the repository");
}

#[test]
fn full_matrix_is_exact_or_refused_by_name() {
    compare_all("matrix", &vdb_files("../shared/vdb-matrix"));
}

#[test]
fn further_matrix_is_exact_or_refused_by_name() {
    match std::env::var("MAJORANT_VDB_MATRIX") {
        Ok(folder) => {
            compare_all("further matrix", &vdb_files(&folder));
        }
        Err(_) => println!("skipped: MAJORANT_VDB_MATRIX names no folder"),
    }
}

/// One row of the table in the volumes' README, as OpenVDB described the file.
struct Row {
    file: String,
    grids: Vec<(String, String, [i32; 3], u64)>,
    format: String,
}

fn rows() -> Vec<Row> {
    let Ok(text) = std::fs::read_to_string(in_crate("../shared/volumes/README.md")) else {
        println!("skipped: ../shared/volumes is not here");
        return Vec::new();
    };
    let cells =
        |line: &str| -> Vec<String> { line.split('|').map(|c| c.trim().to_owned()).collect() };
    let rows = text
        .lines()
        .map(cells)
        .filter(|c| c.len() == 7 && is_vdb(&c[1]));
    rows.map(|c| Row {
        grids: c[3].split("; ").filter_map(parse_grid).collect(),
        file: c[1].clone(),
        format: c[5].clone(),
    })
    .collect()
}

fn is_vdb(name: &str) -> bool {
    Path::new(name).extension().is_some_and(|e| e == "vdb")
}

/// Parses `density float 52x52x59 77,249`.
fn parse_grid(text: &str) -> Option<(String, String, [i32; 3], u64)> {
    let words: Vec<_> = text.split(' ').collect();
    let [name, type_name, size, count] = words[..] else {
        return None;
    };
    let size: Vec<i32> = size.split('x').filter_map(|n| n.parse().ok()).collect();
    let count: String = count.chars().filter(char::is_ascii_digit).collect();
    Some((
        name.to_owned(),
        type_name.to_owned(),
        size.try_into().ok()?,
        count.parse().ok()?,
    ))
}

fn shape(info: &GridInfo) -> [i32; 3] {
    let size = info.index_bbox.map(|(min, max)| max - min + 1);
    size.map_or([0; 3], |s| s.to_array())
}

#[test]
fn real_volumes_match_their_table() {
    let (mut grids, mut refused) = (0, 0);
    let rows = rows();
    for row in &rows {
        let opened = Archive::open(&in_crate("../shared/volumes").join(&row.file));
        if row.grids.is_empty() {
            let error = opened
                .err()
                .unwrap_or_else(|| panic!("{} should be an error", row.file));
            println!("  {error}");
            refused += 1;
            continue;
        }
        let archive = opened.unwrap_or_else(|e| panic!("{e}"));
        assert!(
            row.format.contains(&format!("v{}", archive.version())),
            "version of {}",
            row.file
        );
        assert_eq!(
            archive.grids().len(),
            row.grids.len(),
            "grids of {}",
            row.file
        );
        for (name, type_name, size, count) in &row.grids {
            let i = archive.find(name).unwrap_or_else(|e| panic!("{e}"));
            let info = &archive.grids()[i];
            let what = format!("{} {name}", row.file);
            assert_eq!(&info.type_name, type_name, "{what}");
            assert_eq!(info.active_voxel_count, Some(*count), "{what}");
            assert_eq!(&shape(info), size, "{what}");
            assert!(
                row.format.contains(&format!("half={}", info.half)),
                "half of {what}"
            );
            assert!(
                row.format.contains(&info.codec),
                "codec {} of {what}",
                info.codec
            );
            archive
                .load(i, &LoadOptions::default())
                .unwrap_or_else(|e| panic!("{e}"));
            if info.background.len() == 1 {
                let density = archive.load_density(i, &LoadOptions::default());
                density.unwrap_or_else(|e| panic!("{e}"));
            }
            grids += 1;
        }
    }
    println!(
        "real volumes: {} files, exact {grids} grids, damaged {refused}, wrong 0",
        rows.len()
    );
}

//! `majorant info` and `majorant probe`, run as a program, against what OpenVDB reads.

use crate::support::{Folder, code, fixture, majorant, stderr, stdout};
use serde_json::{Value, json};

fn path(name: &str) -> String {
    fixture(name).display().to_string()
}

fn info(args: &[&str]) -> (i32, Value) {
    let run = majorant(&[&["info", "--json"][..], args].concat());
    let text = stdout(&run);
    let json = serde_json::from_str(&text).unwrap_or_else(|e| panic!("{e}: {text}"));
    (code(&run), json)
}

/// Returns the words behind `key` in the first lines of a fixture's oracle.
fn oracle(name: &str, key: &str) -> Vec<String> {
    let text = std::fs::read_to_string(path(&format!("{name}.oracle"))).expect("beside the file");
    let line = text
        .lines()
        .find(|l| l.split_whitespace().next() == Some(key));
    let line = line.unwrap_or_else(|| panic!("{key} in the oracle of {name}"));
    line.split_whitespace().skip(1).map(str::to_owned).collect()
}

#[test]
fn info_says_what_openvdb_says() {
    let name = "xf_affine.vdb";
    let (code, json) = info(&[&path(name)]);
    assert_eq!(code, 0);
    let file = &json["files"][0];
    assert_eq!(file["path"], path(name));
    assert_eq!(file["version"], 224);
    let grid = &file["grids"][0];
    assert_eq!(grid["name"], "density");
    assert_eq!(grid["type"], "float");
    assert_eq!(grid["class"], "fog volume");
    assert_eq!(
        (&grid["half"], &grid["renderable"]),
        (&json!(false), &json!(true))
    );
    assert_eq!(grid["refused"], Value::Null);
    assert_eq!(
        grid["active_voxel_count"].to_string(),
        oracle(name, "active")[0]
    );
    let bbox: Vec<i32> = oracle(name, "bbox")
        .iter()
        .map(|w| w.parse().unwrap())
        .collect();
    assert_eq!(grid["index_bbox"], json!([bbox[..3], bbox[3..]]));
    let sum: f64 = oracle(name, "sum")[0].parse().unwrap();
    assert!(
        (grid["sum"].as_f64().unwrap() / sum - 1.0).abs() < 1e-6,
        "{grid}"
    );
    // Column vectors: the oracle's map of the origin is the last column.
    let matrix = &grid["world_from_index"];
    let last: Vec<_> = (0..4).map(|row| matrix[row][3].as_f64().unwrap()).collect();
    assert_eq!(last, [1.0, 2.0, 3.0, 1.0]);
    assert!(grid["bytes_in_memory"].as_u64() > Some(100_000), "{grid}");
}

#[test]
fn refused_grids_are_listed_with_the_reason_and_unknowns_are_null() {
    let (code, json) = info(&[&path("mixed_bool_first.vdb")]);
    assert_eq!(code, 0, "a grid that cannot be rendered is no damage");
    let grids = json["files"][0]["grids"].as_array().unwrap();
    let refused = grids.iter().find(|g| g["type"] == "bool").unwrap();
    assert_eq!(refused["renderable"], false);
    assert!(
        refused["refused"].as_str().unwrap().contains("bool"),
        "{refused}"
    );
    for key in ["min", "max", "sum", "background"] {
        assert_eq!(refused[key], Value::Null, "{key}");
    }
    let good = grids.iter().find(|g| g["type"] == "float").unwrap();
    assert!(good["sum"].is_f64(), "{good}");
}

#[test]
fn quick_does_not_decode_but_knows_the_counts() {
    let (code, json) = info(&["--quick", &path("vec3s_only_zip.vdb")]);
    assert_eq!(code, 0);
    let grid = &json["files"][0]["grids"][0];
    assert_eq!((&grid["min"], &grid["sum"]), (&Value::Null, &Value::Null));
    assert!(grid["active_voxel_count"].is_u64(), "{grid}");
    assert_eq!(grid["renderable"], true, "a vector loads");
}

#[test]
fn vectors_have_arrays_and_floats_their_own_digits() {
    let (_, json) = info(&[&path("vec3s_only_zip.vdb")]);
    let grid = &json["files"][0]["grids"][0];
    assert_eq!(grid["sum"].as_array().unwrap().len(), 3);
    let (_, json) = info(&[&path("background_0.5_half_blosc.vdb")]);
    assert_eq!(json["files"][0]["grids"][0]["background"], 0.5);
    let (_, json) = info(&[&path("xf_affine.vdb")]);
    // An f32 needs at most nine digits; printed as f64 it would have seventeen.
    let max = json["files"][0]["grids"][0]["max"].to_string();
    assert!(max.len() <= 11, "{max}");
}

#[test]
fn info_goes_on_after_a_bad_file() {
    let folder = Folder::new();
    let bad = folder.write("bad.vdb", "not a volume");
    let (code, json) = info(&[&bad, &path("xf_affine.vdb")]);
    assert_eq!(code, 3);
    assert_eq!(json["files"].as_array().unwrap().len(), 1);
    let run = majorant(&["info", &bad, "nowhere.vdb", &path("xf_affine.vdb")]);
    assert_eq!(crate::support::code(&run), 3);
    assert!(stderr(&run).contains("bad.vdb") && stderr(&run).contains("nowhere.vdb"));
    assert!(
        stdout(&run).contains("density: float, fog volume"),
        "{}",
        stdout(&run)
    );
}

/// `at i j k active value` of an oracle whose values are scalars.
fn spots(name: &str) -> Vec<([i32; 3], bool, f64)> {
    let text = std::fs::read_to_string(path(&format!("{name}.oracle"))).expect("beside the file");
    let words = text.lines().filter_map(|l| l.strip_prefix("at "));
    let spot = |line: &str| {
        let w: Vec<f64> = line
            .split_whitespace()
            .map(|w| w.parse().expect("numbers"))
            .collect();
        #[expect(clippy::cast_possible_truncation, reason = "voxel indices")]
        let index = [w[0] as i32, w[1] as i32, w[2] as i32];
        (index, w[3] == 1.0, w[4])
    };
    words.map(spot).collect()
}

#[test]
fn probe_reads_what_openvdb_reads() {
    let name = "inactive_two_half_blosc.vdb";
    let folder = Folder::new();
    let spots = spots(name);
    assert!(spots.len() > 100, "{} spots", spots.len());
    let lines: Vec<_> = spots
        .iter()
        .map(|([i, j, k], ..)| format!("{i} {j}\t{k}"))
        .collect();
    let list = folder.write("at.txt", &format!("{}\n\n", lines.join("\n")));
    let run = majorant(&[
        "probe",
        &path(name),
        "--grid",
        "density",
        "--at-file",
        &list,
        "--json",
    ]);
    assert_eq!(code(&run), 0, "{}", stderr(&run));
    let found: Vec<Value> = serde_json::from_str(&stdout(&run)).expect("JSON");
    assert_eq!(found.len(), spots.len());
    for (got, (index, active, value)) in found.iter().zip(&spots) {
        assert_eq!(got["index"], json!(index));
        assert_eq!(got["active"], json!(active), "{got}");
        // Both print enough digits to tell any two f32 apart.
        #[expect(clippy::cast_possible_truncation, reason = "the grid holds f32")]
        let bits = |v: f64| (v as f32).to_bits();
        let v = got["value"].as_f64().unwrap();
        assert_eq!(bits(v), bits(*value), "{got}: {value}");
    }
}

#[test]
fn negative_voxels_and_points_parse_and_filtering_meets_voxels() {
    let args = [
        "probe",
        &path("xf_affine.vdb"),
        "--grid",
        "density",
        "--json",
    ];
    let run = majorant(
        &[
            &args[..],
            &["--at", "-1,2,3", "--at", "0,0,0", "--world", "1,2,3"],
        ]
        .concat(),
    );
    assert_eq!(code(&run), 0, "{}", stderr(&run));
    let found: Vec<Value> = serde_json::from_str(&stdout(&run)).expect("JSON");
    assert_eq!(found[0]["index"], json!([-1, 2, 3]));
    // World (1, 2, 3) is where this file's map puts voxel 0.
    let (voxel, point) = (
        found[1]["value"].as_f64().unwrap(),
        found[2]["value"].as_f64().unwrap(),
    );
    assert!(
        (voxel - point).abs() < 1e-6 * voxel.abs(),
        "{voxel} and {point}"
    );
    assert_eq!(found[2]["world"], json!([1.0, 2.0, 3.0]));
}

#[test]
fn probe_errors_have_their_codes() {
    let file = path("xf_affine.vdb");
    let run = majorant(&["probe", &file, "--grid", "dens", "--at", "0,0,0"]);
    assert_eq!(code(&run), 3);
    assert!(stderr(&run).contains("density"), "{}", stderr(&run));
    assert_eq!(
        code(&majorant(&["probe", &file, "--grid", "density"])),
        2,
        "nothing asked"
    );
    assert_eq!(
        code(&majorant(&[
            "probe", &file, "--grid", "density", "--at", "1,2"
        ])),
        2
    );
    let folder = Folder::new();
    let list = folder.write("at.txt", "1 2 3\n1 2\n");
    let run = majorant(&["probe", &file, "--grid", "density", "--at-file", &list]);
    assert_eq!(code(&run), 3);
    assert!(stderr(&run).contains("at.txt:2"), "{}", stderr(&run));
}

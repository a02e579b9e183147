//! `majorant converge`, run as a program: files, exit codes, interruption and resumption.

use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Duration;

use crate::support::{Folder, code, fixture, majorant, stderr};
use serde_json::Value;

const SETTINGS: [&str; 10] = [
    "--estimators",
    "auto,delta+ratio,regular+exact",
    "--budget",
    "1h",
    "--max-spp",
    "32",
    "--seeds",
    "3",
    "-j",
    "2",
];

/// A small scene of a fixture with a sun.
fn scene(folder: &Folder) -> String {
    let volume = fixture("xf_affine.vdb").display().to_string();
    let text = format!(
        "[image]\nresolution = [24, 16]\n[camera]\nposition = [10, -10, 3]\n\
         look_at = [1.0, 2.0, 3.0]\n[[volume]]\nfile = {volume:?}\n\
         [[light]]\ntype = \"constant\"\nradiance = [1, 2, 4]\n\
         [[light]]\ntype = \"distant\"\ndirection_to_light = [1, -1, 1]\nirradiance = [3, 3, 3]\n\
         [render]\nseed = 3\n"
    );
    folder.write("scene.toml", &text)
}

fn arguments<'a>(scene: &'a str, output: &'a str, more: &[&'a str]) -> Vec<&'a str> {
    let head = ["converge", scene, "-o", output];
    [&head[..], &SETTINGS, more].concat()
}

fn results(output: &str) -> Value {
    let path = Path::new(output).join("results.json");
    let text = std::fs::read_to_string(path).expect("written");
    serde_json::from_str(&text).expect("JSON")
}

/// Removes what may differ between two runs.
fn without_timing(mut value: Value) -> Value {
    match &mut value {
        Value::Object(fields) => {
            fields.remove("timing");
            for field in fields.values_mut() {
                *field = without_timing(field.take());
            }
        }
        Value::Array(items) => {
            for item in items {
                *item = without_timing(item.take());
            }
        }
        _ => {}
    }
    value
}

#[test]
fn a_comparison_becomes_json_csv_and_one_page() {
    let folder = Folder::new();
    let (scene, output) = (scene(&folder), folder.path("out"));
    let run = majorant(&arguments(&scene, &output, &["--target", "0.02"]));
    assert_eq!(code(&run), 0, "{}", stderr(&run));
    let found = results(&output);
    assert_eq!(found["complete"], true);
    assert_eq!(found["target_rel_mse"], 0.02);
    let names: Vec<_> = (0..3)
        .map(|i| found["estimators"][i]["name"].clone())
        .collect();
    assert_eq!(names, ["auto", "delta+ratio", "regular+exact"]);
    // Each is compared with what it is not.
    let reference = |i: usize| {
        let index = found["estimators"][i]["reference"]
            .as_u64()
            .expect("an index");
        usize::try_from(index).map(|i| found["references"][i]["source"].clone())
    };
    assert_eq!(reference(1).expect("small"), "regular+exact");
    assert_eq!(reference(2).expect("small"), "delta+ratio");
    for i in 0..3 {
        let e = &found["estimators"][i];
        let points = e["points"].as_array().expect("points");
        let spp: Vec<_> = points.iter().map(|p| p["spp"].as_u64()).collect();
        assert_eq!(spp, [1, 2, 4, 8, 16, 32].map(Some));
        assert!(points[0]["rel_mse"]["mean"].as_f64() > points[5]["rel_mse"]["mean"].as_f64());
        assert!(points[0]["timing"]["cpu"].is_f64(), "{e}");
        assert!(
            points[0]["flip"].is_f64() && points[0]["values_read"].is_f64(),
            "{e}"
        );
        assert!(e["timing"]["efficiency"]["interval"]["low"].is_f64(), "{e}");
        assert!(e["efficiency_by_values_read"]["value"].is_f64(), "{e}");
        assert_eq!(e["bias"]["verdict"], "unbiased", "{e}");
        assert_eq!(e["counts"]["bound_violations"], 0);
    }
    let csv = std::fs::read_to_string(Path::new(&output).join("results.csv")).expect("written");
    let columns: Vec<_> = csv.lines().map(|line| line.split(',').count()).collect();
    assert_eq!(columns, [13; 19], "a header and 3 times 6 points");
    let page = std::fs::read_to_string(Path::new(&output).join("report.html")).expect("written");
    assert!(page.starts_with("<!doctype html>") && page.ends_with("</html>\n"));
    for foreign in ["http:", "https:", "<script", "<link", "@import", "NaN"] {
        assert!(!page.contains(foreign), "{foreign}");
    }
    assert_eq!(page.matches("<svg class=\"plot\"").count(), 3);
    // The reference, and four pictures of each estimator.
    assert_eq!(page.matches("data:image/png;base64,").count(), 1 + 4 * 3);

    // The reference serves another run, which finds no bias against it either.
    let reference = folder.path("out/reference-1.exr");
    let again = folder.path("again");
    let more = ["--reference", &*reference, "-r", "24x16"];
    let run = majorant(&arguments(&scene, &again, &more));
    assert_eq!(code(&run), 0, "{}", stderr(&run));
    let given = results(&again);
    assert_eq!(given["references"][0]["noise_known"], true);
    let (a, b) = (&given["references"][0], &found["references"][0]);
    let close =
        a["rel_mse_noise"].as_f64().expect("known") / b["rel_mse_noise"].as_f64().expect("known");
    assert!(
        (close - 1.0).abs() < 1e-5,
        "floats instead of doubles: {close}"
    );
    assert_eq!(given["estimators"][1]["bias"]["verdict"], "unbiased");
}

/// Kills the program again and again, each time after another while, until it ends by itself.
/// Whenever that happens, the results are those of a run that nothing disturbed.
#[cfg(unix)]
#[test]
fn a_run_that_is_killed_goes_on_as_if_nothing_had_happened() {
    let folder = Folder::new();
    let scene = scene(&folder);
    let (whole, killed) = (folder.path("whole"), folder.path("killed"));
    let run = majorant(&arguments(&scene, &whole, &[]));
    assert_eq!(code(&run), 0, "{}", stderr(&run));
    for attempt in 0..12_u64 {
        let mut child = Command::new(assert_cmd::cargo::cargo_bin("majorant"))
            .args(arguments(&scene, &killed, &["--resume"]))
            .stderr(Stdio::null())
            .spawn()
            .expect("the program starts");
        std::thread::sleep(Duration::from_millis(30 + attempt * 97 % 211));
        child.kill().expect("SIGKILL can be sent");
        child.wait().expect("it ended");
    }
    let run = majorant(&arguments(&scene, &killed, &["--resume"]));
    assert_eq!(code(&run), 0, "{}", stderr(&run));
    assert_eq!(
        without_timing(results(&killed)),
        without_timing(results(&whole))
    );
    let left = std::fs::read_dir(Path::new(&killed).join("checkpoint")).expect("listed");
    let left: Vec<_> = left.map(|e| e.expect("listed").file_name()).collect();
    assert_eq!(left.len(), 5, "two references, three estimators: {left:?}");
    // Nothing is left to do: the same again, at once.
    let before = std::fs::read_to_string(folder.path("killed/results.csv")).expect("written");
    let run = majorant(&arguments(&scene, &killed, &["--resume"]));
    assert_eq!(code(&run), 0, "{}", stderr(&run));
    let after = std::fs::read_to_string(folder.path("killed/results.csv")).expect("written");
    assert_eq!(before, after, "times included");
}

/// SIGINT ends the program with 130 and whatever results there are, or it comes too late.
#[cfg(unix)]
#[test]
fn an_interrupted_run_writes_what_it_has() {
    let folder = Folder::new();
    let (scene, output) = (scene(&folder), folder.path("out"));
    let mut arguments = arguments(&scene, &output, &["--reference-budget", "1s"]);
    // Long enough that it is certainly interrupted.
    let spp = arguments
        .iter()
        .position(|a| *a == "--max-spp")
        .expect("given");
    arguments[spp + 1] = "16777216";
    let child = Command::new(assert_cmd::cargo::cargo_bin("majorant"))
        .args(&arguments)
        .stderr(Stdio::piped())
        .spawn()
        .expect("the program starts");
    // Until the first estimator has a checkpoint, at most a minute.
    let checkpoint = Path::new(&output).join("checkpoint/regular+exact.ckpt");
    for _ in 0..6000 {
        if checkpoint.exists() {
            break;
        }
        std::thread::sleep(Duration::from_millis(10));
    }
    std::thread::sleep(Duration::from_millis(300));
    let interrupt = Command::new("kill")
        .args(["-INT", &child.id().to_string()])
        .status();
    assert!(interrupt.expect("kill is there").success());
    let run = child.wait_with_output().expect("it ended");
    assert_eq!(run.status.code(), Some(130), "{}", stderr(&run));
    assert!(
        stderr(&run).contains("--resume goes on"),
        "{}",
        stderr(&run)
    );
    let found = results(&output);
    assert_eq!(found["complete"], false);
    assert!(found["estimators"][0]["points"][0]["spp"] == 1, "{found}");
    assert!(Path::new(&output).join("report.html").exists());
}

#[test]
fn another_run_is_not_mixed_in() {
    let folder = Folder::new();
    let (scene, output) = (scene(&folder), folder.path("out"));
    let short = [
        "-e",
        "auto",
        "--max-spp",
        "2",
        "--seeds",
        "2",
        "-o",
        &output,
    ];
    let with = |more: &[&str]| majorant(&[&["converge", &scene][..], &short, more].concat());
    assert_eq!(code(&with(&[])), 0);
    let run = with(&[]);
    assert_eq!(code(&run), 2);
    assert!(
        stderr(&run).contains("holds an earlier run: add --resume"),
        "{}",
        stderr(&run)
    );
    let run = with(&["--resume", "-r", "12x8"]);
    assert_eq!(code(&run), 3);
    let said = stderr(&run);
    assert!(
        said.contains("measured with resolution 24x16, now resolution 12x8"),
        "{said}"
    );
    let text = std::fs::read_to_string(&scene).expect("written");
    folder.write("scene.toml", &text.replace("[1, 2, 4]", "[1, 2, 5]"));
    let run = with(&["--resume"]);
    assert_eq!(code(&run), 3);
    assert!(
        stderr(&run).contains("measured with scene "),
        "{}",
        stderr(&run)
    );
    folder.write("scene.toml", &text);
    let checkpoint = folder.path("out/checkpoint/auto.ckpt");
    std::fs::write(&checkpoint, "x").expect("written");
    let run = with(&["--resume"]);
    assert_eq!(code(&run), 3);
    assert!(
        stderr(&run).contains("auto.ckpt: damaged"),
        "{}",
        stderr(&run)
    );
}

#[test]
fn mistakes_are_told_before_anything_is_rendered() {
    let folder = Folder::new();
    let scene = scene(&folder);
    let output = folder.path("out");
    for (wrong, expected) in [
        (&["-e", "delta+rato"][..], "did you mean \"ratio\"?"),
        (&["-e", "analog"], "zero diameter"),
        (&["--budget", "soon"], "such as 90s"),
        (&["--seeds", "0"], "0"),
        (&["--target=-1"], "above 0"),
    ] {
        let run = majorant(&[&["converge", &scene, "-o", &output][..], wrong].concat());
        assert_eq!(code(&run), 2, "{wrong:?}: {}", stderr(&run));
        assert!(stderr(&run).contains(expected), "{}", stderr(&run));
    }
    let volume = fixture("xf_affine.vdb").display().to_string();
    let run = majorant(&["converge", &volume]);
    assert_eq!(code(&run), 2);
    assert!(stderr(&run).contains("--print-scene"), "{}", stderr(&run));
    let gone = folder.path("gone.exr");
    let run = majorant(&["converge", &scene, "-o", &output, "--reference", &gone]);
    assert_eq!(code(&run), 3, "{}", stderr(&run));
    assert!(
        stderr(&run).contains("gone.exr: cannot read the image"),
        "{}",
        stderr(&run)
    );
}

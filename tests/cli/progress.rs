//! What `majorant render` says while it renders, to people, farms and files; and the commands
//! around it: compare, completions, man.

use std::process::Command;

use crate::support::{Folder, code, fixture, majorant, stderr, stdout};

/// A scene that takes a moment: `spp` samples of 24 by 18 pixels.
fn scene(folder: &Folder, spp: u32) -> String {
    let volume = fixture("xf_affine.vdb").display().to_string();
    let text = format!(
        "[image]\nresolution = [24, 18]\n[camera]\nposition = [10, -10, 3]\n\
         look_at = [1.0, 2.0, 3.0]\n[[volume]]\nfile = {volume:?}\n\
         [[light]]\ntype = \"constant\"\nradiance = [1, 2, 4]\n[render]\nspp = {spp}\n"
    );
    folder.write("scene.toml", &text)
}

/// Returns what stdout says of three frames.
fn progress(form: &str) -> String {
    let folder = Folder::new();
    let (scene, out) = (scene(&folder, 3_000), folder.path("a.####.exr"));
    let args = [
        "render",
        &scene,
        "-f",
        "1-3",
        "-o",
        &out,
        "--progress",
        form,
        "-q",
    ];
    let run = majorant(&args);
    assert_eq!(code(&run), 0, "{}", stderr(&run));
    stdout(&run)
}

fn assert_rises_to_100(percents: &[f64]) {
    assert!(
        percents.len() >= 3,
        "at least the end of each frame: {percents:?}"
    );
    // Threads may overtake each other by a tile.
    assert!(
        percents.windows(2).all(|w| w[1] > w[0] - 1.0),
        "{percents:?}"
    );
    assert_eq!(percents.last(), Some(&100.0), "{percents:?}");
    assert!(
        percents[0] >= 0.0 && percents.iter().all(|&p| p <= 100.0),
        "{percents:?}"
    );
}

#[test]
fn alfred_reads_percents() {
    let percents: Vec<f64> = progress("alf")
        .lines()
        .map(|line| {
            let percent = line
                .strip_prefix("ALF_PROGRESS ")
                .and_then(|l| l.strip_suffix('%'));
            percent
                .and_then(|p| p.parse().ok())
                .unwrap_or_else(|| panic!("{line:?}"))
        })
        .collect();
    assert_rises_to_100(&percents);
}

#[test]
fn open_job_description_reads_progress_and_status() {
    let text = progress("openjd");
    let numbers = text
        .lines()
        .filter_map(|l| l.strip_prefix("openjd_progress: "));
    let percents: Vec<f64> = numbers.map(|n| n.parse().expect("a number")).collect();
    assert_rises_to_100(&percents);
    let status: Vec<_> = text
        .lines()
        .filter_map(|l| l.strip_prefix("openjd_status: "))
        .collect();
    assert_eq!(status.len(), 3, "{text}");
    assert_eq!(status[1], "frame 2 (2 of 3): rendering");
    let folder = Folder::new();
    let gone = folder.path("gone.toml");
    let run = majorant(&["render", &gone, "--progress", "openjd"]);
    assert_eq!(code(&run), 3);
    assert!(stdout(&run).starts_with("openjd_fail: ") && stdout(&run).contains("gone.toml"));
}

#[test]
fn scripts_read_json() {
    let text = progress("json");
    let events: Vec<serde_json::Value> = text
        .lines()
        .map(|line| serde_json::from_str(line).expect("an object a line"))
        .collect();
    let of = |kind: &str| {
        events
            .iter()
            .filter(|e| e["event"] == kind)
            .collect::<Vec<_>>()
    };
    let percents: Vec<f64> = of("progress")
        .iter()
        .filter_map(|e| e["percent"].as_f64())
        .collect();
    assert_rises_to_100(&percents);
    assert_eq!(of("frame").len(), 3);
    assert_eq!(of("end").len(), 1);
    assert!(of("end")[0]["failure"].is_null());
    assert_eq!(of("progress")[0]["samples_total"], 24 * 18 * 3_000);
}

#[test]
fn a_pipe_gets_plain_lines_and_a_terminal_a_bar() {
    let folder = Folder::new();
    let (scene, out) = (scene(&folder, 40_000), folder.path("a.exr"));
    let run = majorant(&["render", &scene, "-o", &out, "-j", "1"]);
    let said = stderr(&run);
    assert!(!said.contains('\x1b'), "no escape codes: {said:?}");
    assert!(said.contains(" % in "), "{said}");
    assert!(said.contains("rendered in"), "{said}");
    let program = env!("CARGO_BIN_EXE_majorant");
    let line = format!("'{program}' render '{scene}' -o '{out}' -j 1");
    let run = |no_color: Option<&str>| {
        let mut script = Command::new("script");
        script
            .args(["-qec", &line, "/dev/null"])
            .env_remove("NO_COLOR")
            .env("TERM", "xterm");
        if let Some(value) = no_color {
            script.env("NO_COLOR", value);
        }
        script.output()
    };
    let Ok(on_terminal) = run(None) else {
        return skip("no script, which makes a terminal");
    };
    let said = String::from_utf8_lossy(&on_terminal.stdout).into_owned();
    assert!(
        said.contains("rendering") && said.contains("samples"),
        "a bar: {said:?}"
    );
    assert!(said.contains('\x1b'), "that is redrawn in place: {said:?}");
    let gone = folder.path("gone.toml");
    let line = format!("'{program}' render '{gone}'");
    for (no_color, coloured) in [(None, true), (Some("1"), false)] {
        let mut script = Command::new("script");
        script
            .args(["-qec", &line, "/dev/null"])
            .env_remove("NO_COLOR")
            .env("TERM", "xterm");
        if let Some(value) = no_color {
            script.env("NO_COLOR", value);
        }
        let said = script.output().expect("ran above").stdout;
        let said = String::from_utf8_lossy(&said).into_owned();
        assert_eq!(said.contains("\x1b[1;31m"), coloured, "{said:?}");
    }
}

#[expect(clippy::print_stderr, reason = "says why nothing was tested")]
fn skip(why: &str) {
    eprintln!("skipped: {why}");
}

#[test]
fn messages_go_to_a_file_as_well() {
    let folder = Folder::new();
    let (scene, out) = (scene(&folder, 2), folder.path("a.exr"));
    let log = folder.path("log.txt");
    let run = majorant(&["render", &scene, "-o", &out, "-q", "--log-file", &log]);
    assert_eq!((code(&run), stderr(&run).as_str()), (0, ""));
    let text = std::fs::read_to_string(&log).expect("written");
    assert!(
        text.contains("rendered in") && !text.contains('\x1b'),
        "{text}"
    );
    let json = folder.path("log.json");
    let args = [
        "render",
        &scene,
        "-o",
        &out,
        "-v",
        "--log-file",
        &json,
        "--log-format",
        "json",
    ];
    assert_eq!(code(&majorant(&args)), 0);
    let text = std::fs::read_to_string(&json).expect("written");
    let lines: Vec<serde_json::Value> = text
        .lines()
        .map(|line| serde_json::from_str(line).expect("an object a line"))
        .collect();
    assert!(lines.len() > 3, "{text}");
    assert!(
        lines
            .iter()
            .all(|l| l["timestamp"].is_string() && l["level"].is_string()),
        "{text}"
    );
    let run = majorant(&["render", &scene, "--log-format", "json"]);
    assert_eq!(code(&run), 2, "a form of no file");
}

#[test]
fn a_preview_is_rewritten_while_the_image_converges() {
    let folder = Folder::new();
    let (scene, out) = (scene(&folder, 400_000), folder.path("a.exr"));
    let args = [
        "render",
        &scene,
        "-o",
        &out,
        "--preview-png",
        "--preview-every",
        "0.01",
        "--time-limit",
        "4",
    ];
    let run = majorant(&args);
    assert!([0, 75].contains(&code(&run)), "{}", stderr(&run));
    assert!(
        std::path::Path::new(&folder.path("a.png")).exists(),
        "before the end"
    );
}

#[test]
fn images_are_compared_by_error_and_by_noise() {
    let folder = Folder::new();
    let scene = scene(&folder, 64);
    let render = |name: &str, more: &[&str]| {
        let out = folder.path(name);
        let base = ["render", &scene, "-o", &out, "--sampler", "independent"];
        let run = majorant(&[&base[..], more].concat());
        assert_eq!(code(&run), 0, "{}", stderr(&run));
        out
    };
    let a = render("a.exr", &[]);
    let b = render("b.exr", &["--seed", "1"]);
    let bright = render(
        "c.exr",
        &["--seed", "2", "--set", "light.0.radiance=[1.1,2.2,4.4]"],
    );
    let small = render("d.exr", &["-r", "12x9"]);
    let compare = |x: &str, r: &str| -> serde_json::Value {
        let run = majorant(&["compare", x, r, "--json"]);
        assert_eq!(code(&run), 0, "{}", stderr(&run));
        serde_json::from_str(&stdout(&run)).expect("JSON")
    };
    let number = |v: &serde_json::Value| v.as_f64().expect("a number");
    let same = compare(&a, &a);
    assert_eq!((number(&same["rmse"]), number(&same["flip"])), (0.0, 0.0));
    // Some hundred pixels of little noise, rounded to halves: z has a deviation of about 1, and the
    // image's mean is within 5.
    let noise = compare(&a, &b);
    let z = &noise["z"];
    assert!(
        (0.5..1.5).contains(&number(&z["standard_deviation"])),
        "{noise}"
    );
    assert!(number(&z["of_image_mean"]).abs() < 5.0, "{noise}");
    assert!(
        number(&noise["rmse"]) > 0.0 && number(&noise["rel_mse"]) > 0.0,
        "{noise}"
    );
    // A tenth brighter is no noise.
    let biased = compare(&bright, &b);
    assert!(number(&biased["z"]["of_image_mean"]) > 20.0, "{biased}");
    assert!(
        number(&biased["flip"]) > number(&noise["flip"]),
        "{biased} {noise}"
    );
    let picture = folder.path("d.png");
    let run = majorant(&["compare", &bright, &b, "-d", &picture]);
    assert!(stdout(&run).contains("relMSE"), "{}", stdout(&run));
    assert!(
        std::path::Path::new(&picture).exists(),
        "the picture is there"
    );
    let run = majorant(&["compare", &a, &small]);
    assert_eq!(code(&run), 3);
    assert!(stderr(&run).contains("12 by 9"), "{}", stderr(&run));
}

#[test]
fn shells_and_manuals_know_all_commands() {
    let folder = Folder::new();
    for shell in ["bash", "zsh", "fish"] {
        let run = majorant(&["completions", shell]);
        let script = stdout(&run);
        assert!(
            script.contains("skip-existing") && script.contains("farm"),
            "{shell}"
        );
    }
    let man = folder.path("man");
    assert_eq!(code(&majorant(&["man", "--dir", &man])), 0);
    let page = std::fs::read_to_string(format!("{man}/majorant-render.1")).expect("written");
    assert!(page.contains("\\-\\-skip\\-existing"), "{page}");
    assert!(stdout(&majorant(&["man"])).starts_with(".ie"), "roff");
}

/// A trace is JSON, has every kind of span, and those of each worker do not overlap.
#[test]
fn a_trace_shows_what_ran_when() {
    let folder = Folder::new();
    let (scene, out) = (scene(&folder, 500), folder.path("a.####.exr"));
    let trace = folder.path("trace.json");
    let args = [
        "render", &scene, "-f", "1-2", "-o", &out, "--trace", &trace, "-r", "64x48",
    ];
    let run = majorant(&args);
    assert_eq!(code(&run), 0, "{}", stderr(&run));
    let text = std::fs::read_to_string(&trace).expect("written");
    let trace: serde_json::Value = serde_json::from_str(&text).expect("JSON");
    let events = trace["traceEvents"].as_array().expect("a list");
    let named = |name: &str| {
        let is = |e: &&serde_json::Value| e["name"].as_str().is_some_and(|n| n.starts_with(name));
        events.iter().filter(is).count()
    };
    let kinds = [
        "frame ",
        "load frame ",
        "read",
        "decode",
        "build",
        "prepare",
        "write",
    ];
    for name in kinds {
        assert!(named(name) >= 1, "{name} in {text}");
    }
    assert_eq!((named("frame "), named("write")), (2, 2));
    // 4 by 3 tiles, each in every pass.
    assert_eq!(named("tile"), 12 * named("pass to sample "));
    let mut tiles: Vec<(u64, f64, f64)> = events
        .iter()
        .filter(|e| e["name"] == "tile")
        .map(|e| {
            let number = |key: &str| e[key].as_f64().expect("a number");
            (
                e["tid"].as_u64().expect("a number"),
                number("ts"),
                number("dur"),
            )
        })
        .collect();
    tiles.sort_by(|a, b| a.partial_cmp(b).expect("numbers"));
    let overlap = |w: &[(u64, f64, f64)]| w[0].0 == w[1].0 && w[0].1 + w[0].2 > w[1].1 + 1e-3;
    assert!(!tiles.windows(2).any(overlap), "{tiles:?}");
}

/// What `-h` prints of every command fits on a screen of 100 columns.
#[test]
fn help_is_narrow_and_has_examples() {
    for command in [
        "render", "merge", "farm", "compare", "converge", "cache", "info", "probe",
    ] {
        let help = stdout(&majorant(&[command, "--help"]));
        assert!(help.contains("Example"), "{command}");
        for line in help.lines() {
            assert!(line.chars().count() <= 100, "{command}: {line}");
        }
    }
}

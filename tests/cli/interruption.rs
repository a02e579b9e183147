//! What stops a render, and what goes on where it was stopped: signals, time limits, kills; noise limits.

use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use crate::sequence::{FRAMES, Sequence};
use crate::support::{attribute, code, majorant, pixels, stderr};

/// A noise limit takes as many samples as it needs, the two halves of the pixels each their own
/// number, and reaches about the error asked for; interrupted, it ends with the same bits.
#[test]
fn a_noise_limit_is_reached() {
    let s = Sequence::new(4_096);
    let (out, again) = (s.folder.path("a.exr"), s.folder.path("b.exr"));
    let base = [
        "render",
        &s.scene,
        "-f",
        "24",
        "--noise-limit",
        "0.001",
        "-j",
        "1",
    ];
    let limit = |out: &str, more: &[&str]| majorant(&[&base[..], &["-o", out], more].concat());
    let run = limit(&out, &[]);
    assert_eq!(code(&run), 0, "{}", stderr(&run));
    let all = pixels(&out);
    let channel = |name: &str| -> Vec<f32> {
        let (_, bits) = all.iter().find(|(n, _)| n == name).expect("a channel");
        bits.iter().map(|&b| f32::from_bits(b)).collect()
    };
    let mut counts = channel("sampleCount");
    counts.sort_by(f32::total_cmp);
    counts.dedup();
    // The pilot takes 4096 / 16 samples.
    assert!((1..=2).contains(&counts.len()), "{counts:?}");
    assert!(
        counts[0] >= 256.0 && counts[counts.len() - 1] < 4096.0,
        "{counts:?}"
    );
    let (mut sum, mut n) = (0.0, 0.0);
    for c in ["R", "G", "B"] {
        let variance = channel(&format!("variance.{c}"));
        for (v, x) in variance.iter().zip(channel(c)).filter(|(v, _)| **v > 0.0) {
            sum += f64::from(v / (x * x + 0.01));
            n += 1.0;
        }
    }
    // The error of pixels that may see the volume, here those that do.
    let error = (sum / n).sqrt();
    assert!((0.0005..0.0025).contains(&error), "{error}");
    let mut stops = 0;
    for _ in 0..100 {
        let run = limit(&again, &["--resume", "--time-limit", "0.05"]);
        match code(&run) {
            75 => stops += 1,
            _ => break,
        }
    }
    assert!(stops > 0, "never stopped");
    assert_eq!(pixels(&again), all, "stopped {stops} times");
}

/// Starts the program; what it says goes nowhere.
fn start(args: &[String]) -> std::process::Child {
    Command::new(assert_cmd::cargo::cargo_bin("majorant"))
        .args(args)
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .expect("started")
}

/// Waits until `path` exists, or the child ends.
fn wait_for(path: &str, child: &mut std::process::Child) {
    let begin = Instant::now();
    while !Path::new(path).exists() && begin.elapsed() < Duration::from_mins(1) {
        if child.try_wait().expect("a child").is_some() {
            return;
        }
        std::thread::sleep(Duration::from_millis(2));
    }
}

#[cfg(unix)]
fn signal(child: &std::process::Child, name: &str) {
    let pid = child.id().to_string();
    let status = Command::new("kill").args([name, &pid]).status();
    assert!(status.expect("kill runs").success(), "the child is there");
}

/// TERM ends a frame with a checkpoint and code 75; the same command with `--resume` goes on to
/// the bits of an undisturbed run, its counts included.
#[cfg(unix)]
#[test]
fn an_interrupted_frame_goes_on_to_the_same_bits() {
    let s = Sequence::new(30_000);
    let whole = s.folder.path("whole.exr");
    let part = s.folder.path("part.exr");
    let args = |out: &str| -> Vec<String> {
        [
            "render",
            &s.scene,
            "-f",
            "22",
            "-o",
            out,
            "--resume",
            "--checkpoint",
            "0.001",
        ]
        .map(str::to_owned)
        .to_vec()
    };
    let run_whole = args(&whole);
    let run = majorant(&run_whole.iter().map(String::as_str).collect::<Vec<_>>());
    assert_eq!(code(&run), 0, "{}", stderr(&run));
    let checkpoint = format!("{part}.checkpoint");
    let mut stops = 0;
    for _ in 0..5 {
        let mut child = start(&args(&part));
        wait_for(&checkpoint, &mut child);
        std::thread::sleep(Duration::from_millis(120));
        if child.try_wait().expect("a child").is_none() {
            signal(&child, "-TERM");
        }
        match child.wait().expect("a child").code() {
            Some(75) => stops += 1,
            Some(0) => break,
            other => panic!("ended with {other:?}"),
        }
        assert!(Path::new(&checkpoint).exists(), "a checkpoint is written");
        assert!(!Path::new(&part).exists(), "no image yet");
    }
    let run_part = args(&part);
    let run = majorant(&run_part.iter().map(String::as_str).collect::<Vec<_>>());
    assert_eq!(code(&run), 0, "{}", stderr(&run));
    assert!(
        stops > 0,
        "the run was never interrupted: give it more samples"
    );
    assert_eq!(pixels(&part), pixels(&whole));
    assert!(!Path::new(&checkpoint).exists(), "removed at the end");
    let counts = |path: &str| {
        let stats: serde_json::Value =
            serde_json::from_str(&attribute(path, "majorant/stats")).expect("JSON");
        stats["counts"].clone()
    };
    assert_eq!(counts(&part), counts(&whole), "what rays did, too");
}

/// A time limit is an interruption; a checkpoint of another scene, or a damaged one, is not gone on
/// with.
#[test]
fn a_time_limit_stops_and_foreign_checkpoints_are_left_alone() {
    // More than a minute's work: no machine is done within the limit.
    let s = Sequence::new(2_000_000);
    let out = s.folder.path("a.exr");
    let base = ["render", &s.scene, "-f", "21", "-o", &out, "--resume"];
    let run = majorant(&[&base[..], &["--time-limit", "0.3"]].concat());
    assert_eq!(code(&run), 75, "{}", stderr(&run));
    assert!(
        stderr(&run).contains("the time limit is reached"),
        "{}",
        stderr(&run)
    );
    let checkpoint = format!("{out}.checkpoint");
    let bytes = std::fs::read(&checkpoint).expect("a checkpoint");
    let few = ["--spp", "3"];
    let fresh = s.folder.path("fresh.exr");
    let args = ["render", &s.scene, "-f", "21", "-o", &fresh, "--spp", "3"];
    assert_eq!(code(&majorant(&args)), 0);
    let other = ["--set", "light.0.radiance=[9,9,9]"];
    for (bytes, more, same) in [
        (&bytes[..bytes.len() / 2], &few[..], true),
        (b"nonsense", &few, true),
        // More samples than are asked for now.
        (&bytes, &few, true),
        (&bytes, &[&few[..], &other].concat(), false),
    ] {
        std::fs::write(&checkpoint, bytes).expect("written");
        let run = majorant(&[&base[..], more].concat());
        assert_eq!(code(&run), 0, "{}", stderr(&run));
        assert!(stderr(&run).contains("begins anew"), "{}", stderr(&run));
        assert_eq!(pixels(&out) == pixels(&fresh), same, "{more:?}");
    }
}

/// USR1 writes what there is, and the frame goes on.
#[cfg(unix)]
#[test]
fn a_snapshot_is_written_on_request() {
    let s = Sequence::new(20_000);
    let out = s.folder.path("a.exr");
    let args = [
        "render",
        &s.scene,
        "-f",
        "20",
        "-o",
        &out,
        "--checkpoint",
        "0.001",
    ];
    let args: Vec<String> = args.map(str::to_owned).to_vec();
    let mut child = start(&args);
    wait_for(&format!("{out}.checkpoint"), &mut child);
    signal(&child, "-USR1");
    assert_eq!(child.wait().expect("a child").code(), Some(0));
    let snapshot = s.folder.path("a.snapshot.exr");
    let range = attribute(&snapshot, "majorant/sampleRange");
    assert!(range != "0..20000", "of a part of the samples: {range}");
    assert_eq!(pixels(&snapshot).len(), pixels(&out).len());
}

/// Killed at 20 moments, spread over the time that an undisturbed run takes, and started again by
/// the same command line: the frames are the same bits, what is there under an image's name is
/// always whole, and finished frames are not rendered again.
#[cfg(unix)]
#[test]
fn a_batch_survives_being_killed() {
    let s = Sequence::new(4_000);
    let more = ["--skip-existing", "--resume", "--checkpoint", "0.05"];
    let begin = Instant::now();
    assert_eq!(code(&s.render("undisturbed", &more)), 0);
    let took = begin.elapsed();
    let mut args = s.args("killed");
    args.extend(more.map(str::to_owned));
    let mut finished: Vec<Option<std::time::SystemTime>> = vec![None; FRAMES.len()];
    let mut kills = 0;
    for i in 0..60_u32 {
        let mut child = start(&args);
        // A multiple of the golden ratio: moments that fill the time evenly, in no order.
        let part = (f64::from(i) * 0.618_034).fract();
        std::thread::sleep(took.mul_f64(0.05 + 0.4 * part));
        let ended = child.try_wait().expect("a child").is_some();
        if !ended {
            child.kill().expect("SIGKILL");
            kills += 1;
        }
        child.wait().expect("a child");
        for (frame, finished) in FRAMES.iter().zip(&mut finished) {
            let image = s.image("killed", *frame);
            if Path::new(&image).exists() {
                let same = pixels(&image) == pixels(&s.image("undisturbed", *frame));
                assert!(same, "frame {frame} after {kills} kills");
                let date = std::fs::metadata(&image).and_then(|m| m.modified()).ok();
                assert_eq!(
                    *finished.get_or_insert(date.expect("a date")),
                    date.expect("a date")
                );
            }
        }
        if ended || kills >= 20 {
            break;
        }
    }
    let run = s.render("killed", &more);
    assert_eq!(code(&run), 0, "{}", stderr(&run));
    for frame in FRAMES {
        let same = pixels(&s.image("killed", frame)) == pixels(&s.image("undisturbed", frame));
        assert!(same, "frame {frame} after {kills} kills");
    }
    assert!(kills >= 3, "killed {kills} times only");
}

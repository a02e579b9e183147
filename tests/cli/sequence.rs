//! `majorant render` of sequences, run as a program: which frames come out, whatever happens.

use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use crate::support::{Folder, code, fixture, majorant, stderr, stdout};

/// A sequence of five frames, 20 to 24: links to one small volume, with a camera that moves.
struct Sequence {
    folder: Folder,
    scene: String,
}

const FRAMES: [i32; 5] = [20, 21, 22, 23, 24];

impl Sequence {
    fn new(spp: u32) -> Self {
        let folder = Folder::new();
        for frame in FRAMES {
            let file = folder.path(&format!("v_{frame:04}.vdb"));
            std::fs::copy(fixture("xf_affine.vdb"), file).expect("copied");
        }
        let text = format!(
            "[image]\nresolution = [24, 18]\n[camera]\n\
             position = {{ keys = {{ 20 = [10, -10, 3], 24 = [8, -11, 3] }} }}\n\
             look_at = [1.0, 2.0, 3.0]\n[[volume]]\nfile = \"v_####.vdb\"\n\
             density.scale = {{ keys = {{ 20 = 1, 24 = 5.0 }}, interpolation = \"smooth\" }}\n\
             [[light]]\ntype = \"constant\"\nradiance = [1, 2, 4]\n\
             [[light]]\ntype = \"distant\"\ndirection_to_light = [1, 0, 1]\nirradiance = [1, 1, 1]\n\
             [render]\nspp = {spp}\n"
        );
        let scene = folder.write("scene.toml", &text);
        Self { folder, scene }
    }

    fn volume(&self, frame: i32) -> String {
        self.folder.path(&format!("v_{frame:04}.vdb"))
    }

    /// Arguments that render all frames into `out`.
    fn args(&self, out: &str) -> Vec<String> {
        let output = self.folder.path(&format!("{out}/f.####.exr"));
        ["render", &self.scene, "-f", "20-24", "-o", &output]
            .map(str::to_owned)
            .to_vec()
    }

    fn render(&self, out: &str, more: &[&str]) -> std::process::Output {
        let mut args = self.args(out);
        args.extend(more.iter().map(|&s| s.to_owned()));
        let args: Vec<&str> = args.iter().map(String::as_str).collect();
        majorant(&args)
    }

    fn image(&self, out: &str, frame: i32) -> String {
        self.folder.path(&format!("{out}/f.{frame:04}.exr"))
    }
}

/// The channels of an image, bit by bit.
fn pixels(path: &str) -> Vec<(String, Vec<u32>)> {
    let image = exr::prelude::read_first_flat_layer_from_file(path).expect("an image");
    let channels = image.layer_data.channel_data.list.iter();
    channels
        .map(|c| {
            let bits = c.sample_data.values_as_f32().map(f32::to_bits).collect();
            (c.name.to_string(), bits)
        })
        .collect()
}

fn attribute(path: &str, name: &str) -> String {
    let image = exr::prelude::read_first_flat_layer_from_file(path).expect("an image");
    match image.layer_data.attributes.other.get(name.as_bytes()) {
        Some(exr::prelude::AttributeValue::Text(text)) => text.to_string(),
        other => panic!("{name} is {other:?}"),
    }
}

fn names(folder: &str) -> Vec<String> {
    let entries = std::fs::read_dir(folder).expect("the folder is there");
    let name = |e: std::io::Result<std::fs::DirEntry>| {
        e.expect("listed").file_name().into_string().expect("plain")
    };
    let mut names: Vec<_> = entries.map(name).collect();
    names.sort();
    names
}

/// Makes a volume one that no program can read: a folder. Permissions would not stop root.
fn make_unreadable(path: &str) {
    std::fs::remove_file(path).expect("was there");
    std::fs::create_dir(path).expect("made");
}

#[test]
fn a_sequence_is_its_frames_rendered_one_by_one() {
    let s = Sequence::new(3);
    let run = s.render("a", &["-j", "2"]);
    assert_eq!(code(&run), 0, "{}", stderr(&run));
    assert!(
        stderr(&run).contains("5 frames: 5 rendered"),
        "{}",
        stderr(&run)
    );
    let mut different = 0;
    for frame in FRAMES {
        let alone = s.folder.path("alone.exr");
        let number = frame.to_string();
        let args = ["render", &s.scene, "-f", &number, "-o", &alone, "-j", "1"];
        assert_eq!(code(&majorant(&args)), 0);
        assert_eq!(
            pixels(&s.image("a", frame)),
            pixels(&alone),
            "frame {frame}"
        );
        different += i32::from(pixels(&alone) != pixels(&s.image("a", 20)));
    }
    assert_eq!(different, 4, "keys and noise change from frame to frame");
    let expected = FRAMES.map(|f| format!("f.{f:04}.exr"));
    assert_eq!(names(&s.folder.path("a")), expected, "nothing else is left");
}

#[test]
fn finished_frames_of_the_same_scene_are_left_as_they_are() {
    let s = Sequence::new(3);
    assert_eq!(code(&s.render("a", &[])), 0);
    let undisturbed = pixels(&s.image("a", 22));
    let date = |frame| {
        std::fs::metadata(s.image("a", frame))
            .expect("there")
            .modified()
    };
    let dates = FRAMES.map(|f| date(f).expect("a date"));
    // Cut short, as a full disk or a copy that broke off leaves it.
    let whole = std::fs::read(s.image("a", 22)).expect("there");
    std::fs::write(s.image("a", 22), &whole[..whole.len() - 100]).expect("written");
    // Damaged in the middle of its pixels.
    let mut damaged = std::fs::read(s.image("a", 23)).expect("there");
    let middle = damaged.len() - 200;
    damaged[middle] ^= 0xff;
    std::fs::write(s.image("a", 23), &damaged).expect("written");
    let run = s.render("a", &["--skip-existing"]);
    assert_eq!(code(&run), 0, "{}", stderr(&run));
    let said = stderr(&run);
    assert!(said.contains("2 rendered, 3 complete before"), "{said}");
    assert_eq!(date(20).expect("a date"), dates[0], "not touched");
    assert_eq!(pixels(&s.image("a", 22)), undisturbed);
    // Another sampling, scene, region: again.
    for (more, count) in [
        (&["--spp", "2"][..], 5),
        (&["--spp", "2"], 0),
        (&["--spp", "2", "--set", "volume.0.albedo=[0.5,0.5,0.5]"], 5),
        (&["--spp", "2", "--crop", "3,4,20,9"], 5),
        (&["--spp", "2", "--crop", "3,4,20,9"], 0),
        (&["--spp", "2", "--crop", "3,4,20,9", "--preview-png"], 5),
        (&["--spp", "2", "--crop", "3,4,20,9", "--preview-png"], 0),
    ] {
        let run = s.render("a", &[&["--skip-existing"], more].concat());
        let said = stderr(&run);
        assert!(
            said.contains(&format!("5 frames: {count} rendered")),
            "{more:?}: {said}"
        );
    }
}

#[test]
fn bad_frames_are_named_and_the_others_come_out() {
    let s = Sequence::new(2);
    std::fs::remove_file(s.volume(21)).expect("was there");
    make_unreadable(&s.volume(22));
    let volume = std::fs::read(s.volume(23)).expect("there");
    std::fs::write(s.volume(23), &volume[..volume.len() / 2]).expect("written");
    let run = s.render("a", &[]);
    assert_eq!(code(&run), 4, "{}", stderr(&run));
    assert_eq!(names(&s.folder.path("a")), ["f.0020.exr", "f.0024.exr"]);
    let said = stderr(&run);
    assert!(said.contains("5 frames: 2 rendered, 3 FAILED"), "{said}");
    let report = &said[said.find("5 frames:").expect("above")..];
    for frame in [21, 22, 23] {
        let line = report
            .lines()
            .find(|l| l.contains(&format!("frame {frame}: ")));
        let line = line.unwrap_or_else(|| panic!("{frame} in {report}"));
        assert!(line.contains(&format!("v_{frame:04}.vdb: ")), "{line}");
    }
    let skip = s.render("b", &["--missing", "skip"]);
    assert_eq!(code(&skip), 4, "two are still bad");
    assert!(
        stderr(&skip).contains("1 left out, 2 FAILED"),
        "{}",
        stderr(&skip)
    );
    let hold = s.render("c", &["--missing", "hold", "--set", "render.spp=1"]);
    assert!(
        stderr(&hold).contains("3 rendered, 2 FAILED"),
        "{}",
        stderr(&hold)
    );
    assert!(Path::new(&s.image("c", 21)).exists());
}

#[test]
fn every_pattern_names_inputs_and_outputs() {
    let s = Sequence::new(1);
    let text = std::fs::read_to_string(&s.scene).expect("there");
    for (i, mark) in ["####", "#", "%04d", "$F4", "@@@@", "<F4>"]
        .iter()
        .enumerate()
    {
        let scene = text.replace("v_####", &format!("v_{mark}"));
        let scene = s.folder.write("marks.toml", &scene);
        let out = s.folder.path(&format!("{i}/x{mark}y.exr"));
        let run = majorant(&["render", &scene, "-f", "21,23", "-o", &out]);
        assert_eq!(code(&run), 0, "{mark}: {}", stderr(&run));
        let expected = ["x0021y.exr", "x0023y.exr"];
        assert_eq!(names(&s.folder.path(&i.to_string())), expected, "{mark}");
    }
    // A bare sequence has the look of its first frame; files of an offset are others.
    let volumes = s.folder.path("v_####.vdb");
    let out = s.folder.path("bare/####.exr");
    let small = ["-r", "8x6", "--spp", "1"];
    let run = majorant(&[&["render", &volumes, "-f", "24-23", "-o", &out][..], &small].concat());
    assert_eq!(code(&run), 0, "{}", stderr(&run));
    let offset = text.replace("file = ", "frame_offset = 20\nfile = ");
    let offset = s.folder.write("offset.toml", &offset);
    let out = s.folder.path("offset/####.exr");
    let run = majorant(&["render", &offset, "-f", "0-4x2", "-o", &out]);
    assert_eq!(code(&run), 0, "{}", stderr(&run));
}

#[test]
fn wrong_sequences_are_refused_before_anything_is_rendered() {
    let s = Sequence::new(1);
    let out = s.folder.path("f.####.exr");
    let plain = s.folder.path("f.exr");
    for (args, code_expected, says) in [
        (&["-f", "20:24", "-o", &out][..], 2, "staggered"),
        (&["-f", "20-24", "-o", &plain], 2, "one name for 5 frames"),
        (
            &["-f", "20-24", "-o", &out, "--stats-json", &plain],
            2,
            "one name for 5",
        ),
        (
            &["-f", "20", "-o", &out, "--crop", "30,0,31,1"],
            2,
            "outside of the image",
        ),
        (
            &["-f", "20", "-o", &out, "--crop", "3,3,3,9"],
            2,
            "second corner",
        ),
        (
            &["-f", "20", "-o", &out, "--samples", "9..3"],
            2,
            "no range of samples",
        ),
        (
            &["-f", "20", "-o", &out, "--set", "render.sp=3"],
            3,
            "did you mean `spp`?",
        ),
        (
            &[
                "-f",
                "20-24",
                "-o",
                &out,
                "--set",
                "camera.vertical_fov_degrees={keys={20=20,24=300}}",
            ],
            3,
            "vertical_fov_degrees is 2",
        ),
    ] {
        let run = majorant(&[&["render", &s.scene][..], args].concat());
        assert_eq!(code(&run), code_expected, "{args:?}: {}", stderr(&run));
        assert!(stderr(&run).contains(says), "{args:?}: {}", stderr(&run));
    }
    let left = names(&s.folder.path(""));
    assert_eq!(left.len(), 6, "the scene and its volumes: {left:?}");
}

#[test]
fn a_crop_is_a_part_of_the_whole() {
    let s = Sequence::new(4);
    let (whole, part) = (s.folder.path("w.exr"), s.folder.path("p.exr"));
    let base = ["render", &s.scene, "-f", "22", "-o"];
    assert_eq!(code(&majorant(&[&base[..], &[&whole]].concat())), 0);
    let crop = ["--crop", "5,3,21,99"];
    assert_eq!(
        code(&majorant(&[&base[..], &[&part], &crop[..]].concat())),
        0
    );
    let (whole, part) = (
        pixels(&whole),
        exr::prelude::read_first_flat_layer_from_file(&part),
    );
    let part = part.expect("an image");
    assert_eq!(part.attributes.display_window.size, exr::math::Vec2(24, 18));
    assert_eq!(
        part.layer_data.attributes.layer_position,
        exr::math::Vec2(5, 3)
    );
    assert_eq!(part.layer_data.size, exr::math::Vec2(16, 15));
    for (channel, (name, all)) in part.layer_data.channel_data.list.iter().zip(whole) {
        let bits: Vec<u32> = channel
            .sample_data
            .values_as_f32()
            .map(f32::to_bits)
            .collect();
        let expected: Vec<u32> = (3..18)
            .flat_map(|y| (5..21).map(move |x| y * 24 + x))
            .map(|at| all[at])
            .collect();
        assert_eq!(bits, expected, "{name}");
    }
}

#[test]
fn a_dry_run_says_what_would_be_done_and_does_nothing() {
    let s = Sequence::new(2);
    std::fs::remove_file(s.volume(21)).expect("was there");
    let run = s.render("a", &["--dry-run"]);
    assert_eq!(code(&run), 0, "{}", stderr(&run));
    let said = stdout(&run);
    for line in [
        "frame 20: ",
        "v_0021.vdb is missing",
        "memory of frame 20: ",
        "path integrator",
    ] {
        assert!(said.contains(line), "{line} in {said}");
    }
    assert!(!Path::new(&s.folder.path("a")).exists(), "nothing is made");
}

/// Four parts of one frame merge to the frame rendered at once, but for the rounding of floats, with
/// its variance; whatever does not belong together is refused.
#[test]
#[expect(
    clippy::too_many_lines,
    reason = "one frame in parts, and everything about them"
)]
fn parts_merge_to_the_whole() {
    let s = Sequence::new(40);
    let part = |range: &str, more: &[&str]| {
        let out = s.folder.path(&format!("part.{range}.exr"));
        let base = [
            "render",
            &s.scene,
            "-f",
            "22",
            "--samples",
            range,
            "--aov",
            "albedo,depth",
            "-o",
            &out,
        ];
        let run = majorant(&[&base[..], more].concat());
        assert_eq!(code(&run), 0, "{}", stderr(&run));
        out
    };
    let whole = part("0..40", &[]);
    let parts = ["8..20", "0..1", "1..8", "20..40"].map(|range| part(range, &[]));
    let merge = |parts: &[&str], out: &str| {
        let mut args = vec!["merge", "-o", out];
        args.extend(parts);
        majorant(&args)
    };
    let names: Vec<&str> = parts.iter().map(String::as_str).collect();
    let merged = s.folder.path("merged.exr");
    let run = merge(&names, &merged);
    assert_eq!(code(&run), 0, "{}", stderr(&run));
    assert_eq!(attribute(&merged, "majorant/sampleRange"), "0..40");
    assert_eq!(attribute(&merged, "majorant/spp"), "40");
    let values = |path: &str| -> Vec<(String, Vec<f32>)> {
        let channels = pixels(path).into_iter();
        let floats = |bits: Vec<u32>| bits.into_iter().map(f32::from_bits).collect();
        channels.map(|(name, bits)| (name, floats(bits))).collect()
    };
    let expected = values(&whole);
    for (name, found) in values(&merged) {
        let (_, expected) = expected
            .iter()
            .find(|(n, _)| *n == name)
            .expect("the same channels");
        // Colours are rounded to halves: 2^-11; the rest to floats, some ten times.
        let tolerance = if "RGBA".contains(name.as_str()) {
            5e-4
        } else {
            2e-6
        };
        for (i, (x, e)) in found.iter().zip(expected).enumerate() {
            let close = x == e || (x - e).abs() <= tolerance * e.abs().max(1e-3);
            assert!(close, "{name} of pixel {i}: {x}, not {e}");
        }
    }
    // The order of the parts does not matter, and a frame of all samples is complete.
    let again = s.folder.path("again.exr");
    let reversed: Vec<&str> = names.iter().rev().copied().collect();
    assert_eq!(code(&merge(&reversed, &again)), 0);
    assert_eq!(pixels(&again), pixels(&merged));
    let args = [
        "render",
        &s.scene,
        "-f",
        "22",
        "-o",
        &merged,
        "--skip-existing",
        "--aov",
        "albedo,depth",
    ];
    let run = majorant(&args);
    assert!(
        stderr(&run).contains("1 complete before"),
        "{}",
        stderr(&run)
    );
    // Only with all pixels of one scene, and each sample once.
    let other_scene = part("40..44", &["--seed", "1"]);
    let other_size = part("44..48", &["-r", "20x18"]);
    let other_region = part("48..52", &["--crop", "0,0,5,5"]);
    let overlap = part("39..56", &[]);
    let finished = s.folder.path("finished.exr");
    let args = [
        "render", &s.scene, "-f", "22", "--spp", "2", "-o", &finished,
    ];
    assert_eq!(code(&majorant(&args)), 0);
    for (wrong, says) in [
        (&other_scene, "of the scene"),
        // The resolution is a part of the scene.
        (&other_size, "of the scene"),
        (&other_region, "of the pixels 0,0 to 5,5"),
        (&overlap, "samples 39..40 are in both"),
        (&s.scene, "cannot read the image"),
    ] {
        let run = merge(&[&whole, wrong], &s.folder.path("wrong.exr"));
        assert_eq!(code(&run), 3, "{wrong}");
        assert!(stderr(&run).contains(says), "{wrong}: {}", stderr(&run));
    }
    let run = merge(&[&finished], &s.folder.path("wrong.exr"));
    assert_eq!(code(&run), 3, "halves are no part: {}", stderr(&run));
    assert!(
        !Path::new(&s.folder.path("wrong.exr")).exists(),
        "nothing is written"
    );
    // Frames by number.
    let parts = s.folder.path("p.####.exr");
    let args = [
        "render",
        &s.scene,
        "-f",
        "20-21",
        "--samples",
        "0..2",
        "-o",
        &parts,
    ];
    assert_eq!(code(&majorant(&args)), 0);
    let out = s.folder.path("out/m.####.exr");
    let run = majorant(&["merge", &parts, "-f", "20-22", "-o", &out]);
    assert_eq!(code(&run), 4, "the third is not there: {}", stderr(&run));
    assert!(
        stderr(&run).contains("1 of 3 frames failed: 22"),
        "{}",
        stderr(&run)
    );
    assert_eq!(names_of(&s, "out"), ["m.0020.exr", "m.0021.exr"]);
}

fn names_of(s: &Sequence, folder: &str) -> Vec<String> {
    names(&s.folder.path(folder))
}

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

/// A small file system of its own, where the tests may make one.
struct SmallDisk(String);

impl SmallDisk {
    fn new(folder: &Folder, size: &str) -> Option<Self> {
        let path = folder.path("disk");
        std::fs::create_dir(&path).expect("made");
        let options = format!("size={size}");
        let mut mount = Command::new("mount");
        mount.args(["-t", "tmpfs", "-o", &options, "tmpfs", &path]);
        let made = mount.stderr(Stdio::null()).status();
        made.is_ok_and(|status| status.success())
            .then(|| Self(path))
    }
}

impl Drop for SmallDisk {
    fn drop(&mut self) {
        // Lazily: a failed test may leave files open.
        let _ = Command::new("umount").args(["-l", &self.0]).status();
    }
}

/// A full disk fails the frames that do not fit, says so, and leaves no part of them; when there is
/// room again, the same command line makes the rest.
#[test]
#[expect(clippy::print_stderr, reason = "says why nothing was tested")]
fn a_full_disk_fails_frames_and_tears_none() {
    let s = Sequence::new(1);
    let Some(disk) = SmallDisk::new(&s.folder, "200k") else {
        eprintln!("skipped: no tmpfs can be mounted here");
        return;
    };
    let filler = format!("{}/filler", disk.0);
    std::fs::write(&filler, vec![1_u8; 160_000]).expect("room for it");
    let output = format!("{}/f.####.exr", disk.0);
    let run = || {
        let base = [
            "render",
            &s.scene,
            "-f",
            "20-24",
            "-r",
            "110x80",
            "--skip-existing",
        ];
        majorant(&[&base[..], &["-o", &output]].concat())
    };
    let full = run();
    let said = stderr(&full);
    assert_eq!(code(&full), 4, "{said}");
    assert!(said.contains("No space left on device"), "{said}");
    let images: Vec<String> = names(&disk.0)
        .into_iter()
        .filter(|n| n != "filler")
        .collect();
    assert!(!images.is_empty() && images.len() < 5, "{images:?}");
    for name in &images {
        assert!(name.starts_with("f.00"), "no remnants: {images:?}");
        assert!(
            !pixels(&format!("{}/{name}", disk.0)).is_empty(),
            "{name} is whole"
        );
    }
    std::fs::remove_file(&filler).expect("was there");
    let later = run();
    let before = images.len();
    assert!(
        stderr(&later).contains(&format!("{before} complete before")),
        "{}",
        stderr(&later)
    );
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
    let s = Sequence::new(12_000);
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
    let s = Sequence::new(20_000);
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

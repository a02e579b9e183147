//! `majorant render` of sequences, run as a program: which frames come out, and what becomes of those that cannot.

use std::path::Path;
use std::process::{Command, Stdio};

use crate::support::{Folder, code, fixture, majorant, names, pixels, stderr, stdout};

/// A sequence of five frames, 20 to 24: links to one small volume, with a camera that moves.
pub(crate) struct Sequence {
    pub(crate) folder: Folder,
    pub(crate) scene: String,
}

pub(crate) const FRAMES: [i32; 5] = [20, 21, 22, 23, 24];

impl Sequence {
    pub(crate) fn new(spp: u32) -> Self {
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

    pub(crate) fn volume(&self, frame: i32) -> String {
        self.folder.path(&format!("v_{frame:04}.vdb"))
    }

    /// Arguments that render all frames into `out`.
    pub(crate) fn args(&self, out: &str) -> Vec<String> {
        let output = self.folder.path(&format!("{out}/f.####.exr"));
        ["render", &self.scene, "-f", "20-24", "-o", &output]
            .map(str::to_owned)
            .to_vec()
    }

    pub(crate) fn render(&self, out: &str, more: &[&str]) -> std::process::Output {
        let mut args = self.args(out);
        args.extend(more.iter().map(|&s| s.to_owned()));
        let args: Vec<&str> = args.iter().map(String::as_str).collect();
        majorant(&args)
    }

    pub(crate) fn image(&self, out: &str, frame: i32) -> String {
        self.folder.path(&format!("{out}/f.{frame:04}.exr"))
    }
}

pub(crate) fn names_of(s: &Sequence, folder: &str) -> Vec<String> {
    names(&s.folder.path(folder))
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

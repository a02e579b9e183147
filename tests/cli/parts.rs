//! Parts of a frame, from several machines, and the frame that `majorant merge` makes of them.

use std::path::Path;

use crate::sequence::{Sequence, names_of};
use crate::support::{attribute, code, majorant, pixels, stderr};

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

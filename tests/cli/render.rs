//! `majorant render`, run as a program: exit codes, files and what is in them.

use std::path::Path;

use crate::support::{Folder, code, fixture, majorant, stderr, stdout};
use exr::prelude::{ReadChannels as _, ReadLayers as _};

/// A small scene of a fixture: 16 x 9 pixels, 4 samples.
fn scene(folder: &Folder) -> String {
    let volume = fixture("xf_affine.vdb").display().to_string();
    let text = format!(
        "[image]\nresolution = [16, 9]\n[camera]\nposition = [10, -10, 3]\n\
         look_at = [1.0, 2.0, 3.0]\n[[volume]]\nfile = {volume:?}\n\
         [[light]]\ntype = \"constant\"\nradiance = [1, 2, 4]\n[render]\nspp = 4\nseed = 3\n"
    );
    folder.write("scene.toml", &text)
}

#[test]
fn a_scene_becomes_an_exr_with_its_provenance() {
    let folder = Folder::new();
    let scene = scene(&folder);
    let out = folder.path("deep/er/out.exr");
    let run = majorant(&["render", &scene, "-o", &out, "--preview-png", "-j", "1"]);
    assert_eq!(code(&run), 0, "{}", stderr(&run));
    let image = exr::prelude::read()
        .no_deep_data()
        .largest_resolution_level()
        .all_channels()
        .first_valid_layer()
        .all_attributes()
        .from_file(&out)
        .expect("the image can be read");
    let layer = &image.layer_data;
    assert_eq!((layer.size.0, layer.size.1), (16, 9));
    let channels: Vec<_> = layer
        .channel_data
        .list
        .iter()
        .map(|c| {
            let kind = match c.sample_data {
                exr::image::FlatSamples::F16(_) => "half",
                exr::image::FlatSamples::F32(_) => "float",
                exr::image::FlatSamples::U32(_) => "uint",
            };
            format!("{} {kind}", c.name)
        })
        .collect();
    let expected = "A half, B half, G half, R half, Z float, sampleCount float, \
                    variance.B float, variance.G float, variance.R float";
    assert_eq!(channels.join(", "), expected);
    // The first pixel sees the sky only: exact in half, without variance or depth.
    let first = |i: usize| {
        layer.channel_data.list[i]
            .sample_data
            .value_by_flat_index(0)
            .to_f32()
    };
    let firsts: Vec<_> = (0..9).map(first).collect();
    assert_eq!(
        firsts,
        [0.0, 4.0, 2.0, 1.0, f32::INFINITY, 4.0, 0.0, 0.0, 0.0]
    );
    let opaque = layer.channel_data.list[0]
        .sample_data
        .values_as_f32()
        .any(|a| a > 0.0);
    assert!(opaque, "the volume is in the image");

    let attributes = &layer.attributes;
    let text = |name: &str| match attributes.other.get(name.as_bytes()) {
        Some(exr::prelude::AttributeValue::Text(text)) => text.to_string(),
        other => panic!("{name} is {other:?}"),
    };
    assert_eq!(text("majorant/spp"), "4");
    assert_eq!(text("majorant/seed"), "3");
    assert_eq!(text("majorant/sampleRange"), "0..4");
    assert_eq!(text("majorant/version"), env!("CARGO_PKG_VERSION"));
    assert_eq!(text("majorant/sceneHash").len(), 16);
    assert!(
        text("majorant/commandLine").contains(" render "),
        "{}",
        text("majorant/commandLine")
    );
    let stats: serde_json::Value = serde_json::from_str(&text("majorant/stats")).expect("JSON");
    assert_eq!(stats["counts"]["camera_rays"], 16 * 9 * 4);
    let date = attributes
        .capture_date
        .as_ref()
        .expect("capDate")
        .to_string();
    assert_eq!(
        (date.len(), &date[4..5], &date[10..11]),
        (19, ":", " "),
        "{date}"
    );
    assert!(image.attributes.chromaticities.is_some());
    check_matrices(attributes);

    let png = std::fs::File::open(folder.path("deep/er/out.png")).expect("the preview exists");
    let mut reader = png::Decoder::new(std::io::BufReader::new(png))
        .read_info()
        .expect("a PNG");
    let mut pixels = vec![0; reader.output_buffer_size().expect("small")];
    let info = reader.next_frame(&mut pixels).expect("whole");
    assert_eq!((info.width, info.height), (16, 9));
    assert_eq!(
        pixels[..3],
        [255; 3],
        "the sky is 1, 2, 4: clamped to white"
    );
}

/// The camera looks from (10, -10, 3) to (1, 2, 3): a point halfway, 7.5 units away, is on the
/// axis; in NDC in the middle. EXR matrices act on row vectors.
fn check_matrices(attributes: &exr::prelude::LayerAttributes) {
    let apply = |m: &[f32; 16], p: [f32; 4]| -> [f32; 4] {
        std::array::from_fn(|column| (0..4).map(|row| p[row] * m[row * 4 + column]).sum())
    };
    let close = |a: [f32; 4], b: [f32; 4]| {
        let worst = a
            .iter()
            .zip(b)
            .map(|(a, b)| (a - b).abs())
            .fold(0.0, f32::max);
        assert!(worst < 1e-5, "{a:?}, not {b:?}");
    };
    let halfway = [5.5, -4.0, 3.0, 1.0];
    let to_camera = attributes.world_to_camera.expect("worldToCamera");
    close(apply(&to_camera, halfway), [0.0, 0.0, 7.5, 1.0]);
    let to_ndc = attributes.world_to_normalized_device.expect("worldToNDC");
    let p = apply(&to_ndc, halfway);
    close(p.map(|x| x / p[3]), [0.0, 0.0, 1.0 / 7.5, 1.0]);
    // 7.5 tan 15 degrees above the axis is the image's upper edge.
    let top = [5.5, -4.0, 3.0 + 7.5 * 15.0_f32.to_radians().tan(), 1.0];
    let p = apply(&to_ndc, top);
    close(p.map(|x| x / p[3]), [0.0, 1.0, 1.0 / 7.5, 1.0]);
}

#[test]
fn statistics_have_the_keys_that_scripts_rely_on() {
    let folder = Folder::new();
    let scene = scene(&folder);
    let (out, json) = (folder.path("a.exr"), folder.path("stats/a.json"));
    let run = majorant(&["render", &scene, "-o", &out, "--stats-json", &json, "-q"]);
    assert_eq!(code(&run), 0, "{}", stderr(&run));
    assert_eq!(stderr(&run), "", "-q says nothing");
    let text = std::fs::read_to_string(&json).expect("written");
    let stats: serde_json::Value = serde_json::from_str(&text).expect("JSON");
    for key in [
        "load",
        "read",
        "decode",
        "build",
        "first_sample",
        "render",
        "write",
    ] {
        assert!(stats["seconds"][key].is_f64(), "seconds.{key} in {text}");
    }
    for key in ["load", "build", "render", "write"] {
        assert!(
            stats["cpu_seconds"][key].is_f64(),
            "cpu_seconds.{key} in {text}"
        );
    }
    assert_eq!(stats["spp"], 4);
    assert_eq!(stats["counts"]["bound_violations"], 0);
    assert_eq!(stats["counts"]["clamped_voxels"], 0);
    assert_eq!(stats["grids"][0]["name"], "density");
    assert!(stats["plan"][0]["what"].is_string(), "{text}");
    if cfg!(target_os = "linux") {
        assert!(
            stats["peak_memory_bytes"].as_u64() > Some(1 << 20),
            "{text}"
        );
    }
}

#[test]
fn the_default_look_prints_a_scene_that_renders_to_the_same_picture() {
    let folder = Folder::new();
    let volume = fixture("stream_nooffsets.vdb").display().to_string();
    let print = [
        "render",
        &volume,
        "-r",
        "32x18",
        "--spp",
        "2",
        "--print-scene",
    ];
    let printed = majorant(&print);
    assert_eq!(code(&printed), 0, "{}", stderr(&printed));
    let scene = folder.write("look.toml", &stdout(&printed));
    let (a, b) = (folder.path("a.exr"), folder.path("b.exr"));
    let from_volume = ["render", &volume, "-r", "32x18", "--spp", "2", "-o", &a];
    assert_eq!(code(&majorant(&from_volume)), 0);
    assert_eq!(code(&majorant(&["render", &scene, "-o", &b])), 0);
    let read = |path: &str| exr::prelude::read_first_flat_layer_from_file(path).expect("an image");
    let (a, b) = (read(&a), read(&b));
    assert_eq!(a.layer_data.channel_data, b.layer_data.channel_data);
    let hash = |layer: &exr::prelude::LayerAttributes| {
        format!("{:?}", layer.other.get(&b"majorant/sceneHash"[..]))
    };
    assert_eq!(
        hash(&a.layer_data.attributes),
        hash(&b.layer_data.attributes)
    );
}

#[test]
fn bad_input_ends_with_3_and_says_where() {
    let folder = Folder::new();
    let good = std::fs::read_to_string(scene(&folder)).expect("written");
    let run_with = |name: &str, text: &str| majorant(&["render", &folder.write(name, text)]);
    let run = run_with("key.toml", &good.replace("spp = 4", "ssp = 4"));
    assert_eq!(code(&run), 3);
    let said = stderr(&run);
    assert!(
        said.contains("did you mean `spp`?") && said.contains("key.toml:12:1"),
        "{said}"
    );
    let run = run_with(
        "grid.toml",
        &good.replace(
            "xf_affine.vdb\"",
            "xf_affine.vdb\"\ndensity.grid = \"dnsity\"",
        ),
    );
    assert_eq!(code(&run), 3);
    let said = stderr(&run);
    assert!(
        said.contains("density.grid = ") && said.contains("\"density\""),
        "{said}"
    );
    for (name, text) in [
        ("gone.toml", good.replace("xf_affine", "nowhere")),
        ("empty.toml", String::new()),
    ] {
        let run = run_with(name, &text);
        assert_eq!(code(&run), 3, "{name}: {}", stderr(&run));
    }
    for missing in ["nowhere.toml", "nowhere.vdb"] {
        let run = majorant(&["render", missing]);
        assert_eq!(code(&run), 3, "{missing}");
        assert!(stderr(&run).contains(missing), "{}", stderr(&run));
    }
}

#[test]
fn a_volume_without_density_lists_its_grids() {
    let volume = fixture("levelset_half_zip.vdb").display().to_string();
    let run = majorant(&["render", &volume]);
    assert_eq!(code(&run), 3);
    assert!(stderr(&run).contains("\"surface\" ("), "{}", stderr(&run));
}

#[test]
fn wrong_usage_ends_with_2() {
    let folder = Folder::new();
    let scene = scene(&folder);
    for wrong in [
        &["-r", "480"][..],
        &["-r", "0x5"],
        &["-r", "480x270x2"],
        &["--spp", "0"],
        &["--seed", "-1"],
        &["--seed", "18446744073709551616"],
        &["--max-memory", "much"],
        &["--integrator", "magic"],
        &["--distance", "woodcock"],
        &["--transmittance", "ratios"],
        &["--bounds", "local"],
        &["--march-step", "long"],
        &["--up", "z"],
        &["-o", "out.png"],
        &["-o", "out.exr", "--preview-png=out.exr"],
    ] {
        let args = [&["render", &scene][..], wrong].concat();
        assert_eq!(code(&majorant(&args)), 2, "{wrong:?}");
    }
    assert_eq!(code(&majorant(&["rendr"])), 2);
}

#[test]
fn every_estimator_renders_by_name_and_is_explained() {
    let folder = Folder::new();
    let out = folder.path("a.exr");
    let scene = concat!(env!("CARGO_MANIFEST_DIR"), "/data/scenes/tower.toml");
    let small = ["-r", "16x9", "--spp", "1", "-o", &out];
    let estimators = [
        ("--distance", "delta"),
        ("--distance", "decomposition"),
        ("--distance", "regular"),
        ("--transmittance", "ratio"),
        ("--transmittance", "residual-ratio"),
        ("--transmittance", "exact"),
        ("--transmittance", "power-series"),
        ("--transmittance", "delta"),
        ("--transmittance", "approx-ray-marching"),
        ("--bounds", "global"),
        ("--bounds", "brick"),
        ("--bounds", "hierarchy"),
        ("--distance", "auto"),
    ];
    for (option, name) in estimators {
        let args = [&["render", scene, "--explain", option, name][..], &small].concat();
        let run = majorant(&args);
        assert_eq!(code(&run), 0, "{option} {name}: {}", stderr(&run));
        let said = String::from_utf8(run.stdout).expect("text");
        let line = match name {
            "auto" => "distance by decomposition and regular tracking: auto; closed form in",
            "approx-ray-marching" => "BIASED",
            other => &format!(" {other}: asked for"),
        };
        assert!(said.contains(line), "{option} {name}: {said}");
    }
}

#[test]
fn estimators_that_cannot_track_a_volume_are_errors() {
    let folder = Folder::new();
    let scene = scene(&folder);
    for (option, instead) in [("--distance", "regular"), ("--transmittance", "exact")] {
        let run = majorant(&["render", &scene, option, "closed-form"]);
        assert_eq!(code(&run), 3);
        let text = stderr(&run);
        assert!(text.contains("the density varies along rays"), "{text}");
        assert!(text.contains(instead), "{text}");
    }
    let run = majorant(&["render", &scene, "--collision-rate", "0.5"]);
    assert_eq!(code(&run), 3);
    assert!(
        stderr(&run).contains("collision_rate is 0.5"),
        "{}",
        stderr(&run)
    );
}

#[test]
fn an_output_that_cannot_be_written_ends_with_1_and_leaves_nothing() {
    let folder = Folder::new();
    let scene = scene(&folder);
    // A folder of the output's name: the rename fails after everything was written.
    let taken = folder.path("taken.exr");
    std::fs::create_dir(&taken).expect("made");
    let run = majorant(&["render", &scene, "-o", &taken]);
    assert_eq!(code(&run), 1, "{}", stderr(&run));
    // A file where a folder should be.
    let blocked = format!("{scene}/out.exr");
    assert_eq!(code(&majorant(&["render", &scene, "-o", &blocked])), 1);
    let left = std::fs::read_dir(folder.root()).expect("listed").count();
    assert_eq!(left, 2, "the scene and the folder");
    let text = stderr(&run);
    assert!(
        !text.contains('%'),
        "said before rendering, not after: {text}"
    );
}

#[cfg(unix)]
#[test]
fn images_have_ordinary_permissions() {
    use std::os::unix::fs::PermissionsExt as _;
    let folder = Folder::new();
    let (scene, out) = (scene(&folder), folder.path("a.exr"));
    assert_eq!(code(&majorant(&["render", &scene, "-o", &out])), 0);
    let mode = |path: &Path| {
        std::fs::metadata(path)
            .expect("exists")
            .permissions()
            .mode()
    };
    // The scene was written as any program writes a file: whatever the umask is, both obey it.
    assert_eq!(mode(out.as_ref()), mode(scene.as_ref()));
}

#[test]
fn too_large_an_image_is_refused_before_it_is_allocated() {
    let folder = Folder::new();
    let run = majorant(&[
        "render",
        &scene(&folder),
        "-r",
        "60000x60000",
        "--max-memory",
        "1G",
    ]);
    assert_eq!(code(&run), 3);
    assert!(
        stderr(&run).contains("at most 1073741824 bytes"),
        "{}",
        stderr(&run)
    );
}

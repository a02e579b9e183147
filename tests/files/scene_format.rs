//! The scene format: the documented example and defaults are true, and written scenes read back.

use std::path::Path;

use majorant::aov::Aov;
use majorant::scene::SceneFile;
use majorant::scene::desc::{
    AlbedoDesc, AlbedoGridDesc, CameraDesc, DensityDesc, EmissionDesc, ImageDesc, LightDesc,
    LightKind, PeakDesc, PhaseDesc, PhaseKind, RenderDesc, ScaleDesc, SceneDesc, VolumeDesc,
};
use majorant::tracking::{BoundsKind, DistanceEstimator, TransmittanceEstimator};
use toml::Spanned;

const MINIMAL: &str = "[camera]\nposition = [0, -3, 0]\nlook_at = [0, 0, 0]\n\
                       [[volume]]\nfile = \"a.vdb\"\n";

fn documentation() -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/scene-format.md");
    std::fs::read_to_string(path).expect("the page is part of the project")
}

fn example() -> String {
    let page = documentation();
    let start = page.find("```toml\n").expect("the page has an example") + "```toml\n".len();
    let length = page[start..].find("```").expect("the example ends");
    page[start..start + length].to_owned()
}

fn parse(text: &str) -> SceneFile {
    SceneFile::parse(Path::new("scene.toml"), text.to_owned()).expect("the scene is right")
}

#[test]
fn the_documented_example_is_a_valid_scene() {
    let file = parse(&example());
    file.check(1 << 30).expect("the example is right");
    let SceneDesc { volume, light, .. } = &file.desc;
    assert_eq!(*volume[0].get_ref().density.scale.get_ref(), 84.0);
    let kinds: Vec<_> = light.iter().map(|l| l.get_ref().kind).collect();
    assert_eq!(kinds, [LightKind::Distant, LightKind::Constant]);
}

/// Returns the documented default of `key`, as the text between backticks.
fn documented(page: &str, key: &str) -> String {
    let row = page
        .lines()
        .find(|l| l.starts_with(&format!("| `{key}` |")));
    let row = row.unwrap_or_else(|| panic!("{key} is not documented"));
    let cell = row.split('|').nth(2).expect("the table has columns").trim();
    cell.trim_matches('`').to_owned()
}

#[test]
#[expect(clippy::too_many_lines, reason = "a line for each key")]
fn documented_defaults_are_those_of_the_code() {
    let page = documentation();
    let SceneDesc {
        image: ImageDesc { resolution, aovs },
        camera:
            CameraDesc {
                up,
                vertical_fov_degrees,
                position: _,
                look_at: _,
            },
        volume,
        light: _,
        render:
            RenderDesc {
                spp,
                seed,
                frame,
                integrator,
                max_bounces,
                distance,
                transmittance,
                bounds,
                collision_rate,
                flight_rate,
                march_step,
                camera_ray,
                sampler,
            },
    } = parse(MINIMAL).desc;
    let VolumeDesc {
        file: _,
        frame_offset,
        density: DensityDesc { grid, scale },
        extinction_color,
        albedo,
        emission,
        phase,
        encoding,
        storage_error,
        translate,
        rotate,
        scale: size,
        matrix,
    } = volume[0].get_ref();
    let PhaseDesc {
        kind,
        g,
        gs,
        first_weight,
        diameter_micrometres,
    } = phase.get_ref();
    assert_eq!((*kind, g, gs), (PhaseKind::Isotropic, &None, &None));
    assert_eq!((first_weight, diameter_micrometres), (&None, &None));
    assert_eq!(*size.get_ref(), ScaleDesc::Uniform(1.0));
    assert_eq!((matrix, emission), (&None, &None));
    let constant = AlbedoDesc::Constant([0.99, 0.99, 0.99]);
    assert_eq!(*albedo.get_ref(), constant);
    let integrator = serde_json::to_string(integrator.get_ref()).expect("an enum");
    let shown = [
        (
            "image.resolution",
            format!("{resolution:?}", resolution = resolution.get_ref()),
        ),
        ("image.aovs", format!("{:?}", aovs.get_ref())),
        ("camera.position", "required".to_owned()),
        ("camera.look_at", "required".to_owned()),
        ("camera.up", format!("{:?}", up.get_ref())),
        (
            "camera.vertical_fov_degrees",
            format!("{:?}", vertical_fov_degrees.get_ref()),
        ),
        ("volume.file", "required".to_owned()),
        ("volume.frame_offset", frame_offset.to_string()),
        ("volume.density.grid", format!("{:?}", grid.get_ref())),
        ("volume.density.scale", format!("{:?}", scale.get_ref())),
        (
            "volume.extinction_color",
            format!("{:?}", extinction_color.get_ref()),
        ),
        ("volume.albedo", "[0.99, 0.99, 0.99]".to_owned()),
        ("volume.phase.type", "\"isotropic\"".to_owned()),
        ("volume.phase.g", "none".to_owned()),
        ("volume.phase.gs", "none".to_owned()),
        ("volume.phase.first_weight", "none".to_owned()),
        ("volume.phase.diameter_micrometres", "none".to_owned()),
        ("light.type", "required".to_owned()),
        ("light.direction_to_light", "required".to_owned()),
        ("light.irradiance", "required".to_owned()),
        ("light.angular_diameter_degrees", "0.0".to_owned()),
        ("light.radiance", "required".to_owned()),
        ("light.file", "required".to_owned()),
        ("light.scale", format!("{:?}", LightDesc::ENVIRONMENT_SCALE)),
        (
            "light.rotate_degrees",
            format!("{:?}", LightDesc::ROTATE_DEGREES),
        ),
        ("light.up", format!("{:?}", LightDesc::UP)),
        ("light.turbidity", format!("{:?}", LightDesc::TURBIDITY)),
        ("light.sun_elevation_degrees", "required".to_owned()),
        (
            "light.sun_azimuth_degrees",
            format!("{:?}", LightDesc::SUN_AZIMUTH_DEGREES),
        ),
        (
            "light.ground_albedo",
            format!("{:?}", LightDesc::GROUND_ALBEDO),
        ),
        ("light.position", "required".to_owned()),
        ("light.intensity", "required".to_owned()),
        ("light.radius", "required".to_owned()),
        ("render.spp", spp.get_ref().to_string()),
        ("render.seed", seed.get_ref().to_string()),
        ("render.frame", frame.to_string()),
        ("render.integrator", integrator),
        (
            "render.max_bounces",
            max_bounces.map_or("none".to_owned(), |n| n.to_string()),
        ),
        ("render.distance", format!("\"{}\"", distance.get_ref())),
        (
            "render.transmittance",
            format!("\"{}\"", transmittance.get_ref()),
        ),
        ("render.bounds", format!("\"{bounds}\"")),
        (
            "render.collision_rate",
            format!("{:?}", collision_rate.get_ref()),
        ),
        ("render.flight_rate", format!("{:?}", flight_rate.get_ref())),
        ("render.camera_ray", format!("\"{}\"", camera_ray.name())),
        ("render.sampler", format!("\"{}\"", sampler.name())),
        (
            "volume.encoding",
            format!("\"{}\"", encoding.get_ref().name()),
        ),
        ("volume.storage_error", storage_error.get_ref().to_string()),
        ("volume.translate", format!("{:?}", translate.get_ref())),
        ("volume.rotate", format!("{:?}", rotate.get_ref())),
        ("volume.scale", "1.0".to_owned()),
        ("volume.matrix", "none".to_owned()),
        ("volume.emission.grid", "none".to_owned()),
        ("volume.emission.grids", "none".to_owned()),
        ("volume.emission.temperature", "none".to_owned()),
        ("volume.emission.scale", "1.0".to_owned()),
        ("volume.emission.color", "[1.0, 1.0, 1.0]".to_owned()),
        ("volume.emission.offset", "0.0".to_owned()),
        ("volume.emission.intensity", "1.0".to_owned()),
        ("volume.emission.peak", "\"spectrum\"".to_owned()),
        ("volume.emission.physical", "false".to_owned()),
        ("render.march_step", format!("{:?}", march_step.get_ref())),
    ];
    for (key, value) in shown {
        assert_eq!(documented(&page, key), value, "{key}");
    }
}

/// A light of every key, whether or not one light may have them all.
fn every_light() -> Vec<Spanned<LightDesc>> {
    let at = |x| Some(Spanned::new(0..0, x));
    let vector = |x| Some(Spanned::new(0..0, x));
    let light = LightDesc {
        direction_to_light: vector([0.0, 1.0, 2.0]),
        irradiance: vector([1.0, 2.0, 3.0]),
        angular_diameter_degrees: at(0.5),
        radiance: vector([4.0, 5.0, 6.0]),
        file: Some(Spanned::new(0..0, "a \"sky\".exr".into())),
        scale: at(0.1),
        rotate_degrees: at(-12.5),
        up: vector([0.0, 1.0, 0.0]),
        turbidity: at(4.0),
        sun_elevation_degrees: at(30.0),
        sun_azimuth_degrees: at(110.0),
        ground_albedo: vector([0.1, 0.2, 0.3]),
        position: vector([7.0, 8.0, 9.0]),
        intensity: vector([0.7, 0.8, 0.9]),
        radius: at(0.01),
        ..LightDesc::new(LightKind::SunSky)
    };
    let kinds = [
        LightKind::Environment,
        LightKind::SunSky,
        LightKind::Point,
        LightKind::Sphere,
    ];
    let lights = kinds.map(|kind| LightDesc {
        kind,
        ..light.clone()
    });
    lights.map(|light| Spanned::new(0..0, light)).to_vec()
}

#[test]
fn written_scenes_read_back_equal() {
    let mut file = parse(&example());
    assert_eq!(parse(&file.to_toml("header")).desc, file.desc);
    // Everything that is optional, and a name that needs escaping.
    file.desc.render.max_bounces = Some(7);
    *file.desc.image.aovs.get_mut() = Aov::ALL.to_vec();
    file.desc.render.frame = -3;
    *file.desc.render.distance.get_mut() = DistanceEstimator::Regular;
    *file.desc.render.transmittance.get_mut() = TransmittanceEstimator::ApproxRayMarching;
    file.desc.render.bounds = BoundsKind::Global;
    *file.desc.render.collision_rate.get_mut() = 2.5;
    *file.desc.render.flight_rate.get_mut() = 1.5;
    *file.desc.render.march_step.get_mut() = 0.3;
    file.desc.light = every_light();
    let volume = file.desc.volume[0].get_mut();
    volume.frame_offset = -7;
    volume.phase = Spanned::new(0..0, PhaseDesc::default());
    volume.file = Spanned::new(0..0, "a \"b\"\\ß.vdb".into());
    *volume.density.scale.get_mut() = 1e-30;
    *volume.translate.get_mut() = [1.5, 0.0, -2.0];
    *volume.rotate.get_mut() = [0.0, 90.0, 0.1];
    *volume.scale.get_mut() = ScaleDesc::Axes([1.0, -2.0, 3.0]);
    let mut second = volume.clone();
    *second.scale.get_mut() = ScaleDesc::Uniform(0.25);
    second.phase = Spanned::new(
        0..0,
        PhaseDesc {
            kind: PhaseKind::DoubleHenyeyGreenstein,
            gs: Some(Spanned::new(0..0, [0.9, -0.25])),
            first_weight: Some(Spanned::new(0..0, 0.75)),
            ..PhaseDesc::default()
        },
    );
    *second.extinction_color.get_mut() = [0.1, 1.0, 10.0];
    *second.albedo.get_mut() = AlbedoDesc::Grid(AlbedoGridDesc {
        grid: None,
        grids: Some(["r", "g", "b"].map(str::to_owned)),
        scale: 0.5,
    });
    second.emission = Some(Spanned::new(
        0..0,
        EmissionDesc {
            temperature: Some(Spanned::new(0..0, "heat".to_owned())),
            scale: Spanned::new(0..0, 1000.0),
            offset: Some(Spanned::new(0..0, -10.0)),
            intensity: Some(Spanned::new(0..0, 8.0)),
            peak: Some(Spanned::new(0..0, PeakDesc::Channel)),
            ..EmissionDesc::default()
        },
    ));
    second.matrix = Some(Spanned::new(0..0, [[1.0, 0.5, 0.0, 2.0]; 4]));
    file.desc.volume.push(Spanned::new(0..0, second));
    assert_eq!(parse(&file.to_toml("two\nlines")).desc, file.desc);
}

#[test]
fn written_scenes_are_fit_to_edit() {
    insta::assert_snapshot!(parse(&example()).to_toml("A scene.\nTwo lines of header."));
}

#[test]
fn the_hash_covers_the_picture_but_not_the_sample_count() {
    let hash = |text: &str| parse(text).hash([Path::new("nowhere.vdb")]);
    let text = example();
    let base = hash(&text);
    assert_eq!(
        hash(&text.replace("spp = 64", "spp = 65")),
        base,
        "parts of one picture"
    );
    assert_eq!(
        hash(&text.replace("cloud.vdb", "elsewhere/cloud.vdb")),
        base,
        "moved"
    );
    for (from, to) in [
        ("g = 0.85", "g = 0.84"),
        ("seed = 0", "seed = 1"),
        ("480", "481"),
    ] {
        assert_ne!(hash(&text.replace(from, to)), base, "{from} -> {to}");
    }
}

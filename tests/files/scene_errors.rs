//! What a wrong scene file is told: place, finding, expectation and help of every check.

use std::path::Path;

use majorant::scene::{SceneError, SceneFile};

const GOOD: &str = r#"[image]
resolution = [480, 270]
[camera]
position = [0.6, -3.4, -0.15]
look_at = [0.0, 0.0, -0.06]
up = [0.0, 0.0, 1.0]
vertical_fov_degrees = 23.0
[[volume]]
file = "cloud.vdb"
density = { grid = "density", scale = 84.0 }
albedo = [0.99, 0.99, 0.99]
phase = { type = "henyey-greenstein", g = 0.85 }
[[light]]
type = "distant"
direction_to_light = [0.55, -0.45, 0.7]
irradiance = [6.0, 5.6, 5.0]
angular_diameter_degrees = 0.0
[[light]]
type = "constant"
radiance = [0.3, 0.45, 0.75]
[render]
spp = 64
seed = 0
"#;

fn check(text: &str) -> Result<(), SceneError> {
    let file = SceneFile::parse(Path::new("scene.toml"), text.to_owned())?;
    file.check(1 << 30).map(|_| ())
}

/// Shows an error as `place: message`, the text it points at, what was expected and the help.
fn told(text: &str) -> String {
    let Err(error) = check(text) else {
        panic!("taken for a good scene:\n{text}");
    };
    let place = error.place().expect("the error has a place");
    let at = place
        .text
        .get(place.span.clone())
        .expect("the span is in the text");
    let mut lines = vec![error.to_string()];
    if !at.is_empty() {
        lines.push(format!("  at: {}", at.lines().next().unwrap_or_default()));
    }
    lines.extend(place.expected.as_ref().map(|e| format!("  expected: {e}")));
    lines.extend(place.help.as_ref().map(|h| format!("  help: {h}")));
    lines.join("\n")
}

#[test]
fn the_scene_all_others_are_made_from_is_right() {
    check(GOOD).expect("no error");
}

#[test]
#[expect(clippy::too_many_lines, reason = "a line or three for each mistake")]
fn every_mistake_is_told_where_it_is_and_what_to_do() {
    let mistakes = [
        // keys and types
        ("albedo", "albdo"),
        ("resolution", "size"),
        ("spp = 64", "sp = 64"),
        ("[render]", "[rendr]"),
        ("grid = ", "gird = "),
        ("position = [0.6, -3.4, -0.15]\n", ""),
        ("spp = 64", "spp = \"many\""),
        ("spp = 64", "spp = 6.4"),
        ("seed = 0", "seed = -1"),
        ("seed = 0", "seed = 18446744073709551616"),
        ("up = [0.0, 0.0, 1.0]", "up = [0.0, 1.0]"),
        ("type = \"constant\"", "type = \"constnt\""),
        ("type = \"distant\"", "type = \"spot\""),
        ("seed = 0", "seed = 0\nintegrator = \"paths\""),
        ("seed = 0", "seed = 0\ndistance = \"woodcock\""),
        ("seed = 0", "seed = 0\ntransmittance = \"ratio-tracking\""),
        ("seed = 0", "seed = 0\nbounds = \"bricks\""),
        // syntax
        ("[camera]", "[camera"),
        ("seed = 0", "seed = 0\nseed = 1"),
        // ranges
        ("[480, 270]", "[0, 270]"),
        ("[480, 270]", "[480, 65537]"),
        ("[480, 270]", "[65536, 65536]"),
        ("spp = 64", "spp = 0"),
        ("23.0", "0.0"),
        ("23.0", "180.0"),
        ("23.0", "nan"),
        ("position = [0.6, -3.4, -0.15]", "position = [inf, 0, 0]"),
        (
            "look_at = [0.0, 0.0, -0.06]",
            "look_at = [0.6, -3.4, -0.15]",
        ),
        ("up = [0.0, 0.0, 1.0]", "up = [0, 0, 0]"),
        ("up = [0.0, 0.0, 1.0]", "up = [0.6, -3.4, -0.09]"),
        ("scale = 84.0", "scale = -1.0"),
        ("scale = 84.0", "scale = inf"),
        ("scale = 84.0", "scale = 1e39"),
        ("albedo = [0.99, 0.99, 0.99]", "albedo = [0.99, 1.01, 0.99]"),
        ("albedo = [0.99, 0.99, 0.99]", "albedo = [0.99, nan, 0.99]"),
        (
            "albedo = [0.99, 0.99, 0.99]",
            "albedo = { grid = \"Cd\", grids = [\"r\", \"g\", \"b\"] }",
        ),
        (
            "albedo = [0.99, 0.99, 0.99]",
            "albedo = { grid = \"Cd\", scale = -1 }",
        ),
        ("albedo = [0.99, 0.99, 0.99]", "albedo = \"Cd\""),
        (
            "albedo =",
            "emission = { grid = \"flame\", temperature = \"heat\" }\nalbedo =",
        ),
        (
            "albedo =",
            "emission = { grid = \"flame\", intensity = 2.0 }\nalbedo =",
        ),
        (
            "albedo =",
            "emission = { temperature = \"heat\", color = [1, 1, 1] }\nalbedo =",
        ),
        (
            "albedo =",
            "emission = { temperature = \"heat\", peak = \"channel\", physical = true }\nalbedo =",
        ),
        (
            "albedo =",
            "emission = { grid = \"flame\", scale = nan }\nalbedo =",
        ),
        ("[480, 270]", "[480, 270]\naovs = [\"albdo\"]"),
        ("[480, 270]", "[480, 270]\naovs = [\"albedo\", \"albedo\"]"),
        ("g = 0.85", "g = 1.0"),
        ("g = 0.85", "g = -0.99999999999"),
        (", g = 0.85", ""),
        ("henyey-greenstein", "isotropic"),
        (
            "irradiance = [6.0, 5.6, 5.0]",
            "irradiance = [6.0, -5.6, 5.0]",
        ),
        ("irradiance = [6.0, 5.6, 5.0]\n", ""),
        (
            "direction_to_light = [0.55, -0.45, 0.7]",
            "direction_to_light = [0, 0, 0]",
        ),
        (
            "angular_diameter_degrees = 0.0",
            "angular_diameter_degrees = 180",
        ),
        (
            "angular_diameter_degrees = 0.0",
            "angular_diameter_degrees = 1e-9",
        ),
        ("angular_diameter_degrees = 0.0", "radiance = [1, 1, 1]"),
        (
            "radiance = [0.3, 0.45, 0.75]",
            "radiance = [1, 1, 1]\nirradiance = [1, 1, 1]",
        ),
        ("radiance = [0.3, 0.45, 0.75]", "radiance = [nan, 1, 1]"),
        // lights and phase functions of other types
        ("type = \"constant\"", "type = \"environment\""),
        (
            "type = \"constant\"\nradiance = [0.3, 0.45, 0.75]",
            "type = \"environment\"",
        ),
        (
            "type = \"constant\"\nradiance = [0.3, 0.45, 0.75]",
            "type = \"environment\"\nfile = \"nowhere.exr\"",
        ),
        (
            "type = \"constant\"\nradiance = [0.3, 0.45, 0.75]",
            "type = \"sun-sky\"",
        ),
        (
            "type = \"constant\"\nradiance = [0.3, 0.45, 0.75]",
            "type = \"sun-sky\"\nsun_elevation_degrees = -3.0",
        ),
        (
            "type = \"constant\"\nradiance = [0.3, 0.45, 0.75]",
            "type = \"sun-sky\"\nsun_elevation_degrees = 30.0\nturbidity = 1.0",
        ),
        (
            "type = \"constant\"\nradiance = [0.3, 0.45, 0.75]",
            "type = \"sun-sky\"\nsun_elevation_degrees = 30.0\nground_albedo = [0.2, 0.2, 1.2]",
        ),
        (
            "type = \"constant\"\nradiance = [0.3, 0.45, 0.75]",
            "type = \"point\"\nintensity = [1, 1, 1]",
        ),
        (
            "type = \"constant\"\nradiance",
            "type = \"sphere\"\nposition = [0, 0, 0]\nradiance",
        ),
        (
            "type = \"constant\"\nradiance",
            "type = \"sphere\"\nposition = [0, 0, 0]\nradius = 0.0\nradiance",
        ),
        (
            "phase = { type = \"henyey-greenstein\"",
            "phase = { type = \"droplets\"",
        ),
        (
            "phase = { type = \"henyey-greenstein\", g = 0.85 }",
            "phase = { type = \"droplets\", diameter_micrometres = 51.0 }",
        ),
        (
            "phase = { type = \"henyey-greenstein\", g = 0.85 }",
            "phase = { type = \"double-henyey-greenstein\", gs = [0.9, -1.0], first_weight = 0.5 }",
        ),
        (
            "phase = { type = \"henyey-greenstein\", g = 0.85 }",
            "phase = { type = \"double-henyey-greenstein\", gs = [0.9, -0.4], first_weight = 1.5 }",
        ),
        (
            "albedo = [0.99, 0.99, 0.99]",
            "albedo = [0.99, 0.99, 0.99]\nextinction_color = [1.0, -1.0, 1.0]",
        ),
        ("seed = 0", "seed = 0\ncollision_rate = 0.5"),
        ("seed = 0", "seed = 0\ncollision_rate = nan"),
        ("seed = 0", "seed = 0\nmarch_step = 0.0"),
        // contradictions
        ("seed = 0", "seed = 0\nintegrator = \"analog\""),
        (
            "[[volume]]",
            "[[volume]]\nfile = \"a.vdb\"\n[[volume]]\nscale = 0",
        ),
        ("[[volume]]", "[[volume]]\nscale = [1, inf, 1]"),
        ("[[volume]]", "[[volume]]\nscale = \"large\""),
        ("[[volume]]", "[[volume]]\nrotate = [0, 0, nan]"),
        ("[[volume]]", "[[volume]]\ntranslate = [0, 0, 1e31]"),
        (
            "[[volume]]",
            "[[volume]]\nmatrix = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [1, 2, 3, 1]]",
        ),
        (
            "[[volume]]",
            "[[volume]]\nmatrix = [[1, 0, 0, 0], [0, 1, 0, 0], [1, 1, 0, 0], [0, 0, 0, 1]]",
        ),
        (
            "[[volume]]",
            "[[volume]]\nscale = 2.0\nmatrix = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]",
        ),
        (
            "seed = 0\n",
            "seed = 0\ncamera_ray = \"expected\"\n[[volume]]\nfile = \"a.vdb\"\n",
        ),
    ];
    let all: Vec<_> = mistakes
        .iter()
        .map(|(from, to)| {
            assert!(GOOD.contains(from), "{from:?} is in the scene");
            let text = GOOD.replacen(from, to, 1);
            format!(
                "{} -> {}\n{}\n",
                from.trim_end(),
                to.replace('\n', "; "),
                told(&text)
            )
        })
        .collect();
    insta::assert_snapshot!(all.join("\n"));
}

#[test]
fn a_scene_without_volume_is_an_error_about_the_file() {
    let text = "[camera]\nposition = [0, -3, 0]\nlook_at = [0, 0, 0]\n";
    insta::assert_snapshot!(told(text));
}

#[test]
fn whole_numbers_are_numbers() {
    let text = GOOD
        .replace("84.0", "84")
        .replace("[0.0, 0.0, 1.0]", "[0, 0, 1]");
    check(&text).expect("integers serve as floats");
}

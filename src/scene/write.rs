//! Writes a scene description as a scene file that a person would like to edit.
//!
//! By hand rather than by a serialiser: which tables are inline, the order and the comments
//! are what make it readable. Numbers take the shortest form that reads back exactly.

use std::fmt::Write as _;

use toml::Spanned;

use super::desc::{
    AlbedoDesc, AlbedoGridDesc, DensityDesc, EmissionDesc, LightDesc, PeakDesc, PhaseDesc,
    RenderDesc, ScaleDesc, SceneDesc, VolumeDesc,
};
use crate::grid::StorageKind;
use crate::integrator::IntegratorKind;

/// Writes `desc` below `header`, whose lines become comments.
pub(super) fn to_toml(desc: &SceneDesc, header: &str) -> String {
    let mut out = String::new();
    for line in header.lines() {
        push(&mut out, format_args!("# {line}"));
    }
    let SceneDesc {
        image,
        camera,
        volume,
        light,
        render,
    } = desc;
    let [width, height] = image.resolution.get_ref();
    push(
        &mut out,
        format_args!("[image]\nresolution = [{width}, {height}]"),
    );
    let aovs = image.aovs.get_ref().iter();
    let aovs: Vec<_> = aovs.map(|aov| string(aov.name())).collect();
    if !aovs.is_empty() {
        push(&mut out, format_args!("aovs = [{}]", aovs.join(", ")));
    }
    push(&mut out, format_args!("\n[camera]"));
    push(
        &mut out,
        format_args!("position = {}", vector(&camera.position)),
    );
    push(
        &mut out,
        format_args!("look_at = {}", vector(&camera.look_at)),
    );
    push(&mut out, format_args!("up = {}", vector(&camera.up)));
    let fov = number(*camera.vertical_fov_degrees.get_ref());
    push(&mut out, format_args!("vertical_fov_degrees = {fov}"));
    for v in volume {
        push_volume(&mut out, v.get_ref());
    }
    for l in light {
        push_light(&mut out, l.get_ref());
    }
    let (spp, seed, frame) = (render.spp.get_ref(), render.seed.get_ref(), render.frame);
    push(
        &mut out,
        format_args!("\n[render]\nspp = {spp}\nseed = {seed}\nframe = {frame}"),
    );
    let integrator = match render.integrator.get_ref() {
        IntegratorKind::Path => "path",
        IntegratorKind::Analog => "analog",
    };
    push(&mut out, format_args!("integrator = \"{integrator}\""));
    if let Some(n) = render.max_bounces {
        push(&mut out, format_args!("max_bounces = {n}"));
    }
    push_tracking(&mut out, render);
    out
}

/// Writes what differs from the defaults: few scenes name their estimators.
fn push_tracking(out: &mut String, render: &RenderDesc) {
    let default = RenderDesc::default();
    let RenderDesc {
        camera_ray,
        sampler,
        distance,
        transmittance,
        bounds,
        collision_rate,
        flight_rate,
        march_step,
        ..
    } = render;
    if *camera_ray != default.camera_ray {
        push(out, format_args!("camera_ray = \"{}\"", camera_ray.name()));
    }
    if *sampler != default.sampler {
        push(out, format_args!("sampler = \"{}\"", sampler.name()));
    }
    if distance.get_ref() != default.distance.get_ref() {
        push(out, format_args!("distance = \"{}\"", distance.get_ref()));
    }
    if transmittance.get_ref() != default.transmittance.get_ref() {
        let name = transmittance.get_ref();
        push(out, format_args!("transmittance = \"{name}\""));
    }
    if *bounds != default.bounds {
        push(out, format_args!("bounds = \"{bounds}\""));
    }
    for (key, value, usual) in [
        ("collision_rate", collision_rate, default.collision_rate),
        ("flight_rate", flight_rate, default.flight_rate),
        ("march_step", march_step, default.march_step),
    ] {
        if value.get_ref() != usual.get_ref() {
            push(out, format_args!("{key} = {}", number(*value.get_ref())));
        }
    }
}

fn push_volume(out: &mut String, volume: &VolumeDesc) {
    let VolumeDesc {
        file,
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
    } = volume;
    let file = string(&file.get_ref().to_string_lossy());
    let (grid, scale) = (string(grid.get_ref()), number(*scale.get_ref()));
    push(out, format_args!("\n[[volume]]\nfile = {file}"));
    // Zero: none.
    if *frame_offset != 0 {
        push(out, format_args!("frame_offset = {frame_offset}"));
    }
    let note = "# sigma_t = scale * density, per world unit";
    push(
        out,
        format_args!("density = {{ grid = {grid}, scale = {scale} }} {note}"),
    );
    if extinction_color != &VolumeDesc::default_extinction_color() {
        let color = vector(extinction_color);
        push(out, format_args!("extinction_color = {color}"));
    }
    push(
        out,
        format_args!("albedo = {}", albedo_text(albedo.get_ref())),
    );
    if let Some(emission) = emission {
        push_emission(out, emission.get_ref());
    }
    push(
        out,
        format_args!("phase = {}", phase_table(phase.get_ref())),
    );
    if *encoding.get_ref() != StorageKind::default() {
        let name = encoding.get_ref().name();
        push(out, format_args!("encoding = \"{name}\""));
    }
    if storage_error.get_ref() != VolumeDesc::default_storage_error().get_ref() {
        let error = number(*storage_error.get_ref());
        push(out, format_args!("storage_error = {error}"));
    }
    if translate != &VolumeDesc::default_translate() {
        push(out, format_args!("translate = {}", vector(translate)));
    }
    if rotate != &VolumeDesc::default_rotate() {
        push(out, format_args!("rotate = {}", vector(rotate)));
    }
    if size != &VolumeDesc::default_scale() {
        let size = match size.get_ref() {
            ScaleDesc::Uniform(s) => number(*s),
            ScaleDesc::Axes(axes) => array(axes),
        };
        push(out, format_args!("scale = {size}"));
    }
    if let Some(matrix) = matrix {
        let rows = matrix.get_ref().each_ref().map(|row| array(row));
        push(out, format_args!("matrix = [{}]", rows.join(", ")));
    }
}

fn phase_table(phase: &PhaseDesc) -> String {
    let PhaseDesc {
        kind,
        g,
        gs,
        first_weight,
        diameter_micrometres,
    } = phase;
    let mut table = format!("{{ type = \"{}\"", kind.name());
    let mut add = |key: &str, value: String| {
        write!(table, ", {key} = {value}").expect("writing to a string cannot fail");
    };
    if let Some(g) = g {
        add("g", number(*g.get_ref()));
    }
    if let Some(gs) = gs {
        let [a, b] = gs.get_ref().map(number);
        add("gs", format!("[{a}, {b}]"));
    }
    if let Some(weight) = first_weight {
        add("first_weight", number(*weight.get_ref()));
    }
    if let Some(diameter) = diameter_micrometres {
        add("diameter_micrometres", number(*diameter.get_ref()));
    }
    table + " }"
}

fn albedo_text(albedo: &AlbedoDesc) -> String {
    let AlbedoGridDesc { grid, grids, scale } = match albedo {
        AlbedoDesc::Constant(channels) => return array(channels),
        AlbedoDesc::Grid(desc) => desc,
    };
    let mut keys = Vec::new();
    keys.extend(grid.as_ref().map(|name| format!("grid = {}", string(name))));
    keys.extend(grids.as_ref().map(|names| {
        let names = names.each_ref().map(|name| string(name));
        format!("grids = [{}]", names.join(", "))
    }));
    keys.push(format!("scale = {}", number(*scale)));
    format!("{{ {} }}", keys.join(", "))
}

fn push_emission(out: &mut String, emission: &EmissionDesc) {
    let EmissionDesc {
        grid,
        grids,
        temperature,
        scale,
        color,
        offset,
        intensity,
        peak,
        physical,
    } = emission;
    let mut keys = Vec::new();
    let mut key = |name: &str, value: Option<String>| {
        keys.extend(value.map(|value| format!("{name} = {value}")));
    };
    let names = |names: &Spanned<[String; 3]>| {
        let [r, g, b] = names.get_ref().each_ref().map(|name| string(name));
        format!("[{r}, {g}, {b}]")
    };
    let one = |x: &Spanned<f64>| number(*x.get_ref());
    key("grid", grid.as_ref().map(|g| string(g.get_ref())));
    key("grids", grids.as_ref().map(names));
    key(
        "temperature",
        temperature.as_ref().map(|g| string(g.get_ref())),
    );
    key("scale", Some(one(scale)));
    key("color", color.as_ref().map(vector));
    key("offset", offset.as_ref().map(one));
    key("intensity", intensity.as_ref().map(one));
    let peak = peak.as_ref().map(|peak| match peak.get_ref() {
        PeakDesc::Spectrum => "\"spectrum\"".to_owned(),
        PeakDesc::Channel => "\"channel\"".to_owned(),
    });
    key("peak", peak);
    key(
        "physical",
        physical.as_ref().map(|p| p.get_ref().to_string()),
    );
    push(out, format_args!("emission = {{ {} }}", keys.join(", ")));
}

fn push_light(out: &mut String, light: &LightDesc) {
    let LightDesc {
        kind,
        direction_to_light,
        irradiance,
        angular_diameter_degrees,
        radiance,
        file,
        scale,
        rotate_degrees,
        up,
        turbidity,
        sun_elevation_degrees,
        sun_azimuth_degrees,
        ground_albedo,
        position,
        intensity,
        radius,
    } = light;
    push(out, format_args!("\n[[light]]\ntype = \"{}\"", kind.name()));
    if let Some(file) = file {
        let file = string(&file.get_ref().to_string_lossy());
        push(out, format_args!("file = {file}"));
    }
    let numbers = [
        ("scale", scale),
        ("rotate_degrees", rotate_degrees),
        ("turbidity", turbidity),
        ("sun_elevation_degrees", sun_elevation_degrees),
        ("sun_azimuth_degrees", sun_azimuth_degrees),
        ("radius", radius),
        ("angular_diameter_degrees", angular_diameter_degrees),
    ];
    let vectors = [
        ("up", up),
        ("position", position),
        ("direction_to_light", direction_to_light),
        ("irradiance", irradiance),
        ("intensity", intensity),
        ("radiance", radiance),
        ("ground_albedo", ground_albedo),
    ];
    for (key, value) in vectors {
        if let Some(value) = value {
            push(out, format_args!("{key} = {}", vector(value)));
        }
    }
    for (key, value) in numbers {
        if let Some(value) = value {
            push(out, format_args!("{key} = {}", number(*value.get_ref())));
        }
    }
}

fn push(out: &mut String, line: std::fmt::Arguments<'_>) {
    writeln!(out, "{line}").expect("writing to a string cannot fail");
}

/// The shortest form that reads back exactly; always with a point, so that it stays a float.
fn number(x: f64) -> String {
    toml::Value::Float(x).to_string()
}

fn vector(v: &Spanned<[f64; 3]>) -> String {
    array(v.get_ref())
}

fn array(numbers: &[f64]) -> String {
    let numbers: Vec<_> = numbers.iter().copied().map(number).collect();
    format!("[{}]", numbers.join(", "))
}

fn string(s: &str) -> String {
    toml::Value::String(s.to_owned()).to_string()
}

//! What a scene needs from the renderer, what is left out, and why.
//!
//! For people and statistics: a picture that surprises often does so because of one of these
//! lines. Nothing is decided here that the integrator does not decide by itself.

use std::fmt;

use serde::Serialize;

use crate::aov::Aov;
use crate::emission::Emission;
use crate::grid::brick::BRICK_DIM;
use crate::integrator::{
    CameraRay, IntegratorKind, Kernel, TransportSettings, absorbing_tracking, absorbs_only, steers,
};
use crate::light::Lights;
use crate::medium::Medium;
use crate::phase::Phase;
use crate::sampling::SamplerKind;
use crate::scene::{LoadedVolume, Scene};
use crate::spectrum::Rgb;
use crate::tracking::{BoundsKind, BrickShares, DistanceEstimator, Survey, TransmittanceEstimator};

/// Below this, in kelvin, nothing glows visibly: the Draper point.
const DRAPER: f32 = 798.0;

/// One decision.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct PlanLine {
    /// What it is about.
    pub what: String,
    /// Why.
    pub why: String,
}

impl fmt::Display for PlanLine {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.what, self.why)
    }
}

/// Lists what rendering `scene`, with `volumes` in it, uses and leaves out.
pub fn plan(scene: &Scene, volumes: &[LoadedVolume]) -> Vec<PlanLine> {
    let mut lines = Vec::new();
    let mut add = |what: &str, why: &str| {
        lines.push(PlanLine {
            what: what.to_owned(),
            why: why.to_owned(),
        });
    };
    add_unused_grids(&mut add, volumes);
    let Scene {
        media,
        lights,
        transport,
        ..
    } = scene;
    match transport.integrator {
        IntegratorKind::Path => add("path integrator", "suns are sampled where they can matter"),
        IntegratorKind::Analog => add("analog integrator", "asked for; no light is sampled"),
    }
    let absorbs = !media.is_empty() && absorbs_only(transport, media);
    match (lights.distant.len(), transport.integrator) {
        (0, _) => add("no shadow rays to suns", "the scene has no sun"),
        _ if absorbs => add("no shadow rays", "nothing is scattered towards the camera"),
        (_, IntegratorKind::Path) => add("shadow rays", "towards each sun"),
        (_, IntegratorKind::Analog) => add("no shadow rays", "suns are found by chance"),
    }
    add_surroundings(&mut add, lights, transport);
    let is_dark = lights.distant.is_empty() && lights.local.is_empty() && lights.maps.is_empty();
    let glows = media.iter().any(|m| m.emission().is_some());
    if is_dark && lights.environment.is_black() && !glows {
        add("black image", "the scene has no light at all");
    }
    add("active masks dropped", "rendering reads values only");
    match media.len() {
        1 => add("one medium by itself", "the scene has one volume"),
        n => add(
            &format!("{n} media fly to the nearest collision of all"),
            "volumes add up where they overlap",
        ),
    }
    if absorbs {
        let estimator = absorbing_tracking(transport.tracking).transmittance;
        add(
            &format!("camera rays: transmittance alone, by {estimator}"),
            "the albedo is 0: no collisions, paths, survey of bounds or lattice of light",
        );
    } else {
        let surveys: Vec<Survey> = media.iter().map(Survey::new).collect();
        if transport.integrator == IntegratorKind::Path && !media.iter().any(Medium::is_chromatic) {
            add_camera_rays(&mut add, transport, &surveys);
        }
        for (i, (medium, survey)) in media.iter().zip(&surveys).enumerate() {
            let mut add = named(&mut add, media.len(), i);
            add_tracking(
                &mut add,
                (medium, survey),
                transport,
                !lights.distant.is_empty() || glows,
            );
        }
    }
    for (i, (medium, volume)) in media.iter().zip(volumes).enumerate() {
        add_medium(&mut named(&mut add, media.len(), i), medium, volume);
    }
    match transport.sampler {
        SamplerKind::Sobol => add(
            "first numbers of a path from a scrambled Sobol' sequence",
            "the variance channel overestimates the noise",
        ),
        SamplerKind::Independent => add("all numbers independent", "asked for"),
    }
    if lights.constant_radiance().is_some() {
        add(
            "no rays in pixels beside the medium",
            "the sky is one radiance, and no voxel is in the way",
        );
    }
    add_aovs(&mut add, &scene.aovs);
    match transport.max_bounces {
        None => add(
            "no depth cap",
            "paths end by escape, absorption and roulette: unbiased",
        ),
        Some(_) => add(
            "BIASED depth cap",
            "max_bounces is set: the image is too dark",
        ),
    }
    lines
}

/// Lets lines about one of several volumes say which.
fn named(add: &mut impl FnMut(&str, &str), count: usize, index: usize) -> impl FnMut(&str, &str) {
    move |what, why| {
        if count > 1 {
            add(&format!("volume {}: {what}", index + 1), why);
        } else {
            add(what, why);
        }
    }
}

/// Adds the grids that lie in the files and are not used.
fn add_unused_grids(add: &mut impl FnMut(&str, &str), volumes: &[LoadedVolume]) {
    let mut names: Vec<&str> = Vec::new();
    for volume in volumes {
        let is_used = |name: &str| {
            let mut used = volumes.iter().filter(|v| v.path == volume.path);
            used.any(|v| v.name == name)
        };
        for name in &volume.unused_grids {
            if !is_used(name) && !names.contains(&&**name) {
                names.push(name);
            }
        }
    }
    if !names.is_empty() {
        add(
            &format!("grids not loaded: {}", names.join(", ")),
            "the scene names none of them",
        );
    }
}

/// Adds how light is found that is no sun's.
fn add_surroundings(
    add: &mut impl FnMut(&str, &str),
    lights: &Lights,
    transport: &TransportSettings,
) {
    let Lights {
        distant: _,
        environment,
        maps,
        local,
    } = lights;
    let samples = transport.integrator == IntegratorKind::Path;
    for map in maps {
        let share = 100.0 * map.sampled_share();
        if samples && map.is_sampled() {
            add(
                "sky from a map: by shadow rays and by what leaves, in shares by density",
                &format!("{share:.0} % of its light is above its mean"),
            );
        } else {
            add("sky from a map: by what leaves", "nothing of it is sampled");
        }
    }
    if !local.is_empty() && samples {
        add(
            &format!(
                "{} lights in the scene: one for each scattering",
                local.len()
            ),
            "chosen by intensity and distance",
        );
        let (what, why) = if transport.levers.equiangular {
            (
                "distances also equiangular",
                "the light of a near point is found where it is",
            )
        } else {
            ("no equiangular distances", "turned off")
        };
        add(what, why);
    }
    if environment.is_black() && maps.is_empty() {
        add(
            "black sky",
            "the scene has no constant light and no image of a sky",
        );
    }
}

/// Adds what is particular to a medium.
fn add_medium(add: &mut impl FnMut(&str, &str), medium: &Medium, volume: &LoadedVolume) {
    let encoding = volume.stored.encoding;
    add(
        &format!("values stored as {encoding}"),
        &volume.stored.explain(medium.sigma_t_per_density()),
    );
    if medium.is_chromatic() {
        let Rgb([r, g, b]) = medium.tint();
        add(
            "three channels in one flight",
            &format!("the extinction has a colour: {r:.3}, {g:.3}, {b:.3} of the largest"),
        );
    }
    match medium.phase() {
        Phase::Isotropic => add("isotropic kernel", "the phase function is isotropic"),
        Phase::HenyeyGreenstein { g: 0.0 } => {
            add("Henyey-Greenstein kernel at g = 0", "isotropic by value");
        }
        Phase::HenyeyGreenstein { .. } => {
            add(
                "Henyey-Greenstein kernel",
                "the phase function has a mean cosine",
            );
        }
        phase => add_other_phase(add, phase),
    }
    if medium.albedo().is_black() {
        add("absorption only", "the albedo is 0");
    }
    if medium.is_coloured() {
        add(
            "albedo from grids",
            "the scene names them; a look at each collision",
        );
    }
    match medium.emission() {
        None => add("no emission", "the volume emits nothing"),
        Some(emission) => add_emission(add, emission),
    }
    // Zero: nothing to collide with.
    if medium.sigma_t_per_density() == 0.0 {
        add("empty medium", "the density scale is 0");
    }
}

/// Adds which channels an image has.
fn add_aovs(add: &mut impl FnMut(&str, &str), aovs: &[Aov]) {
    if aovs.is_empty() {
        let what = "no image channels but R G B A Z, variance, sampleCount";
        add(what, "none are asked for");
        return;
    }
    let names: Vec<_> = aovs.iter().map(|aov| aov.name()).collect();
    add(
        &format!("output variables: {}", names.join(", ")),
        "asked for; the others are left out",
    );
}

/// Adds what a volume emits.
fn add_emission(add: &mut impl FnMut(&str, &str), emission: &Emission) {
    let radiance = emission.typical_radiance();
    let why = format!("a line through much of it collects about {radiance:.2}");
    match emission.glow().kelvin() {
        None => add("emission from a grid of light", &why),
        Some([least, most]) => {
            add(
                &format!("emission from temperatures of {least:.0} to {most:.0} K"),
                &why,
            );
            if most < DRAPER {
                add(
                    "too cold to glow",
                    "raise the emission's scale: files are in kelvin, 0 to 1 or 0 to 1000",
                );
            }
        }
    }
    add(
        "emission sampled as a light as well",
        "by its power on a lattice of cells; along rays otherwise",
    );
}

/// Adds how the path integrator finds the collisions of camera rays.
fn add_camera_rays(
    add: &mut impl FnMut(&str, &str),
    transport: &TransportSettings,
    surveys: &[Survey],
) {
    let why = match (transport.camera_ray, surveys) {
        (CameraRay::Auto, [one]) => {
            let met = one.collisions_per_ray;
            let depth = one.optical_depth;
            format!(
                "auto; rays from inside meet {met:.2} collisions on average, over an optical depth of {depth:.2}"
            )
        }
        (CameraRay::Auto, _) => "auto; the scene has several volumes".to_owned(),
        _ => "asked for".to_owned(),
    };
    let what = match Kernel::new(transport, surveys) {
        Kernel::Expected => "camera rays scatter and escape, by expectation",
        _ => "camera rays scatter or escape, by chance",
    };
    add(what, &why);
}

/// Adds the phase functions that are drawn lobe by lobe.
fn add_other_phase(add: &mut impl FnMut(&str, &str), phase: Phase) {
    let what = match phase {
        Phase::Rayleigh => "Rayleigh kernel".to_owned(),
        Phase::DoubleHenyeyGreenstein { .. } => "kernel of two Henyey-Greenstein lobes".to_owned(),
        _ => "kernel of droplets: a Henyey-Greenstein lobe and Draine's function".to_owned(),
    };
    let why = format!("asked for; the mean cosine is {:.3}", phase.mean_cosine());
    add(&what, &why);
}

/// Adds how directions of scattering are drawn where there are suns.
fn add_directions(add: &mut impl FnMut(&str, &str), phase: Phase) {
    if steers(phase) {
        add(
            "directions chosen from 16",
            "a narrow phase function can miss the sun",
        );
    } else {
        add(
            "directions from the phase function alone",
            "it is broad: choosing would cost more than it gains",
        );
    }
}

/// Adds which estimators track rays, and how often `auto` takes which.
fn add_tracking(
    add: &mut impl FnMut(&str, &str),
    (medium, survey): (&Medium, &Survey),
    transport: &TransportSettings,
    has_suns: bool,
) {
    let shares = BrickShares::new(medium, &transport.tracking);
    let asked_bounds = transport.tracking.bounds;
    let tracking = transport.tracking.fitted(survey);
    let shadows = transport.integrator == IntegratorKind::Path && has_suns;
    if shadows {
        add_directions(add, medium.phase());
    }
    let share = |n: u64| format!("{:.1} %", 100.0 * n as f64 / shares.bricks.max(1) as f64);
    let asked = |name: &str| (name.to_owned(), "asked for".to_owned());
    let (distance, why) = match tracking.distance {
        DistanceEstimator::Auto => (
            "decomposition and regular tracking".to_owned(),
            format!(
                "auto; closed form in {} of bricks, no lookup below the minimum in {}, cell by cell \
                 in {}, where collisions would be dense; delta tracking otherwise",
                share(shares.homogeneous),
                share(shares.decomposed),
                share(shares.regular),
            ),
        ),
        other => asked(other.name()),
    };
    add(&format!("distance by {distance}"), &why);
    if shadows {
        let (transmittance, why) = match tracking.transmittance {
            TransmittanceEstimator::Auto => (
                "residual ratio tracking and exact integration".to_owned(),
                format!(
                    "auto; closed form in {} of bricks, exact in {}, where collisions would be \
                     dense; a control and ratio tracking otherwise",
                    share(shares.homogeneous),
                    share(shares.exact),
                ),
            ),
            TransmittanceEstimator::ApproxRayMarching => (
                format!("ray marching in steps of {} voxels", tracking.march_step),
                "BIASED, asked for: the image is too bright".to_owned(),
            ),
            other => asked(other.name()),
        };
        add(&format!("transmittance by {transmittance}"), &why);
    }
    let why = match asked_bounds {
        BoundsKind::Auto => format!(
            "auto; one bound for all saves {:.1} steps a ray and adds {:.1} collisions",
            survey.saved_segments, survey.added_collisions
        ),
        _ => "asked for".to_owned(),
    };
    let cells = medium.cell_edge();
    let larger = if tracking.bounds == BoundsKind::Hierarchy && cells > BRICK_DIM {
        format!(", of cells of {cells}³ voxels")
    } else {
        String::new()
    };
    add(&format!("bounds: {}{larger}", tracking.bounds), &why);
    let auto = tracking.transmittance == TransmittanceEstimator::Auto;
    let met = survey.collisions_per_ray;
    for (rate, what, why) in [
        (
            tracking.rate,
            "shadow rays",
            if auto {
                format!("auto; they meet {met:.2} collisions on average")
            } else {
                "asked for".to_owned()
            },
        ),
        (tracking.flight_rate, "free flight", "asked for".to_owned()),
    ] {
        // 1: the bound itself.
        if rate > 1.0 {
            add(
                &format!("{what} collide at {rate:.2} times the bound"),
                &why,
            );
        }
    }
}

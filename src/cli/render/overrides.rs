//! What the command line says over what the scene file says.

use majorant::scene::SceneFile;
use majorant::scene::desc::unplaced;

use super::input::is_volume;
use crate::cli::args::{RenderArgs, TrackingArgs};

/// Puts what the command line says over what the file says.
pub(super) fn overridden(mut file: SceneFile, args: &RenderArgs) -> SceneFile {
    let desc = &mut file.desc;
    if let Some(resolution) = args.resolution {
        desc.image.resolution = unplaced(resolution);
    }
    if !args.aov.is_empty() {
        desc.image.aovs = unplaced(args.aov.clone());
    }
    if let Some(spp) = args.spp.or(args.samples.as_ref().map(|range| range.end)) {
        desc.render.spp = unplaced(spp);
    }
    if let Some(seed) = args.seed {
        desc.render.seed = unplaced(seed);
    }
    if let Some(integrator) = args.integrator {
        desc.render.integrator = unplaced(integrator.into());
    }
    let TrackingArgs {
        camera_ray,
        sampler,
        distance,
        transmittance,
        bounds,
        collision_rate,
        flight_rate,
        march_step,
    } = args.tracking;
    if let Some(camera_ray) = camera_ray {
        desc.render.camera_ray = camera_ray;
    }
    if let Some(sampler) = sampler {
        desc.render.sampler = sampler;
    }
    if let Some(distance) = distance {
        desc.render.distance = unplaced(distance);
    }
    if let Some(transmittance) = transmittance {
        desc.render.transmittance = unplaced(transmittance);
    }
    if let Some(bounds) = bounds {
        desc.render.bounds = bounds;
    }
    if let Some(rate) = collision_rate {
        desc.render.collision_rate = unplaced(rate);
    }
    if let Some(rate) = flight_rate {
        desc.render.flight_rate = unplaced(rate);
    }
    if let Some(step) = march_step {
        desc.render.march_step = unplaced(step);
    }
    if let Some(grid) = &args.grid {
        for volume in &mut desc.volume {
            volume.get_mut().density.grid = unplaced(grid.clone());
        }
    }
    if let Some(kind) = args.encoding {
        for volume in &mut desc.volume {
            volume.get_mut().encoding = unplaced(kind);
        }
    }
    file
}

/// The chosen scene with the reasons of its choice, or a clean copy of a scene file.
pub(super) fn scene_text(file: &SceneFile, args: &RenderArgs) -> String {
    let comments = file.text().lines().map_while(|l| l.strip_prefix("# "));
    let header = if is_volume(&args.input) {
        comments.collect::<Vec<_>>().join("\n")
    } else {
        format!("{}, as the command line changes it.", args.input.display())
    };
    file.to_toml(&header)
}

//! What a scene needs from the renderer, what is left out, and why.
//!
//! For people and statistics: a picture that surprises often does so because of one of these
//! lines. Nothing is decided here that the integrator does not decide by itself.

use std::fmt;

use serde::Serialize;

use crate::integrator::IntegratorKind;
use crate::phase::Phase;
use crate::scene::Scene;

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

/// Lists what rendering `scene` uses and leaves out.
pub fn plan(scene: &Scene) -> Vec<PlanLine> {
    let mut lines = Vec::new();
    let mut add = |what: &str, why: &str| {
        lines.push(PlanLine {
            what: what.to_owned(),
            why: why.to_owned(),
        });
    };
    let Scene {
        medium,
        lights,
        transport,
        ..
    } = scene;
    match transport.integrator {
        IntegratorKind::Path => add("path integrator", "suns are sampled where they can matter"),
        IntegratorKind::Analog => add("analog integrator", "asked for; no light is sampled"),
    }
    match (lights.distant.len(), transport.integrator) {
        (0, _) => add("no shadow rays", "the scene has no sun"),
        (_, IntegratorKind::Path) => add("shadow rays", "ratio tracking towards each sun"),
        (_, IntegratorKind::Analog) => add("no shadow rays", "suns are found by chance"),
    }
    if lights.environment.is_black() {
        add("black sky", "the scene has no constant light");
        if lights.distant.is_empty() {
            add("black image", "the scene has no light at all");
        }
    }
    if let Some(medium) = medium {
        add("active masks dropped", "rendering reads values only");
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
        }
        if medium.albedo().is_black() {
            add("absorption only", "the albedo is 0");
        }
        // Zero: nothing to collide with.
        if medium.sigma_t_per_density() == 0.0 {
            add("empty medium", "the density scale is 0");
        }
    }
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

//! Checks which estimators a scene asks for, alone and against the loaded medium.

use toml::Spanned;

use super::desc::RenderDesc;
use super::error::{Check, Source};
use super::value::number;
use crate::integrator::IntegratorKind;
use crate::medium::Medium;
use crate::tracking::{DistanceEstimator, Tracking, TransmittanceEstimator};

/// Most tentative collisions for each unit of the bound: more would be a mistake.
const MAX_RATE: f32 = 1e6;

/// Range of the step of ray marching in voxels. A ray through the largest tile takes a million
/// of the shortest.
const STEP_RANGE: std::ops::RangeInclusive<f64> = 0.01..=1e6;

/// Checks the estimators by themselves.
pub(super) fn check_tracking(source: &Source, render: &RenderDesc) -> Check<Tracking> {
    let rate = check_rate(source, "collision_rate", &render.collision_rate)?;
    let flight_rate = check_rate(source, "flight_rate", &render.flight_rate)?;
    let march_step = number(source, "march_step", &render.march_step)?;
    if !STEP_RANGE.contains(&march_step) {
        let message = format!("march_step is {march_step}");
        let expected = format!(
            "a step from {} to {} voxels",
            STEP_RANGE.start(),
            STEP_RANGE.end()
        );
        return Err(source.error(render.march_step.span(), message, expected));
    }
    let transmittance = *render.transmittance.get_ref();
    let analog = *render.integrator.get_ref() == IntegratorKind::Analog;
    if analog && transmittance != TransmittanceEstimator::Auto {
        let message = "the analog integrator estimates no transmittance";
        let mut error = source.error(render.transmittance.span(), message, "no transmittance");
        error.help = Some("or render with integrator = \"path\"".to_owned());
        return Err(error);
    }
    Ok(Tracking {
        distance: *render.distance.get_ref(),
        transmittance,
        bounds: render.bounds,
        rate,
        flight_rate,
        march_step,
    })
}

fn check_rate(source: &Source, key: &str, value: &Spanned<f64>) -> Check<f32> {
    let wide = number(source, key, value)?;
    #[expect(clippy::cast_possible_truncation, reason = "checked after rounding")]
    let rate = wide as f32;
    if !(1.0..=MAX_RATE).contains(&rate) {
        let message = format!("{key} is {wide}");
        let expected = format!("a number from 1 to {MAX_RATE}, times the bound");
        return Err(source.error(value.span(), message, expected));
    }
    Ok(rate)
}

/// Checks that the estimators that were asked for can track the loaded medium.
pub(super) fn check_medium(source: &Source, render: &RenderDesc, medium: &Medium) -> Check<()> {
    if medium.is_homogeneous() {
        return Ok(());
    }
    let (key, span, instead) = if *render.distance.get_ref() == DistanceEstimator::ClosedForm {
        ("distance", render.distance.span(), "regular")
    } else if *render.transmittance.get_ref() == TransmittanceEstimator::ClosedForm {
        ("transmittance", render.transmittance.span(), "exact")
    } else {
        return Ok(());
    };
    let message = format!("{key} is \"closed-form\", but the density varies along rays");
    let expected = format!("\"{instead}\" or \"auto\": both take closed forms where they hold");
    Err(source.error(span, message, expected))
}

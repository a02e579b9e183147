//! Checks the lights of a scene description.
//!
//! A light's keys depend on its type; one that belongs to another type is an error, not
//! ignored.

use toml::Spanned;

use super::desc::{LightDesc, LightKind, SceneDesc};
use super::error::{Check, Source};
use super::value::{colour, direction, number};
use crate::integrator::IntegratorKind;
use crate::light::{DistantLight, Lights};
use crate::spectrum::Rgb;

const DISTANT: &str = "distant";
const CONSTANT: &str = "constant";

/// Smallest disk that is not parallel light. Its radiance is 4e15 times its irradiance: still
/// far from the end of `f32` for any irradiance that is allowed.
const MIN_DIAMETER_DEGREES: f64 = 1e-6;

pub(super) fn check_lights(source: &Source, desc: &SceneDesc) -> Check<Lights> {
    let mut lights = Lights::default();
    for spanned in &desc.light {
        match spanned.get_ref().kind {
            LightKind::Distant => lights.distant.push(check_distant(source, desc, spanned)?),
            LightKind::Constant => lights.environment += check_constant(source, spanned)?,
        }
    }
    Ok(lights)
}

fn check_constant(source: &Source, spanned: &Spanned<LightDesc>) -> Check<Rgb> {
    let LightDesc {
        kind: _,
        direction_to_light,
        irradiance,
        angular_diameter_degrees,
        radiance,
    } = spanned.get_ref();
    let diameter = angular_diameter_degrees.as_ref();
    foreign_key(
        source,
        CONSTANT,
        "direction_to_light",
        direction_to_light.as_ref(),
    )?;
    foreign_key(source, CONSTANT, "irradiance", irradiance.as_ref())?;
    foreign_key(source, CONSTANT, "angular_diameter_degrees", diameter)?;
    let radiance = required(source, CONSTANT, "radiance", radiance.as_ref(), spanned)?;
    colour(source, "radiance", radiance)
}

fn check_distant(
    source: &Source,
    desc: &SceneDesc,
    spanned: &Spanned<LightDesc>,
) -> Check<DistantLight> {
    let LightDesc {
        kind: _,
        direction_to_light,
        irradiance,
        angular_diameter_degrees,
        radiance,
    } = spanned.get_ref();
    let key = "direction_to_light";
    foreign_key(source, DISTANT, "radiance", radiance.as_ref())?;
    let to_light = required(source, DISTANT, key, direction_to_light.as_ref(), spanned)?;
    let irradiance = required(source, DISTANT, "irradiance", irradiance.as_ref(), spanned)?;
    let diameter = match angular_diameter_degrees {
        Some(d) => number(source, "angular_diameter_degrees", d)?,
        None => 0.0,
    };
    let at = angular_diameter_degrees
        .as_ref()
        .map_or(spanned.span(), Spanned::span);
    if diameter != 0.0 && !(MIN_DIAMETER_DEGREES..180.0).contains(&diameter) {
        let message = format!("angular_diameter_degrees is {diameter}");
        let expected = "0 for parallel light, or an angle from 1e-6 to below 180 degrees";
        return Err(source.error(at, message, expected));
    }
    if diameter == 0.0 && *desc.render.integrator.get_ref() == IntegratorKind::Analog {
        let message = "the analog integrator cannot see a sun of zero diameter";
        let mut error = source.error(at, message, "a diameter, say 0.53 degrees as on Earth");
        error.help = Some("or render with integrator = \"path\"".to_owned());
        return Err(error);
    }
    let unit = direction(source, key, to_light)?;
    let irradiance = colour(source, "irradiance", irradiance)?;
    DistantLight::new(unit, irradiance, diameter.to_radians()).ok_or_else(|| {
        source.error(
            to_light.span(),
            "direction_to_light is no direction",
            "a finite vector",
        )
    })
}

fn required<'a, T>(
    source: &Source,
    kind: &str,
    key: &str,
    value: Option<&'a Spanned<T>>,
    light: &Spanned<LightDesc>,
) -> Check<&'a Spanned<T>> {
    value.ok_or_else(|| {
        let message = format!("a {kind} light needs {key}");
        source.error(light.span(), message, format!("{key} = [x, y, z]"))
    })
}

/// Refuses a key that lights of another type have.
fn foreign_key<T>(source: &Source, kind: &str, key: &str, value: Option<&Spanned<T>>) -> Check<()> {
    match value {
        None => Ok(()),
        Some(v) => {
            let keys = match kind {
                CONSTANT => "type and radiance only",
                _ => "type, direction_to_light, irradiance, angular_diameter_degrees only",
            };
            Err(source.error(v.span(), format!("a {kind} light has no {key}"), keys))
        }
    }
}

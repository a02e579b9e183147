//! Checks the lights of a scene description.
//!
//! A light's keys depend on its type; one that belongs to another type is an error, not
//! ignored. The image of a sky is read here: it is a part of the description.

use std::ops::Range;
use std::sync::Arc;

use glam::DVec3;
use toml::Spanned;

use super::desc::{LightDesc, LightKind, SceneDesc};
use super::environment::read_environment;
use super::error::{Check, Source};
use super::value::{colour, direction, finite_vector, non_negative_f32, number};
use crate::integrator::IntegratorKind;
use crate::light::{DistantLight, EnvironmentMap, Lights, LocalLight, Orientation, SunSky};
use crate::spectrum::Rgb;

/// Smallest disk that is not parallel light. Its radiance is 4e15 times its irradiance: still
/// far from the end of `f32` for any irradiance that is allowed.
const MIN_DIAMETER_DEGREES: f64 = 1e-6;

/// Turbidities that the model of the sky has been fitted to.
const TURBIDITIES: std::ops::RangeInclusive<f64> = 2.0..=10.0;

/// Lowest sun of a sky: on the horizon the model loses its footing.
const MIN_ELEVATION_DEGREES: f64 = 1.0;

/// Radii of spheres: solid angles and areas stay far from the ends of `f32`.
const RADII: std::ops::RangeInclusive<f64> = 1e-9..=1e9;

pub(super) fn check_lights(
    source: &Source,
    desc: &SceneDesc,
    max_memory_bytes: u64,
) -> Check<Lights> {
    let mut lights = Lights::default();
    for spanned in &desc.light {
        let light = Light { source, spanned };
        light.refuse_foreign_keys()?;
        match spanned.get_ref().kind {
            LightKind::Distant => lights.distant.push(light.distant(desc)?),
            LightKind::Constant => lights.environment += light.radiance()?,
            LightKind::Environment => lights.maps.push(light.environment(max_memory_bytes)?),
            LightKind::SunSky => {
                let (map, sun) = light.sun_sky()?;
                lights.maps.push(Arc::new(map));
                lights.distant.push(sun);
            }
            LightKind::Point => lights.local.push(light.point(desc)?),
            LightKind::Sphere => lights.local.push(light.sphere()?),
        }
    }
    Ok(lights)
}

/// A light, to be checked.
#[derive(Clone, Copy)]
struct Light<'a> {
    source: &'a Source,
    spanned: &'a Spanned<LightDesc>,
}

impl<'a> Light<'a> {
    fn distant(self, desc: &SceneDesc) -> Check<DistantLight> {
        let Self { source, spanned } = self;
        let LightDesc {
            direction_to_light,
            irradiance,
            angular_diameter_degrees,
            ..
        } = spanned.get_ref();
        let key = "direction_to_light";
        let to_light = self.required(key, direction_to_light.as_ref())?;
        let irradiance = self.required("irradiance", irradiance.as_ref())?;
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
        if diameter == 0.0 {
            let expected = "a diameter, say 0.53 degrees as on Earth";
            self.analog_can_meet(desc, "a sun of zero diameter", at, expected)?;
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

    fn radiance(self) -> Check<Rgb> {
        let radiance = self.spanned.get_ref().radiance.as_ref();
        let radiance = self.required("radiance", radiance)?;
        colour(self.source, "radiance", radiance)
    }

    fn environment(self, max_memory_bytes: u64) -> Check<Arc<EnvironmentMap>> {
        let file = self.spanned.get_ref().file.as_ref();
        let file = file.ok_or_else(|| {
            let message = "an environment light needs file";
            let expected = "file = \"sky.exr\" or \"sky.hdr\", a latitude-longitude image";
            self.source.error(self.spanned.span(), message, expected)
        })?;
        let scale = self.scale(LightDesc::ENVIRONMENT_SCALE)?;
        let orientation = self.orientation()?;
        let path = self.source.folder().join(file.get_ref());
        read_environment(&path, max_memory_bytes, scale, orientation)
            .map(Arc::new)
            .map_err(|e| {
                let expected = "an image of non-negative numbers, .exr or .hdr";
                self.source.error(file.span(), e.to_string(), expected)
            })
    }

    fn sun_sky(self) -> Check<(EnvironmentMap, DistantLight)> {
        let Self { source, spanned } = self;
        let LightDesc {
            turbidity,
            sun_elevation_degrees,
            sun_azimuth_degrees,
            ground_albedo,
            ..
        } = spanned.get_ref();
        let in_range =
            |key: &str, value: &Spanned<f64>, ok: &dyn Fn(f64) -> bool, expected: &str| {
                let x = number(source, key, value)?;
                if ok(x) {
                    return Ok(x);
                }
                Err(source.error(value.span(), format!("{key} is {x}"), expected))
            };
        let key = "turbidity";
        let turbidity = match turbidity {
            Some(t) => in_range(
                key,
                t,
                &|t| TURBIDITIES.contains(&t),
                "2 for clear air to 10 for haze",
            )?,
            None => LightDesc::TURBIDITY,
        };
        let key = "sun_elevation_degrees";
        let Some(elevation) = sun_elevation_degrees else {
            let message = "a sun-sky light needs sun_elevation_degrees";
            let expected = "sun_elevation_degrees = the sun's height above the horizon, say 40";
            return Err(source.error(spanned.span(), message, expected));
        };
        let is_up = |e: f64| (MIN_ELEVATION_DEGREES..=90.0).contains(&e);
        let elevation = in_range(key, elevation, &is_up, "1 to 90 degrees above the horizon")?;
        let azimuth = match sun_azimuth_degrees {
            Some(a) => number(source, "sun_azimuth_degrees", a)?,
            None => LightDesc::SUN_AZIMUTH_DEGREES,
        };
        let ground = match ground_albedo {
            Some(albedo) if albedo.get_ref().iter().all(|a| (0.0..=1.0).contains(a)) => {
                colour(source, "ground_albedo", albedo)?
            }
            Some(albedo) => {
                let message = format!("ground_albedo is {:?}", albedo.get_ref());
                return Err(source.error(albedo.span(), message, "three numbers from 0 to 1"));
            }
            #[expect(clippy::cast_possible_truncation, reason = "colours are f32")]
            None => Rgb(LightDesc::GROUND_ALBEDO.map(|c| c as f32)),
        };
        let sky = SunSky {
            turbidity,
            elevation_radians: elevation.to_radians(),
            azimuth_radians: azimuth.to_radians(),
            ground_albedo: ground,
            scale: self.scale(LightDesc::SUN_SKY_SCALE)?,
        };
        Ok(sky.lights(self.orientation()?))
    }

    fn point(self, desc: &SceneDesc) -> Check<LocalLight> {
        let intensity = self.spanned.get_ref().intensity.as_ref();
        let intensity = self.required("intensity", intensity)?;
        let expected = "a sphere, which can be met";
        self.analog_can_meet(desc, "a point", self.spanned.span(), expected)?;
        let intensity = colour(self.source, "intensity", intensity)?;
        Ok(LocalLight::point(self.position()?, intensity))
    }

    fn sphere(self) -> Check<LocalLight> {
        let Self { source, spanned } = self;
        let Some(radius) = &spanned.get_ref().radius else {
            let message = "a sphere light needs radius";
            return Err(source.error(spanned.span(), message, "radius = a length"));
        };
        let (position, radiance) = (self.position()?, self.radiance()?);
        let r = number(source, "radius", radius)?;
        RADII
            .contains(&r)
            .then(|| LocalLight::sphere(position, r, radiance))
            .flatten()
            .ok_or_else(|| {
                let message = format!("radius is {r}");
                source.error(radius.span(), message, "a length from 1e-9 to 1e9")
            })
    }

    fn position(self) -> Check<DVec3> {
        let position = self.spanned.get_ref().position.as_ref();
        let position = self.required("position", position)?;
        finite_vector(self.source, "position", position)
    }

    fn scale(self, default: f64) -> Check<f32> {
        let Some(scale) = &self.spanned.get_ref().scale else {
            #[expect(clippy::cast_possible_truncation, reason = "scales are f32")]
            return Ok(default as f32);
        };
        let x = number(self.source, "scale", scale)?;
        non_negative_f32(x).filter(|_| x <= 1e10).ok_or_else(|| {
            let message = format!("scale is {x}");
            self.source
                .error(scale.span(), message, "a number from 0 to 1e10")
        })
    }

    fn orientation(self) -> Check<Orientation> {
        let LightDesc {
            up, rotate_degrees, ..
        } = self.spanned.get_ref();
        let degrees = match rotate_degrees {
            Some(degrees) => number(self.source, "rotate_degrees", degrees)?,
            None => LightDesc::ROTATE_DEGREES,
        };
        let up = match up {
            Some(up) => direction(self.source, "up", up)?,
            None => DVec3::from_array(LightDesc::UP),
        };
        Ok(Orientation::new(up, degrees.to_radians()))
    }

    fn required<T>(self, key: &str, value: Option<&'a Spanned<T>>) -> Check<&'a Spanned<T>> {
        value.ok_or_else(|| {
            let kind = self.spanned.get_ref().kind.name();
            let message = format!("a {kind} light needs {key}");
            let expected = format!("{key} = [x, y, z]");
            self.source.error(self.spanned.span(), message, expected)
        })
    }

    /// Refuses a light that no path can meet by chance, where paths sample none.
    fn analog_can_meet(
        self,
        desc: &SceneDesc,
        what: &str,
        at: Range<usize>,
        expected: &str,
    ) -> Check<()> {
        if *desc.render.integrator.get_ref() != IntegratorKind::Analog {
            return Ok(());
        }
        let message = format!("the analog integrator cannot see {what}");
        let mut error = self.source.error(at, message, expected);
        error.help = Some("or render with integrator = \"path\"".to_owned());
        Err(error)
    }

    /// Refuses a key that lights of another type have.
    fn refuse_foreign_keys(self) -> Check<()> {
        let light = self.spanned.get_ref();
        let known = known_keys(light.kind);
        match keys(light)
            .into_iter()
            .find(|(key, _)| !known.contains(key))
        {
            None => Ok(()),
            Some((key, at)) => {
                let kind = light.kind.name();
                let article = if kind == "environment" { "an" } else { "a" };
                let message = format!("{article} {kind} light has no {key}");
                let expected = match known {
                    [key] => format!("type and {key} only"),
                    keys => format!("type, {} only", keys.join(", ")),
                };
                Err(self.source.error(at, message, expected))
            }
        }
    }
}

/// Returns the keys that a light of a type may have.
fn known_keys(kind: LightKind) -> &'static [&'static str] {
    match kind {
        LightKind::Distant => &[
            "direction_to_light",
            "irradiance",
            "angular_diameter_degrees",
        ],
        LightKind::Constant => &["radiance"],
        LightKind::Environment => &["file", "scale", "rotate_degrees", "up"],
        LightKind::SunSky => &[
            "turbidity",
            "sun_elevation_degrees",
            "sun_azimuth_degrees",
            "ground_albedo",
            "scale",
            "rotate_degrees",
            "up",
        ],
        LightKind::Point => &["position", "intensity"],
        LightKind::Sphere => &["position", "radius", "radiance"],
    }
}

/// Returns the keys that a light has, and where.
fn keys(light: &LightDesc) -> Vec<(&'static str, Range<usize>)> {
    fn span<T>(value: Option<&Spanned<T>>) -> Option<Range<usize>> {
        value.map(Spanned::span)
    }
    let LightDesc {
        kind: _,
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
    let all = [
        ("direction_to_light", span(direction_to_light.as_ref())),
        ("irradiance", span(irradiance.as_ref())),
        (
            "angular_diameter_degrees",
            span(angular_diameter_degrees.as_ref()),
        ),
        ("radiance", span(radiance.as_ref())),
        ("file", span(file.as_ref())),
        ("scale", span(scale.as_ref())),
        ("rotate_degrees", span(rotate_degrees.as_ref())),
        ("up", span(up.as_ref())),
        ("turbidity", span(turbidity.as_ref())),
        (
            "sun_elevation_degrees",
            span(sun_elevation_degrees.as_ref()),
        ),
        ("sun_azimuth_degrees", span(sun_azimuth_degrees.as_ref())),
        ("ground_albedo", span(ground_albedo.as_ref())),
        ("position", span(position.as_ref())),
        ("intensity", span(intensity.as_ref())),
        ("radius", span(radius.as_ref())),
    ];
    let present = all.into_iter().filter_map(|(key, at)| Some((key, at?)));
    present.collect()
}

//! Checks what a volume is said to emit, and turns its grids into that.

use std::ops::Range;

use toml::Spanned;

use super::desc::{EmissionDesc, PeakDesc};
use super::error::{Check, Source};
use super::fields::FieldNames;
use super::value::{colour, non_negative_f32, number};
use crate::blackbody::Brightness;
use crate::emission::Glow;
use crate::field::Field;
use crate::spectrum::Rgb;

/// Hottest temperature, in kelvin: hotter than any star's surface.
const MAX_KELVIN: f64 = 1e6;

/// Emission, its grids not yet loaded.
#[derive(Clone, Debug)]
pub(super) struct CheckedEmission {
    pub(super) names: FieldNames,
    law: CheckedLaw,
    /// Of the scale, in the scene file.
    at: Range<usize>,
}

#[derive(Clone, Copy, Debug)]
enum CheckedLaw {
    Direct(Rgb),
    Thermal {
        scale: f32,
        offset: f32,
        intensity: f32,
        brightness: Brightness,
    },
}

impl CheckedEmission {
    /// Checks the description of what a volume emits.
    pub(super) fn new(source: &Source, spanned: &Spanned<EmissionDesc>) -> Check<Self> {
        let desc = spanned.get_ref();
        let EmissionDesc {
            grid,
            grids,
            temperature,
            scale,
            ..
        } = desc;
        let given = [grid.is_some(), grids.is_some(), temperature.is_some()];
        if given.into_iter().filter(|g| *g).count() != 1 {
            let message = "emission needs one of grid, grids and temperature";
            let expected = "emission = { grid = \"…\" } or { temperature = \"…\" }";
            return Err(source.error(spanned.span(), message, expected));
        }
        let factor = not_negative(source, "scale", scale)?;
        let (names, law) = if let Some(name) = temperature {
            (FieldNames::one(name), check_thermal(source, desc, factor)?)
        } else {
            let names = FieldNames::new(grid.as_ref(), grids.as_ref(), spanned);
            (names, check_direct(source, desc, factor)?)
        };
        Ok(Self {
            names,
            law,
            at: if scale.span().is_empty() {
                spanned.span()
            } else {
                scale.span()
            },
        })
    }

    /// Makes light of the loaded field.
    pub(super) fn glow(&self, source: &Source, field: Field) -> Check<Glow> {
        let (largest, limit, what) = match self.law {
            CheckedLaw::Direct(scale) => {
                let largest = f64::from(field.max()) * f64::from(scale.max_channel());
                (largest, 1e20, "an emission")
            }
            CheckedLaw::Thermal { scale, offset, .. } => {
                let largest = f64::from(field.max()) * f64::from(scale) + f64::from(offset);
                (largest, MAX_KELVIN, "a temperature")
            }
        };
        if largest > limit {
            let message = format!("the grid's largest value makes {what} of {largest:.3e}");
            let expected = format!("at most {limit:.0e}: lower the scale");
            return Err(source.error(self.at.clone(), message, expected));
        }
        Ok(match self.law {
            CheckedLaw::Direct(scale) => Glow::direct(field, scale),
            CheckedLaw::Thermal {
                scale,
                offset,
                intensity,
                brightness,
            } => Glow::thermal(field, (scale, offset), (intensity, brightness)),
        })
    }
}

fn check_direct(source: &Source, desc: &EmissionDesc, scale: f32) -> Check<CheckedLaw> {
    let of_temperature = |span: Option<Range<usize>>, key: &str| match span {
        None => Ok(()),
        Some(span) => {
            let message = format!("{key} beside a grid of light");
            let expected = format!("{key} with temperature only");
            Err(source.error(span, message, expected))
        }
    };
    of_temperature(desc.offset.as_ref().map(Spanned::span), "offset")?;
    of_temperature(desc.intensity.as_ref().map(Spanned::span), "intensity")?;
    of_temperature(desc.peak.as_ref().map(Spanned::span), "peak")?;
    of_temperature(desc.physical.as_ref().map(Spanned::span), "physical")?;
    let color = match &desc.color {
        Some(color) => colour(source, "color", color)?,
        None => Rgb::WHITE,
    };
    Ok(CheckedLaw::Direct(color * scale))
}

fn check_thermal(source: &Source, desc: &EmissionDesc, scale: f32) -> Check<CheckedLaw> {
    if let Some(color) = &desc.color {
        let message = "color beside temperature";
        return Err(source.error(color.span(), message, "no color: it follows from the heat"));
    }
    let offset = match &desc.offset {
        Some(offset) => number(source, "offset", offset)?,
        None => 0.0,
    };
    if offset.abs() > MAX_KELVIN {
        let span = desc.offset.as_ref().map_or(0..0, Spanned::span);
        let expected = "between -1e6 and 1e6 kelvin";
        return Err(source.error(span, format!("offset is {offset}"), expected));
    }
    let intensity = match &desc.intensity {
        Some(intensity) => not_negative(source, "intensity", intensity)?,
        None => 1.0,
    };
    let peak = desc.peak.as_ref();
    let physical = desc.physical.as_ref().is_some_and(|p| *p.get_ref());
    let brightness = match peak.map(|p| *p.get_ref()) {
        Some(_) if physical => {
            let span = peak.map_or(0..0, Spanned::span);
            let message = "peak beside physical = true";
            return Err(source.error(span, message, "either a peak of 1 or physical units"));
        }
        None if physical => Brightness::Physical,
        None | Some(PeakDesc::Spectrum) => Brightness::Spectrum,
        Some(PeakDesc::Channel) => Brightness::Channel,
    };
    #[expect(clippy::cast_possible_truncation, reason = "checked above")]
    let offset = offset as f32;
    Ok(CheckedLaw::Thermal {
        scale,
        offset,
        intensity,
        brightness,
    })
}

fn not_negative(source: &Source, key: &str, value: &Spanned<f64>) -> Check<f32> {
    let x = number(source, key, value)?;
    non_negative_f32(x).filter(|_| x <= 1e20).ok_or_else(|| {
        source.error(
            value.span(),
            format!("{key} is {x}"),
            "a number from 0 to 1e20",
        )
    })
}

//! Checks of single values: finite, in range, of a length.
//!
//! Each returns the value in the type that renders, or an error at its place in the file.

use glam::DVec3;
use toml::Spanned;

use super::error::{Check, Source};
use crate::spectrum::Rgb;

pub(super) fn number(source: &Source, key: &str, value: &Spanned<f64>) -> Check<f64> {
    let x = *value.get_ref();
    if x.is_finite() {
        return Ok(x);
    }
    Err(source.error(value.span(), format!("{key} is {x}"), "a finite number"))
}

/// Largest coordinate: squares and products of three stay far from overflow.
const MAX_COORDINATE: f64 = 1e30;

pub(super) fn finite_vector(source: &Source, key: &str, value: &Spanned<[f64; 3]>) -> Check<DVec3> {
    let v = DVec3::from_array(*value.get_ref());
    if v.abs().cmple(DVec3::splat(MAX_COORDINATE)).all() {
        return Ok(v);
    }
    let message = format!("{key} is {:?}", value.get_ref());
    Err(source.error(
        value.span(),
        message,
        "three numbers between -1e30 and 1e30",
    ))
}

pub(super) fn direction(source: &Source, key: &str, value: &Spanned<[f64; 3]>) -> Check<DVec3> {
    finite_vector(source, key, value)?
        .try_normalize()
        .ok_or_else(|| {
            let message = format!("{key} is {:?}", value.get_ref());
            source.error(value.span(), message, "a vector that is not zero")
        })
}

/// Largest channel: sums and products of several stay far from the end of `f32`.
const MAX_CHANNEL: f64 = 1e20;

pub(super) fn colour(source: &Source, key: &str, value: &Spanned<[f64; 3]>) -> Check<Rgb> {
    let channel = |&x: &f64| non_negative_f32(x).filter(|_| x <= MAX_CHANNEL);
    let [r, g, b] = value.get_ref().each_ref().map(channel);
    let (Some(r), Some(g), Some(b)) = (r, g, b) else {
        let message = format!("{key} is {:?}", value.get_ref());
        return Err(source.error(value.span(), message, "three numbers from 0 to 1e20"));
    };
    Ok(Rgb([r, g, b]))
}

/// Rounds to `f32`; `None` if negative, not a number or too large.
pub(super) fn non_negative_f32(x: f64) -> Option<f32> {
    #[expect(clippy::cast_possible_truncation, reason = "rounding to f32 is meant")]
    let y = x as f32;
    (x >= 0.0 && y.is_finite()).then_some(y)
}

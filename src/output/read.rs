//! Images on disk: of any program to compare with, and of our own to go on with.

use std::path::Path;

use exr::prelude::{
    AnyChannel, AnyChannels, FlatSamples, Image, Layer, read_first_flat_layer_from_file,
};

use super::OutputError;
use super::attributes::{Identity, Origin};
use super::exr::{DEPTH_WEIGHT, SAMPLE_COUNT};
use crate::aov::{Planes, is_channel};
use crate::film::{Film, Pixel, Region};

/// An EXR as others may have written it.
#[derive(Clone, Debug, PartialEq)]
pub struct ReadImage {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// R, G and B, row by row from the top.
    pub colours: Vec<[f64; 3]>,
    /// `variance.R`, `.G` and `.B`, if all are there and finite.
    pub variance: Option<Vec<[f64; 3]>>,
    /// Whether the colours are halves, rounded to 11 binary digits.
    pub is_half: bool,
}

/// Reads the colours of the first layer of an EXR, and their variances if it has them.
///
/// # Errors
/// If it cannot be read, has no channels R, G and B, or any that is not finite.
pub fn read_exr(path: &Path) -> Result<ReadImage, OutputError> {
    let unreadable = |message: String| OutputError::Unreadable {
        path: path.to_owned(),
        message,
    };
    let layer = read_first_flat_layer_from_file(path)
        .map_err(|e| unreadable(e.to_string()))?
        .layer_data;
    let channels = &layer.channel_data.list;
    let channel = |name: &str| channels.iter().find(|c| c.name.eq(name));
    let triple = |names: [&str; 3]| -> Option<Vec<[f64; 3]>> {
        let [a, b, c] = names.map(channel);
        let values = |c: &AnyChannel<FlatSamples>| -> Vec<f64> {
            c.sample_data.values_as_f32().map(f64::from).collect()
        };
        let (a, b, c) = (values(a?), values(b?), values(c?));
        let three = a.iter().zip(b).zip(c).map(|((&a, b), c)| [a, b, c]);
        Some(three.collect())
    };
    let colours = triple(["R", "G", "B"]).ok_or_else(|| {
        let found: Vec<_> = channels.iter().map(|c| c.name.to_string()).collect();
        unreadable(format!(
            "its channels are {}, expected R, G and B",
            found.join(", ")
        ))
    })?;
    if !colours.as_flattened().iter().all(|x| x.is_finite()) {
        return Err(unreadable("it holds values that are not finite".to_owned()));
    }
    let is_half =
        |name| channel(name).is_some_and(|c| matches!(c.sample_data, FlatSamples::F16(_)));
    Ok(ReadImage {
        width: layer.size.0,
        height: layer.size.1,
        colours,
        variance: triple(["variance.R", "variance.G", "variance.B"])
            .filter(|v| v.as_flattened().iter().all(|&x| x.is_finite() && x >= 0.0)),
        is_half: ["R", "G", "B"].into_iter().any(is_half),
    })
}

/// The image as the `exr` crate reads it.
type Stored = Image<Layer<AnyChannels<FlatSamples>>>;

/// A part of a frame, or a whole one, that was written by this program.
#[derive(Clone, Debug, PartialEq)]
pub struct Part {
    /// What it is a part of, and which.
    pub identity: Identity,
    /// Its pixels, with means, second moments and counts.
    pub film: Film,
    /// All that it says of itself.
    pub origin: Origin,
}

/// Reads what an image says of itself and where in its frame it lies, after decoding all of it: a
/// file that is damaged or cut short is an error.
///
/// # Errors
/// If it cannot be read, or is not of this program.
pub fn read_identity(path: &Path) -> Result<(Identity, [u32; 2], Region), OutputError> {
    let (identity, size, region, _) = read_stored(path)?;
    Ok((identity, size, region))
}

/// Reads a part of a frame, as `write_float_exr` writes it.
///
/// # Errors
/// If it cannot be read, is not of this program, or is none: parts have float colours.
pub fn read_part(path: &Path) -> Result<Part, OutputError> {
    let (identity, size, region, stored) = read_stored(path)?;
    let channels = &stored.layer_data.channel_data.list;
    let floats = |name: &str| {
        let channel = channels.iter().find(|c| c.name.eq(name));
        match channel.map(|c| &c.sample_data) {
            Some(FlatSamples::F32(values)) => Ok(&values[..]),
            _ => Err(unreadable(
                path,
                format!(
                    "it has no float channel {name}: expected a part, of render --samples A..B"
                ),
            )),
        }
    };
    let colours = [floats("R")?, floats("G")?, floats("B")?];
    let variances = [
        floats("variance.R")?,
        floats("variance.G")?,
        floats("variance.B")?,
    ];
    let (alpha, depth) = (floats("A")?, floats("Z")?);
    let (depth_weight, count) = (floats(DEPTH_WEIGHT)?, floats(SAMPLE_COUNT)?);
    let pixel = |i: usize| {
        let n = f64::from(count[i]);
        let weight = f64::from(depth_weight[i]);
        Pixel {
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "a whole number; what is none saturates"
            )]
            count: n as u64,
            mean: colours.map(|c| f64::from(c[i])),
            // Of one sample the variance is unknown, and the sum of squares zero.
            m2: variances.map(|v| {
                if n < 2.0 {
                    0.0
                } else {
                    f64::from(v[i]) * (n - 1.0) * n
                }
            }),
            opacity: f64::from(alpha[i]) * n,
            depth_weight: weight,
            // Zero: nothing was hit, and the depth is infinite.
            depth_mean: if weight > 0.0 {
                f64::from(depth[i])
            } else {
                0.0
            },
        }
    };
    let pixels: Vec<Pixel> = (0..count.len()).map(pixel).collect();
    let is_finite = |p: &Pixel| {
        let [r, g, b] = p.mean;
        let [x, y, z] = p.m2;
        let all = [r, g, b, x, y, z, p.opacity, p.depth_weight, p.depth_mean];
        all.iter().all(|x| x.is_finite())
    };
    if !pixels.iter().all(is_finite) {
        let message = "it holds values that are not finite".to_owned();
        return Err(unreadable(path, message));
    }
    let film = Film::from_pixels(size, region, pixels)
        .ok_or_else(|| unreadable(path, "its size contradicts itself".to_owned()))?;
    let names = stored
        .layer_data
        .channel_data
        .list
        .iter()
        .map(|c| c.name.to_string());
    let film = film.with_planes(planes(names, &floats, count.len()));
    let origin = Origin::new(stored.layer_data.attributes);
    Ok(Part {
        identity,
        film,
        origin,
    })
}

/// Reads the channels of output variables among `names`.
fn planes<'a, E>(
    names: impl Iterator<Item = String>,
    floats: &impl Fn(&str) -> Result<&'a [f32], E>,
    pixel_count: usize,
) -> Planes {
    let names: Vec<_> = names.filter(|name| is_channel(name)).collect();
    let mut planes = Planes::new(&names, pixel_count);
    for (c, values) in names.iter().map(|name| floats(name)).enumerate() {
        let values = values.unwrap_or_default();
        for (i, &value) in values.iter().enumerate() {
            planes.pixel_mut(i)[c] = value;
        }
    }
    planes
}

fn read_stored(path: &Path) -> Result<(Identity, [u32; 2], Region, Stored), OutputError> {
    let stored =
        read_first_flat_layer_from_file(path).map_err(|e| unreadable(path, e.to_string()))?;
    let foreign = || unreadable(path, "it was not written by majorant".to_owned());
    let identity = Identity::of(&stored.layer_data.attributes).ok_or_else(foreign)?;
    let edge = |n: usize| u32::try_from(n).ok();
    let place = || {
        let size = stored.attributes.display_window.size;
        let size = [edge(size.0)?, edge(size.1)?];
        let at = stored.layer_data.attributes.layer_position;
        let min = [u32::try_from(at.0).ok()?, u32::try_from(at.1).ok()?];
        let extent = stored.layer_data.size;
        let max = [
            min[0].checked_add(edge(extent.0)?)?,
            min[1].checked_add(edge(extent.1)?)?,
        ];
        let region = Region { min, max };
        (region.within(size[0], size[1]) == Some(region)).then_some((size, region))
    };
    let (size, region) = place().ok_or_else(foreign)?;
    Ok((identity, size, region, stored))
}

fn unreadable(path: &Path, message: String) -> OutputError {
    OutputError::Unreadable {
        path: path.to_owned(),
        message,
    }
}

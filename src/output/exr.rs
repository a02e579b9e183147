//! Images as OpenEXR.

use std::path::Path;

use exr::meta::attribute::Chromaticities;
use exr::prelude::{
    AnyChannel, AnyChannels, Encoding, FlatSamples, Image, IntegerBounds, Layer, LayerAttributes,
    SmallVec, Vec2, WritableImage as _, f16,
};

use super::attributes::{Origin, Provenance, attributes};
use super::whole::write_whole;
use super::{OutputError, SampleRanges};
use crate::film::{Film, Pixel};

/// How many samples a pixel has.
pub(super) const SAMPLE_COUNT: &str = "sampleCount";

/// Sum of the weights of a pixel's depths: what means of `Z` are merged by.
pub(super) const DEPTH_WEIGHT: &str = "depthWeight";

/// Writes `film` as an EXR.
///
/// # Errors
/// If the folder cannot be made or the file not be written; no part of it is then left.
pub fn write_exr(path: &Path, film: &Film, provenance: &Provenance) -> Result<(), OutputError> {
    write_layer(path, film, attributes(provenance), Colours::Half)
}

/// Writes `film` as an EXR whose `R G B A` are float: a part of a frame, which is added to others,
/// or a reference, where a half's rounding would be taken for bias. The channel `depthWeight` is
/// what depths are averaged by.
///
/// # Errors
/// If the folder cannot be made or the file not be written; no part of it is then left.
pub fn write_float_exr(
    path: &Path,
    film: &Film,
    provenance: &Provenance,
) -> Result<(), OutputError> {
    write_layer(path, film, attributes(provenance), Colours::Float)
}

/// Writes `film`, which was put together from `origin` and other parts of a frame, as an EXR like
/// that of a frame rendered at once; it took `secs` and `command` in all.
///
/// # Errors
/// If the folder cannot be made or the file not be written; no part of it is then left.
pub fn write_merged_exr(
    path: &Path,
    film: &Film,
    origin: &Origin,
    samples: &SampleRanges,
    secs: f64,
    command: &str,
) -> Result<(), OutputError> {
    let attributes = origin.merged(samples, secs, command);
    write_layer(path, film, attributes, Colours::Half)
}

fn write_layer(
    path: &Path,
    film: &Film,
    mut attributes: LayerAttributes,
    colours: Colours,
) -> Result<(), OutputError> {
    let size = (film.width() as usize, film.height() as usize);
    let channels = channels(film, colours);
    let corner = film.region().min.map(u32::cast_signed);
    attributes.layer_position = Vec2(corner[0], corner[1]);
    let layer = Layer::new(size, attributes, Encoding::SMALL_LOSSLESS, channels);
    let mut image = Image::from_layer(layer);
    let [width, height] = film.full_size();
    image.attributes.display_window = IntegerBounds::new((0, 0), (width as usize, height as usize));
    image.attributes.chromaticities = Some(REC_709);
    write_whole(path, |file| {
        image
            .write()
            .to_buffered(file)
            .map_err(|source| OutputError::Exr {
                path: path.to_owned(),
                source,
            })
    })
}

/// Returns how many pixels are brighter than a half can hold.
pub fn half_overflow_count(film: &Film) -> u64 {
    let too_bright = |p: &&Pixel| p.mean.iter().any(|&x| x > HALF_MAX);
    film.pixels().iter().filter(too_bright).count() as u64
}

/// How colours are stored.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Colours {
    Half,
    Float,
}

fn channels(film: &Film, colours: Colours) -> AnyChannels<FlatSamples> {
    let pixels = film.pixels();
    let half = |name: &str, value: &dyn Fn(&Pixel) -> f64| {
        let samples = pixels.iter().map(|p| to_half(value(p))).collect();
        AnyChannel::new(name, FlatSamples::F16(samples))
    };
    #[expect(clippy::cast_possible_truncation, reason = "data channels are f32")]
    let float = |name: &str, value: &dyn Fn(&Pixel) -> f64| {
        let samples = pixels.iter().map(|p| value(p) as f32).collect();
        AnyChannel::new(name, FlatSamples::F32(samples))
    };
    let colour = |name: &str, value: &dyn Fn(&Pixel) -> f64| match colours {
        Colours::Half => half(name, value),
        Colours::Float => float(name, value),
    };
    let depth = |p: &Pixel| {
        if p.depth_weight == 0.0 {
            f64::INFINITY
        } else {
            p.depth_mean
        }
    };
    let mut list: SmallVec<[AnyChannel<FlatSamples>; 4]> = [
        colour("R", &|p| p.mean[0]),
        colour("G", &|p| p.mean[1]),
        colour("B", &|p| p.mean[2]),
        colour("A", &Pixel::alpha),
        float("Z", &depth),
        float("variance.R", &|p| p.variance_of_mean()[0]),
        float("variance.G", &|p| p.variance_of_mean()[1]),
        float("variance.B", &|p| p.variance_of_mean()[2]),
        float(SAMPLE_COUNT, &|p| p.count as f64),
    ]
    .into_iter()
    .collect();
    for (i, name) in film.planes().channels().iter().enumerate() {
        let samples = film.planes().plane(i).collect();
        list.push(AnyChannel::new(&**name, FlatSamples::F32(samples)));
    }
    if colours == Colours::Float {
        list.push(float(DEPTH_WEIGHT, &|p| p.depth_weight));
    }
    AnyChannels::sort(list)
}

/// The largest finite half.
const HALF_MAX: f64 = 65504.0;

/// BIAS: what a half cannot hold is clamped, and counted, rather than written as infinity,
/// which a compositor's blur spreads over the picture.
fn to_half(x: f64) -> f16 {
    f16::from_f64(x.min(HALF_MAX))
}

/// Primaries and white point of Rec. 709.
const REC_709: Chromaticities = Chromaticities {
    red: Vec2(0.64, 0.33),
    green: Vec2(0.30, 0.60),
    blue: Vec2(0.15, 0.06),
    white: Vec2(0.3127, 0.3290),
};

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn halves_never_overflow() {
        assert_eq!(to_half(1e9).to_f64(), HALF_MAX);
        assert_eq!(to_half(0.25).to_f64(), 0.25);
    }
}

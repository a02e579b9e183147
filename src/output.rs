//! Film → EXR with provenance, and PNG preview.
//!
//! The EXR is one scanline part, ZIP compressed: `R G B A` half (associated alpha), and as
//! float `Z`, `variance.R/G/B` and `sampleCount`. The PNG is for looking at: 8 bit sRGB by the
//! exact transfer function, exposure 0, values outside [0, 1] clamped, no alpha.
//!
//! Files appear whole or not at all: both are written to a temporary file in the target's
//! folder, synced, and renamed over the target. Existing files are replaced.

use std::fs::File;
use std::io::{self, BufWriter, Write as _};
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

use exr::meta::attribute::{AttributeValue, Chromaticities, Text};
use exr::prelude::{
    AnyChannel, AnyChannels, Encoding, FlatSamples, Image, Layer, LayerAttributes, SmallVec, Vec2,
    WritableImage as _, f16, read_first_flat_layer_from_file,
};
use glam::DMat4;
use tempfile::NamedTempFile;

use crate::film::{Film, Pixel};

/// An image that could not be written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum OutputError {
    /// The folder or file cannot be made, filled or renamed.
    #[error("{}: cannot be written", path.display())]
    Io {
        /// The image, not the temporary file.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// The EXR encoder refused the image.
    #[error("{}: cannot encode the image", path.display())]
    Exr {
        /// The image.
        path: PathBuf,
        /// What the encoder said.
        source: exr::error::Error,
    },
    /// An image that was to be read is missing, damaged or has no colours.
    #[error("{}: cannot read the image: {message}", path.display())]
    Unreadable {
        /// The image.
        path: PathBuf,
        /// What is wrong with it.
        message: String,
    },
    /// The PNG encoder refused the image.
    #[error("{}: cannot encode the image", path.display())]
    Png {
        /// The image.
        path: PathBuf,
        /// What the encoder said.
        source: png::EncodingError,
    },
}

/// Where an image comes from: what its attributes say.
#[derive(Clone, Debug, PartialEq)]
pub struct Provenance {
    /// World space to the camera's: x right, y up, z backwards.
    pub camera_from_world: DMat4,
    /// Half the width and height of the image plane at distance 1.
    pub half_size: glam::DVec2,
    /// Samples a pixel.
    pub spp: u32,
    /// Seed of the random streams.
    pub seed: u64,
    /// Frame number.
    pub frame: i32,
    /// Hash of the scene.
    pub scene_hash: u64,
    /// The command that rendered the image.
    pub command_line: String,
    /// Wall-clock seconds of rendering.
    pub render_secs: f64,
    /// Largest memory of the process so far, if the system tells.
    pub peak_memory_bytes: Option<u64>,
    /// Statistics, as JSON.
    pub stats_json: String,
}

/// Writes `film` as an EXR.
///
/// # Errors
/// If the folder cannot be made or the file not be written; no part of it is then left.
pub fn write_exr(path: &Path, film: &Film, provenance: &Provenance) -> Result<(), OutputError> {
    write_layer(path, film, provenance, channels(film, Colours::Half))
}

/// Writes `film` as an EXR whose `R G B` are float: to compare with, where a half's rounding would
/// be taken for bias.
///
/// # Errors
/// If the folder cannot be made or the file not be written; no part of it is then left.
pub fn write_float_exr(
    path: &Path,
    film: &Film,
    provenance: &Provenance,
) -> Result<(), OutputError> {
    write_layer(path, film, provenance, channels(film, Colours::Float))
}

fn write_layer(
    path: &Path,
    film: &Film,
    provenance: &Provenance,
    channels: AnyChannels<FlatSamples>,
) -> Result<(), OutputError> {
    let size = (film.width() as usize, film.height() as usize);
    let encoding = Encoding::SMALL_LOSSLESS;
    let layer = Layer::new(size, attributes(provenance), encoding, channels);
    let mut image = Image::from_layer(layer);
    image.attributes.chromaticities = Some(REC_709);
    write_whole(path, |file| {
        let result = image.write().to_buffered(BufWriter::new(file));
        result.map_err(|source| OutputError::Exr {
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

/// Writes `film` as an 8 bit sRGB picture.
///
/// # Errors
/// If the folder cannot be made or the file not be written; no part of it is then left.
pub fn write_png(path: &Path, film: &Film) -> Result<(), OutputError> {
    let pixels = film.pixels();
    let bytes: Vec<u8> = pixels.iter().flat_map(|p| p.mean.map(srgb_byte)).collect();
    write_whole(path, |file| {
        let mut encoder = png::Encoder::new(BufWriter::new(file), film.width(), film.height());
        encoder.set_color(png::ColorType::Rgb);
        encoder.set_depth(png::BitDepth::Eight);
        encoder.set_source_srgb(png::SrgbRenderingIntent::RelativeColorimetric);
        let write = |encoder: png::Encoder<'_, _>| {
            let mut writer = encoder.write_header()?;
            writer.write_image_data(&bytes)?;
            writer.finish()
        };
        write(encoder).map_err(|source| OutputError::Png {
            path: path.to_owned(),
            source,
        })
    })
}

/// Writes a text, such as statistics, with the same care as images.
///
/// # Errors
/// If the folder cannot be made or the file not be written; no part of it is then left.
pub fn write_text(path: &Path, text: &str) -> Result<(), OutputError> {
    write_whole(path, |file| {
        file.write_all(text.as_bytes())
            .map_err(|source| OutputError::Io {
                path: path.to_owned(),
                source,
            })
    })
}

/// Writes bytes with the same care as images.
///
/// # Errors
/// If the folder cannot be made or the file not be written; no part of it is then left.
pub fn write_bytes(path: &Path, bytes: &[u8]) -> Result<(), OutputError> {
    write_whole(path, |file| {
        file.write_all(bytes).map_err(|source| OutputError::Io {
            path: path.to_owned(),
            source,
        })
    })
}

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
    let image = read_first_flat_layer_from_file(path).map_err(|e| unreadable(e.to_string()))?;
    let layer = image.layer_data;
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

/// Finds out whether `path` can be written, before hours of work depend on it.
///
/// Makes the folder if it is missing and leaves nothing else behind.
///
/// # Errors
/// If the folder cannot be made, no file can be made in it, or `path` is a folder itself.
pub fn check_writable(path: &Path) -> Result<(), OutputError> {
    if path.is_dir() {
        let source = io::ErrorKind::IsADirectory.into();
        let path = path.to_owned();
        return Err(OutputError::Io { path, source });
    }
    temporary_beside(path).map(drop)
}

/// Fills a temporary file beside `path` by `fill`, then renames it to `path`.
fn write_whole(
    path: &Path,
    fill: impl FnOnce(&mut File) -> Result<(), OutputError>,
) -> Result<(), OutputError> {
    let io_error = |source| OutputError::Io {
        path: path.to_owned(),
        source,
    };
    // Removed on drop, so an error on any of the following lines leaves nothing behind.
    let mut file = temporary_beside(path)?;
    fill(file.as_file_mut())?;
    file.as_file_mut().flush().map_err(io_error)?;
    file.as_file().sync_all().map_err(io_error)?;
    file.persist(path).map_err(|e| io_error(e.error))?;
    Ok(())
}

/// Makes a temporary file in the folder of `path`, and the folder if it is missing.
///
/// The umask applies as for any new file: a frame that a farm's other machines cannot read is
/// of no use.
fn temporary_beside(path: &Path) -> Result<NamedTempFile, OutputError> {
    let io_error = |source| OutputError::Io {
        path: path.to_owned(),
        source,
    };
    let folder = match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    };
    std::fs::create_dir_all(folder).map_err(io_error)?;
    let mut builder = tempfile::Builder::new();
    builder.prefix(".majorant-").suffix(".part");
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt as _;
        // The default of a temporary file is 0600; the umask is taken off this.
        builder.permissions(std::fs::Permissions::from_mode(0o666));
    }
    builder.tempfile_in(folder).map_err(io_error)
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
    let list: SmallVec<[AnyChannel<FlatSamples>; 4]> = [
        colour("R", &|p| p.mean[0]),
        colour("G", &|p| p.mean[1]),
        colour("B", &|p| p.mean[2]),
        half("A", &Pixel::alpha),
        float("Z", &depth),
        float("variance.R", &|p| p.variance_of_mean()[0]),
        float("variance.G", &|p| p.variance_of_mean()[1]),
        float("variance.B", &|p| p.variance_of_mean()[2]),
        float("sampleCount", &|p| p.count as f64),
    ]
    .into_iter()
    .collect();
    AnyChannels::sort(list)
}

/// The largest finite half.
const HALF_MAX: f64 = 65504.0;

/// BIAS: what a half cannot hold is clamped, and counted, rather than written as infinity,
/// which a compositor's blur spreads over the picture.
fn to_half(x: f64) -> f16 {
    f16::from_f64(x.min(HALF_MAX))
}

/// Encodes a linear value for an 8 bit sRGB picture, clamped to [0, 1].
///
/// # Reference
/// `[Stokes1996]`.
pub fn srgb_byte(linear: f64) -> u8 {
    let x = linear.clamp(0.0, 1.0);
    let encoded = if x <= 0.003_130_8 {
        12.92 * x
    } else {
        1.055 * x.powf(1.0 / 2.4) - 0.055
    };
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "in 0..=255 after clamping; NaN becomes 0"
    )]
    let byte = (encoded * 255.0 + 0.5) as u8;
    byte
}

/// Primaries and white point of Rec. 709.
const REC_709: Chromaticities = Chromaticities {
    red: Vec2(0.64, 0.33),
    green: Vec2(0.30, 0.60),
    blue: Vec2(0.15, 0.06),
    white: Vec2(0.3127, 0.3290),
};

fn attributes(provenance: &Provenance) -> LayerAttributes {
    let Provenance {
        camera_from_world,
        half_size,
        spp,
        seed,
        frame,
        scene_hash,
        command_line,
        render_secs,
        peak_memory_bytes,
        stats_json,
    } = provenance;
    let version = env!("CARGO_PKG_VERSION");
    // OpenEXR's camera space is left-handed: x right, y up, z into the scene.
    let flip = DMat4::from_scale(glam::DVec3::new(1.0, 1.0, -1.0));
    let world_to_camera = flip * *camera_from_world;
    // x and y in [-1, 1] over the image after division by w = z; z becomes 1 / depth.
    let project = DMat4::from_cols(
        glam::DVec4::X / half_size.x,
        glam::DVec4::Y / half_size.y,
        glam::DVec4::W,
        glam::DVec4::Z,
    );
    let text = |s: &str| AttributeValue::Text(text(s));
    let other = [
        ("majorant/version", text(version)),
        ("majorant/spp", text(&spp.to_string())),
        ("majorant/seed", text(&seed.to_string())),
        ("majorant/frame", AttributeValue::I32(*frame)),
        ("majorant/sampleRange", text(&format!("0..{spp}"))),
        ("majorant/sceneHash", text(&format!("{scene_hash:016x}"))),
        ("majorant/commandLine", text(command_line)),
        ("majorant/renderTime", AttributeValue::F64(*render_secs)),
        ("majorant/stats", text(stats_json)),
    ];
    let mut layer = LayerAttributes {
        software_name: Some(self::text(&format!("majorant {version}"))),
        capture_date: Some(self::text(&capture_date(SystemTime::now()))),
        utc_offset: Some(0.0),
        world_to_camera: Some(row_vector_matrix(world_to_camera)),
        world_to_normalized_device: Some(row_vector_matrix(project * world_to_camera)),
        ..LayerAttributes::default()
    };
    layer.other = other.into_iter().map(|(k, v)| (self::text(k), v)).collect();
    if let Some(bytes) = peak_memory_bytes {
        let value = text(&bytes.to_string());
        layer.other.insert(self::text("majorant/peakMemory"), value);
    }
    layer
}

/// EXR texts are bytes; whatever is not ASCII is written as `?`, so that any reader shows it.
fn text(s: &str) -> Text {
    let ascii: String = s
        .chars()
        .map(|c| if c.is_ascii() { c } else { '?' })
        .collect();
    Text::new_or_none(ascii).expect("ASCII is representable")
}

/// EXR stores matrices row by row for row vectors; ours act on column vectors, so the columns
/// are the rows wanted: the translation comes last.
#[expect(clippy::cast_possible_truncation, reason = "EXR matrices are f32")]
fn row_vector_matrix(m: DMat4) -> [f32; 16] {
    m.to_cols_array().map(|x| x as f32)
}

/// Returns `YYYY:MM:DD hh:mm:ss` in UTC.
fn capture_date(now: SystemTime) -> String {
    let secs = now.duration_since(UNIX_EPOCH).map_or(0, |d| d.as_secs());
    let (days, rest) = (secs / 86_400, secs % 86_400);
    let (year, month, day) = civil_from_days(days);
    let (hour, minute, second) = (rest / 3600, rest / 60 % 60, rest % 60);
    format!("{year:04}:{month:02}:{day:02} {hour:02}:{minute:02}:{second:02}")
}

/// Returns year, month and day of the day `days` after 1970-01-01, in the Gregorian calendar.
fn civil_from_days(mut days: u64) -> (u64, u64, u64) {
    let is_leap = |y: u64| y.is_multiple_of(4) && (!y.is_multiple_of(100) || y.is_multiple_of(400));
    let mut year = 1970;
    loop {
        let len = 365 + u64::from(is_leap(year));
        if days < len {
            break;
        }
        days -= len;
        year += 1;
    }
    let lengths = [
        31,
        28 + u64::from(is_leap(year)),
        31,
        30,
        31,
        30,
        31,
        31,
        30,
        31,
        30,
        31,
    ];
    let mut month = 1;
    for len in lengths {
        if days < len {
            break;
        }
        days -= len;
        month += 1;
    }
    (year, month, days + 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn srgb_bytes_are_those_of_the_standard() {
        // 0.5 encodes to 0.735 357 of 255 = 187.5; 0.214 041 is mid-grey 127.5 of 255.
        for (linear, byte) in [(0.0, 0), (1.0, 255), (0.5, 188), (0.0021, 7), (-1.0, 0)] {
            assert_eq!(srgb_byte(linear), byte, "of {linear}");
        }
        assert_eq!(srgb_byte(7.0), 255, "clamped");
        assert_eq!(srgb_byte(f64::NAN), 0, "not a number");
    }

    #[test]
    fn dates_are_gregorian() {
        for (days, date) in [
            (0, (1970, 1, 1)),
            (59, (1970, 3, 1)),
            (11_016, (2000, 2, 29)),
            (20_089, (2025, 1, 1)),
        ] {
            assert_eq!(civil_from_days(days), date, "day {days}");
        }
    }

    #[test]
    fn halves_never_overflow() {
        assert_eq!(to_half(1e9).to_f64(), HALF_MAX);
        assert_eq!(to_half(0.25).to_f64(), 0.25);
    }
}

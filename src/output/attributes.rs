//! Where an image comes from, as attributes of an EXR.

use std::time::{SystemTime, UNIX_EPOCH};

use exr::meta::attribute::{AttributeValue, Text};
use exr::prelude::LayerAttributes;
use glam::DMat4;

use super::SampleRanges;

const VERSION: &str = "majorant/version";
const SCENE_HASH: &str = "majorant/sceneHash";
const SAMPLE_RANGE: &str = "majorant/sampleRange";
const NOISE_LIMIT: &str = "majorant/noiseLimit";
const SAMPLE_COUNT: &str = "majorant/spp";
const COMMAND_LINE: &str = "majorant/commandLine";
const RENDER_TIME: &str = "majorant/renderTime";
const PEAK_MEMORY: &str = "majorant/peakMemory";
const STATS: &str = "majorant/stats";

/// What decides, with the size, whether two images are one: a frame on disk of the same identity
/// need not be rendered again.
#[derive(Clone, Debug, PartialEq)]
pub struct Identity {
    /// The program's version.
    pub version: String,
    /// Hash of the scene.
    pub scene_hash: u64,
    /// Which samples a pixel has, at most.
    pub samples: SampleRanges,
    /// The relative error at which it was enough, if one was asked for.
    pub noise_limit: Option<f64>,
}

impl Identity {
    /// Reads the identity of an image; `None` if it has none.
    pub(super) fn of(attributes: &LayerAttributes) -> Option<Self> {
        let text = |key: &str| match attributes.other.get(key.as_bytes())? {
            AttributeValue::Text(text) => Some(text.to_string()),
            _ => None,
        };
        let noise_limit = match text(NOISE_LIMIT) {
            None => None,
            Some(limit) => Some(limit.parse().ok()?),
        };
        Some(Self {
            version: text(VERSION)?,
            scene_hash: u64::from_str_radix(&text(SCENE_HASH)?, 16).ok()?,
            samples: text(SAMPLE_RANGE)?.parse().ok()?,
            noise_limit,
        })
    }
}

/// The attributes of an image on disk.
#[derive(Clone, Debug, PartialEq)]
pub struct Origin(LayerAttributes);

impl Origin {
    pub(super) fn new(attributes: LayerAttributes) -> Self {
        Self(attributes)
    }

    /// Returns the wall-clock seconds that the image took, if it says.
    pub fn render_secs(&self) -> Option<f64> {
        match self.0.other.get(RENDER_TIME.as_bytes())? {
            AttributeValue::F64(secs) => Some(*secs),
            _ => None,
        }
    }

    /// Returns the attributes of an image that was put together from this one and others.
    pub(super) fn merged(
        &self,
        samples: &SampleRanges,
        secs: f64,
        command: &str,
    ) -> LayerAttributes {
        let mut layer = self.0.clone();
        let mut put = |key: &str, value: AttributeValue| layer.other.insert(text(key), value);
        put(
            SAMPLE_RANGE,
            AttributeValue::Text(text(&samples.to_string())),
        );
        let count = samples.count().to_string();
        put(SAMPLE_COUNT, AttributeValue::Text(text(&count)));
        put(RENDER_TIME, AttributeValue::F64(secs));
        put(COMMAND_LINE, AttributeValue::Text(text(command)));
        // Those of one part say nothing of the whole.
        for key in [STATS, PEAK_MEMORY] {
            layer.other.remove(&text(key));
        }
        layer.capture_date = Some(text(&capture_date(SystemTime::now())));
        layer
    }
}

/// Where an image comes from: what its attributes say.
#[derive(Clone, Debug, PartialEq)]
pub struct Provenance {
    /// World space to the camera's: x right, y up, z backwards.
    pub camera_from_world: DMat4,
    /// Half the width and height of the image plane at distance 1.
    pub half_size: glam::DVec2,
    /// What is rendered, and how far.
    pub identity: Identity,
    /// Seed of the random streams.
    pub seed: u64,
    /// Frame number.
    pub frame: i32,
    /// The command that rendered the image.
    pub command_line: String,
    /// Wall-clock seconds of rendering.
    pub render_secs: f64,
    /// Largest memory of the process so far, if the system tells.
    pub peak_memory_bytes: Option<u64>,
    /// Statistics, as JSON.
    pub stats_json: String,
}

pub(super) fn attributes(provenance: &Provenance) -> LayerAttributes {
    let Provenance {
        camera_from_world,
        half_size,
        identity,
        seed,
        frame,
        command_line,
        render_secs,
        peak_memory_bytes,
        stats_json,
    } = provenance;
    let Identity {
        version,
        scene_hash,
        samples,
        noise_limit,
    } = identity;
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
        (VERSION, text(version)),
        (SAMPLE_COUNT, text(&samples.count().to_string())),
        ("majorant/seed", text(&seed.to_string())),
        ("majorant/frame", AttributeValue::I32(*frame)),
        (SAMPLE_RANGE, text(&samples.to_string())),
        (SCENE_HASH, text(&format!("{scene_hash:016x}"))),
        (COMMAND_LINE, text(command_line)),
        (RENDER_TIME, AttributeValue::F64(*render_secs)),
        (STATS, text(stats_json)),
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
    if let Some(limit) = noise_limit {
        let value = text(&limit.to_string());
        layer.other.insert(self::text(NOISE_LIMIT), value);
    }
    if let Some(bytes) = peak_memory_bytes {
        let value = text(&bytes.to_string());
        layer.other.insert(self::text(PEAK_MEMORY), value);
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
}

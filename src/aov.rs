//! Arbitrary output variables by name: which channels an image has beside its colours.
//!
//! What a channel holds is told where it is filled (`render`); here are names alone, and the film's
//! planes for those that are asked for. Nothing is allocated for the others.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Something to write beside the colours.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Aov {
    /// What the media let through along camera rays.
    Transmittance,
    /// Where the media begin and end along the ray through the pixel's centre.
    Depth,
    /// Albedo at the first collision.
    Albedo,
    /// Direction of falling density at the first collision.
    Normal,
    /// Light that comes straight to the camera: emission and the sky behind.
    Emission,
    /// Light that is scattered once.
    Direct,
    /// Light that is scattered more than once.
    Indirect,
    /// Light by where it comes from.
    Lights,
    /// Voxel values read.
    Lookups,
}

impl Aov {
    /// All of them, in the order of the documentation.
    pub const ALL: &'static [Self] = &[
        Self::Transmittance,
        Self::Depth,
        Self::Albedo,
        Self::Normal,
        Self::Emission,
        Self::Direct,
        Self::Indirect,
        Self::Lights,
        Self::Lookups,
    ];

    /// Returns its name in scene files and on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Transmittance => "transmittance",
            Self::Depth => "depth",
            Self::Albedo => "albedo",
            Self::Normal => "normal",
            Self::Emission => "emission",
            Self::Direct => "direct",
            Self::Indirect => "indirect",
            Self::Lights => "lights",
            Self::Lookups => "lookups",
        }
    }

    /// Returns the channels it is written as, but for those of [`Lights`](Self::Lights), which are
    /// three for each.
    fn fixed_channels(self) -> &'static [&'static str] {
        match self {
            Self::Transmittance => &["transmittance"],
            Self::Depth => &["depth.front", "depth.back"],
            Self::Albedo => &["albedo.R", "albedo.G", "albedo.B"],
            Self::Normal => &["normal.X", "normal.Y", "normal.Z"],
            Self::Emission => &["emission.R", "emission.G", "emission.B"],
            Self::Direct => &["direct.R", "direct.G", "direct.B"],
            Self::Indirect => &["indirect.R", "indirect.G", "indirect.B"],
            Self::Lights => &[],
            Self::Lookups => &["lookups"],
        }
    }
}

/// What the names of channels of lights begin with.
const LIGHT: &str = "light.";

/// Returns the channels that `aovs` are written as, in the order of a pixel's values, where the lights
/// have these names.
pub fn channels(aovs: &[Aov], lights: &[String]) -> Vec<String> {
    let mut channels = Vec::new();
    for aov in aovs {
        channels.extend(aov.fixed_channels().iter().map(|&name| name.to_owned()));
        if *aov == Aov::Lights {
            for light in lights {
                channels.extend(["R", "G", "B"].map(|c| format!("{LIGHT}{light}.{c}")));
            }
        }
    }
    channels
}

/// Returns whether a channel is one of an output variable.
pub fn is_channel(name: &str) -> bool {
    let mut fixed = Aov::ALL.iter().flat_map(|aov| aov.fixed_channels());
    name.starts_with(LIGHT) || fixed.any(|&channel| channel == name)
}

/// Values of channels for each pixel.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Planes {
    channels: Vec<String>,
    /// `[pixel][channel]`, channels fastest.
    values: Vec<f32>,
}

impl Planes {
    /// Makes planes of zeros for `pixel_count` pixels.
    pub fn new(channels: &[String], pixel_count: usize) -> Self {
        Self {
            channels: channels.to_vec(),
            values: vec![0.0; channels.len() * pixel_count],
        }
    }

    /// Merges the means of other samples of pixel `index`, which are `share` of all samples, into
    /// these. Both have the same channels.
    pub fn merge_pixel(&mut self, other: &Self, index: usize, share: f64) {
        let count = self.channels.len();
        let range = index * count..(index + 1) * count;
        for (a, b) in self.values[range.clone()]
            .iter_mut()
            .zip(&other.values[range])
        {
            // Equal ones may be infinite: depths where there is nothing.
            if a != b {
                let (x, y) = (f64::from(*a), f64::from(*b));
                #[expect(clippy::cast_possible_truncation, reason = "planes are f32")]
                let mean = (x + (y - x) * share) as f32;
                *a = mean;
            }
        }
    }

    /// Returns the channels' names, in the order of a pixel's values.
    pub fn channels(&self) -> &[String] {
        &self.channels
    }

    /// Returns the values of a channel, pixel by pixel.
    pub fn plane(&self, channel: usize) -> impl Iterator<Item = f32> + '_ {
        let count = self.channels.len().max(1);
        self.values.iter().skip(channel).step_by(count).copied()
    }

    /// Returns the values of a pixel, to be filled.
    pub fn pixel_mut(&mut self, index: usize) -> &mut [f32] {
        let count = self.channels.len();
        &mut self.values[index * count..(index + 1) * count]
    }
}

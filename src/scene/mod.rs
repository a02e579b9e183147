//! From a scene file, or a bare volume, to everything a frame needs.
//!
//! ```text
//! scene.toml ── SceneFile::read ──┐                       ┌─ LoadedVolumes ◄── .vdb
//!                                 ├─► check ─► Checked ───┴─► into_scene ─► Scene
//! bare .vdb ─── default_look ─────┘   (no file touched)
//! ```
//!
//! A bare volume takes the same way: its default look is written as a scene file and read
//! back, so what `--print-scene` prints is exactly what is rendered.
//!
//! Every number is checked here, once; whatever follows may rely on it.

mod check;
mod check_albedo;
mod check_emission;
mod check_light;
mod check_phase;
mod check_tracking;
pub mod default_look;
pub mod desc;
mod environment;
mod error;
mod fields;
mod files;
mod framing;
mod keyframes;
mod load;
mod placement;
mod schema;
mod template;
mod value;
mod write;

pub use check::{BYTES_PER_PIXEL, Checked, MAX_RESOLUTION};
pub use error::{DescriptionError, SceneError};
pub use files::MissingFile;
pub use load::{LoadOptions, LoadStage, LoadedVolume};
pub use schema::schema;
pub use template::SceneTemplate;

use std::path::Path;

use crate::aov::{self, Aov};
use crate::camera::Camera;
use crate::integrator::TransportSettings;
use crate::light::Lights;
use crate::medium::Medium;
use desc::SceneDesc;
use error::Source;

/// Everything a frame needs, loaded and checked.
#[derive(Debug)]
pub struct Scene {
    /// Columns of the image.
    pub width: u32,
    /// Rows of the image.
    pub height: u32,
    /// Samples a pixel.
    pub spp: u32,
    /// Seed of all random streams.
    pub seed: u64,
    /// Frame number: part of the random streams' key.
    pub frame: i32,
    /// The camera.
    pub camera: Camera,
    /// The media: their coefficients add up where they overlap.
    pub media: Vec<Medium>,
    /// The lights.
    pub lights: Lights,
    /// Light transport.
    pub transport: TransportSettings,
    /// What is written beside the colours.
    pub aovs: Vec<Aov>,
}

impl Scene {
    /// Returns the channels that are written beside the colours.
    pub fn channels(&self) -> Vec<String> {
        aov::channels(&self.aovs, &self.lights.names())
    }
}

/// A scene file's text and what it says at one frame, not yet checked.
#[derive(Clone, Debug, PartialEq)]
pub struct SceneFile {
    source: Source,
    /// What the file says. Change it to override the file.
    pub desc: SceneDesc,
}

impl SceneFile {
    /// Reads a scene file, at the frame that it says.
    ///
    /// # Errors
    /// If it cannot be read, is not TOML, or has unknown, missing or mistyped keys.
    pub fn read(path: &Path) -> Result<Self, SceneError> {
        SceneTemplate::read(path)?.at(None)
    }

    /// Reads the text of a scene file; `path` is what errors call it and what files are
    /// relative to.
    ///
    /// # Errors
    /// If it is not TOML, or has unknown, missing or mistyped keys.
    ///
    /// # Examples
    /// ```
    /// use majorant::scene::SceneFile;
    /// let text = "[camera]\nposition = [0, -3, 0]\nlook_at = [0, 0, 0]\nupp = [0, 0, 1]\n";
    /// let error = SceneFile::parse("a.toml".as_ref(), text.to_owned()).unwrap_err();
    /// assert!(error.to_string().starts_with("a.toml:4:1: unknown field `upp`"));
    /// ```
    pub fn parse(path: &Path, text: String) -> Result<Self, SceneError> {
        SceneTemplate::new(path, text).at(None)
    }

    /// Returns the file's text as it was read or chosen.
    pub fn text(&self) -> &str {
        &self.source.text
    }

    /// Writes what the scene says as a clean scene file below a header of comments.
    ///
    /// Comments of the text it was read from are not kept. Reading the result gives an equal
    /// description.
    pub fn to_toml(&self, header: &str) -> String {
        write::to_toml(&self.desc, header)
    }

    /// Returns a hash of all that decides a pixel's expectation and noise, but not how many
    /// samples: parts of one picture have equal hashes.
    ///
    /// Volumes count by file name, length, and their first and last 64 KiB: there is the identifier
    /// that OpenVDB gives to every file anew.
    pub fn hash<'p>(&self, volume_paths: impl IntoIterator<Item = &'p Path>) -> u64 {
        let mut desc = self.desc.clone();
        desc.render.spp = desc::unplaced(1);
        for volume in &mut desc.volume {
            let volume = volume.get_mut();
            let name = volume.file.get_ref().file_name().unwrap_or_default();
            volume.file = desc::unplaced(name.into());
        }
        let files = volume_paths.into_iter().map(files::fingerprint);
        let files = files.collect::<Vec<_>>().join(" ");
        fnv1a(write::to_toml(&desc, &files).as_bytes())
    }
}

/// # Reference
/// `[Fowler2019]`: FNV-1a, 64 bits; stable over versions and machines, which the standard library's
/// hasher is not.
fn fnv1a(bytes: &[u8]) -> u64 {
    bytes.iter().fold(0xcbf2_9ce4_8422_2325, |hash, &byte| {
        (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3)
    })
}

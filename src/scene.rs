//! The validated, loaded scene.

use crate::camera::Camera;
use crate::integrator::TransportSettings;
use crate::light::Lights;
use crate::medium::Medium;

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
    /// The medium, if there is one.
    pub medium: Option<Medium>,
    /// The lights.
    pub lights: Lights,
    /// Light transport.
    pub transport: TransportSettings,
}

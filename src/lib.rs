//! majorant: unbiased rendering of OpenVDB clouds, smoke and fire on the CPU.

pub mod camera;
pub mod film;
pub mod grid;
pub mod integrator;
pub mod light;
pub mod medium;
pub mod output;
pub mod phase;
pub mod plan;
pub mod render;
pub mod sampling;
pub mod scene;
pub mod space;
pub mod spectrum;
pub mod stats;
pub mod tracking;
pub mod vdb;

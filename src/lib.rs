//! majorant: unbiased rendering of OpenVDB clouds, smoke and fire on the CPU.

pub mod grid;
pub mod space;
pub mod spectrum;
pub mod vdb;

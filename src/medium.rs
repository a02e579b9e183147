//! A grid with optics: density times a scale is extinction; albedo and phase say the rest.

use std::sync::Arc;

use crate::grid::DensityGrid;
use crate::phase::Phase;
use crate::spectrum::Rgb;

/// A participating medium whose extinction follows a density grid.
#[derive(Clone, Debug)]
pub struct Medium {
    pub(crate) grid: Arc<DensityGrid>,
    pub(crate) sigma_t_per_density: f32,
    pub(crate) albedo: Rgb,
    pub(crate) phase: Phase,
}

impl Medium {
    /// Makes a medium: `sigma_t = sigma_t_per_density · density`, per world unit.
    pub fn new(
        grid: Arc<DensityGrid>,
        sigma_t_per_density: f32,
        albedo: Rgb,
        phase: Phase,
    ) -> Self {
        Self {
            grid,
            sigma_t_per_density,
            albedo,
            phase,
        }
    }
}

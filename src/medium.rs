//! A grid with optics: density times a scale is extinction; albedo and phase say the rest.
//!
//! What the tracking above sees of it is two things: segments of constant bound along a ray,
//! and the extinction at a point of the current segment. Voxels and index space end here.

use std::sync::Arc;

use crate::grid::{Columns, DensityGrid, Sampler, Segment, Traversal};
use crate::phase::Phase;
use crate::space::Ray;
use crate::spectrum::Rgb;
use glam::{DAffine3, DVec3};

/// A participating medium whose gray extinction follows a density grid.
#[derive(Clone, Debug)]
pub struct Medium {
    grid: Arc<DensityGrid>,
    sigma_t_per_density: f32,
    albedo: Rgb,
    phase: Phase,
}

impl Medium {
    /// Makes a medium: `sigma_t = sigma_t_per_density · density`, per world unit.
    ///
    /// `sigma_t_per_density` and `albedo` must be finite and not negative.
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

    /// Returns a medium of the same grid with other optics; nothing is copied.
    #[must_use]
    pub fn with_optics(&self, sigma_t_per_density: f32, albedo: Rgb, phase: Phase) -> Self {
        Self::new(Arc::clone(&self.grid), sigma_t_per_density, albedo, phase)
    }

    /// Returns the grid that the extinction follows.
    pub fn grid(&self) -> &DensityGrid {
        &self.grid
    }

    /// Returns extinction per unit of density, per world unit.
    pub fn sigma_t_per_density(&self) -> f32 {
        self.sigma_t_per_density
    }

    /// Returns the single-scattering albedo, `sigma_s / sigma_t`.
    pub fn albedo(&self) -> Rgb {
        self.albedo
    }

    /// Returns the phase function.
    pub fn phase(&self) -> Phase {
        self.phase
    }

    /// Estimates, coarsely and once, the transmittance from every point towards `direction`.
    ///
    /// `None` for a medium without density. For importance only: not an unbiased estimate.
    pub fn light_columns(&self, direction: DVec3) -> Option<LightColumns> {
        let scale = f64::from(self.sigma_t_per_density);
        #[expect(clippy::cast_possible_truncation, reason = "a number in [0, 1]")]
        let root_transmittance = |column: f64| (-0.5 * scale * column).exp() as f32;
        Some(LightColumns {
            columns: Columns::new(&self.grid, direction, root_transmittance)?,
            index_from_world: self.grid.transform().index_from_world(),
        })
    }

    /// Prepares the walk of a ray through the medium, from `t = 0` to `t_max`.
    #[inline] // bench: frame
    pub fn ray(&self, ray: &Ray, t_max: f64) -> MediumRay<'_> {
        let to_index = self.grid.transform().index_from_world();
        let origin = to_index.transform_point3(ray.origin);
        let direction = to_index.transform_vector3(ray.direction);
        MediumRay {
            traversal: self.grid.traverse(origin, direction, t_max),
            sampler: self.grid.sampler(),
            origin,
            direction,
            sigma_t_per_density: self.sigma_t_per_density,
            segment: None,
        }
    }
}

/// Coarse estimates of the transmittance towards one direction.
#[derive(Clone, Debug)]
pub struct LightColumns {
    columns: Columns,
    index_from_world: DAffine3,
}

impl LightColumns {
    /// Returns an estimate of the square root of the transmittance from `p_world`.
    #[inline] // bench: frame
    pub fn root_transmittance(&self, p_world: DVec3) -> f32 {
        self.columns
            .at(self.index_from_world.transform_point3(p_world))
    }
}

/// An interval of a ray on which the extinction lies between two constants.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BoundSegment {
    /// World distance of the start.
    pub t0: f64,
    /// World distance of the end.
    pub t1: f64,
    /// The extinction is nowhere below, per world unit.
    pub sigma_min: f32,
    /// The extinction is nowhere above: the majorant.
    pub sigma_maj: f32,
}

impl BoundSegment {
    /// Returns whether the extinction is the same all along.
    pub fn is_homogeneous(&self) -> bool {
        self.sigma_min == self.sigma_maj
    }
}

/// One ray's walk through a medium.
#[derive(Debug)]
pub struct MediumRay<'a> {
    traversal: Traversal<'a>,
    sampler: Sampler<'a>,
    /// In index space.
    origin: DVec3,
    direction: DVec3,
    sigma_t_per_density: f32,
    segment: Option<Segment>,
}

impl MediumRay<'_> {
    /// Returns the next segment that is not empty. Segments are ordered and do not overlap.
    #[inline] // bench: frame
    pub fn next_segment(&mut self) -> Option<BoundSegment> {
        self.segment = self.traversal.next();
        let scale = self.sigma_t_per_density;
        self.segment.as_ref().map(|s| BoundSegment {
            t0: s.t0,
            t1: s.t1,
            sigma_min: s.bound.min * scale,
            sigma_maj: s.bound.max * scale,
        })
    }

    /// Returns an unbiased estimate of the extinction at `t` in the current segment: the value
    /// at one voxel drawn with its trilinear weight from 64 random `bits`.
    ///
    /// It never exceeds the segment's bound: the point is clamped into the segment's cell, so
    /// that rounding cannot carry it past a face, where other voxels are read.
    #[inline] // bench: frame
    pub fn estimate_sigma_t(&mut self, t: f64, bits: u64) -> f32 {
        let p = self.point_in_segment(t);
        self.sampler.stochastic(p, bits) * self.sigma_t_per_density
    }

    /// Returns the trilinear extinction at `t` in the current segment.
    pub fn sigma_t(&mut self, t: f64) -> f32 {
        let p = self.point_in_segment(t);
        self.sampler.trilinear(p) * self.sigma_t_per_density
    }

    #[inline] // bench: frame
    fn point_in_segment(&self, t: f64) -> DVec3 {
        let p = self.origin + self.direction * t;
        let Some(segment) = &self.segment else {
            return p;
        };
        let low = segment.cell.as_dvec3();
        p.max(low).min(low + f64::from(segment.cell_size))
    }
}

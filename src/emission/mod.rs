//! What a volume emits: a field with a law, and where its light comes from.
//!
//! * [`Glow`]: emitted radiance per unit length at a point, given by a grid, or by a temperature and
//!   the absorption of the medium.
//! * [`Emission`]: that in place, with a lattice of its power, from which points are drawn as of a
//!   light, and along rays.
//!
//! The absorption is the medium's business and handed in. No rays through media here.

mod glow;
mod lattice;

use std::ops::ControlFlow;

use glam::DVec3;

pub use glow::{Glow, Law};
use lattice::Lattice;

use crate::sampling::Stream;
use crate::space::{Aabb, Ray};
use crate::spectrum::Rgb;

/// A glow with the lattice of its power.
#[derive(Clone, Debug)]
pub struct Emission {
    glow: Glow,
    /// In index space, of the field.
    hull: Aabb,
    lattice: Lattice,
}

impl Emission {
    /// Prepares what emits `emitted` at a point in world space, in the box of `glow`. `None` if that
    /// is nothing.
    ///
    /// # Cost
    /// Some two million looks, in parallel.
    pub fn new(glow: Glow, emitted: impl Fn(&Glow, DVec3) -> Rgb + Sync) -> Option<Self> {
        let hull = glow.field().occupied()?;
        let transform = *glow.field().transform();
        let lattice = Lattice::new(&hull, transform, |p| emitted(&glow, p).max_channel())?;
        Some(Self {
            glow,
            hull,
            lattice,
        })
    }

    /// Returns the field and its law.
    pub fn glow(&self) -> &Glow {
        &self.glow
    }

    /// Returns the integral of the brightest channel over the volume, about: for importance.
    pub fn power(&self) -> f64 {
        self.lattice.power()
    }

    /// Returns the radiance, about, of a line through a point that emits much.
    pub fn typical_radiance(&self) -> f32 {
        self.lattice.typical().radiance
    }

    /// Returns the mean radiance, about, of all directions at a point as far away as the box of the
    /// field is wide.
    pub fn radiance_around(&self) -> f32 {
        self.lattice.radiance_around()
    }

    /// Returns over which length, about, such a line collects it.
    pub fn typical_length(&self) -> f32 {
        self.lattice.typical().length
    }

    /// Returns where `ray` is in the box of the field, if it ever is.
    pub fn interval(&self, ray: &Ray) -> Option<(f64, f64)> {
        let to_index = self.glow.field().transform().index_from_world();
        let origin = to_index.transform_point3(ray.origin);
        let direction = to_index.transform_vector3(ray.direction);
        self.hull.intersect(origin, direction)
    }

    /// Draws a point in world space, where much is emitted more often; returns it with its density
    /// per unit of volume.
    #[inline] // bench: frame
    pub fn sample_point(&self, stream: &mut Stream) -> (DVec3, f32) {
        self.lattice.sample(stream)
    }

    /// Returns the density of [`sample_point`](Self::sample_point) at a point in world space.
    #[inline] // bench: frame
    pub fn pdf_point(&self, p_world: DVec3) -> f32 {
        self.lattice.pdf(p_world)
    }

    /// Visits points of `ray` up to `t_max`, in order, each with a length: the sum of what is found
    /// at the points times their lengths has the integral along the ray as its expectation.
    ///
    /// There is a point for each `spacing` of radiance that the lattice expects; `u`, uniform in
    /// [0, 1), says where the first one lies.
    #[inline] // bench: frame
    pub fn for_each_point(
        &self,
        ray: &Ray,
        t_max: f64,
        (spacing, u): (f32, f32),
        visit: impl FnMut(f64, f32) -> ControlFlow<()>,
    ) {
        self.lattice.for_each_point(ray, t_max, (spacing, u), visit);
    }
}

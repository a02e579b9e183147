//! What a path brings home: its radiance alone, or in parts.
//!
//! Paths add up their light through one trait. For images it is a colour, and the rest of each call
//! is compiled away; for arbitrary output variables it is [`Parts`], sorted by how often light was
//! scattered and by where it comes from.

use glam::{DVec3, Vec3};

use crate::medium::Medium;
use crate::spectrum::Rgb;

/// Where light comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Source {
    /// Suns, but for their disks behind the medium.
    Sun = 0,
    /// Skies of all kinds, and all that a camera ray sees behind the media.
    Sky = 1,
    /// Points and spheres in the scene.
    Lamp = 2,
    /// What media emit.
    Emission = 3,
}

/// Adds up what a path finds.
pub(super) trait Gather: Default {
    /// Takes light of `source` that was scattered `order` times.
    fn add(&mut self, radiance: Rgb, order: u32, source: Source);

    /// Takes all that another has.
    fn merge(&mut self, other: Self);

    /// Takes the collision of the camera ray, at a point in world space, with its weight.
    fn meet(&mut self, medium: &Medium, p_world: DVec3, weight: f32);
}

/// Starts with what is seen behind the media.
#[inline] // bench: frame
pub(super) fn gathered<G: Gather>(behind: Rgb) -> G {
    let mut radiance = G::default();
    radiance.add(behind, 0, Source::Sky);
    radiance
}

impl Gather for Rgb {
    #[inline] // bench: frame
    fn add(&mut self, radiance: Rgb, _order: u32, _source: Source) {
        *self += radiance;
    }

    #[inline] // bench: frame
    fn merge(&mut self, other: Self) {
        *self += other;
    }

    #[inline] // bench: frame
    fn meet(&mut self, _medium: &Medium, _p_world: DVec3, _weight: f32) {}
}

/// Radiance in parts, and what the camera ray met.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Parts {
    /// All of it.
    pub radiance: Rgb,
    /// Not scattered, scattered once, and more than once: they add up to all.
    pub by_order: [Rgb; 3],
    /// By [`Source`]: they add up to all.
    pub by_source: [Rgb; 4],
    /// Albedo at the collision, weighted.
    pub albedo: Rgb,
    /// Direction of falling extinction at the collision, of unit length or zero, weighted.
    pub normal: Vec3,
    /// Weight of the collision.
    pub met: f32,
}

impl Parts {
    /// Returns those of a ray that sees the sky alone.
    pub fn of_sky(radiance: Rgb) -> Self {
        gathered(radiance)
    }
}

impl Gather for Parts {
    fn add(&mut self, radiance: Rgb, order: u32, source: Source) {
        self.radiance += radiance;
        self.by_order[order.min(2) as usize] += radiance;
        self.by_source[source as usize] += radiance;
    }

    fn merge(&mut self, other: Self) {
        let Self {
            radiance,
            by_order,
            by_source,
            albedo,
            normal,
            met,
        } = other;
        self.radiance += radiance;
        for (sum, x) in self.by_order.iter_mut().zip(by_order) {
            *sum += x;
        }
        for (sum, x) in self.by_source.iter_mut().zip(by_source) {
            *sum += x;
        }
        self.albedo += albedo;
        self.normal += normal;
        self.met += met;
    }

    fn meet(&mut self, medium: &Medium, p_world: DVec3, weight: f32) {
        self.met += weight;
        self.albedo += medium.albedo_at(p_world) * weight;
        self.normal -= medium.gradient(p_world).normalize_or_zero() * weight;
    }
}

//! What a path brings home: its radiance alone, or in parts.
//!
//! Paths add up their light through one trait. For images it is a colour, and the rest of each call
//! is compiled away; for arbitrary output variables it is [`Parts`], sorted by how often light was
//! scattered and by which light it comes from.

use glam::{DVec3, Vec3};

use crate::light::Lights;
use crate::medium::Medium;
use crate::spectrum::Rgb;

/// Where light comes from; numbers are those of the lists in [`Lights`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Source {
    /// A sun, its disk behind the medium included.
    Sun(usize),
    /// The sky that is the same from everywhere.
    Constant,
    /// A sky that is not.
    Map(usize),
    /// A point or a sphere in the scene.
    Lamp(usize),
    /// What media emit.
    Emission,
}

/// Adds up what a path finds.
pub(super) trait Gather: Sized {
    /// Starts with nothing, where these are the lights.
    fn of(lights: &Lights) -> Self;

    /// Takes light that was scattered `order` times; `split` says how much is whose.
    fn take(&mut self, radiance: Rgb, order: u32, split: impl FnOnce(&mut dyn FnMut(Source, Rgb)));

    /// Takes light of `source` that was scattered `order` times.
    #[inline] // bench: frame
    fn add(&mut self, radiance: Rgb, order: u32, source: Source) {
        self.take(radiance, order, |each| each(source, radiance));
    }

    /// Takes `weight` times the usual sky, as if it were scattered once.
    #[inline] // bench: frame
    fn add_usual(&mut self, lights: &Lights, weight: Rgb) {
        self.take(lights.usual_radiance() * weight, 1, |each| {
            each(Source::Constant, lights.environment * weight);
            for (i, map) in lights.maps.iter().enumerate() {
                each(Source::Map(i), map.usual_radiance() * weight);
            }
        });
    }

    /// Takes all that another has.
    fn merge(&mut self, other: Self);

    /// Takes the collision of the camera ray, at a point in world space, with its weight.
    fn meet(&mut self, medium: &Medium, p_world: DVec3, weight: f32);
}

/// Starts with what is seen behind the media, as far as it comes through.
#[inline] // bench: frame
pub(super) fn gathered<G: Gather>(lights: &Lights, direction: DVec3, through: Rgb) -> G {
    let mut radiance = G::of(lights);
    radiance.take(lights.radiance(direction) * through, 0, |each| {
        for (i, sun) in lights.distant.iter().enumerate() {
            each(Source::Sun(i), sun.radiance(direction) * through);
        }
        each(Source::Constant, lights.environment * through);
        for (i, map) in lights.maps.iter().enumerate() {
            each(Source::Map(i), map.radiance(direction) * through);
        }
    });
    radiance
}

impl Gather for Rgb {
    #[inline] // bench: frame
    fn of(_lights: &Lights) -> Self {
        Self::BLACK
    }

    #[inline] // bench: frame
    fn take(
        &mut self,
        radiance: Self,
        _order: u32,
        _split: impl FnOnce(&mut dyn FnMut(Source, Self)),
    ) {
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
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Parts {
    /// All of it.
    pub radiance: Rgb,
    /// Not scattered, scattered once, and more than once: they add up to all.
    pub by_order: [Rgb; 3],
    /// By light, in the order of [`Lights::names`]; they add up to all.
    pub by_light: Vec<Rgb>,
    /// Number of suns, and of all before the lights in the scene.
    starts: [usize; 2],
    /// Albedo at the collision, weighted.
    pub albedo: Rgb,
    /// Direction of falling extinction at the collision, of unit length or zero, weighted.
    pub normal: Vec3,
    /// Weight of the collision.
    pub met: f32,
}

impl Parts {
    /// Returns radiance of which no more is known.
    pub(super) fn unsorted(radiance: Rgb) -> Self {
        Self {
            radiance,
            ..Self::default()
        }
    }

    /// Returns those of a ray that sees the constant sky alone.
    pub fn of_sky(lights: &Lights) -> Self {
        let mut parts = Self::of(lights);
        parts.add(lights.environment, 0, Source::Constant);
        parts
    }
}

impl Gather for Parts {
    fn of(lights: &Lights) -> Self {
        let suns = lights.distant.len();
        let skies = suns + 1 + lights.maps.len();
        Self {
            by_light: vec![Rgb::BLACK; skies + lights.local.len() + 1],
            starts: [suns, skies],
            ..Self::default()
        }
    }

    fn take(&mut self, radiance: Rgb, order: u32, split: impl FnOnce(&mut dyn FnMut(Source, Rgb))) {
        let Self {
            radiance: all,
            by_order,
            by_light,
            starts: [suns, skies],
            ..
        } = self;
        *all += radiance;
        by_order[order.min(2) as usize] += radiance;
        let last = by_light.len() - 1;
        split(&mut |source, part| {
            let index = match source {
                Source::Sun(i) => i,
                Source::Constant => *suns,
                Source::Map(i) => *suns + 1 + i,
                Source::Lamp(i) => *skies + i,
                Source::Emission => last,
            };
            by_light[index] += part;
        });
    }

    fn merge(&mut self, other: Self) {
        let Self {
            radiance,
            by_order,
            by_light,
            starts: _,
            albedo,
            normal,
            met,
        } = other;
        self.radiance += radiance;
        for (sum, x) in self.by_order.iter_mut().zip(by_order) {
            *sum += x;
        }
        for (sum, x) in self.by_light.iter_mut().zip(by_light) {
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

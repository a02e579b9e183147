//! Lights: the distant sun, the sky, and lights that stand in the scene.
//!
//! A light either can be hit by a ray (the sky, a sun with a disk, a sphere) or cannot (a sun of
//! zero diameter, a point). What a scattered ray may count on leaving is decided by the integrator,
//! so that no light is counted twice.

mod distant;
mod environment;
mod equiangular;
mod local;
mod sun_sky;

use std::sync::Arc;

use glam::DVec3;

pub use self::distant::DistantLight;
pub use self::environment::{EnvironmentMap, EnvironmentTooLarge, MapSample, Orientation};
pub use self::equiangular::Equiangular;
pub use self::local::{LocalLight, LocalSample};
pub use self::sun_sky::{SUN_DIAMETER_DEGREES, SunSky};
use crate::spectrum::Rgb;

/// A direction to a light, with what arrives from there if nothing is in between.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LightSample {
    /// Unit vector to the light.
    pub direction: DVec3,
    /// Radiance divided by the density of the direction.
    pub weight: Rgb,
}

/// The lights of a scene.
#[derive(Clone, Debug, Default)]
pub struct Lights {
    /// Suns.
    pub distant: Vec<DistantLight>,
    /// Radiance of the sky that is the same from everywhere; black if there is none.
    pub environment: Rgb,
    /// Skies that differ from direction to direction, added to that.
    pub maps: Vec<Arc<EnvironmentMap>>,
    /// Points and spheres in the scene.
    pub local: Vec<LocalLight>,
}

/// A direction worth looking at.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Beacon {
    /// Unit vector to the light.
    pub direction: DVec3,
    /// Its brightest channel spread over the whole sphere.
    pub typical_radiance: f32,
}

impl Lights {
    /// Returns a radiance that is typical of what the lights make of a white medium, but for those
    /// in the scene, which are brighter or darker with the distance. For scales of importance,
    /// not for images.
    pub fn typical_radiance(&self) -> f32 {
        let suns = self.distant.iter().map(DistantLight::typical_radiance);
        let maps = self
            .maps
            .iter()
            .map(|map| map.mean_radiance().max_channel());
        self.environment.max_channel() + suns.sum::<f32>() + maps.sum::<f32>()
    }

    /// Returns the directions that much light comes from: those of the suns, in order, then of the
    /// brightest part of each map.
    pub fn beacons(&self) -> impl Iterator<Item = Beacon> + '_ {
        let suns = self.distant.iter().map(|sun| Beacon {
            direction: sun.direction(),
            typical_radiance: sun.typical_radiance(),
        });
        suns.chain(self.maps.iter().map(|map| map.beacon()))
    }

    /// Returns names of the lights for who wants to know whose light is whose: suns, the constant sky,
    /// other skies, lights in the scene, and what volumes emit.
    pub fn names(&self) -> Vec<String> {
        let numbered = |kind: &str, count: usize| -> Vec<String> {
            (0..count).map(|i| format!("{kind}{i}")).collect()
        };
        let mut names = numbered("sun", self.distant.len());
        names.push("constant".to_owned());
        names.extend(numbered("sky", self.maps.len()));
        names.extend(numbered("lamp", self.local.len()));
        names.push("emission".to_owned());
        names
    }

    /// Returns what a camera sees looking past the scene, if that is the same everywhere.
    pub fn constant_radiance(&self) -> Option<Rgb> {
        let seen = self.distant.iter().any(DistantLight::is_visible)
            || self.local.iter().any(LocalLight::is_visible)
            || !self.maps.is_empty();
        (!seen).then_some(self.environment)
    }

    /// Returns a radiance that is near that of most of the sky.
    pub fn usual_radiance(&self) -> Rgb {
        let maps = self.maps.iter().map(|map| map.usual_radiance());
        maps.fold(self.environment, |sum, usual| sum + usual)
    }

    /// Returns all that a camera sees looking past the scene: sky and suns' disks.
    pub fn radiance(&self, direction: DVec3) -> Rgb {
        let suns = self.distant.iter().map(|sun| sun.radiance(direction));
        let maps = self.maps.iter().map(|map| map.radiance(direction));
        suns.chain(maps)
            .fold(self.environment, |sum, radiance| sum + radiance)
    }
}

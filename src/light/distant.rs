//! The distant sun: parallel light, or light from a disk of constant radiance.

use std::f64::consts::PI;

use glam::DVec3;

use super::LightSample;
use crate::sampling::{Stream, sample_cone};
use crate::spectrum::Rgb;

/// A sun: parallel light, or light from a small disk of constant radiance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DistantLight {
    /// Unit vector from the scene to the light.
    direction_to_light: DVec3,
    /// Irradiance on a plane that faces the light.
    irradiance: Rgb,
    /// `1 − cos` of the disk's angular radius; 0 for parallel light.
    one_minus_cos: f64,
}

impl DistantLight {
    /// Makes a sun; `None` for a zero or non-finite direction, or a diameter outside [0, π).
    pub fn new(
        direction_to_light: DVec3,
        irradiance: Rgb,
        angular_diameter_radians: f64,
    ) -> Option<Self> {
        let direction_to_light = direction_to_light.try_normalize()?;
        // 1 - cos a = 2 sin²(a/2) keeps the digits of a small disk.
        let one_minus_cos = 2.0 * (angular_diameter_radians / 4.0).sin().powi(2);
        (0.0..PI)
            .contains(&angular_diameter_radians)
            .then_some(Self {
                direction_to_light,
                irradiance,
                one_minus_cos,
            })
    }

    /// Returns the unit vector to the light, the centre of its disk if it has one.
    pub fn direction(&self) -> DVec3 {
        self.direction_to_light
    }

    /// Returns the brightest channel of the light spread over the whole sphere.
    pub fn typical_radiance(&self) -> f32 {
        self.irradiance.max_channel() / (4.0 * std::f32::consts::PI)
    }

    /// Draws a direction to the light.
    #[inline] // bench: frame
    pub fn sample(&self, stream: &mut Stream) -> LightSample {
        let Self {
            direction_to_light,
            irradiance,
            one_minus_cos,
        } = *self;
        if one_minus_cos == 0.0 {
            // Zero: parallel light, the density is a delta that cancels.
            return LightSample {
                direction: direction_to_light,
                weight: irradiance,
            };
        }
        let direction = sample_cone(direction_to_light, one_minus_cos, stream);
        // radiance / density = radiance * solid angle, with density 1 / (2π x).
        #[expect(clippy::cast_possible_truncation, reason = "a solid angle in (0, 2π)")]
        let solid_angle = (2.0 * PI * one_minus_cos) as f32;
        LightSample {
            direction,
            weight: self.disk_radiance() * solid_angle,
        }
    }

    /// Returns the radiance seen in `direction`: that of the disk inside it, else none.
    pub fn radiance(&self, direction: DVec3) -> Rgb {
        let x = 1.0 - direction.dot(self.direction_to_light);
        // Zero: parallel light cannot be seen.
        if self.one_minus_cos > 0.0 && x <= self.one_minus_cos {
            self.disk_radiance()
        } else {
            Rgb::BLACK
        }
    }

    /// Returns whether there is a disk to be seen.
    pub fn is_visible(&self) -> bool {
        // Zero: parallel light.
        self.one_minus_cos > 0.0
    }

    /// Returns the radiance of the disk such that a facing plane receives the irradiance:
    /// E = ∫ L cos θ dω = L π sin²(radius).
    fn disk_radiance(&self) -> Rgb {
        let x = self.one_minus_cos;
        #[expect(clippy::cast_possible_truncation, reason = "radiance is f32")]
        let scale = (1.0 / (PI * x * (2.0 - x))) as f32;
        self.irradiance * scale
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampling::StreamKey;

    #[test]
    fn a_disk_delivers_its_irradiance() {
        let up = DVec3::new(0.0, 0.0, 2.0);
        for degrees in [0.0_f64, 0.53, 30.0, 170.0] {
            let sun = DistantLight::new(up, Rgb([6.0, 5.0, 4.0]), degrees.to_radians()).unwrap();
            let mut stream = Stream::new(StreamKey::default());
            let n = 20_000;
            let mut sum = 0.0;
            for _ in 0..n {
                let s = sun.sample(&mut stream);
                sum += f64::from(s.weight.0[0]) * s.direction.z;
                if degrees > 0.0 {
                    assert_eq!(
                        sun.radiance(s.direction),
                        sun.disk_radiance(),
                        "inside the disk"
                    );
                }
            }
            // At 170 degrees the cosine's deviation is 0.26: 5 sigma of the mean are 1.6 %.
            let mean = sum / f64::from(n);
            assert!((mean / 6.0 - 1.0).abs() < 0.02, "{degrees} degrees: {mean}");
        }
    }

    #[test]
    fn a_parallel_sun_cannot_be_seen() {
        let sun = DistantLight::new(DVec3::Z, Rgb::WHITE, 0.0).unwrap();
        assert_eq!(sun.radiance(DVec3::Z), Rgb::BLACK);
        assert!(DistantLight::new(DVec3::ZERO, Rgb::WHITE, 0.0).is_none());
        assert!(DistantLight::new(DVec3::Z, Rgb::WHITE, -0.1).is_none());
    }
}

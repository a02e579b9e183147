//! Distances along a ray, equally dense in the angle from a light.
//!
//! What a thin medium scatters of a point's light goes with the inverse square of the distance, and
//! so does this density: their quotient is constant, however near the ray passes.
//!
//! # Reference
//! `[Kulla2012]` sec. 4.

use glam::DVec3;

use crate::space::Ray;

/// The density over an interval of a ray.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Equiangular {
    /// Distance at which the ray is nearest to the light.
    nearest: f64,
    /// Distance of the two there, or more.
    height: f64,
    /// Angle from the nearest point at the start, and by how much it grows to the end.
    start: f64,
    angle: f64,
}

impl Equiangular {
    /// Sees the interval `(t0, t1)` of `ray` from the light at `p`; `None` where that is empty.
    ///
    /// `least_height` is above 0: on a ray through the light itself the density would be a delta.
    pub fn new(ray: &Ray, (t0, t1): (f64, f64), p: DVec3, least_height: f64) -> Option<Self> {
        let to_light = p - ray.origin;
        let nearest = to_light.dot(ray.direction);
        let height = (to_light - ray.direction * nearest)
            .length()
            .max(least_height);
        let start = ((t0 - nearest) / height).atan();
        let end = ((t1 - nearest) / height).atan();
        // Far away, the angle may be too small for f64 to tell.
        (t1 > t0 && end > start).then_some(Self {
            nearest,
            height,
            start,
            angle: end - start,
        })
    }

    /// Returns the distance for the uniform number `u` in [0, 1].
    pub fn sample(&self, u: f64) -> f64 {
        self.nearest + self.height * (self.start + u * self.angle).tan()
    }

    /// Returns the density of distance `t`, which must lie in the interval.
    pub fn pdf(&self, t: f64) -> f64 {
        let x = (t - self.nearest) / self.height;
        1.0 / (self.angle * self.height * (1.0 + x * x))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The inverse of the distribution, against the density by a midpoint rule.
    #[test]
    fn samples_follow_the_density() {
        let ray = Ray {
            origin: DVec3::new(-3.0, 0.0, 0.0),
            direction: DVec3::X,
        };
        for (p, least) in [
            (DVec3::new(0.0, 0.1, 0.0), 1e-6),
            (DVec3::ZERO, 0.01),
            (DVec3::new(-9.0, 0.0, 2.0), 1e-6),
        ] {
            let (t0, t1) = (1.0, 7.0);
            let light = Equiangular::new(&ray, (t0, t1), p, least).unwrap();
            assert!((light.sample(0.0) - t0).abs() < 1e-9 && (light.sample(1.0) - t1).abs() < 1e-9);
            for u in [0.01, 0.3, 0.5, 0.9] {
                let t = light.sample(u);
                let n = 2_000_000;
                let below: f64 = (0..n)
                    .map(|i| light.pdf(t0 + (t - t0) * (f64::from(i) + 0.5) / f64::from(n)))
                    .sum();
                let below = below * (t - t0) / f64::from(n);
                assert!((below - u).abs() < 1e-6, "{p}, u {u}: {below} lies below");
            }
        }
        assert_eq!(Equiangular::new(&ray, (1.0, 1.0), DVec3::ZERO, 1e-6), None);
    }
}

//! Points, boxes, rays and the map between world and index space.
//!
//! Two spaces exist. *World* is the scene's; its unit is the scene's length unit. *Index* is
//! one grid's: voxel values sit at integer points, one step is one voxel. Names say which
//! (`p_world`, `ray_index`); transforms are called `destination_from_source` so that names
//! chain. The ray parameter `t` is always **world distance**: directions are unit vectors in
//! world space and are deliberately not renormalised in index space, so one `t` serves every
//! grid of a scene.
//!
//! Geometry is `f64`. A cloud ten million units from the origin then still has positions
//! good to 2e-9 units, and adding a free path to `t` cannot stall (in `f32` it does beyond
//! `sigma_t` of about 1e3 at t = 1e4). Voxel values, coefficients and radiance are `f32`.
//!
//! This file knows nothing of grids or optics.

use glam::{DAffine3, DMat3, DVec3, IVec3};

/// A half-line in world space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ray {
    /// Where `t = 0` is.
    pub origin: DVec3,
    /// Unit direction of propagation.
    pub direction: DVec3,
}

impl Ray {
    /// Returns the point at world distance `t`.
    pub fn at(&self, t: f64) -> DVec3 {
        self.origin + self.direction * t
    }
}

/// An axis-aligned box, closed on all sides; empty when any `min > max`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Aabb {
    /// Lowest corner.
    pub min: DVec3,
    /// Highest corner.
    pub max: DVec3,
}

impl Aabb {
    /// The empty box: the neutral element of [`Aabb::including`].
    pub const EMPTY: Self = Self {
        min: DVec3::INFINITY,
        max: DVec3::NEG_INFINITY,
    };

    /// Returns the smallest box that holds this one and `p`.
    #[must_use]
    pub fn including(self, p: DVec3) -> Self {
        Self {
            min: self.min.min(p),
            max: self.max.max(p),
        }
    }

    /// Returns the centre.
    pub fn center(&self) -> DVec3 {
        (self.min + self.max) * 0.5
    }

    /// Returns the eight corners.
    pub fn corners(&self) -> [DVec3; 8] {
        std::array::from_fn(|i| {
            let pick = |bit: usize, lo: f64, hi: f64| if i >> bit & 1 == 0 { lo } else { hi };
            DVec3::new(
                pick(0, self.min.x, self.max.x),
                pick(1, self.min.y, self.max.y),
                pick(2, self.min.z, self.max.z),
            )
        })
    }

    /// Returns the interval of `t >= 0` in which `origin + t * direction` is inside, if any.
    ///
    /// The direction need not have unit length. Components that are zero, or so small that
    /// their reciprocal overflows, only test whether the origin lies between the planes.
    pub fn intersect(&self, origin: DVec3, direction: DVec3) -> Option<(f64, f64)> {
        self.intersect_inverse(origin, DVec3::ONE / direction)
    }

    /// As [`intersect`](Self::intersect), given the reciprocal of the direction, not finite for
    /// the axes that the ray runs across.
    #[inline] // bench: traversal
    pub fn intersect_inverse(&self, origin: DVec3, inverse: DVec3) -> Option<(f64, f64)> {
        let (a, b) = ((self.min - origin) * inverse, (self.max - origin) * inverse);
        let (mut near, mut far) = (a.min(b), a.max(b));
        if !inverse.is_finite() {
            for axis in 0..3 {
                if !inverse[axis].is_finite() {
                    if origin[axis] < self.min[axis] || origin[axis] > self.max[axis] {
                        return None;
                    }
                    near[axis] = f64::NEG_INFINITY;
                    far[axis] = f64::INFINITY;
                }
            }
        }
        let (t0, t1) = (near.max_element().max(0.0), far.min_element());
        (t0 <= t1).then_some((t0, t1))
    }
}

/// The affine map between a grid's index space and world space, kept in `f64`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct IndexTransform {
    world_from_index: DAffine3,
    index_from_world: DAffine3,
}

impl IndexTransform {
    /// Makes the transform from its forward map.
    ///
    /// Returns `None` where the map is not finite or cannot be inverted (a voxel without
    /// volume): such a grid can be listed but not rendered.
    pub fn from_world_from_index(world_from_index: DAffine3) -> Option<Self> {
        let index_from_world = world_from_index.inverse();
        (world_from_index.is_finite() && index_from_world.is_finite()).then_some(Self {
            world_from_index,
            index_from_world,
        })
    }

    /// The uniform map `world = index * voxel_size`.
    ///
    /// # Panics
    /// If `voxel_size` is zero or not finite.
    pub fn uniform(voxel_size: f64) -> Self {
        Self::from_world_from_index(DAffine3::from_scale(DVec3::splat(voxel_size)))
            .expect("a voxel size must be finite and not zero")
    }

    /// Returns the forward map.
    pub fn world_from_index(&self) -> DAffine3 {
        self.world_from_index
    }

    /// Returns the inverse map.
    pub fn index_from_world(&self) -> DAffine3 {
        self.index_from_world
    }

    /// Returns the lengths of the three voxel edges in world units.
    pub fn voxel_size(&self) -> DVec3 {
        let DMat3 {
            x_axis,
            y_axis,
            z_axis,
        } = self.world_from_index.matrix3;
        DVec3::new(x_axis.length(), y_axis.length(), z_axis.length())
    }
}

/// Returns the voxel whose cell `[i, i + 1)` holds `p_index`, per axis.
///
/// Saturates at the ends of `i32`; NaN gives 0.
#[expect(
    clippy::cast_possible_truncation,
    reason = "saturation at the ends of i32 is meant"
)]
#[inline] // bench: lookup
pub fn floor_to_voxel(p_index: DVec3) -> IVec3 {
    // `as` truncates towards zero; subtracting where that rounded up gives the floor without
    // the library call that `f64::floor` is on x86-64 before SSE4.1.
    let floor = |x: f64| {
        let i = x as i32;
        i.saturating_sub(i32::from(f64::from(i) > x))
    };
    IVec3::new(floor(p_index.x), floor(p_index.y), floor(p_index.z))
}

/// Returns two unit vectors that make a right-handed frame with the unit vector `n`.
///
/// # Reference
/// `[Duff2017]`: no branch on the direction beyond its sign, no cancellation at the poles.
pub fn orthonormal_frame(n: DVec3) -> (DVec3, DVec3) {
    let sign = 1.0_f64.copysign(n.z);
    let a = -1.0 / (sign + n.z);
    let b = n.x * n.y * a;
    (
        DVec3::new(1.0 + sign * n.x * n.x * a, sign * b, -sign * n.x),
        DVec3::new(b, sign + n.y * n.y * a, -n.y),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn floor_agrees_with_the_library_at_the_edges() {
        for x in [
            -0.0,
            0.0,
            0.5,
            -0.5,
            7.0,
            -8.0,
            -8.000_001,
            2.9e9,
            -2.9e9,
            f64::NAN,
        ] {
            #[expect(clippy::cast_possible_truncation, reason = "the oracle saturates too")]
            let expected = x.floor() as i32;
            assert_eq!(floor_to_voxel(DVec3::splat(x)).x, expected, "at {x}");
        }
    }

    #[test]
    fn box_is_hit_by_rays_in_its_faces() {
        let cube = Aabb {
            min: DVec3::ZERO,
            max: DVec3::ONE,
        };
        assert_eq!(
            cube.intersect(DVec3::new(0.0, 0.5, -1.0), DVec3::Z),
            Some((1.0, 2.0))
        );
        assert_eq!(cube.intersect(DVec3::new(-1e-9, 0.5, -1.0), DVec3::Z), None);
        let denormal = DVec3::new(1e-320, 0.0, 1.0);
        assert_eq!(
            cube.intersect(DVec3::new(0.5, 0.5, 0.5), denormal),
            Some((0.0, 0.5))
        );
    }

    #[test]
    fn frames_are_orthonormal_in_all_directions() {
        for i in 0..1000 {
            let f = f64::from(i);
            let z = 1.0 - 2.0 * (f + 0.5) / 1000.0;
            let r = (1.0 - z * z).sqrt();
            let n = DVec3::new(r * (f * 2.4).cos(), r * (f * 2.4).sin(), z);
            let (s, t) = orthonormal_frame(n);
            assert!((s.cross(t) - n).length() < 1e-14, "frame at {n}");
        }
    }
}

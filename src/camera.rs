//! The pinhole camera: film position to world ray.

use glam::{DMat4, DVec2, DVec3, DVec4};

use crate::space::Ray;

/// A pinhole camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Camera {
    position: DVec3,
    /// Unit vectors to the right of the image, to its top, and into the scene.
    right: DVec3,
    up: DVec3,
    forward: DVec3,
    /// Half the width and height of the image plane at distance 1.
    half_size: DVec2,
}

impl Camera {
    /// Makes a camera at `position` that looks at `look_at`.
    ///
    /// `vertical_fov_radians` spans the image's height; `aspect` is width over height. Returns
    /// `None` where these do not define a view: `look_at` at the position, `up` along the view
    /// direction, a field of view outside (0, π), or anything not finite.
    pub fn look_at(
        position: DVec3,
        look_at: DVec3,
        up: DVec3,
        vertical_fov_radians: f64,
        aspect: f64,
    ) -> Option<Self> {
        let forward = (look_at - position).try_normalize()?;
        let right = forward.cross(up.try_normalize()?);
        // A sine below 1e-6 between view and up: which side is right is rounding noise.
        let right = (right.length() > 1e-6)
            .then(|| right.try_normalize())
            .flatten()?;
        let valid = position.is_finite()
            && vertical_fov_radians > 0.0
            && vertical_fov_radians < std::f64::consts::PI
            && aspect > 0.0
            && aspect.is_finite();
        let half_height = (vertical_fov_radians / 2.0).tan();
        valid.then_some(Self {
            position,
            right,
            up: right.cross(forward),
            forward,
            half_size: DVec2::new(half_height * aspect, half_height),
        })
    }

    /// Returns the ray through `film`, in [0, 1]² from the top left of the image.
    pub fn ray(&self, film: DVec2) -> Ray {
        let x = (2.0 * film.x - 1.0) * self.half_size.x;
        let y = (1.0 - 2.0 * film.y) * self.half_size.y;
        // Never zero: the three axes are orthonormal and the forward part is 1.
        let direction = self.forward + self.right * x + self.up * y;
        Ray {
            origin: self.position,
            direction: direction / direction.length(),
        }
    }

    /// Returns where `p_world` is on the film, in [0, 1]² if it is in the image; `None` unless it
    /// is in front of the camera.
    pub fn project(&self, p_world: DVec3) -> Option<DVec2> {
        let d = p_world - self.position;
        let depth = d.dot(self.forward);
        // Not only above zero: nearer, the quotients are rounding noise.
        (depth > 1e-9 * d.length()).then(|| {
            let offset = DVec2::new(d.dot(self.right), -d.dot(self.up)) / depth;
            (offset / self.half_size + 1.0) * 0.5
        })
    }

    /// Returns the distance of `p_world` from the camera along its axis.
    pub fn depth(&self, p_world: DVec3) -> f64 {
        (p_world - self.position).dot(self.forward)
    }

    /// Returns the matrix from world space to the camera's (x right, y up, z backwards).
    pub fn camera_from_world(&self) -> DMat4 {
        let Self {
            position: p,
            right,
            up,
            forward,
            ..
        } = *self;
        DMat4::from_rows(
            right.extend(-right.dot(p)),
            up.extend(-up.dot(p)),
            (-forward).extend(forward.dot(p)),
            DVec4::W,
        )
    }

    /// Returns half the width and height of the image plane at distance 1.
    pub fn half_size(&self) -> DVec2 {
        self.half_size
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn centre_and_corners_look_where_they_should() {
        let fov = 2.0 * 0.5_f64.atan();
        let eye = DVec3::new(0.0, -2.0, 0.0);
        let camera = Camera::look_at(eye, DVec3::ZERO, DVec3::Z, fov, 2.0).unwrap();
        assert!((camera.ray(DVec2::splat(0.5)).direction - DVec3::Y).length() < 1e-15);
        // Top left: one unit to the left (aspect 2), half a unit up, for each unit forwards.
        let d = camera.ray(DVec2::ZERO).direction;
        assert!(
            (d / d.y - DVec3::new(-1.0, 1.0, 0.5)).length() < 1e-12,
            "{d}"
        );
        for film in [DVec2::new(0.1, 0.8), DVec2::new(0.9, 0.3)] {
            let back = camera.project(camera.ray(film).at(3.7)).unwrap();
            assert!(
                (back - film).length() < 1e-12,
                "{film} comes back as {back}"
            );
        }
        assert_eq!(camera.project(DVec3::new(0.0, -3.0, 0.0)), None, "behind");
        assert!((camera.depth(DVec3::new(5.0, 1.0, 9.0)) - 3.0).abs() < 1e-12);
        let p = camera
            .camera_from_world()
            .transform_point3(DVec3::new(1.0, 0.0, 3.0));
        assert!((p - DVec3::new(1.0, 3.0, -2.0)).length() < 1e-12, "{p}");
    }

    #[test]
    fn views_that_are_none_are_refused() {
        let make = |to, up, fov| Camera::look_at(DVec3::ZERO, to, up, fov, 1.0);
        assert!(make(DVec3::ZERO, DVec3::Z, 1.0).is_none(), "no direction");
        assert!(make(DVec3::Z, DVec3::Z, 1.0).is_none(), "up along the view");
        assert!(make(DVec3::X, DVec3::Z, 0.0).is_none(), "no field of view");
        assert!(make(DVec3::X, DVec3::ZERO, 1.0).is_none(), "no up");
        assert!(
            make(DVec3::splat(f64::NAN), DVec3::Z, 1.0).is_none(),
            "not a number"
        );
    }
}

//! Where a camera stands so that it sees all of a volume and little else.

use glam::DVec3;

use super::default_look::UpAxis;
use crate::grid::DensityGrid;
use crate::space::Aabb;

/// Vertical field of view of the camera.
pub(super) const FOV_DEGREES: f64 = 30.0;
/// Turn of the camera from the volume's front to its right.
const AZIMUTH_DEGREES: f64 = 30.0;
/// Height of the camera above the volume's horizon.
const ELEVATION_DEGREES: f64 = 6.0;
/// Share of the image's half size that the volume may take.
const FILL: f64 = 0.84;
/// Rays along an edge of the raster that looks for the volume's outline: it is found to a
/// fiftieth of the bounding box's half diagonal.
const RASTER: u32 = 100;

/// Axes of a three-quarter view.
#[derive(Clone, Copy, Debug)]
pub(super) struct Axes {
    pub(super) right: DVec3,
    pub(super) up: DVec3,
    /// Against the view direction.
    pub(super) back: DVec3,
}

impl Axes {
    pub(super) fn new(axis: UpAxis) -> Self {
        let (azimuth, elevation) = (AZIMUTH_DEGREES.to_radians(), ELEVATION_DEGREES.to_radians());
        let (world_up, front) = (axis.up(), axis.front());
        let side = world_up.cross(front);
        let level = front * azimuth.cos() + side * azimuth.sin();
        let back = level * elevation.cos() + world_up * elevation.sin();
        let right = front * -azimuth.sin() + side * azimuth.cos();
        Self {
            right,
            up: back.cross(right),
            back,
        }
    }

    fn split(&self, p: DVec3) -> DVec3 {
        DVec3::new(p.dot(self.right), p.dot(self.up), p.dot(self.back))
    }

    fn join(&self, p: DVec3) -> DVec3 {
        self.right * p.x + self.up * p.y + self.back * p.z
    }
}

/// A camera's place.
#[derive(Clone, Copy, Debug)]
pub(super) struct Frame {
    pub(super) position: DVec3,
    pub(super) look_at: DVec3,
}

impl Frame {
    /// Centres `points` and steps back until all of them are in the image.
    pub(super) fn around(points: &[DVec3], axes: &Axes, aspect: f64) -> Self {
        let extent = |bounds: Aabb, &p: &DVec3| bounds.including(axes.split(p));
        let center = points.iter().fold(Aabb::EMPTY, extent).center();
        let half_height = (FOV_DEGREES.to_radians() / 2.0).tan() * FILL;
        // A point o off the centre is inside if |o.x| <= (distance - o.z) · half_width and so on.
        let distance = points.iter().fold(0.0_f64, |distance, &p| {
            let o = axes.split(p) - center;
            let needed = (o.x.abs() / (half_height * aspect)).max(o.y.abs() / half_height);
            distance.max(needed + o.z)
        });
        let look_at = axes.join(center);
        Self {
            position: look_at + axes.back * distance,
            look_at,
        }
    }
}

/// Returns points on all that is visible of `grid` along the view: ends of the segments that
/// hold more than `min_column` density × world units. Its box's corners if nothing does.
///
/// A grid's box is often far larger than what can be seen of it: the corners of a cloud's box
/// are empty, and simulations keep a haze of nearly nothing around their smoke.
pub(super) fn visible_points(
    grid: &DensityGrid,
    bounds: &Aabb,
    axes: &Axes,
    min_column: f64,
) -> Vec<DVec3> {
    let radius = (bounds.max - bounds.min).length() / 2.0;
    let index_from_world = grid.transform().index_from_world();
    let forward = -axes.back;
    let direction_index = index_from_world.transform_vector3(forward);
    let at = |i: u32| (2.0 * (f64::from(i) + 0.5) / f64::from(RASTER) - 1.0) * radius;
    let mut points = Vec::new();
    for i in 0..RASTER * RASTER {
        let across = axes.right * at(i % RASTER) + axes.up * at(i / RASTER);
        let start = bounds.center() + across - forward * radius;
        let start_index = index_from_world.transform_point3(start);
        for segment in grid.traverse(start_index, direction_index, 2.0 * radius) {
            if f64::from(segment.bound.mean) * (segment.t1 - segment.t0) > min_column {
                points.push(start + forward * segment.t0);
                points.push(start + forward * segment.t1);
            }
        }
    }
    if points.is_empty() {
        points.extend(bounds.corners());
    }
    points
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::Camera;

    #[test]
    fn all_points_are_in_the_image_and_the_outermost_at_its_margin() {
        let bounds = Aabb {
            min: DVec3::new(-3.0, 10.0, 100.0),
            max: DVec3::new(5.0, 11.0, 104.0),
        };
        for axis in [UpAxis::Y, UpAxis::Z] {
            for aspect in [0.5, 16.0 / 9.0] {
                let axes = Axes::new(axis);
                let frame = Frame::around(&bounds.corners(), &axes, aspect);
                let fov = FOV_DEGREES.to_radians();
                let camera =
                    Camera::look_at(frame.position, frame.look_at, axis.up(), fov, aspect).unwrap();
                let largest = bounds.corners().into_iter().fold(0.0_f64, |m, corner| {
                    let p = camera.camera_from_world().transform_point3(corner);
                    let film = (p.truncate() / -p.z / camera.half_size()).abs();
                    m.max(film.max_element())
                });
                assert!(
                    (largest - FILL).abs() < 1e-9,
                    "{axis:?} {aspect}: {largest}"
                );
            }
        }
    }
}

//! What `auto` needs to know of a medium as a whole, and what it will do in its bricks.
//!
//! A walk of some rays tells how many collisions and steps they meet: bounds and rate are chosen
//! by that ([`Tracking::fitted`]). The shares of bricks are for people: `majorant render --explain`
//! prints them. The choice of methods is made ray by ray and segment by segment, with the same
//! limits; here every brick stands for a ray that crosses it in a typical direction, of three
//! voxel cells for two voxel lengths.

use super::distance;
use super::settings::Tracking;
use super::transmittance::{self, residual};
use crate::medium::{Medium, Segments};
use crate::sampling::{Stream, StreamKey, sample_cone};
use crate::space::Ray;
use glam::DVec3;

/// Numbers of bricks that are not empty, by how `auto` treats them.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct BrickShares {
    /// All of them.
    pub bricks: u64,
    /// Of one extinction: closed forms.
    pub homogeneous: u64,
    /// Of a minimum above zero, which collides without a lookup, homogeneous ones aside.
    pub decomposed: u64,
    /// Tracked regularly for the distance.
    pub regular: u64,
    /// Integrated exactly for the transmittance.
    pub exact: u64,
}

/// What rays meet.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Survey {
    /// Mean number of collisions of residual ratio tracking, at a rate of 1, on a ray from a
    /// point of the medium, drawn in proportion to density, outwards.
    pub collisions_per_ray: f32,
    /// Mean, over the same rays, of the optical depth, by the bricks' means.
    pub optical_depth: f32,
    /// Mean, over the same rays, of the segments that one bound for all would save.
    pub saved_segments: f32,
    /// Mean of the collisions that it would add, real or not.
    pub added_collisions: f32,
}

/// Rays that are walked for the mean number of collisions.
const RAYS: usize = 256;

impl BrickShares {
    /// Counts the bricks of `medium`, for distances tracked at `flight_rate` and transmittances at
    /// `rate` collisions for each unit of the bound.
    ///
    /// # Cost
    /// A look at each brick's bound: for people, so rendering does without.
    pub fn new(
        medium: &Medium,
        Tracking {
            rate, flight_rate, ..
        }: &Tracking,
    ) -> Self {
        // The mean of |x| + |y| + |z| over directions is 3/2.
        let voxels_per_length = 1.5 / medium.mean_voxel_size();
        let dense = |rate: f32, limit: f64| f64::from(rate) > limit * voxels_per_length;
        let mut shares = Self::default();
        for segment in medium.brick_segments() {
            shares.bricks += 1;
            if segment.is_homogeneous() {
                shares.homogeneous += 1;
                continue;
            }
            let (_, bound) = residual(&segment);
            let flight = segment.sigma_maj * flight_rate;
            let regular = dense(flight, distance::EXACT_COLLISIONS_PER_VOXEL);
            let exact = dense(bound * rate, transmittance::EXACT_COLLISIONS_PER_VOXEL);
            shares.decomposed += u64::from(segment.sigma_min > 0.0);
            shares.regular += u64::from(regular);
            shares.exact += u64::from(exact);
        }
        shares
    }
}

impl Survey {
    /// Surveys `medium` by rays outwards from the centres of bricks, drawn in proportion to their
    /// mean, in all directions.
    ///
    /// # Cost
    /// The walks of 256 rays, and two looks at each brick's mean to draw them. Deterministic.
    #[expect(clippy::cast_possible_truncation, reason = "estimates")]
    pub fn new(medium: &Medium) -> Self {
        let mut stream = Stream::new(StreamKey::default());
        let centres = medium.brick_centres(RAYS);
        let (mut collisions, mut saved, mut added, mut depth) = (0.0, 0.0, 0.0, 0.0);
        for &centre in &centres {
            // The whole sphere.
            let direction = sample_cone(DVec3::Z, 2.0, &mut stream);
            let outwards = Ray {
                origin: centre,
                direction,
            };
            let mut walk = medium.ray_over(&outwards, f64::INFINITY, Segments::Blocks);
            while let Some(segment) = walk.next_segment() {
                let length = segment.t1 - segment.t0;
                saved += 1.0;
                added -= f64::from(segment.sigma_maj) * length;
                depth += f64::from(segment.sigma_mean) * length;
                if !segment.is_homogeneous() {
                    let (_, bound) = residual(&segment);
                    collisions += f64::from(bound) * length;
                }
            }
            let mut walk = medium.ray_over(&outwards, f64::INFINITY, Segments::Whole);
            if let Some(segment) = walk.next_segment() {
                saved -= 1.0;
                added += f64::from(segment.sigma_maj) * (segment.t1 - segment.t0);
            }
        }
        let mean = |sum: f64| (sum / centres.len().max(1) as f64) as f32;
        Self {
            optical_depth: mean(depth),
            collisions_per_ray: mean(collisions),
            saved_segments: mean(saved),
            added_collisions: mean(added),
        }
    }
}

//! What `auto` will do in a medium: the share of its bricks that each method gets.
//!
//! For people: `majorant render --explain` prints it. The choice itself is made ray by ray and
//! segment by segment with the same limits; here every brick stands for a ray that crosses it in
//! a typical direction, of three voxel cells for two voxel lengths.

use super::distance;
use super::transmittance::{self, residual};
use crate::medium::Medium;

/// Numbers of bricks that are not empty, by how `auto` treats them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Survey {
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

impl Survey {
    /// Counts the bricks of `medium` at `rate` collisions for each unit of the bound.
    pub fn new(medium: &Medium, rate: f32) -> Self {
        // The mean of |x| + |y| + |z| over directions is 3/2.
        let voxels_per_length = 1.5 / medium.mean_voxel_size();
        let dense = |bound: f32, limit: f64| f64::from(bound * rate) > limit * voxels_per_length;
        let mut survey = Self::default();
        for segment in medium.brick_segments() {
            survey.bricks += 1;
            if segment.is_homogeneous() {
                survey.homogeneous += 1;
                continue;
            }
            let (_, bound) = residual(&segment);
            let regular = dense(segment.sigma_maj, distance::EXACT_COLLISIONS_PER_VOXEL);
            let exact = dense(bound, transmittance::EXACT_COLLISIONS_PER_VOXEL);
            survey.decomposed += u64::from(segment.sigma_min > 0.0);
            survey.regular += u64::from(regular);
            survey.exact += u64::from(exact);
        }
        survey
    }
}

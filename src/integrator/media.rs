//! The media of a scene, side by side, inside and across each other.
//!
//! Coefficients of overlapping media add up. The collisions of each are a Poisson process of its
//! own along a ray, and the first collision of them all is the nearest of their first ones: so each
//! medium flies by itself, with the bounds and the estimators that suit it, up to the nearest
//! collision so far. The medium that collides is chosen with probability `sigma_t,i / Σ sigma_t` by
//! that alone, and its albedo and phase function apply: phase functions mix by `sigma_s`, exactly.
//! Transmittances of the media multiply, and so do independent estimates of them.
//!
//! What is deliberately not here: any merging of grids or bounds. A ray pays for each medium by
//! itself, one that it misses with one test of its box.

use glam::DVec3;

use crate::medium::{Medium, MediumRay};
use crate::sampling::Stream;
use crate::space::Ray;
use crate::tracking::Tracking;

/// A medium with the estimators that suit it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Tracked<'a> {
    pub(super) medium: &'a Medium,
    pub(super) tracking: Tracking,
}

/// A collision, with the walk that met it.
#[derive(Debug)]
pub(super) struct Met<'a> {
    /// Which medium it is with.
    pub(super) index: usize,
    pub(super) walk: MediumRay<'a>,
    /// World distance on the walk.
    pub(super) t: f64,
}

/// All media.
#[derive(Debug)]
pub(super) struct Media<'a> {
    all: Vec<Tracked<'a>>,
}

impl<'a> Media<'a> {
    pub(super) fn new(all: Vec<Tracked<'a>>) -> Self {
        Self { all }
    }

    pub(super) fn all(&self) -> &[Tracked<'a>] {
        &self.all
    }

    /// Returns the estimators of medium `index`.
    #[inline] // bench: frame
    pub(super) fn tracking(&self, index: usize) -> &Tracking {
        &self.all[index].tracking
    }

    /// Returns whether there is more than one: less is the usual case, and pays nothing.
    #[inline] // bench: frame
    pub(super) fn are_several(&self) -> bool {
        self.all.len() > 1
    }

    /// Returns the trilinear extinction of all media at a point in world space.
    pub(super) fn sigma_t(&self, p: DVec3) -> f32 {
        self.all.iter().map(|one| one.medium.sigma_t_at(p)).sum()
    }

    /// Chooses the medium that a collision at `p` is with, in proportion to its extinction there;
    /// returns it with the extinction of all. `None` where nothing is.
    pub(super) fn choose(&self, p: DVec3, stream: &mut Stream) -> Option<(&'a Medium, f32)> {
        let mut sum = 0.0;
        let mut chosen = None;
        for one in &self.all {
            let sigma_t = one.medium.sigma_t_at(p);
            sum += sigma_t;
            // The first needs no number: alone, it is chosen.
            if sigma_t > 0.0 && (sum == sigma_t || stream.uniform() * sum < sigma_t) {
                chosen = Some(one.medium);
            }
        }
        Some((chosen?, sum))
    }

    /// Draws the first collision along `ray`.
    pub(super) fn first_collision(&self, ray: &Ray, stream: &mut Stream) -> Option<Met<'a>> {
        self.nearer(None, ray, f64::INFINITY, stream)
    }

    /// Draws the first collision up to `t_max` along `ray` with any medium but `except`.
    pub(super) fn nearer(
        &self,
        except: Option<usize>,
        ray: &Ray,
        mut t_max: f64,
        stream: &mut Stream,
    ) -> Option<Met<'a>> {
        let mut nearest = None;
        for (index, Tracked { medium, tracking }) in self.all.iter().enumerate() {
            if except == Some(index) {
                continue;
            }
            let mut walk = tracking.start_path(medium, ray, t_max);
            let depth = stream.exponential();
            if let Some(t) = tracking.next_collision(&mut walk, depth, stream) {
                t_max = t;
                nearest = Some(Met { index, walk, t });
            }
        }
        nearest
    }

    /// Estimates the transmittance of all media but `except`, along `ray` up to `t_max`, times
    /// `weight`.
    ///
    /// Weights below `roulette_weight` play roulette, as in [`Tracking::estimate_transmittance`].
    pub(super) fn transmittance(
        &self,
        except: Option<usize>,
        (ray, t_max): (&Ray, f64),
        (mut weight, roulette_weight): (f32, f32),
        stream: &mut Stream,
    ) -> f32 {
        for (index, Tracked { medium, tracking }) in self.all.iter().enumerate() {
            // Zero: nothing is left to attenuate.
            if except != Some(index) && weight > 0.0 {
                let least = (roulette_weight / weight).min(1.0);
                weight *= tracking.estimate_transmittance(medium, ray, t_max, least, stream);
            }
        }
        weight
    }
}

/// Returns the ray from distance `t` of `walk` towards `direction`, in world space.
pub(super) fn ray_from(walk: &MediumRay<'_>, t: f64, direction: DVec3) -> Ray {
    Ray {
        origin: walk.world_position(t),
        direction,
    }
}

//! A number or a colour at each point of the world, from one grid or three.
//!
//! Trilinear between voxels, each grid with its own resolution and transform. What the numbers mean
//! is left to others: the colour of dust, a temperature, light.

use std::sync::Arc;

use glam::{DAffine3, DVec3};

use crate::grid::DensityGrid;
use crate::space::{Aabb, IndexTransform};
use crate::spectrum::Rgb;

/// One grid for all channels, or one for each.
#[derive(Clone, Debug)]
pub struct Field {
    channels: Channels,
}

#[derive(Clone, Debug)]
#[expect(
    clippy::large_enum_variant,
    reason = "a few in a scene, and one channel must not be a pointer away"
)]
enum Channels {
    One(Placed),
    Three([Placed; 3]),
}

/// A grid that stands where `transform` says, not its own.
#[derive(Clone, Debug)]
struct Placed {
    grid: Arc<DensityGrid>,
    transform: IndexTransform,
}

impl Placed {
    fn new(grid: Arc<DensityGrid>) -> Self {
        let transform = *grid.transform();
        Self { grid, transform }
    }

    fn moved(&self, map: DAffine3) -> Option<Self> {
        let moved = map * self.transform.world_from_index();
        Some(Self {
            grid: Arc::clone(&self.grid),
            transform: IndexTransform::from_world_from_index(moved)?,
        })
    }

    #[inline] // bench: frame
    fn at(&self, p_world: DVec3) -> f32 {
        let p_index = self.transform.index_from_world().transform_point3(p_world);
        self.grid.sampler().trilinear(p_index)
    }
}

impl Field {
    /// Makes a field of one number everywhere.
    pub fn scalar(grid: Arc<DensityGrid>) -> Self {
        Self {
            channels: Channels::One(Placed::new(grid)),
        }
    }

    /// Makes a field of colours.
    pub fn colour(grids: [Arc<DensityGrid>; 3]) -> Self {
        Self {
            channels: Channels::Three(grids.map(Placed::new)),
        }
    }

    /// Returns this field moved by `map`, from world to world; `None` if it cannot be inverted.
    pub fn moved(&self, map: DAffine3) -> Option<Self> {
        let channels = match &self.channels {
            Channels::One(one) => Channels::One(one.moved(map)?),
            Channels::Three([r, g, b]) => {
                Channels::Three([r.moved(map)?, g.moved(map)?, b.moved(map)?])
            }
        };
        Some(Self { channels })
    }

    /// Returns the value at a point; of a scalar field, the same in all channels.
    ///
    /// # Cost
    /// Eight loads for each grid.
    #[inline] // bench: frame
    pub fn at(&self, p_world: DVec3) -> Rgb {
        match &self.channels {
            Channels::One(one) => Rgb::splat(one.at(p_world)),
            Channels::Three(three) => Rgb(three.each_ref().map(|grid| grid.at(p_world))),
        }
    }

    /// Returns the largest value of any channel.
    pub fn max(&self) -> f32 {
        let max = |placed: &Placed| placed.grid.bound().max;
        self.grids().iter().map(max).fold(0.0, f32::max)
    }

    /// Returns the transform of the first grid: the field's own resolution.
    pub fn transform(&self) -> &IndexTransform {
        &self.grids()[0].transform
    }

    /// Returns a box in the index space of the first grid outside of which the field is zero, tight
    /// to some voxels; `None` if it is zero everywhere.
    pub fn occupied(&self) -> Option<Aabb> {
        let mut hull = Aabb::EMPTY;
        let to_index = self.transform().index_from_world();
        for Placed { grid, transform } in self.grids() {
            let to_first = to_index * transform.world_from_index();
            if let Some(own) = grid.occupied() {
                let corners = own.corners().map(|p| to_first.transform_point3(p));
                hull = corners.into_iter().fold(hull, Aabb::including);
            }
        }
        (hull.min.x <= hull.max.x).then_some(hull)
    }

    /// Visits the corners, in world space, of boxes outside of which the field is zero.
    ///
    /// # Cost
    /// See [`DensityGrid::for_each_occupied`].
    pub fn for_each_occupied(&self, mut visit: impl FnMut([DVec3; 8])) {
        for Placed { grid, transform } in self.grids() {
            let to_world = transform.world_from_index();
            grid.for_each_occupied(|corners| visit(corners.map(|p| to_world.transform_point3(p))));
        }
    }

    fn grids(&self) -> &[Placed] {
        match &self.channels {
            Channels::One(one) => std::slice::from_ref(one),
            Channels::Three(three) => three,
        }
    }
}

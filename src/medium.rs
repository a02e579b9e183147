//! A grid with optics: density times a scale is extinction; albedo and phase say the rest.
//!
//! What the tracking above sees of it is two things: segments of constant bound along a ray,
//! and the extinction at a point of the current segment. Voxels and index space end here.

use std::ops::ControlFlow;
use std::sync::Arc;

use crate::emission::{Emission, Glow};
use crate::field::Field;
pub use crate::grid::LOOKUP_COST;
use crate::grid::{Blocks, Bound, Cells, Columns, DensityGrid, Sampler, Traversal, VoxelWalk};
use crate::phase::Phase;
use crate::space::{IndexTransform, Ray};
use crate::spectrum::Rgb;
use crate::stats::Counts;
use glam::{DAffine3, DVec3, Vec3};

/// A participating medium whose gray extinction follows a density grid.
#[derive(Clone, Debug)]
pub struct Medium {
    grid: Arc<DensityGrid>,
    /// The grid's own, moved to where this medium stands.
    transform: IndexTransform,
    sigma_t_per_density: f32,
    /// Extinction of each channel over that of the largest; white if it is gray.
    tint: Rgb,
    albedo: Rgb,
    phase: Phase,
    /// World length of the diagonal of one voxel.
    voxel_diagonal: f32,
    blocks: Arc<Blocks>,
    emission: Option<Arc<Emission>>,
    /// Where the albedo varies: a field, and what it is multiplied by.
    colour: Option<(Field, f32)>,
}

impl Medium {
    /// Makes a medium: `sigma_t = sigma_t_per_density · density`, per world unit.
    ///
    /// `sigma_t_per_density` and `albedo` must be finite and not negative.
    pub fn new(
        grid: Arc<DensityGrid>,
        sigma_t_per_density: f32,
        albedo: Rgb,
        phase: Phase,
    ) -> Self {
        let transform = *grid.transform();
        Self::at(grid, transform, sigma_t_per_density, albedo, phase)
    }

    /// Makes a medium whose grid's voxels stand where `transform` says, not the grid's own.
    fn at(
        grid: Arc<DensityGrid>,
        transform: IndexTransform,
        sigma_t_per_density: f32,
        albedo: Rgb,
        phase: Phase,
    ) -> Self {
        #[expect(clippy::cast_possible_truncation, reason = "an estimate")]
        let voxel_diagonal = transform.voxel_size().length() as f32;
        #[expect(clippy::cast_possible_truncation, reason = "an estimate")]
        let voxel = (transform.voxel_size().element_sum() / 3.0) as f32;
        let blocks = Arc::new(grid.blocks(sigma_t_per_density * voxel));
        Self {
            grid,
            transform,
            sigma_t_per_density,
            tint: Rgb::WHITE,
            albedo,
            phase,
            voxel_diagonal,
            blocks,
            emission: None,
            colour: None,
        }
    }

    /// Returns this medium moved by `world_from_world`, with what it emits; voxels are not copied.
    /// `None` if the map cannot be inverted.
    ///
    /// Extinction stays what it is per world unit: a medium of twice the size is twice as thick.
    pub fn moved(&self, world_from_world: DAffine3) -> Option<Self> {
        let world_from_index = world_from_world * self.transform.world_from_index();
        let transform = IndexTransform::from_world_from_index(world_from_index)?;
        let Self {
            sigma_t_per_density,
            albedo,
            phase,
            ..
        } = *self;
        let grid = Arc::clone(&self.grid);
        let colour = match &self.colour {
            Some((field, scale)) => Some((field.moved(world_from_world)?, *scale)),
            None => None,
        };
        let moved = Self {
            tint: self.tint,
            colour,
            ..Self::at(grid, transform, sigma_t_per_density, albedo, phase)
        };
        Some(match &self.emission {
            Some(emission) => moved.glowing(emission.glow().moved(world_from_world)?),
            None => moved,
        })
    }

    /// Returns a medium of the same grid with other optics; voxels are not copied.
    #[must_use]
    pub fn with_optics(&self, sigma_t_per_density: f32, albedo: Rgb, phase: Phase) -> Self {
        let grid = Arc::clone(&self.grid);
        let other = Self {
            tint: self.tint,
            ..Self::at(grid, self.transform, sigma_t_per_density, albedo, phase)
        };
        match &self.emission {
            Some(emission) => other.glowing(emission.glow().clone()),
            None => other,
        }
    }

    /// Returns this medium with the extinction of each channel multiplied by that of `color`, which
    /// must be finite and not negative; nothing is copied.
    #[must_use]
    pub fn with_extinction_color(&self, color: Rgb) -> Self {
        let most = color.max_channel();
        let sigma_t_per_density = self.sigma_t_per_density * most;
        let medium = self.with_optics(sigma_t_per_density, self.albedo, self.phase);
        // Zero: nothing is there, of whatever colour.
        if most == 0.0 {
            return medium;
        }
        let tint = Rgb(color.0.map(|c| c / most)) * self.tint;
        let colour = self.colour.clone();
        Self {
            tint,
            colour,
            ..medium
        }
    }

    /// Returns the extinction of each channel over that of the one with the largest, which is
    /// [`sigma_t`](MediumRay::sigma_t) and its like; white for a gray medium.
    pub fn tint(&self) -> Rgb {
        self.tint
    }

    /// Returns whether the channels differ in their extinction.
    pub fn is_chromatic(&self) -> bool {
        self.tint != Rgb::WHITE
    }

    /// Returns this medium with the albedo of a field, times `scale`, at most 1.
    #[must_use]
    pub fn coloured(self, field: Field, scale: f32) -> Self {
        let albedo = Rgb::splat((field.max() * scale).min(1.0));
        let colour = Some((field, scale));
        Self {
            albedo,
            colour,
            ..self
        }
    }

    /// Returns this medium with light of its own.
    ///
    /// # Cost
    /// See [`Emission::new`].
    #[must_use]
    pub fn glowing(self, glow: Glow) -> Self {
        let emission = Emission::new(glow, |glow, p| self.glow_at(glow, p)).map(Arc::new);
        Self { emission, ..self }
    }

    /// Returns what the medium emits; `None` if that is nothing.
    pub fn emission(&self) -> Option<&Emission> {
        self.emission.as_deref()
    }

    /// Returns the radiance emitted per unit length at a point in world space.
    ///
    /// # Cost
    /// Eight loads for each grid that it takes.
    #[inline] // bench: frame
    pub fn emitted(&self, p_world: DVec3) -> Rgb {
        match &self.emission {
            Some(emission) => self.glow_at(emission.glow(), p_world),
            None => Rgb::BLACK,
        }
    }

    #[inline] // bench: frame
    fn glow_at(&self, glow: &Glow, p_world: DVec3) -> Rgb {
        glow.emitted(p_world, || {
            let sigma_t = self.tint * self.sigma_t_at(p_world);
            let albedo = self.albedo_at(p_world);
            Rgb(std::array::from_fn(|c| (1.0 - albedo.0[c]) * sigma_t.0[c]))
        })
    }

    /// Returns the grid that the extinction follows.
    pub fn grid(&self) -> &DensityGrid {
        &self.grid
    }

    /// Returns the map between the index space of the grid and the world.
    pub fn transform(&self) -> &IndexTransform {
        &self.transform
    }

    /// Visits the corners, in world space, of boxes outside of which there is nothing.
    ///
    /// # Cost
    /// See [`DensityGrid::for_each_occupied`].
    pub fn for_each_occupied(&self, mut visit: impl FnMut([DVec3; 8])) {
        let to_world = self.transform.world_from_index();
        self.grid
            .for_each_occupied(|corners| visit(corners.map(|p| to_world.transform_point3(p))));
        if let Some(emission) = &self.emission {
            emission.glow().field().for_each_occupied(visit);
        }
    }

    /// Returns extinction per unit of density, per world unit.
    pub fn sigma_t_per_density(&self) -> f32 {
        self.sigma_t_per_density
    }

    /// Returns the single-scattering albedo, `sigma_s / sigma_t`; the largest where it varies.
    pub fn albedo(&self) -> Rgb {
        self.albedo
    }

    /// Returns whether the albedo varies from point to point.
    pub fn is_coloured(&self) -> bool {
        self.colour.is_some()
    }

    /// Returns the albedo at a point in world space.
    #[inline] // bench: frame
    pub fn albedo_at(&self, p_world: DVec3) -> Rgb {
        match &self.colour {
            None => self.albedo,
            Some((field, scale)) => Rgb((field.at(p_world) * *scale).0.map(|a| a.min(1.0))),
        }
    }

    /// Returns the phase function.
    pub fn phase(&self) -> Phase {
        self.phase
    }

    /// Estimates, coarsely and once, the transmittance from every point towards `direction`.
    ///
    /// `None` for a medium without density. For importance only: not an unbiased estimate.
    pub fn light_columns(&self, direction: DVec3) -> Option<LightColumns> {
        let Rgb([r, g, b]) = self.tint;
        let scale = f64::from(self.sigma_t_per_density * ((r + g + b) / 3.0));
        #[expect(clippy::cast_possible_truncation, reason = "a number in [0, 1]")]
        let root_transmittance = |column: f64| (-0.5 * scale * column).exp() as f32;
        let to_index = self.transform.index_from_world();
        let direction = to_index.transform_vector3(direction);
        Some(LightColumns {
            columns: Columns::new(&self.grid, direction, root_transmittance)?,
        })
    }

    /// Returns the gradient of the extinction at a point in world space, over a voxel.
    pub fn gradient(&self, p_world: DVec3) -> Vec3 {
        let to_world = self.transform.world_from_index().matrix3;
        let p_index = self.transform.index_from_world().transform_point3(p_world);
        let mut sampler = self.grid.sampler();
        let mut difference = |axis: DVec3| {
            let ahead = sampler.trilinear(p_index + axis * 0.5);
            ahead - sampler.trilinear(p_index - axis * 0.5)
        };
        let index = Vec3::new(
            difference(DVec3::X),
            difference(DVec3::Y),
            difference(DVec3::Z),
        );
        // Gradients go by the inverse transpose of the map of points.
        let gradient = to_world.inverse().transpose() * index.as_dvec3();
        gradient.as_vec3() * self.sigma_t_per_density
    }

    /// Returns where the optical depth along `ray` reaches `depth`, and where that of what is left
    /// is `depth`; `None` if it is less in all.
    ///
    /// # Cost
    /// One step for each voxel cell, until there from either end.
    pub fn extent(&self, ray: &Ray, depth: f64, counts: &mut Counts) -> Option<(f64, f64)> {
        let reach = |ray: &Ray, counts: &mut Counts| {
            let mut left = depth;
            let mut walk = self.ray(ray, f64::INFINITY);
            while walk.next_segment().is_some() {
                let reached = walk.reach_depth(&mut left, counts);
                if reached.is_some() {
                    return reached;
                }
            }
            None
        };
        let front = reach(ray, counts)?;
        // Back from beyond the last segment.
        let mut walk = self.ray(ray, f64::INFINITY);
        let mut end = front;
        while let Some(segment) = walk.next_segment() {
            end = segment.t1;
        }
        let back = Ray {
            origin: ray.at(end),
            direction: -ray.direction,
        };
        reach(&back, counts).map(|t| (front, end - t))
    }

    /// Returns the trilinear extinction at a point in world space.
    ///
    /// # Cost
    /// A search for eight voxels from scratch: a walk knows where it is.
    pub fn sigma_t_at(&self, p_world: DVec3) -> f32 {
        let p = self.transform.index_from_world().transform_point3(p_world);
        self.grid.sampler().trilinear(p) * self.sigma_t_per_density
    }

    /// Returns the edge, in voxels, of the cells that rays walk by [`Segments::Blocks`]: that of a brick or more.
    pub fn cell_edge(&self) -> i32 {
        self.blocks.cell_edge()
    }

    /// Returns the largest extinction anywhere.
    pub fn majorant(&self) -> f32 {
        self.grid.bound().max * self.sigma_t_per_density
    }

    /// Returns whether every segment of every ray has one extinction all along, so that closed
    /// forms are all it takes.
    pub fn is_homogeneous(&self) -> bool {
        self.grid.is_homogeneous()
    }

    /// Returns the mean edge of a voxel in world units.
    pub fn mean_voxel_size(&self) -> f64 {
        self.transform.voxel_size().element_sum() / 3.0
    }

    /// Returns what a ray meets in each brick that is not empty, as segments without length.
    pub fn brick_segments(&self) -> impl Iterator<Item = BoundSegment> + '_ {
        let bounds = self.grid.brick_bounds();
        bounds.map(|bound| self.bound_segment(bound, (0.0, 0.0), 8.0))
    }

    /// Returns the world positions of the centres of about `count` bricks, drawn in proportion to
    /// their mean by steps of equal sums. Deterministic; empty for an empty medium.
    pub fn brick_centres(&self, count: usize) -> Vec<DVec3> {
        let to_world = self.transform.world_from_index();
        let centres = self.grid.brick_centres(count);
        centres
            .into_iter()
            .map(|p| to_world.transform_point3(p))
            .collect()
    }

    /// Gives the bound of a cell `edge` voxels wide its optics.
    #[inline] // bench: frame
    fn bound_segment(&self, bound: Bound, (t0, t1): (f64, f64), edge: f32) -> BoundSegment {
        let scale = self.sigma_t_per_density;
        BoundSegment {
            t0,
            t1,
            sigma_min: bound.min * scale,
            sigma_maj: bound.max * scale,
            sigma_mean: bound.mean * scale,
            diagonal: edge * self.voxel_diagonal,
        }
    }

    /// Prepares the walk of a ray through the medium, from `t = 0` to `t_max`, brick by brick.
    #[inline] // bench: frame
    pub fn ray(&self, ray: &Ray, t_max: f64) -> MediumRay<'_> {
        self.ray_over(ray, t_max, Segments::Bricks)
    }

    /// As [`ray`](Self::ray), over other segments.
    #[inline] // bench: frame
    pub fn ray_over(&self, ray: &Ray, t_max: f64, segments: Segments) -> MediumRay<'_> {
        let to_index = self.transform.index_from_world();
        let origin = to_index.transform_point3(ray.origin);
        let direction = to_index.transform_vector3(ray.direction);
        let cells = match segments {
            Segments::Whole => Cells::Whole,
            Segments::Bricks => Cells::Bricks,
            Segments::Blocks => Cells::Blocks(&self.blocks),
        };
        MediumRay {
            traversal: self.grid.traverse_cells(origin, direction, t_max, cells),
            sampler: self.grid.sampler(),
            medium: self,
        }
    }
}

/// How a ray is cut into segments of one bound.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Segments {
    /// One segment, with the bound of the whole medium.
    Whole,
    /// A segment for every brick of 8³ voxels.
    Bricks,
    /// As `Bricks`, but one for a block of bricks that are empty or thin.
    Blocks,
}

/// Coarse estimates of the transmittance towards one direction.
#[derive(Clone, Debug)]
pub struct LightColumns {
    columns: Columns,
}

impl LightColumns {
    /// Returns an estimate of the square root of the transmittance from `p_index`, a point
    /// in the index space of the medium's grid.
    #[inline] // bench: frame
    pub fn root_transmittance(&self, p_index: DVec3) -> f32 {
        self.columns.at(p_index)
    }
}

/// An interval of a ray on which the extinction lies between two constants.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BoundSegment {
    /// World distance of the start.
    pub t0: f64,
    /// World distance of the end.
    pub t1: f64,
    /// The extinction is nowhere below, per world unit.
    pub sigma_min: f32,
    /// The extinction is nowhere above: the majorant.
    pub sigma_maj: f32,
    /// Mean extinction of the cell: an estimate, between the two.
    pub sigma_mean: f32,
    /// Diagonal of the cell in world units, for estimates.
    pub diagonal: f32,
}

impl BoundSegment {
    /// Returns whether the extinction is the same all along.
    pub fn is_homogeneous(&self) -> bool {
        self.sigma_min == self.sigma_maj
    }
}

/// One ray's walk through a medium.
#[derive(Clone, Debug)]
pub struct MediumRay<'a> {
    traversal: Traversal<'a>,
    sampler: Sampler<'a>,
    medium: &'a Medium,
}

impl<'a> MediumRay<'a> {
    /// Returns the next segment that is not empty. Segments are ordered and do not overlap.
    #[inline] // bench: frame
    pub fn next_segment(&mut self) -> Option<BoundSegment> {
        let bound = self.traversal.next_bound()?;
        Some(
            self.medium
                .bound_segment(bound, self.traversal.interval(), self.traversal.edge()),
        )
    }

    /// Goes on from distance `t` in the current segment, as a new ray from there in another
    /// `direction`, a unit vector in world space, up to `t_max`. Cheaper than a new ray.
    #[inline] // bench: frame
    pub fn turn(&mut self, t: f64, direction: DVec3, t_max: f64) {
        let to_index = self.medium.transform.index_from_world();
        let direction = to_index.transform_vector3(direction);
        self.traversal.turn(t, direction, t_max);
    }

    /// Returns the point at distance `t`, in the index space of the medium's grid.
    #[inline] // bench: frame
    pub fn index_position(&self, t: f64) -> DVec3 {
        let (origin, direction) = self.traversal.ray();
        origin + direction * t
    }

    /// Returns the point at distance `t`, in world space.
    pub fn world_position(&self, t: f64) -> DVec3 {
        let to_world = self.medium.transform.world_from_index();
        to_world.transform_point3(self.index_position(t))
    }

    /// Returns the albedo of the medium at distance `t`.
    #[inline] // bench: frame
    pub fn albedo(&self, t: f64) -> Rgb {
        if self.medium.colour.is_none() {
            return self.medium.albedo;
        }
        self.medium.albedo_at(self.world_position(t))
    }

    /// Returns the medium.
    #[inline] // bench: frame
    pub fn medium(&self) -> &'a Medium {
        self.medium
    }

    /// Returns about how many voxel cells the ray crosses in a world unit.
    #[inline] // bench: frame
    pub fn voxels_per_length(&self) -> f64 {
        self.traversal.ray().1.abs().element_sum()
    }

    /// Returns the optical depth of the current segment, exactly but for rounding.
    ///
    /// # Cost
    /// One step and eight loads for each voxel cell.
    pub fn optical_depth(&mut self, counts: &mut Counts) -> f64 {
        let mut sum = 0.0;
        for cubic in VoxelWalk::new(&mut self.sampler, &self.traversal) {
            counts.voxel_cells += 1;
            sum += cubic.integral();
        }
        sum * f64::from(self.medium.sigma_t_per_density)
    }

    /// Returns where the optical depth from the start of the current segment reaches `depth`, or
    /// `None`, having reduced `depth` by that of the whole segment.
    ///
    /// # Cost
    /// As [`optical_depth`](Self::optical_depth), up to there.
    pub fn reach_depth(&mut self, depth: &mut f64, counts: &mut Counts) -> Option<f64> {
        let scale = f64::from(self.medium.sigma_t_per_density);
        for cubic in VoxelWalk::new(&mut self.sampler, &self.traversal) {
            counts.voxel_cells += 1;
            let cell = cubic.integral() * scale;
            if *depth < cell {
                return Some(cubic.reach(*depth / scale));
            }
            *depth -= cell;
        }
        None
    }

    /// Returns an unbiased estimate of the extinction at `t` in the current segment: the value
    /// at one voxel drawn with its trilinear weight from 64 random `bits`.
    ///
    /// It never exceeds the segment's bound.
    #[inline] // bench: frame
    pub fn estimate_sigma_t(&mut self, t: f64, bits: u64) -> f32 {
        self.sampler.stochastic_at(&self.traversal, t, bits) * self.medium.sigma_t_per_density
    }

    /// Decides by `accepts`, true of all extinctions from some value on, on that estimate: breaks
    /// where it need not be known for that, and returns it else.
    #[inline] // bench: frame
    pub fn decide_by_sigma_t(
        &mut self,
        t: f64,
        bits: u64,
        accepts: impl Fn(f32) -> bool,
    ) -> ControlFlow<bool, f32> {
        let scale = self.medium.sigma_t_per_density;
        // Products round monotonically: what holds of a cell's bounds holds of its values.
        let accepts = |value: f32| accepts(value * scale);
        self.sampler
            .stochastic_decision(&self.traversal, t, bits, accepts)
            .map_continue(|value| value * scale)
    }

    /// Returns the trilinear extinction at `t` in the current segment.
    pub fn sigma_t(&mut self, t: f64) -> f32 {
        self.sampler.trilinear_at(&self.traversal, t) * self.medium.sigma_t_per_density
    }
}

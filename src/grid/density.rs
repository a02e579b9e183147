//! A scalar tree made ready for rendering: halo, bounds and transform.

use glam::DVec3;

use super::blocks::Blocks;
use super::bounds::{Bound, Bounds, add_halo};
use super::brick::{BRICK_DIM, BRICK_LEN, BRICK_LOG2};
use super::cells::{Cell, CellTable, Hints};
use super::curve;
use super::directory::Directory;
use super::encoding::Encoding;
use super::ranks::Ranks;
use super::sampler::Sampler;
use super::traverse::{Cells, Traversal};
use super::tree::{LOWER_LEN, Tree};
use super::values::{Values, Voxels};
use crate::space::{Aabb, IndexTransform, orthonormal_frame};

/// Density values with conservative bounds, placed in the world.
#[derive(Debug)]
pub struct DensityGrid {
    /// Nodes and tiles; the values of its bricks are in `values`.
    pub(super) tree: Tree<f32>,
    /// Slots and bounds of the lower nodes, which tree and bounds no longer have.
    pub(super) cells: CellTable,
    /// Of the cells' bounds.
    pub(super) hints: Hints,
    /// Which of the cells are which bricks.
    pub(super) ranks: Ranks,
    pub(super) values: Values,
    pub(super) bounds: Bounds,
    pub(super) directory: Directory,
    /// Blocks of empty cells.
    pub(super) empty_blocks: Blocks,
    transform: IndexTransform,
}

/// Preparing a grid for rendering would take more memory than allowed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("values, nodes and bounds take {needed} bytes, more than the {limit} allowed")]
pub struct GridTooLarge {
    /// Bytes that would be needed.
    pub needed: usize,
    /// Bytes that are allowed.
    pub limit: usize,
}

impl DensityGrid {
    /// Computes the bounds of `tree` and places it by `transform`; values stay as they are.
    ///
    /// Values must be finite and not negative, the loader's policy.
    ///
    /// # Errors
    /// If the grid with its bounds would take more than `max_bytes`.
    pub fn new(
        tree: Tree<f32>,
        transform: IndexTransform,
        max_bytes: usize,
    ) -> Result<Self, GridTooLarge> {
        Self::encoded(tree, transform, Encoding::F32, max_bytes)
    }

    /// As [`new`](Self::new), with values stored as `encoding`. Bounds are those of the decoded
    /// values.
    ///
    /// # Errors
    /// As [`new`](Self::new).
    pub fn encoded(
        mut tree: Tree<f32>,
        transform: IndexTransform,
        encoding: Encoding,
        max_bytes: usize,
    ) -> Result<Self, GridTooLarge> {
        let too_large = |needed| GridTooLarge {
            needed,
            limit: max_bytes,
        };
        let values = std::mem::take(&mut tree.values);
        let bytes = values.len() / BRICK_LEN * encoding.brick_bytes();
        if bytes > max_bytes {
            return Err(too_large(bytes));
        }
        let values = Values::encode(values, encoding).map_err(|_refused| too_large(bytes))?;
        let (tree, values, bounds) = Self::prepare(tree, values, max_bytes)?;
        Ok(Self::from_parts(tree, values, bounds, transform))
    }

    /// Completes a tree, whose bricks' values are apart from it, by its halo and its bounds.
    pub(super) fn prepare(
        mut tree: Tree<f32>,
        values: Values,
        max_bytes: usize,
    ) -> Result<(Tree<f32>, Values, Bounds), GridTooLarge> {
        add_halo(&mut tree, &values, max_bytes).map_err(|needed| GridTooLarge {
            needed,
            limit: max_bytes,
        })?;
        let bounds = Bounds::new(Voxels {
            tree: &tree,
            values: &values,
        });
        Ok((tree, values, bounds))
    }

    /// Puts a tree, its values and its bounds together.
    pub(super) fn from_parts(
        mut tree: Tree<f32>,
        values: Values,
        mut bounds: Bounds,
        transform: IndexTransform,
    ) -> Self {
        let directory = Directory::new(&tree, &bounds);
        let slots = tree.take_lower();
        let cells = CellTable::new(&slots, &std::mem::take(&mut bounds.lower));
        let empty_blocks = Blocks::new(&cells, f32::INFINITY);
        tree.drop_origins();
        // Outside of the table, where everything reads as the background, nothing asks for upper
        // nodes, of which a grid of 128³ voxels has eight: 4 MB, twice its values.
        if directory.memory_bytes() > 0 && tree.background() == 0.0 {
            tree.drop_upper();
            bounds.upper = Vec::new();
        }
        Self {
            tree,
            hints: cells.hints(),
            ranks: Ranks::new(&slots),
            cells,
            values,
            bounds,
            directory,
            empty_blocks,
            transform,
        }
    }

    /// Returns the map between index and world space.
    pub fn transform(&self) -> &IndexTransform {
        &self.transform
    }

    /// Returns a reader of values at points in index space.
    pub fn sampler(&self) -> Sampler<'_> {
        Sampler::new(self)
    }

    /// Walks `origin + t · direction`, both in index space, from t = 0 to `t_max`, brick by brick.
    pub fn traverse(&self, origin: DVec3, direction: DVec3, t_max: f64) -> Traversal<'_> {
        self.traverse_cells(origin, direction, t_max, Cells::Bricks)
    }

    /// As [`traverse`](Self::traverse), over other cells.
    #[inline] // bench: frame
    pub fn traverse_cells<'a>(
        &'a self,
        origin: DVec3,
        direction: DVec3,
        t_max: f64,
        cells: Cells<'a>,
    ) -> Traversal<'a> {
        Traversal::new(self, origin, direction, t_max, cells)
    }

    /// Chooses blocks of cells that a ray crosses in one step, for a medium whose optical depth is
    /// `depth_per_density` along one voxel of density 1.
    ///
    /// # Cost
    /// Two looks at each cell.
    pub fn blocks(&self, depth_per_density: f32) -> Blocks {
        Blocks::cheapest(self.blocks_of_all_sizes(depth_per_density))
            .unwrap_or_else(|| Blocks::new(&self.cells, depth_per_density))
    }

    /// Returns what [`blocks`](Self::blocks) chooses from: blocks of bricks and of each size of larger
    /// cells, any of them exact. None but those of bricks where there is no table of all nodes, or a
    /// background, which walks by blocks leave to bricks.
    pub fn blocks_of_all_sizes(&self, depth_per_density: f32) -> Vec<Blocks> {
        let has_all_nodes = self.directory.memory_bytes() > 0 && self.tree.background() == 0.0;
        match self.bounds.occupied {
            Some(occupied) if has_all_nodes => {
                Blocks::of_all_sizes(&self.cells, &self.directory, occupied, depth_per_density)
            }
            _ => vec![Blocks::new(&self.cells, depth_per_density)],
        }
    }

    /// Returns the bound of all values, background included; empty for an empty grid.
    pub fn bound(&self) -> Bound {
        self.bounds.whole
    }

    /// Returns whether the value is the same along every segment of every ray.
    pub fn is_homogeneous(&self) -> bool {
        // A cell is constant only if everything below it is, and its neighbours' first layers.
        self.bounds.root.iter().all(Bound::is_constant)
    }

    /// Returns the bounds of all cells of 8³ voxels that are not empty: what most segments of
    /// rays carry.
    pub fn brick_bounds(&self) -> impl Iterator<Item = Bound> + '_ {
        let all = self.cells.iter().map(|cell| cell.bound);
        all.filter(|b| b.max > 0.0)
    }

    /// Returns the centres, in index space, of about `count` cells of 8³ voxels, drawn in proportion
    /// to their mean by steps of equal sums; none for an empty grid.
    pub fn brick_centres(&self, count: usize) -> Vec<DVec3> {
        let total: f64 = self.brick_bounds().map(|b| f64::from(b.mean)).sum();
        let step = total / count as f64;
        let mut centres = Vec::with_capacity(count);
        let mut next = 0.5 * step;
        for (i, &Cell { bound, .. }) in self.cells.iter().enumerate() {
            next -= f64::from(bound.mean);
            // At most one a brick: a single bright one need not be taken for all of them.
            if next < 0.0 && bound.max > 0.0 {
                let node = self.tree.lower_origins[i / LOWER_LEN];
                let origin = node + (curve::cell_at(i % LOWER_LEN) << BRICK_LOG2);
                centres.push(origin.as_dvec3() + 0.5 * f64::from(BRICK_DIM));
                next = next.rem_euclid(step);
            }
        }
        centres
    }

    /// Returns a box, in index space, outside of which density is zero, tight to 8 voxels;
    /// `None` if it is zero everywhere.
    pub fn occupied(&self) -> Option<Aabb> {
        let (first, last) = self.bounds.occupied?;
        let scale = f64::from(BRICK_DIM);
        Some(Aabb {
            min: first.as_dvec3() * scale,
            max: (last.as_dvec3() + DVec3::ONE) * scale,
        })
    }

    /// Returns a box, in world space, outside of which density is zero, tight to 8 voxels;
    /// `None` if it is zero everywhere.
    pub fn world_bounds(&self) -> Option<Aabb> {
        let to_world = self.transform.world_from_index();
        let corners = self
            .occupied()?
            .corners()
            .map(|p| to_world.transform_point3(p));
        Some(corners.into_iter().fold(Aabb::EMPTY, Aabb::including))
    }

    /// Returns the mean of ∫ density dt over parallel rays along the unit vector
    /// `direction_world`, in density × world units, counting the rays that cross something;
    /// 0 for an empty grid.
    ///
    /// # Cost
    /// A raster of 64² rays and one addition for each cell they cross: the cells' means stand
    /// for their values, so the result is good to some per cent.
    pub fn mean_column_density(&self, direction_world: DVec3) -> f64 {
        const RASTER: i32 = 64;
        let Some(bounds) = self.world_bounds() else {
            return 0.0;
        };
        let radius = (bounds.max - bounds.min).length() / 2.0;
        let (s, t) = orthonormal_frame(direction_world);
        let to_index = self.transform.index_from_world();
        let direction = to_index.transform_vector3(direction_world);
        let (mut sum, mut count) = (0.0, 0);
        for i in 0..RASTER * RASTER {
            let at = |k: i32| (2.0 * (f64::from(k) + 0.5) / f64::from(RASTER) - 1.0) * radius;
            let start = bounds.center() - direction_world * radius
                + s * at(i % RASTER)
                + t * at(i / RASTER);
            let column: f64 = self
                .traverse(to_index.transform_point3(start), direction, f64::INFINITY)
                .map(|segment| f64::from(segment.bound.mean) * (segment.t1 - segment.t0))
                .sum();
            if column > 0.0 {
                sum += column;
                count += 1;
            }
        }
        if count == 0 {
            0.0
        } else {
            sum / f64::from(count)
        }
    }

    /// Returns the values of the bricks.
    pub fn values(&self) -> &Values {
        &self.values
    }

    /// Returns the number of bricks.
    pub fn brick_count(&self) -> usize {
        self.values.brick_count()
    }

    /// Returns the bytes of [`memory_bytes`](Self::memory_bytes) that a grid mapped from a cache
    /// file holds in memory always.
    pub fn resident_bytes(&self) -> usize {
        self.memory_bytes() - self.values.payload_bytes()
    }

    /// Returns the bytes that values, nodes and bounds occupy.
    pub fn memory_bytes(&self) -> usize {
        self.tree.memory_bytes()
            + size_of_val(&self.cells[..])
            + self.hints.memory_bytes()
            + self.ranks.memory_bytes()
            + self.values.memory_bytes()
            + self.bounds.memory_bytes()
            + self.directory.memory_bytes()
            + self.empty_blocks.memory_bytes()
    }
}

//! Loading a grid: exact values of any type, or density with the voxel policy applied.
//!
//! Both estimate memory from the walked counts before anything is allocated. The voxel policy
//! (see `docs/vdb.md`): values that are not finite are an error, or 0 where asked for; negative
//! density is clamped to 0 and counted. It holds for inactive voxels, tiles and the background
//! too, since filters read them.

use std::time::Instant;

use glam::IVec3;

use super::archive::Archive;
use super::decode::{DecodeError, Decoder, Ingest, Stored};
use super::error::{Damage, Place, VdbError};
use super::listing::Walked;
use super::memory;
use super::record::ValueType;
use super::statistics::TypedGrid;
use crate::grid::{Tree, Voxel};
use crate::space::IndexTransform;

/// What the caller allows.
#[derive(Clone, Copy, Debug)]
pub struct LoadOptions {
    /// Grids whose estimated peak memory is above this are an error.
    pub max_memory_bytes: u64,
    /// Read NaN and infinite values as 0 instead of failing; [`Archive::load_density`] only.
    pub sanitize: bool,
}

impl Default for LoadOptions {
    /// No memory limit, nothing sanitised.
    fn default() -> Self {
        Self {
            max_memory_bytes: u64::MAX,
            sanitize: false,
        }
    }
}

/// A grid with its exact values, whatever their type.
#[derive(Clone, Debug)]
#[non_exhaustive]
#[expect(missing_docs, reason = "the variants are the value types")]
pub enum Grid {
    F32(TypedGrid<f32>),
    F64(TypedGrid<f64>),
    I32(TypedGrid<i32>),
    I64(TypedGrid<i64>),
    Vec3F(TypedGrid<[f32; 3]>),
    Vec3D(TypedGrid<[f64; 3]>),
    Vec3I(TypedGrid<[i32; 3]>),
}

/// A scalar grid ready to be rendered.
#[derive(Clone, Debug)]
pub struct DensityData {
    /// Finite values that are not negative; no active masks.
    pub tree: Tree<f32>,
    /// Where the grid lies in the world.
    pub transform: IndexTransform,
    /// What happened on the way.
    pub report: LoadReport,
}

/// Counts and times of a load.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LoadReport {
    /// Stored values that were negative and became 0; a tile counts once.
    pub clamped_negative_count: u64,
    /// Stored values that were not finite and became 0; a tile counts once.
    pub sanitized_count: u64,
    /// Wall seconds for estimating, decoding and building the tree.
    pub decode_seconds: f64,
}

impl Archive {
    /// Loads the exact values of grid `index`, active masks included.
    ///
    /// # Errors
    /// If the grid is one that is only listed, needs too much memory, or is damaged.
    ///
    /// # Panics
    /// If there is no grid `index`.
    pub fn load(&self, index: usize, options: &LoadOptions) -> Result<Grid, VdbError> {
        let walked = self.walked(index)?;
        let transform = self.transform(index)?;
        let typed = ExactLoad {
            archive: self,
            index,
            walked,
            transform,
            options,
        };
        Ok(match walked.encoding.value {
            ValueType::F32 => Grid::F32(typed.run()?),
            ValueType::F64 => Grid::F64(typed.run()?),
            ValueType::I32 => Grid::I32(typed.run()?),
            ValueType::I64 => Grid::I64(typed.run()?),
            ValueType::Vec3F => Grid::Vec3F(typed.run()?),
            ValueType::Vec3D => Grid::Vec3D(typed.run()?),
            ValueType::Vec3I => Grid::Vec3I(typed.run()?),
        })
    }

    /// Loads grid `index` as density: any scalar type, with the voxel policy applied.
    ///
    /// # Errors
    /// As [`Archive::load`]; also for vector grids, and for values that are not finite unless
    /// they are to be sanitised.
    ///
    /// # Panics
    /// If there is no grid `index`.
    pub fn load_density(
        &self,
        index: usize,
        options: &LoadOptions,
    ) -> Result<DensityData, VdbError> {
        let walked = self.walked(index)?;
        if walked.encoding.value.is_vector() {
            return Err(VdbError::NotScalar {
                path: self.path().to_owned(),
                grid: self.grids()[index].address.clone(),
                type_name: self.grids()[index].type_name.clone(),
            });
        }
        self.density_of(index, options, || match walked.encoding.value {
            ValueType::F64 => self.decode::<f64, _>(index, walked, &Density),
            ValueType::I32 => self.decode::<i32, _>(index, walked, &Density),
            ValueType::I64 => self.decode::<i64, _>(index, walked, &Density),
            _ => self.decode::<f32, _>(index, walked, &Density),
        })
    }

    /// Returns whether grid `index` holds vectors.
    ///
    /// # Errors
    /// If the grid is one that is only listed.
    ///
    /// # Panics
    /// If there is no grid `index`.
    pub fn is_vector(&self, index: usize) -> Result<bool, VdbError> {
        Ok(self.walked(index)?.encoding.value.is_vector())
    }

    /// Loads one component, 0 to 2, of the vectors of grid `index` as density.
    ///
    /// # Errors
    /// As [`Archive::load_density`], but for scalar grids.
    ///
    /// # Panics
    /// If there is no grid `index`, or no such component.
    pub fn load_component(
        &self,
        index: usize,
        component: usize,
        options: &LoadOptions,
    ) -> Result<DensityData, VdbError> {
        let walked = self.walked(index)?;
        let of = &Component(component);
        self.density_of(index, options, || match walked.encoding.value {
            ValueType::Vec3F => self.decode::<[f32; 3], _>(index, walked, of),
            ValueType::Vec3D => self.decode::<[f64; 3], _>(index, walked, of),
            ValueType::Vec3I => self.decode::<[i32; 3], _>(index, walked, of),
            _ => Err(VdbError::NotVector {
                path: self.path().to_owned(),
                grid: self.grids()[index].address.clone(),
                type_name: self.grids()[index].type_name.clone(),
            }),
        })
    }

    /// Applies the policy to what `decode` makes of grid `index`.
    fn density_of(
        &self,
        index: usize,
        options: &LoadOptions,
        decode: impl FnOnce() -> Result<(Tree<f32>, DensityTally), VdbError>,
    ) -> Result<DensityData, VdbError> {
        let start = Instant::now();
        let transform = self.transform(index)?;
        self.check_memory(index, self.walked(index)?, size_of::<f32>(), options)?;
        let (mut tree, tally) = decode()?;
        if let Some((first, value)) = tally.first_not_finite
            && !options.sanitize
        {
            return Err(VdbError::NotFinite {
                path: self.path().to_owned(),
                grid: self.grids()[index].address.clone(),
                count: tally.not_finite_count,
                first,
                value,
            });
        }
        tree.drop_active_masks();
        Ok(DensityData {
            tree,
            transform,
            report: LoadReport {
                clamped_negative_count: tally.negative_count,
                sanitized_count: tally.not_finite_count,
                decode_seconds: start.elapsed().as_secs_f64(),
            },
        })
    }

    fn transform(&self, index: usize) -> Result<IndexTransform, VdbError> {
        let transform = self.grids()[index].transform;
        transform.ok_or_else(|| self.damaged(index, Damage::new(0, "the grid has no affine map")))
    }

    fn check_memory(
        &self,
        index: usize,
        walked: &Walked,
        value_size: usize,
        options: &LoadOptions,
    ) -> Result<(), VdbError> {
        let needed = memory::estimate(&walked.topology, value_size);
        if needed > options.max_memory_bytes {
            return Err(self.too_large(index, needed, options.max_memory_bytes));
        }
        if let Some(what) = memory::too_many_nodes(&walked.topology) {
            return Err(self.damaged(index, Damage::new(walked.topology.background_at, what)));
        }
        Ok(())
    }

    fn too_large(&self, index: usize, needed: u64, limit: u64) -> VdbError {
        VdbError::TooLarge {
            path: self.path().to_owned(),
            grid: self.grids()[index].address.clone(),
            needed,
            limit,
        }
    }

    fn decode<V: Stored, I: Ingest<V>>(
        &self,
        index: usize,
        walked: &Walked,
        ingest: &I,
    ) -> Result<(Tree<I::Out>, I::Tally), VdbError> {
        let decoder = Decoder {
            bytes: self.bytes(),
            encoding: walked.encoding,
            topology: &walked.topology,
            ingest,
        };
        decoder.tree::<V>().map_err(|e| match e {
            DecodeError::Damage(damage) => self.damaged(index, damage),
            DecodeError::Undecodable(what) => VdbError::Undecodable {
                path: self.path().to_owned(),
                grid: self.grids()[index].address.clone(),
                what,
            },
            // The system refused: what it would have granted is not known.
            DecodeError::OutOfMemory { bytes } => self.too_large(index, bytes, 0),
        })
    }
}

struct ExactLoad<'a> {
    archive: &'a Archive,
    index: usize,
    walked: &'a Walked,
    transform: IndexTransform,
    options: &'a LoadOptions,
}

impl ExactLoad<'_> {
    fn run<V: Stored>(&self) -> Result<TypedGrid<V>, VdbError> {
        let Self {
            archive,
            index,
            walked,
            transform,
            options,
        } = *self;
        archive.check_memory(index, walked, size_of::<V>(), options)?;
        let (tree, ()) = archive.decode::<V, _>(index, walked, &Exact)?;
        Ok(TypedGrid {
            tree,
            transform,
            active_voxel_count: walked.topology.active_voxel_count,
            index_bbox: walked.topology.active_box,
        })
    }
}

/// Keeps values as they are.
struct Exact;

impl<V: Voxel> Ingest<V> for Exact {
    type Out = V;
    type Tally = ();

    fn convert(&self, value: V) -> V {
        value
    }

    fn inspect(&self, _origin: Option<IVec3>, _values: &mut [V], (): &mut ()) {}

    fn merge(&self, (): &mut (), (): ()) {}
}

/// Makes values finite and not negative, and counts where they were not.
struct Density;

#[derive(Debug, Default)]
struct DensityTally {
    negative_count: u64,
    not_finite_count: u64,
    first_not_finite: Option<(Place, f64)>,
}

/// A scalar that can serve as density; what overflows becomes infinite and is caught later.
trait Scalar: Copy {
    fn to_density(self) -> f32;
}

impl Scalar for f32 {
    fn to_density(self) -> f32 {
        self
    }
}

impl Scalar for f64 {
    #[expect(
        clippy::cast_possible_truncation,
        reason = "rounding to f32 is the point"
    )]
    fn to_density(self) -> f32 {
        self as f32
    }
}

impl Scalar for i32 {
    fn to_density(self) -> f32 {
        self as f32
    }
}

impl Scalar for i64 {
    fn to_density(self) -> f32 {
        self as f32
    }
}

impl<V: Scalar> Ingest<V> for Density {
    type Out = f32;
    type Tally = DensityTally;

    fn convert(&self, value: V) -> f32 {
        value.to_density()
    }

    fn inspect(&self, origin: Option<IVec3>, values: &mut [f32], tally: &mut DensityTally) {
        tally.inspect(origin, values);
    }

    fn merge(&self, into: &mut DensityTally, later: DensityTally) {
        into.merge(&later);
    }
}

/// One component of vectors, treated as density.
struct Component(usize);

impl<V: Scalar> Ingest<[V; 3]> for Component {
    type Out = f32;
    type Tally = DensityTally;

    fn convert(&self, value: [V; 3]) -> f32 {
        value[self.0].to_density()
    }

    fn inspect(&self, origin: Option<IVec3>, values: &mut [f32], tally: &mut DensityTally) {
        tally.inspect(origin, values);
    }

    fn merge(&self, into: &mut DensityTally, later: DensityTally) {
        into.merge(&later);
    }
}

impl DensityTally {
    fn inspect(&mut self, origin: Option<IVec3>, values: &mut [f32]) {
        // One pass without branches for the bricks that are as they should be.
        if values
            .iter()
            .fold(true, |fine, v| fine & (0.0..f32::INFINITY).contains(v))
        {
            return;
        }
        for (i, value) in values.iter_mut().enumerate() {
            if !value.is_finite() {
                self.not_finite_count += 1;
                let place = || match origin {
                    None => Place::Background,
                    Some(o) => Place::Voxel(o + crate::grid::brick::voxel_at(i)),
                };
                self.first_not_finite
                    .get_or_insert_with(|| (place(), f64::from(*value)));
                *value = 0.0;
            } else if *value < 0.0 {
                self.negative_count += 1;
                *value = 0.0;
            }
        }
    }

    fn merge(&mut self, later: &Self) {
        let Self {
            negative_count,
            not_finite_count,
            first_not_finite,
        } = *later;
        self.negative_count += negative_count;
        self.not_finite_count += not_finite_count;
        self.first_not_finite = self.first_not_finite.or(first_not_finite);
    }
}

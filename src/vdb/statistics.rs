//! Exact grids and what can be said of all their active values.
//!
//! Sums are `f64`, taken brick by brick in file order, so they are the same for any number of
//! threads. Tiles count with their number of voxels.

use glam::IVec3;
use rayon::prelude::*;

use crate::grid::brick::BRICK_LEN;
use crate::grid::{Tree, Voxel};
use crate::space::IndexTransform;

/// A grid whose values have type `V`.
#[derive(Clone, Debug)]
pub struct TypedGrid<V> {
    /// Values, tiles and active masks as in the file.
    pub tree: Tree<V>,
    /// Where the grid lies in the world.
    pub transform: IndexTransform,
    /// Active voxels, those of tiles included.
    pub active_voxel_count: u64,
    /// Lowest and highest active voxel; `None` where there is none.
    pub index_bbox: Option<(IVec3, IVec3)>,
}

/// What the active values of a grid amount to, one entry a component.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Statistics {
    /// Sum over active voxels.
    pub sum: Vec<f64>,
    /// Smallest active value; infinite where there is none. NaN is passed over.
    pub min: Vec<f64>,
    /// Largest active value; minus infinite where there is none. NaN is passed over.
    pub max: Vec<f64>,
}

/// A value whose components can be measured.
pub trait Components: Voxel {
    /// How many there are: 1 or 3.
    const COUNT: usize;
    /// Returns component `i` as `f64`; `i64` beyond 2⁵³ is rounded.
    fn component(&self, i: usize) -> f64;
}

macro_rules! components {
    ($($t:ty),*) => {$(
        impl Components for $t {
            const COUNT: usize = 1;
            fn component(&self, _i: usize) -> f64 {
                *self as f64
            }
        }
    )*};
}
components!(f64, i64);

macro_rules! lossless_components {
    ($($t:ty),*) => {$(
        impl Components for $t {
            const COUNT: usize = 1;
            fn component(&self, _i: usize) -> f64 {
                f64::from(*self)
            }
        }
        impl Components for [$t; 3] {
            const COUNT: usize = 3;
            fn component(&self, i: usize) -> f64 {
                f64::from(self[i])
            }
        }
    )*};
}
lossless_components!(f32, i32);

impl Components for [f64; 3] {
    const COUNT: usize = 3;
    fn component(&self, i: usize) -> f64 {
        self[i]
    }
}

#[derive(Clone, Copy)]
struct Part {
    sum: [f64; 3],
    min: [f64; 3],
    max: [f64; 3],
}

impl Part {
    const EMPTY: Self = Self {
        sum: [0.0; 3],
        min: [f64::INFINITY; 3],
        max: [f64::NEG_INFINITY; 3],
    };

    fn add<V: Components>(&mut self, value: &V, times: f64) {
        for i in 0..V::COUNT {
            let v = value.component(i);
            self.sum[i] += v * times;
            self.min[i] = self.min[i].min(v);
            self.max[i] = self.max[i].max(v);
        }
    }

    fn merge(mut self, other: Self) -> Self {
        for i in 0..3 {
            self.sum[i] += other.sum[i];
            self.min[i] = self.min[i].min(other.min[i]);
            self.max[i] = self.max[i].max(other.max[i]);
        }
        self
    }
}

impl<V: Components> TypedGrid<V> {
    /// Returns sum, minimum and maximum of the active values.
    pub fn statistics(&self) -> Statistics {
        let masks = self.tree.active_masks();
        let parts: Vec<_> = (0..self.tree.brick_count())
            .into_par_iter()
            .with_min_len(64)
            .map(|b| {
                let mut part = Part::EMPTY;
                for (values, mut bits) in self.tree.brick(b).chunks_exact(64).zip(masks[b]) {
                    while bits != 0 {
                        part.add(&values[bits.trailing_zeros() as usize], 1.0);
                        bits &= bits - 1;
                    }
                }
                part
            })
            .collect();
        const {
            assert!(
                BRICK_LEN.is_multiple_of(64),
                "one mask word for each 64 values"
            );
        };
        let mut all = parts.into_iter().fold(Part::EMPTY, Part::merge);
        for (_, edge, tile) in self.tree.stored_tiles() {
            if tile.active {
                all.add(&tile.value, f64::from(edge).powi(3));
            }
        }
        let of = |a: [f64; 3]| a[..V::COUNT].to_vec();
        Statistics {
            sum: of(all.sum),
            min: of(all.min),
            max: of(all.max),
        }
    }
}

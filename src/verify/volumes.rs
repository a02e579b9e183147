//! Volumes whose optics are known, and a slow second reading of their voxels.
//!
//! [`Volume`] keeps the tree that the renderer's grid was made from and reads it by the textbook:
//! eight corners, Gauss's quadrature cell by cell. It shares no code with the sampler, the
//! bounds or the walk.

use std::sync::Arc;

use glam::{DAffine3, DVec3, IVec3};

use crate::grid::{DensityGrid, Tree, TreeBuilder};
use crate::medium::Medium;
use crate::phase::Phase;
use crate::space::{IndexTransform, Ray};
use crate::spectrum::Rgb;

/// A density field, as the renderer sees it and as the oracle does.
#[derive(Clone)]
pub(super) struct Volume {
    tree: Tree<f32>,
    transform: IndexTransform,
    grid: Arc<DensityGrid>,
}

impl Volume {
    pub(super) fn new(tree: Tree<f32>, world_from_index: DAffine3) -> Self {
        let transform = IndexTransform::from_world_from_index(world_from_index)
            .expect("the suite's maps can be inverted");
        let grid = DensityGrid::new(tree.clone(), transform, usize::MAX).expect("no limit is set");
        Self {
            tree,
            transform,
            grid: Arc::new(grid),
        }
    }

    /// Places a tree by a voxel size alone.
    pub(super) fn uniform(tree: Tree<f32>, voxel_size: f64) -> Self {
        Self::new(tree, DAffine3::from_scale(DVec3::splat(voxel_size)))
    }

    pub(super) fn tree(&self) -> &Tree<f32> {
        &self.tree
    }

    pub(super) fn world_from_index(&self) -> DAffine3 {
        self.transform.world_from_index()
    }

    pub(super) fn medium(&self, sigma_t: f32, albedo: Rgb, phase: Phase) -> Medium {
        Medium::new(Arc::clone(&self.grid), sigma_t, albedo, phase)
    }

    /// A medium that only attenuates.
    pub(super) fn attenuating(&self, sigma_t: f32) -> Medium {
        self.medium(sigma_t, Rgb::WHITE, Phase::Isotropic)
    }

    /// ∫ density dt along a ray in the world, from `t0` to `t1`.
    pub(super) fn column(&self, ray: &Ray, range: (f64, f64)) -> f64 {
        let to_index = self.transform.index_from_world();
        let origin = to_index.transform_point3(ray.origin);
        let direction = to_index.transform_vector3(ray.direction);
        integrate(&self.tree, (origin, direction), range)
    }

    /// The same of the squares of the voxels, interpolated: the mean square of one tap.
    pub(super) fn column_of_squares(&self, ray: &Ray, range: (f64, f64)) -> f64 {
        let to_index = self.transform.index_from_world();
        let origin = to_index.transform_point3(ray.origin);
        let direction = to_index.transform_vector3(ray.direction);
        integrate_by((origin, direction), range, |p| {
            corners(p)
                .map(|(q, w)| w * f64::from(self.tree.probe(q).value).powi(2))
                .sum()
        })
    }

    /// ∫ density dV over everything: a voxel's tent has the volume of the voxel.
    ///
    /// For trees of bricks without tiles.
    pub(super) fn mass(&self) -> f64 {
        let values = (0..self.tree.brick_count()).flat_map(|b| self.tree.brick(b));
        let sum: f64 = values.map(|&v| f64::from(v)).sum();
        sum * self.world_from_index().matrix3.determinant().abs()
    }
}

/// The eight voxels around `p` with their trilinear weights.
fn corners(p: DVec3) -> impl Iterator<Item = (IVec3, f64)> {
    let low = p.floor();
    let f = p - low;
    (0..8).map(move |i| {
        let corner = IVec3::new(i >> 2 & 1, i >> 1 & 1, i & 1);
        let weight = |axis: usize| {
            if corner[axis] == 1 {
                f[axis]
            } else {
                1.0 - f[axis]
            }
        };
        (low.as_ivec3() + corner, weight(0) * weight(1) * weight(2))
    })
}

/// The trilinear value at `p`, in index space.
pub(super) fn trilinear(tree: &Tree<f32>, p: DVec3) -> f64 {
    corners(p)
        .map(|(q, w)| w * f64::from(tree.probe(q).value))
        .sum()
}

fn integrate(tree: &Tree<f32>, ray: (DVec3, DVec3), range: (f64, f64)) -> f64 {
    integrate_by(ray, range, |p| trilinear(tree, p))
}

/// ∫ f(o + t·d) dt for an `f` that is a cubic along the ray within each cell: Gauss's rule of
/// two points, exact up to cubics, between all the planes that the ray crosses.
fn integrate_by(
    (origin, direction): (DVec3, DVec3),
    (t0, t1): (f64, f64),
    f: impl Fn(DVec3) -> f64,
) -> f64 {
    let mut cuts = vec![t0, t1];
    for axis in 0..3 {
        let (o, d) = (origin[axis], direction[axis]);
        // Zero: parallel to the planes of this axis.
        if d == 0.0 {
            continue;
        }
        let (a, b) = (o + d * t0, o + d * t1);
        let mut plane = a.min(b).ceil();
        while plane <= a.max(b) {
            cuts.push((plane - o) / d);
            plane += 1.0;
        }
    }
    cuts.retain(|t| (t0..=t1).contains(t));
    cuts.sort_by(f64::total_cmp);
    let piece = |w: &[f64]| {
        let (middle, half) = (f64::midpoint(w[0], w[1]), (w[1] - w[0]) / 2.0);
        let node = half / 3.0_f64.sqrt();
        let at = |x: f64| f(origin + direction * (middle + x));
        half * (at(-node) + at(node))
    };
    cuts.windows(2).map(piece).sum()
}

/// Voxels of the box from `low` to `high`, `high` not included, with values by `f`.
pub(super) fn box_of(low: IVec3, high: IVec3, f: impl Fn(IVec3) -> f32) -> Tree<f32> {
    let mut voxels = Vec::new();
    for x in low.x..high.x {
        for y in low.y..high.y {
            for z in low.z..high.z {
                let p = IVec3::new(x, y, z);
                voxels.push((p, f(p)));
            }
        }
    }
    Tree::from_voxels(0.0, voxels)
}

/// A slab of thickness 1 between z = 0 and 1, but for ramps of half a voxel (1/256), density 1,
/// and 4096 wide: light that leaves through a side has scattered a thousand thicknesses away.
pub(super) fn slab() -> Volume {
    let mut b = TreeBuilder::new(0.0_f32);
    let node = b.upper_node(IVec3::ZERO);
    for xy in 0..32 * 32 {
        b.set_upper_tile(node, xy << 5, 1.0, true);
    }
    let tree = b.finish(Vec::new(), Vec::new());
    // Values reach from voxel 0 to voxel 127 with a ramp of one voxel below and above.
    let scale = DAffine3::from_scale(DVec3::new(1.0, 1.0, 1.0 / 128.0));
    let shift = DAffine3::from_translation(DVec3::new(-2048.0, -2048.0, 0.5));
    Volume::new(tree, scale * shift)
}

/// Value of the lumpy ball of radius about 20 voxels around the origin, with holes, at voxel `p`.
pub(super) fn lumps(p: IVec3) -> f32 {
    let q = p.as_vec3();
    let lumps = (q.x * 0.5).sin() * (q.y * 0.4).cos() + (q.z * 0.6).sin();
    (1.0 - q.length() / 20.0 + 0.4 * lumps).max(0.0)
}

/// Positions of the voxels of [`lumps`], those of value zero not left out.
pub(super) fn lump_voxels() -> impl Iterator<Item = IVec3> {
    (0..48 * 48 * 48).map(|i| IVec3::new(i / 2304, i / 48 % 48, i % 48) - 24)
}

/// The tree of [`lumps`].
pub(super) fn cloud_tree() -> Tree<f32> {
    let voxels = lump_voxels().map(|p| (p, lumps(p)));
    Tree::from_voxels(0.0, voxels.filter(|&(_, v)| v > 0.0))
}

/// The lumpy ball in the box from −1.2 to 1.2.
pub(super) fn cloud() -> Volume {
    Volume::uniform(cloud_tree(), 0.05)
}

/// A box of constant density, 1.6 wide.
pub(super) fn cube() -> Volume {
    let corner = IVec3::splat(16);
    Volume::uniform(box_of(-corner, corner, |_| 1.0), 0.05)
}

/// A ball of radius 1 and density 1 around the origin, `radius` voxels in radius: a voxel holds
/// the fraction of it that lies inside.
pub(super) fn ball(radius: i32) -> Volume {
    const PARTS: i32 = 6;
    let r = f64::from(radius);
    let inside = |p: IVec3| {
        let center = p.as_dvec3();
        // Half a voxel's diagonal is 0.87.
        if center.length() < r - 0.87 {
            return 1.0;
        }
        if center.length() > r + 0.87 {
            return 0.0;
        }
        let part = |i: i32| (f64::from(i) + 0.5) / f64::from(PARTS) - 0.5;
        let hits = (0..PARTS * PARTS * PARTS).filter(|i| {
            let offset = IVec3::new(i / PARTS / PARTS, i / PARTS % PARTS, i % PARTS);
            let q = center + DVec3::new(part(offset.x), part(offset.y), part(offset.z));
            q.length() < r
        });
        hits.count() as f32 / (PARTS * PARTS * PARTS) as f32
    };
    let corner = IVec3::splat(radius + 2);
    Volume::uniform(box_of(-corner, corner, inside), 1.0 / r)
}

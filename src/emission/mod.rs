//! What a volume emits: a field with a law, and where its light comes from.
//!
//! * [`Glow`]: emitted radiance per unit length at a point, given by a grid, or by a temperature and
//!   the absorption of the medium.
//! * [`Emission`]: that in place, with a lattice of its power, from which points are drawn as of a
//!   light, and along rays, and directions.
//!
//! The absorption is the medium's business and handed in. No rays through media here.

mod glow;
mod lattice;

use std::ops::ControlFlow;

use glam::DVec3;

pub use glow::{Glow, Law};
use lattice::Lattice;
pub use lattice::Spread;

use crate::sampling::Stream;
use crate::space::{Aabb, Ray};
use crate::spectrum::Rgb;

/// A glow with the lattice of its power.
#[derive(Clone, Debug)]
pub struct Emission {
    glow: Glow,
    /// In index space, of the field.
    hull: Aabb,
    lattice: Lattice,
}

impl Emission {
    /// Prepares what emits `emitted` at a point in world space, in the box of `glow`. `None` if that
    /// is nothing.
    ///
    /// # Cost
    /// Some two million looks, in parallel.
    pub fn new(glow: Glow, emitted: impl Fn(&Glow, DVec3) -> Rgb + Sync) -> Option<Self> {
        let hull = glow.field().occupied()?;
        let transform = *glow.field().transform();
        let lattice = Lattice::new(&hull, transform, |p| emitted(&glow, p).max_channel())?;
        Some(Self {
            glow,
            hull,
            lattice,
        })
    }

    /// Returns the field and its law.
    pub fn glow(&self) -> &Glow {
        &self.glow
    }

    /// Returns the integral of the brightest channel over the volume, about: for importance.
    pub fn power(&self) -> f64 {
        self.lattice.power()
    }

    /// Returns where that power is, about.
    pub fn spread(&self) -> Spread {
        self.lattice.spread()
    }

    /// Returns the radiance, about, of a line through a point that emits much.
    pub fn typical_radiance(&self) -> f32 {
        self.lattice.typical().radiance
    }

    /// Returns over which length, about, such a line collects it.
    pub fn typical_length(&self) -> f32 {
        self.lattice.typical().length
    }

    /// Returns where `ray` is in the box of the field, if it ever is.
    pub fn interval(&self, ray: &Ray) -> Option<(f64, f64)> {
        let to_index = self.glow.field().transform().index_from_world();
        let origin = to_index.transform_point3(ray.origin);
        let direction = to_index.transform_vector3(ray.direction);
        self.hull.intersect(origin, direction)
    }

    /// Draws a point in world space, where much is emitted more often; returns it with its density
    /// per unit of volume.
    #[inline] // bench: frame
    pub fn sample_point(&self, stream: &mut Stream) -> (DVec3, f32) {
        self.lattice.sample(stream)
    }

    /// Returns the density of [`sample_point`](Self::sample_point) at a point in world space.
    #[inline] // bench: frame
    pub fn pdf_point(&self, p_world: DVec3) -> f32 {
        self.lattice.pdf(p_world)
    }

    /// Draws a direction from `origin`, in world space, towards where much is emitted.
    #[inline] // bench: frame
    pub fn sample_towards(&self, origin: DVec3, stream: &mut Stream) -> DVec3 {
        self.lattice.sample_towards(origin, stream)
    }

    /// Returns the density of [`sample_towards`](Self::sample_towards) per unit of solid angle, from
    /// the origin of `ray` in its direction.
    #[inline] // bench: frame
    pub fn pdf_towards(&self, ray: &Ray) -> f32 {
        self.lattice.pdf_towards(ray)
    }

    /// Visits points of `ray` up to `t_max`, in order, each with a length: the sum of what is found
    /// at the points times their lengths has the integral along the ray as its expectation.
    ///
    /// There is a point for each `spacing` of radiance that the lattice expects; `u`, uniform in
    /// [0, 1), says where the first one lies.
    #[inline] // bench: frame
    pub fn for_each_point(
        &self,
        ray: &Ray,
        t_max: f64,
        (spacing, u): (f32, f32),
        visit: impl FnMut(f64, f32) -> ControlFlow<()>,
    ) {
        self.lattice.for_each_point(ray, t_max, (spacing, u), visit);
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use glam::{DAffine3, DQuat, IVec3};
    use statrs::distribution::{ChiSquared, ContinuousCDF as _};

    use super::*;
    use crate::field::Field;
    use crate::grid::{DensityGrid, Tree};
    use crate::sampling::StreamKey;
    use crate::space::IndexTransform;

    /// Lumps in a box of 24³ voxels, turned and stretched.
    fn emission() -> (Emission, DAffine3) {
        let at = |i: i32| IVec3::new(i / 576, i / 24 % 24, i % 24);
        let value = |p: IVec3| {
            let q = p.as_vec3();
            (q.x * 0.7).sin() + (q.y * 0.5).cos() * (q.z * 0.3).sin()
        };
        let voxels = (0..24 * 24 * 24).map(|i| (at(i), value(at(i)).powi(3)));
        let tree = Tree::from_voxels(0.0, voxels.filter(|(_, v)| *v > 0.0));
        let map = DAffine3::from_scale_rotation_translation(
            DVec3::new(0.1, 0.3, 0.2),
            DQuat::from_rotation_x(0.6),
            DVec3::new(1.0, 2.0, 3.0),
        );
        let transform = IndexTransform::from_world_from_index(map).expect("a map");
        let grid = DensityGrid::new(tree, transform, usize::MAX).expect("no limit was set");
        let glow = Glow::direct(Field::scalar(Arc::new(grid)), Rgb([1.0, 0.5, 0.0]));
        let emitted = |glow: &Glow, p: DVec3| glow.emitted(p, || Rgb::BLACK);
        (Emission::new(glow, emitted).expect("it glows"), map)
    }

    /// Chi-square of 2²⁰ points in 1000 blocks of 4³ voxels against the density, which is constant in
    /// each voxel cell: a bias of 2 % in a tenth of the points shifts the statistic by 8 standard
    /// deviations.
    #[test]
    fn points_follow_their_density() {
        let (emission, map) = emission();
        let n = 1 << 20;
        let block = |p: DVec3| {
            let q = (p / 4.0).floor().as_ivec3() + 2;
            let inside = q.cmpge(IVec3::ZERO).all() && q.cmplt(IVec3::splat(10)).all();
            inside.then(|| ((q.x * 10 + q.y) * 10 + q.z).unsigned_abs() as usize)
        };
        let mut counts = vec![0.0; 1000];
        let mut stream = Stream::new(StreamKey::default());
        let to_index = map.inverse();
        for _ in 0..n {
            let (p, density) = emission.sample_point(&mut stream);
            assert!(
                (density / emission.pdf_point(p) - 1.0).abs() < 1e-6,
                "at {p}"
            );
            let at = block(to_index.transform_point3(p)).expect("inside of the box");
            counts[at] += 1.0;
        }
        let mut expected = vec![0.0; 1000];
        let volume = map.matrix3.determinant();
        // From a brick below the first voxel, whose last cells read it, to the end.
        for i in 0..40 * 40 * 40 {
            let p = IVec3::new(i / 1600, i / 40 % 40, i % 40).as_dvec3() - 7.5;
            let at = block(p).expect("inside of the box");
            let density = emission.pdf_point(map.transform_point3(p));
            expected[at] += f64::from(n) * volume * f64::from(density);
        }
        let total: f64 = expected.iter().sum();
        assert!(
            (total / f64::from(n) - 1.0).abs() < 1e-4,
            "the density integrates to 1: {total}"
        );
        let cells = counts.iter().zip(&expected).filter(|(_, e)| **e > 0.0);
        let chi2: f64 = cells.clone().map(|(c, e)| (c - e).powi(2) / e).sum();
        let freedom = cells.count() as f64 - 1.0;
        let p = 1.0 - ChiSquared::new(freedom).expect("cells").cdf(chi2);
        assert!(
            p > 1e-4,
            "chi-square {chi2} of {freedom} degrees of freedom, p {p}"
        );
    }

    /// Chi-square of 2²⁰ directions, from beside the box and from within, in 24 × 48 bins of the sphere
    /// against the density, integrated by 256 midpoints a bin: a bias of 2 % in a tenth of the
    /// directions shifts the statistic by 8 standard deviations.
    #[test]
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "numbers of bins"
    )]
    fn directions_follow_their_density() {
        const BINS: [u32; 2] = [24, 48];
        const FINER: u32 = 16;
        let (emission, map) = emission();
        let n = 1 << 20;
        for from in [DVec3::new(-14.0, 9.0, 20.0), DVec3::new(11.0, 14.0, 9.0)] {
            let origin = map.transform_point3(from);
            let mut stream = Stream::new(StreamKey::default());
            let mut counts = vec![0.0; (BINS[0] * BINS[1]) as usize];
            for _ in 0..n {
                let d = emission.sample_towards(origin, &mut stream);
                let turn = (d.y.atan2(d.x) / std::f64::consts::TAU).rem_euclid(1.0);
                let bin = |x: f64, bins: u32| (x * f64::from(bins)).min(f64::from(bins) - 0.5);
                let (row, column) = (bin(0.5 * d.z + 0.5, BINS[0]), bin(turn, BINS[1]));
                counts[row as usize * BINS[1] as usize + column as usize] += 1.0;
            }
            let [rows, columns] = BINS.map(|bins| bins * FINER);
            let solid_angle = 4.0 * std::f64::consts::PI / f64::from(rows * columns);
            let mut expected = vec![0.0; counts.len()];
            for i in 0..rows * columns {
                let z = 2.0 * (f64::from(i / columns) + 0.5) / f64::from(rows) - 1.0;
                let turn = (f64::from(i % columns) + 0.5) / f64::from(columns);
                let (sin, cos) = (std::f64::consts::TAU * turn).sin_cos();
                let r = (1.0 - z * z).sqrt();
                let direction = DVec3::new(r * cos, r * sin, z);
                let pdf = emission.pdf_towards(&Ray { origin, direction });
                let bin = i / columns / FINER * BINS[1] + i % columns / FINER;
                expected[bin as usize] += f64::from(n) * solid_angle * f64::from(pdf);
            }
            let total: f64 = expected.iter().sum();
            assert!(
                (total / f64::from(n) - 1.0).abs() < 1e-3,
                "the density integrates to 1: {total}"
            );
            // Bins of a handful are no normal numbers; they are counted as one.
            let bins = counts.iter().copied().zip(expected);
            let (many, few): (Vec<_>, Vec<_>) = bins.partition(|(_, e)| *e >= 20.0);
            let rest = few
                .iter()
                .fold((0.0, 0.0), |(c, e), (count, of)| (c + count, e + of));
            let cells = many.iter().chain((rest.1 >= 20.0).then_some(&rest));
            assert!(
                rest.0 < rest.1 + 5.0 * rest.1.max(1.0).sqrt(),
                "rare bins: {rest:?}"
            );
            let chi2: f64 = cells.clone().map(|(c, e)| (c - e).powi(2) / e).sum();
            let freedom = cells.count() as f64 - 1.0;
            let p = 1.0 - ChiSquared::new(freedom).expect("cells").cdf(chi2);
            assert!(
                p > 1e-4,
                "from {from}: chi-square {chi2} of {freedom} degrees of freedom, p {p}"
            );
        }
    }

    /// Sums over points along lines against the integral in steps of a fiftieth of a voxel.
    #[test]
    fn points_along_rays_add_up_to_integrals() {
        let (emission, map) = emission();
        let mut stream = Stream::new(StreamKey::default());
        for k in 0..4 {
            let k = f64::from(k);
            let from = map.transform_point3(DVec3::new(-3.0, 4.0 + 4.0 * k, 9.0));
            let to = map.transform_point3(DVec3::new(30.0, 17.0 - 3.0 * k, 12.0 + k));
            let ray = Ray {
                origin: from,
                direction: (to - from).normalize_or_zero(),
            };
            let t_max = (to - from).length() * 0.8;
            let value = |t: f64| f64::from(emission.glow().emitted(ray.at(t), || Rgb::BLACK).0[0]);
            let steps = 2000;
            let step = t_max / f64::from(steps);
            let integral: f64 = (0..steps)
                .map(|i| step * value((f64::from(i) + 0.5) * step))
                .sum();
            let n = 200_000;
            let (mut sum, mut squares) = (0.0, 0.0);
            for _ in 0..n {
                let mut found = 0.0;
                let start = (emission.typical_radiance() / 2.0, stream.uniform());
                emission.for_each_point(&ray, t_max, start, |t, length| {
                    assert!(t < t_max, "beyond the end");
                    found += value(t) * f64::from(length);
                    ControlFlow::Continue(())
                });
                sum += found;
                squares += found * found;
            }
            let mean = sum / f64::from(n);
            let error = ((squares / f64::from(n) - mean * mean) / f64::from(n)).sqrt();
            // The steps are good to 1e-3.
            let off = (mean - integral).abs();
            assert!(
                off < 5.0 * error + 1e-3 * integral,
                "{mean} ± {error} for {integral}"
            );
            assert!(
                error < 0.01 * integral,
                "a bias of 5 % would be missed: {error}"
            );
        }
    }
}

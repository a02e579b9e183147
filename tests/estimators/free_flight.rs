//! Free flight and transmittance against closed forms: the first tests to believe.
//!
//! Each medium has τ(t) in closed form (piecewise cubic, integrated exactly by quadrature).
//! Distances of delta tracking are put through the distribution function 1 − exp(−τ) and must
//! be uniform: chi-square over 64 cells. With 2²⁰ flights a shift of 0.7 % of the probability
//! between the two halves of the distribution gives p < 1e-6. Estimates of ratio tracking must
//! have the mean exp(−τ) and the variance T²(exp(∫E[s²]/σ̄ dt) − 1), s being the one tap, each
//! within 5 standard errors: the smallest bias of the mean that is seen is 0.4 % (lone voxel)
//! to 1.1 % (oblique step). Seeds are fixed: a failure is a defect.

#![allow(
    clippy::cast_possible_truncation,
    clippy::cast_possible_wrap,
    clippy::cast_sign_loss,
    clippy::print_stdout,
    reason = "small numbers; what a test can see is printed"
)]

use std::sync::Arc;

use crate::support::{chi_square_p, integrate, moments};
use glam::{DVec3, IVec3};
use majorant::grid::{DensityGrid, Tree, TreeBuilder};
use majorant::medium::Medium;
use majorant::medium::{BoundSegment, Segments};
use majorant::phase::Phase;
use majorant::sampling::{Stream, StreamKey};
use majorant::space::{IndexTransform, Ray};
use majorant::spectrum::Rgb;
use majorant::stats::Counts;
use majorant::tracking::{BoundsKind, DistanceEstimator, Tracking, TransmittanceEstimator};

const FLIGHTS: usize = 1 << 20;
const CELLS: usize = 64;
const VOXEL: f64 = 0.25;

struct Case {
    name: &'static str,
    tree: Tree<f32>,
    scale: f32,
    /// In index space; the direction has unit length there, too.
    ray: (DVec3, DVec3),
    /// Where the ray is past everything, in voxels.
    end: f64,
}

/// The transmittance tests thin the media to optical thicknesses of 0.6 to 1.8: in a thick
/// medium the mean rests on a handful of large weights, and a test of it sees nothing.
const THIN: f32 = 0.12;

/// Voxels of the box from `lo` to `hi`, `hi` not included, with values by `f`.
fn box_of(lo: IVec3, hi: IVec3, f: impl Fn(IVec3) -> f32) -> Tree<f32> {
    let mut voxels = Vec::new();
    for x in lo.x..hi.x {
        for y in lo.y..hi.y {
            for z in lo.z..hi.z {
                voxels.push((IVec3::new(x, y, z), f(IVec3::new(x, y, z))));
            }
        }
    }
    Tree::from_voxels(0.0, voxels)
}

fn cases() -> Vec<Case> {
    let along_x = |y: f64, z: f64| (DVec3::new(-6.0, y, z), DVec3::X);
    let tilted = DVec3::new(0.8, 0.36, 0.48);
    let mut tile = TreeBuilder::new(0.0_f32);
    let node = tile.lower_node(IVec3::ZERO);
    tile.set_lower_tile(node, 0, 1.5, true);
    tile.set_lower_tile(node, 256, 1.5, true);
    vec![
        Case {
            name: "homogeneous: two tiles, with the filter's ramps at both ends",
            tree: tile.finish(Vec::new(), Vec::new()),
            scale: 0.5,
            ray: along_x(3.25, 2.5),
            end: 40.0,
        },
        Case {
            name: "step on a brick face",
            tree: box_of(IVec3::ZERO, IVec3::new(16, 8, 8), |p| {
                if p.x < 8 { 0.2 } else { 1.0 }
            }),
            scale: 0.9,
            ray: along_x(3.0, 4.75),
            end: 40.0,
        },
        Case {
            name: "step off a brick face, crossed at an angle",
            tree: box_of(IVec3::ZERO, IVec3::splat(16), |p| {
                if p.x < 5 { 0.1 } else { 0.8 }
            }),
            scale: 1.3,
            ray: (DVec3::new(-6.0, 1.3, 0.7), tilted),
            end: 60.0,
        },
        Case {
            name: "linear ramp, against the axes",
            tree: box_of(IVec3::ZERO, IVec3::splat(24), |p| {
                (p.x + 2 * p.y) as f32 * 0.02
            }),
            scale: 0.4,
            ray: (DVec3::new(26.0, 20.3, 22.9), -tilted),
            end: 80.0,
        },
        Case {
            name: "lone bright voxel at a brick corner",
            tree: Tree::from_voxels(0.0, [(IVec3::splat(8), 6.0)]),
            scale: 1.0,
            ray: (DVec3::splat(7.7) - tilted * 6.0, tilted),
            end: 20.0,
        },
    ]
}

impl Case {
    fn thinned(self) -> Self {
        Self {
            scale: self.scale * THIN,
            ..self
        }
    }

    fn medium(&self) -> Medium {
        let transform = IndexTransform::uniform(VOXEL);
        let grid = DensityGrid::new(self.tree.clone(), transform, usize::MAX).expect("no limit");
        // The extinction is given per voxel; the world's unit is another.
        let scale = self.scale / VOXEL as f32;
        Medium::new(Arc::new(grid), scale, Rgb::WHITE, Phase::Isotropic)
    }

    fn world_ray(&self) -> Ray {
        Ray {
            origin: self.ray.0 * VOXEL,
            direction: self.ray.1,
        }
    }

    /// The tree with each value squared; tiles are not needed.
    fn squares(&self) -> Tree<f32> {
        let bricks = self.tree.brick_origins().iter().enumerate();
        let voxels = bricks.flat_map(|(b, &o)| {
            let values = self.tree.brick(b).iter().enumerate();
            values.map(move |(i, v)| (o + majorant::grid::brick::voxel_at(i), v * v))
        });
        let tiles = self.tree.stored_tiles().flat_map(|(o, size, tile)| {
            (0..size * size * size).map(move |i| {
                let p = o + IVec3::new(i / size / size, i / size % size, i % size);
                (p, tile.value * tile.value)
            })
        });
        Tree::from_voxels(0.0, voxels.chain(tiles))
    }

    /// Optical thickness up to `t` voxels.
    fn tau(&self, t: f64) -> f64 {
        f64::from(self.scale) * integrate(&self.tree, self.ray, (0.0, t))
    }
}

/// All combinations of distance estimators and bounds, and a rate above the bound.
fn distance_settings() -> Vec<Tracking> {
    use DistanceEstimator as D;
    let mut all = Vec::new();
    for distance in [D::Delta, D::Decomposition, D::Regular, D::Auto] {
        for bounds in [BoundsKind::Brick, BoundsKind::Global, BoundsKind::Hierarchy] {
            for rate in [1.0, 2.5] {
                all.push(Tracking {
                    distance,
                    bounds,
                    flight_rate: rate,
                    ..Tracking::default()
                });
            }
        }
    }
    // The bound and the rate do not matter where nothing is drawn.
    all.retain(|t| {
        t.distance != D::Regular || (t.bounds, t.flight_rate) == (BoundsKind::Brick, 1.0)
    });
    all
}

fn shown(t: &Tracking) -> String {
    let Tracking {
        distance,
        transmittance,
        bounds,
        rate,
        flight_rate,
        ..
    } = t;
    format!("{distance} at {flight_rate}, {transmittance} at {rate}, {bounds}")
}

#[test]
fn free_flight_draws_the_right_distances() {
    for case in cases() {
        let (medium, ray) = (case.medium(), case.world_ray());
        // The distribution function on a fine raster, for looking up cells.
        let steps = 20_000;
        let mut table = vec![0.0];
        for i in 0..steps {
            let at = |k: usize| case.end * k as f64 / f64::from(steps as u32);
            let piece = integrate(&case.tree, case.ray, (at(i), at(i + 1)));
            table.push(table[i] + f64::from(case.scale) * piece);
        }
        let total = table[steps];
        for (seed, tracking) in distance_settings().iter().enumerate() {
            let what = format!("{}: {}", case.name, shown(tracking));
            // The plainest has the most flights; the others share its code but for a switch.
            let flights = if seed == 0 { FLIGHTS } else { FLIGHTS / 4 };
            let mut cells = [0_u32; CELLS];
            let (mut escaped, mut counts) = (0_u32, Counts::default());
            for i in 0..flights {
                let mut stream = Stream::new(StreamKey {
                    seed: seed as u64,
                    sample: i as u64,
                    ..StreamKey::default()
                });
                let end = f64::INFINITY;
                let flight = tracking.sample_collision(&medium, &ray, end, &mut stream);
                counts.add(&stream.counts);
                let Some(t) = flight else {
                    escaped += 1;
                    continue;
                };
                let at = (t / VOXEL / case.end * steps as f64).min(steps as f64 - 1e-9);
                let (k, f) = (at as usize, at.fract());
                let tau = table[k] + (table[k + 1] - table[k]) * f;
                // Uniform in [0, 1) given that the flight ended.
                let u = (1.0 - (-tau).exp()) / (1.0 - (-total).exp());
                cells[((u * CELLS as f64) as usize).min(CELLS - 1)] += 1;
            }
            assert_eq!(counts.bound_violations, 0, "{what}");
            let n = flights as f64;
            let p = (-total).exp();
            let z = (f64::from(escaped) - n * p) / (n * p * (1.0 - p)).sqrt();
            assert!(z.abs() < 5.0, "{what}: escapes are off, z = {z}");
            let expected = (n - f64::from(escaped)) / CELLS as f64;
            let chi2: f64 = cells
                .iter()
                .map(|&c| (f64::from(c) - expected).powi(2) / expected)
                .sum();
            let p = chi_square_p(chi2, CELLS as f64 - 1.0);
            println!("{what}: tau {total:.3}, escape z {z:+.2}, chi2 {chi2:.1}, p {p:.3}");
            assert!(p > 1e-5, "{what}: chi2 {chi2}, p {p}, cells {cells:?}");
        }
    }
}

/// All unbiased combinations of transmittance estimators, bounds and rates.
fn transmittance_settings() -> Vec<Tracking> {
    use TransmittanceEstimator as E;
    let mut all = Vec::new();
    for transmittance in [
        E::Ratio,
        E::ResidualRatio,
        E::Exact,
        E::PowerSeries,
        E::Delta,
        E::Auto,
    ] {
        for bounds in [BoundsKind::Brick, BoundsKind::Global, BoundsKind::Hierarchy] {
            for rate in [1.0, 2.5] {
                all.push(Tracking {
                    transmittance,
                    bounds,
                    rate,
                    ..Tracking::default()
                });
            }
        }
    }
    // Exact has no bound, delta tracking no variance that would depend on it.
    all.retain(|t| {
        !matches!(t.transmittance, E::Exact | E::Delta)
            || (t.bounds, t.rate) == (BoundsKind::Brick, 1.0)
    });
    all
}

/// The segments that a setting cuts rays into; `Hierarchy` merges nodes below a depth of 3.
fn segments(bounds: BoundsKind) -> Segments {
    match bounds {
        BoundsKind::Global => Segments::Whole,
        BoundsKind::Auto | BoundsKind::Brick => Segments::Bricks,
        BoundsKind::Hierarchy => Segments::Blocks,
    }
}

/// Novák's control of a segment and the bound of what it leaves, from the published formula.
fn novak(s: &BoundSegment) -> (f64, f64) {
    let [min, max, mean] = [s.sigma_min, s.sigma_maj, s.sigma_mean].map(f64::from);
    let r = max - min;
    let c = min + r * ((1.0 / (f64::from(s.diagonal) * r)).exp2() - 1.0);
    let c = c.clamp(min, mean.max(min));
    (c, (max - c).max(c - min))
}

impl Case {
    /// The variance that theory gives an estimator; `None` where it is a mixture.
    fn variance(&self, medium: &Medium, tracking: &Tracking) -> Option<f64> {
        let transmittance = (-self.tau(self.end)).exp();
        let residual = match tracking.transmittance {
            TransmittanceEstimator::Exact => return Some(0.0),
            TransmittanceEstimator::Delta => return Some(transmittance * (1.0 - transmittance)),
            TransmittanceEstimator::Ratio => false,
            TransmittanceEstimator::ResidualRatio => true,
            _ => return None,
        };
        // ∫ E[(s − c)²] / M over the segments that are not closed forms; the mean square of one
        // tap is the trilinear value of the squares.
        let squares = self.squares();
        let mut walk = medium.ray_over(&self.world_ray(), f64::INFINITY, segments(tracking.bounds));
        let scale = f64::from(self.scale) / VOXEL;
        let mut exponent = 0.0;
        while let Some(s) = walk.next_segment() {
            if !s.is_homogeneous() {
                let (control, bound) = if residual {
                    novak(&s)
                } else {
                    (0.0, s.sigma_maj.into())
                };
                let rate = bound * f64::from(tracking.rate);
                let range = (s.t0 / VOXEL, s.t1 / VOXEL);
                let square = integrate(&squares, self.ray, range) * scale * scale * VOXEL;
                let value = integrate(&self.tree, self.ray, range) * scale * VOXEL;
                let constant = control * control * (s.t1 - s.t0);
                exponent += (square - 2.0 * control * value + constant) / rate;
            }
        }
        Some(transmittance.powi(2) * exponent.exp_m1())
    }
}

/// Draws `n` estimates.
fn estimates(case: &Case, tracking: &Tracking, roulette: f32, seed: u64, n: usize) -> Vec<f64> {
    let (medium, ray) = (case.medium(), case.world_ray());
    let mut counts = Counts::default();
    let weights = (0..n)
        .map(|i| {
            let mut stream = Stream::new(StreamKey {
                seed,
                sample: i as u64,
                ..StreamKey::default()
            });
            let end = f64::INFINITY;
            let weight = tracking.estimate_transmittance(&medium, &ray, end, roulette, &mut stream);
            counts.add(&stream.counts);
            f64::from(weight)
        })
        .collect();
    assert_eq!(counts.bound_violations, 0, "{}", case.name);
    weights
}

#[test]
fn transmittance_has_the_right_mean_and_variance() {
    for case in cases().into_iter().map(Case::thinned) {
        let medium = case.medium();
        let transmittance = (-case.tau(case.end)).exp();
        for (seed, tracking) in transmittance_settings().iter().enumerate() {
            let what = format!("{}: {}", case.name, shown(tracking));
            let flights = if seed == 0 { FLIGHTS } else { FLIGHTS / 4 };
            let weights = estimates(&case, tracking, 0.0, 100 + seed as u64, flights);
            let (mean, variance, fourth) = moments(&weights);
            let n = flights as f64;
            // Exact but for the rounding of an f32 weight.
            let error = (variance / n).sqrt().max(3e-7 * transmittance);
            let z_mean = (mean - transmittance) / error;
            println!(
                "{what}: T {transmittance:.5}, z of mean {z_mean:+.2}, smallest bias seen {:.1e}",
                5.0 * error / transmittance,
            );
            assert!(z_mean.abs() < 5.0, "{what}: {mean}, not {transmittance}");
            if let Some(expected) = case.variance(&medium, tracking) {
                let spread = ((fourth - variance * variance) / n).sqrt();
                // The code's control has a polynomial for the power, 2e-4 off at most.
                let near = 5.0 * spread + 2e-3 * expected + 1e-12;
                assert!(
                    (variance - expected).abs() < near,
                    "{what}: variance {variance} ± {spread}, not {expected}"
                );
            }
        }
    }
}

#[test]
fn roulette_keeps_the_mean() {
    use TransmittanceEstimator as E;
    for case in cases().into_iter().map(Case::thinned) {
        let transmittance = (-case.tau(case.end)).exp();
        for estimator in [
            E::Ratio,
            E::ResidualRatio,
            E::Exact,
            E::PowerSeries,
            E::Auto,
        ] {
            let tracking = Tracking {
                transmittance: estimator,
                ..Tracking::default()
            };
            for roulette in [0.1, 0.5, 1.0] {
                let weights = estimates(&case, &tracking, roulette, 2, FLIGHTS / 8);
                let (mean, variance, _) = moments(&weights);
                let error = (variance / weights.len() as f64).sqrt();
                let z = (mean - transmittance) / error.max(3e-7 * transmittance);
                assert!(
                    z.abs() < 5.0,
                    "{}, {estimator} at {roulette}: {mean}, not {transmittance}",
                    case.name
                );
                // The power series is no product of probabilities.
                assert!(
                    estimator == E::PowerSeries || weights.iter().all(|w| *w >= 0.0),
                    "{}: an estimate is negative",
                    case.name
                );
            }
        }
    }
}

#[test]
fn ray_marching_is_biased_and_says_so() {
    // The lone voxel, marched in steps of 4: exp(−Σ) is too large by more than 30 standard
    // errors; at a twentieth of a voxel the bias is below what 2¹⁸ estimates see.
    let cases = cases();
    let case = cases.last().expect("a lone voxel");
    let transmittance = (-case.tau(case.end)).exp();
    let z = |march_step: f64| {
        let tracking = Tracking {
            transmittance: TransmittanceEstimator::ApproxRayMarching,
            march_step,
            ..Tracking::default()
        };
        let weights = estimates(case, &tracking, 0.0, 3, FLIGHTS / 4);
        let (mean, variance, _) = moments(&weights);
        (mean - transmittance) / (variance / weights.len() as f64).sqrt()
    };
    let (coarse, fine) = (z(4.0), z(0.05));
    println!("z of ray marching: {coarse:+.1} in steps of 4, {fine:+.2} in steps of 0.05");
    assert!(coarse > 30.0, "{coarse}");
    assert!(fine.abs() < 5.0, "{fine}");
}

#[test]
fn seventeen_decades_of_extinction_follow_beer_and_lambert() {
    // One tile of 8³ voxels crossed through its middle, its ramps cut off by starting inside.
    let mut b = TreeBuilder::new(0.0_f32);
    b.set_root_tile(IVec3::ZERO, 1.0, true);
    let transform = IndexTransform::uniform(1.0);
    let grid = DensityGrid::new(b.finish(vec![], vec![]), transform, usize::MAX).unwrap();
    let grid = Arc::new(grid);
    for decade in -8..=8 {
        let sigma_t = 10.0_f32.powi(decade);
        let medium = Medium::new(Arc::clone(&grid), sigma_t, Rgb::WHITE, Phase::Isotropic);
        let (n, length) = (200_000, 1.0 / f64::from(sigma_t));
        let start = DVec3::splat(2000.0);
        let mut counts = Counts::default();
        let mut escaped = 0;
        let tracking = Tracking::default();
        for i in 0..n {
            let mut stream = Stream::new(StreamKey {
                sample: i,
                ..StreamKey::default()
            });
            let ray = Ray {
                origin: start,
                direction: DVec3::Y,
            };
            let flight = tracking.sample_collision(&medium, &ray, length, &mut stream);
            counts.add(&stream.counts);
            escaped += u32::from(flight.is_none());
        }
        // The tile is 4096 wide with ramps: at low extinction the ray leaves it.
        let inside = length.min(2095.0 + 0.5);
        let p = (-f64::from(sigma_t) * inside).exp();
        let n = n as f64;
        let z = (f64::from(escaped) - n * p) / (n * p * (1.0 - p)).sqrt().max(1.0);
        assert!(
            z.abs() < 5.0,
            "sigma_t 1e{decade}: {escaped} of {n} escape, not {}",
            n * p
        );
        assert!(
            counts.tentative_collisions <= counts.segments + 200_000,
            "1e{decade}: {counts:?}"
        );
    }
}

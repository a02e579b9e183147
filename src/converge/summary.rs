//! What the measurements of one estimator come to: points of the error curve, efficiency, time
//! to a target error, and whether there is a bias.
//!
//! * **Points**: means over the seeds of a rung, with standard errors of the means.
//! * **Efficiency** is `1 / (variance · CPU s)`, relative variance as in relMSE; twice as
//!   efficient is half the time for the same noise. Variance falls as `1/N` and time grows as
//!   `N`, so the product does not depend on `N` but for the fixed cost of beginning a render. It
//!   is pooled over the upper rungs, whose samples are within 4 times of the largest.
//! * **Time to a target**: where `relMSE = variance(1 sample) / N + bias²` reaches it, by the
//!   pooled variance and cost; never, if the bias alone is larger.
//!
//! Everything that depends on time is in a `timing` field. The rest is the same in every run.

use serde::{Deserialize, Serialize};

use super::bias::{BiasTest, Verdict, test_bias};
use super::bootstrap::{Interval, interval_95};
use super::ladder::{Comparison, Measurement, Record, Seconds};
use super::metrics::{SquaredError, TRIMMED_ONE_OF};
use crate::stats::Counts;

/// Rungs with at least a quarter of the largest number of samples are pooled.
const POOLED: u32 = 4;

/// A mean over seeds and its standard error; unknown for one seed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Mean {
    /// The mean.
    pub mean: f64,
    /// Its standard error.
    pub standard_error: Option<f64>,
}

impl Mean {
    fn of(values: &[f64]) -> Self {
        let n = values.len() as f64;
        let mean = values.iter().sum::<f64>() / n;
        let squares = values.iter().map(|x| (x - mean).powi(2)).sum::<f64>();
        Self {
            mean,
            standard_error: (values.len() > 1).then(|| (squares / (n - 1.0) / n).sqrt()),
        }
    }
}

/// One rung.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Point {
    /// Samples a pixel.
    pub spp: u32,
    /// Voxel values read by one render, the mean.
    pub values_read: f64,
    /// Mean squared error, the reference's noise subtracted; below zero by chance.
    pub mse: Mean,
    /// Relative mean squared error likewise.
    pub rel_mse: Mean,
    /// The same without the worst pixels.
    pub rel_mse_trimmed: Mean,
    /// relMSE by the image's own samples: what it is without bias.
    pub rel_variance: Option<Mean>,
    /// Mean FLIP of the first seed.
    pub flip: Option<f64>,
    /// What one render took, the mean.
    pub timing: Seconds,
}

/// A number with its 95 % interval, where there is one.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Estimate {
    /// The number.
    pub value: f64,
    /// Its interval.
    pub interval: Option<Interval>,
}

/// What depends on the machine and on what else it does.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Timing {
    /// CPU seconds of all renders.
    pub cpu_secs: f64,
    /// Wall-clock seconds from the beginning of a render to its first tile, the least of the
    /// shortest renders: what is prepared before the first sample.
    pub first_tile_secs: f64,
    /// CPU seconds for one sample of every pixel.
    pub cpu_secs_per_spp: f64,
    /// `1 / (relative variance · CPU s)`.
    pub efficiency: Option<Estimate>,
    /// CPU seconds until the target error is reached; `None` if never.
    pub cpu_secs_to_target: Option<f64>,
}

/// All about one estimator.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Summary {
    /// The complete rungs.
    pub points: Vec<Point>,
    /// Renders, those of an incomplete rung included.
    pub render_count: usize,
    /// Sums over all renders.
    pub counts: Counts,
    /// Samples a pixel, over all renders.
    pub total_spp: u64,
    /// relMSE times samples a pixel, by the image's own samples.
    pub rel_variance_of_one_spp: Option<f64>,
    /// `1 / (relative variance · million values read)`.
    pub efficiency_by_values_read: Option<Estimate>,
    /// Slope of log relMSE over log samples, of the upper rungs: −1 without bias.
    pub slope: Option<f64>,
    /// Share of the relMSE of the last point that the worst pixels make up.
    pub worst_share: Option<f64>,
    /// Samples a pixel until the target error is reached; `None` if never.
    pub spp_to_target: Option<f64>,
    /// Comparison of all renders together with the reference.
    pub bias: BiasTest,
    /// What depends on time.
    pub timing: Timing,
}

/// Sums up a record, whose rungs have `seeds` renders.
pub fn summarise(
    record: &Record,
    seeds: u32,
    comparison: Comparison<'_>,
    target_rel_mse: f64,
) -> Summary {
    let points: Vec<Point> = record.complete_rungs(seeds).map(point).collect();
    let pool = Pool::of(record, seeds);
    let bias = test_bias(&record.film, comparison.reference, comparison.covered);
    let remaining = match bias.verdict {
        Verdict::Biased | Verdict::Differs => target_rel_mse - bias.squared_bias,
        Verdict::Unbiased | Verdict::Unknown => target_rel_mse,
    };
    let variance = pool.variance_of_one_spp();
    let reachable = variance.filter(|_| remaining > 0.0);
    let spp_to_target = reachable.map(|variance| variance / remaining);
    let mut counts = Counts::default();
    for m in &record.measurements {
        counts.add(&m.counts);
    }
    let spp = |m: &Measurement| u64::from(m.spp);
    let total_spp = record.measurements.iter().map(spp).sum();
    let cpu_secs_per_spp = pool.cost_of_one_spp(|x| x.cpu_secs);
    let first = record.measurements.iter().take_while(|m| m.spp == 1);
    Summary {
        slope: slope(&points),
        worst_share: points.last().and_then(worst_share),
        points,
        render_count: record.measurements.len(),
        counts,
        total_spp,
        rel_variance_of_one_spp: variance,
        efficiency_by_values_read: pool.efficiency(|x| x.million_values),
        spp_to_target,
        bias,
        timing: Timing {
            cpu_secs: record.cpu_secs(),
            first_tile_secs: first
                .map(|m| m.first_tile_secs)
                .fold(f64::INFINITY, f64::min),
            cpu_secs_per_spp,
            efficiency: pool.efficiency(|x| x.cpu_secs),
            cpu_secs_to_target: spp_to_target.map(|n| n * cpu_secs_per_spp),
        },
    }
}

fn point(rung: &[Measurement]) -> Point {
    let mean = |f: &dyn Fn(&Measurement) -> f64| Mean::of(&rung.iter().map(f).collect::<Vec<_>>());
    let error = |f: fn(&super::metrics::Errors) -> SquaredError| {
        mean(&move |m| m.errors.as_ref().map_or(f64::NAN, |e| f(e).value()))
    };
    let variances: Option<Vec<f64>> = rung
        .iter()
        .map(|m| m.errors.and_then(|e| e.rel_variance))
        .collect();
    Point {
        spp: rung[0].spp,
        values_read: mean(&|m| m.counts.values_read() as f64).mean,
        mse: error(|e| e.mse),
        rel_mse: error(|e| e.rel_mse),
        rel_mse_trimmed: error(|e| e.rel_mse_trimmed),
        rel_variance: variances.map(|v| Mean::of(&v)),
        flip: rung[0].flip,
        timing: Seconds {
            cpu: mean(&|m| m.secs.cpu).mean,
            wall: mean(&|m| m.secs.wall).mean,
        },
    }
}

/// What trimming takes away. Unknown where the error is not above the reference's noise.
fn worst_share(point: &Point) -> Option<f64> {
    let kept = 1.0 - 1.0 / TRIMMED_ONE_OF as f64;
    let share = 1.0 - kept * point.rel_mse_trimmed.mean / point.rel_mse.mean;
    (0.0..=1.0).contains(&share).then_some(share)
}

/// One render of the upper rungs.
#[derive(Clone, Copy)]
struct Pooled {
    spp: f64,
    rel_variance: f64,
    cpu_secs: f64,
    million_values: f64,
}

/// The renders of the upper rungs, rung by rung.
struct Pool(Vec<Vec<Pooled>>);

impl Pool {
    fn of(record: &Record, seeds: u32) -> Self {
        let largest = record.complete_rungs(seeds).last().map_or(0, |r| r[0].spp);
        let upper = record
            .complete_rungs(seeds)
            .filter(|rung| rung[0].spp * POOLED >= largest);
        let pooled = |m: &Measurement| {
            Some(Pooled {
                spp: f64::from(m.spp),
                rel_variance: m.errors?.rel_variance?,
                cpu_secs: m.secs.cpu,
                million_values: m.counts.values_read() as f64 / 1e6,
            })
        };
        let rungs = upper.map(|rung| rung.iter().filter_map(pooled).collect());
        Self(rungs.filter(|r: &Vec<Pooled>| !r.is_empty()).collect())
    }

    fn variance_of_one_spp(&self) -> Option<f64> {
        let all: Vec<Pooled> = self.0.concat();
        (!all.is_empty()).then(|| variance_of_one_spp(&all))
    }

    fn cost_of_one_spp(&self, cost: fn(&Pooled) -> f64) -> f64 {
        cost_of_one_spp(&self.0.concat(), cost)
    }

    fn efficiency(&self, cost: fn(&Pooled) -> f64) -> Option<Estimate> {
        let efficiency = |x: &[Pooled]| (variance_of_one_spp(x) * cost_of_one_spp(x, cost)).recip();
        let value = efficiency(&self.0.concat());
        // No variance or no lookups: there is nothing to be efficient at.
        value.is_finite().then(|| Estimate {
            value,
            interval: interval_95(&self.0, &efficiency),
        })
    }
}

/// Weighted by samples: the larger rungs know it better.
fn variance_of_one_spp(pooled: &[Pooled]) -> f64 {
    let weighted = pooled.iter().map(|x| x.spp * x.spp * x.rel_variance);
    weighted.sum::<f64>() / pooled.iter().map(|x| x.spp).sum::<f64>()
}

fn cost_of_one_spp(pooled: &[Pooled], cost: fn(&Pooled) -> f64) -> f64 {
    pooled.iter().map(cost).sum::<f64>() / pooled.iter().map(|x| x.spp).sum::<f64>()
}

/// The regression line through the upper half of the rungs, at least three.
fn slope(points: &[Point]) -> Option<f64> {
    let upper = &points[points.len().saturating_sub((points.len() / 2).max(3))..];
    let logs: Vec<(f64, f64)> = upper
        .iter()
        .filter(|p| p.rel_mse.mean > 0.0)
        .map(|p| (f64::from(p.spp).ln(), p.rel_mse.mean.ln()))
        .collect();
    let n = logs.len() as f64;
    if logs.len() < 3 {
        return None;
    }
    let (mx, my) = logs
        .iter()
        .fold((0.0, 0.0), |(a, b), (x, y)| (a + x / n, b + y / n));
    let covariance: f64 = logs.iter().map(|(x, y)| (x - mx) * (y - my)).sum();
    let variance: f64 = logs.iter().map(|(x, _)| (x - mx).powi(2)).sum();
    Some(covariance / variance)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::converge::Reference;
    use crate::converge::metrics::Errors;

    /// Renders whose variance is 8/N and whose cost is N/4 s.
    fn record(rungs: u32, bias: f64) -> Record {
        let mut record = Record::new(2, 1);
        for rung in 0..rungs {
            for repeat in 0..2 {
                let spp = 1 << rung;
                let variance = 8.0 / f64::from(spp);
                let rel_mse = SquaredError {
                    raw: variance + bias + 0.5,
                    noise: 0.5,
                };
                record.measurements.push(Measurement {
                    spp,
                    repeat,
                    secs: Seconds {
                        cpu: f64::from(spp) / 4.0,
                        wall: 1.0,
                    },
                    first_tile_secs: 0.1 * f64::from(rung + 1),
                    counts: Counts {
                        lookups: u64::from(spp) * 2_000_000,
                        ..Counts::default()
                    },
                    errors: Some(Errors {
                        rel_mse,
                        rel_variance: (spp > 1).then_some(variance),
                        ..Errors::default()
                    }),
                    flip: None,
                });
            }
        }
        for pixel in record.film.pixels_mut() {
            pixel.count = 100;
            pixel.mean = [1.0 + bias.sqrt(); 3];
            pixel.m2 = [1.0; 3];
        }
        record
    }

    fn summary(rungs: u32, bias: f64) -> Summary {
        let reference = Reference {
            width: 2,
            height: 1,
            mean: vec![[1.0; 3]; 2],
            variance: Some(vec![[0.0; 3]; 2]),
            relative_rounding: 0.0,
        };
        let comparison = Comparison {
            reference: &reference,
            covered: &[0, 1],
        };
        summarise(&record(rungs, bias), 2, comparison, 0.01)
    }

    #[test]
    fn figures_are_those_worked_out_by_hand() {
        let s = summary(6, 0.0);
        let close = |a: Option<f64>, b: f64| {
            let a = a.expect("known");
            assert!((a / b - 1.0).abs() < 1e-9, "{a}, not {b}");
        };
        assert_eq!(s.points.len(), 6);
        close(s.rel_variance_of_one_spp, 8.0);
        close(s.timing.efficiency.map(|e| e.value), 1.0 / (8.0 * 0.25));
        close(
            s.efficiency_by_values_read.map(|e| e.value),
            1.0 / (8.0 * 2.0),
        );
        close(s.slope, -1.0);
        close(s.spp_to_target, 800.0);
        close(s.timing.cpu_secs_to_target, 200.0);
        close(Some(s.timing.first_tile_secs), 0.1);
        close(Some(s.points[3].rel_mse.mean), 1.0);
        assert_eq!(s.points[3].rel_mse.standard_error, Some(0.0));
        assert_eq!(s.total_spp, 2 * 63);
        // The pixels of these renders have no trimmed error at all.
        assert_eq!(s.worst_share, Some(1.0));
    }

    #[test]
    fn a_target_below_the_bias_is_never_reached() {
        let s = summary(6, 0.04);
        assert_eq!(s.bias.verdict, Verdict::Biased);
        assert_eq!((s.spp_to_target, s.timing.cpu_secs_to_target), (None, None));
        assert!(s.slope.unwrap() > -0.95, "{:?}", s.slope);
    }

    #[test]
    fn nothing_measured_is_nothing_known() {
        let s = summary(0, 0.0);
        assert_eq!((s.points.len(), s.spp_to_target, s.slope), (0, None, None));
        let s = summary(1, 0.0);
        assert!(s.timing.efficiency.is_none(), "one sample has no variance");
    }
}

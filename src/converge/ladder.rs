//! The measurements of one estimator: renders of 1, 2, 4, … samples a pixel, several seeds each.
//!
//! Many short renders instead of one that grows: each is independent of all others, so that the
//! spread over seeds is known, and what a render costs is what a user would pay for it. A rung
//! is begun if twice the CPU seconds of the last one still fit into the budget, and is then
//! finished; the first always is. Nothing else depends on time: the images are the same on any
//! machine.

use std::sync::atomic::AtomicBool;

use serde::{Deserialize, Serialize};

use super::metrics::{Errors, errors};
use super::{Reference, flip};
use crate::film::{Film, PixelCost};
use crate::render::{Progress, render_with_costs};
use crate::scene::Scene;
use crate::stats::Counts;

/// The highest rung: 2²⁴ samples a pixel.
const LAST_RUNG: u32 = 24;

/// How far the ladder goes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Extent {
    /// Independent renders of a rung.
    pub seeds: u32,
    /// CPU seconds for all renders.
    pub budget_secs: f64,
    /// No render takes more samples a pixel.
    pub max_spp: u32,
}

/// One render of the ladder.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Step {
    /// The rung: `2^rung` samples a pixel.
    pub rung: u32,
    /// Which of the rung's renders.
    pub repeat: u32,
}

impl Step {
    /// Returns the number of samples a pixel.
    pub fn spp(self) -> u32 {
        1 << self.rung
    }

    /// Returns the seed of this render of a ladder; `ladder` tells ladders apart that must not
    /// share noise.
    pub fn seed(self, base: u64, ladder: u8) -> u64 {
        let step = u64::from(ladder) << 48 | u64::from(self.rung + 1) << 32;
        base.wrapping_add(step | u64::from(self.repeat))
    }
}

/// What rendering took.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Seconds {
    /// Processor seconds of all threads.
    pub cpu: f64,
    /// Seconds on the wall.
    pub wall: f64,
}

/// One render and its error.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Measurement {
    /// Samples a pixel.
    pub spp: u32,
    /// Which of the renders with so many.
    pub repeat: u32,
    /// What it took, without loading and without measuring errors.
    pub secs: Seconds,
    /// Wall-clock seconds until the first tile was complete.
    pub first_tile_secs: f64,
    /// What the rays did.
    pub counts: Counts,
    /// Errors; `None` for a render that is to be the reference.
    pub errors: Option<Errors>,
    /// Mean FLIP of the first repeat.
    pub flip: Option<f64>,
}

/// All that is known of one estimator.
#[derive(Clone, Debug, PartialEq)]
pub struct Record {
    /// Its renders in order of the ladder.
    pub measurements: Vec<Measurement>,
    /// All of them merged.
    pub film: Film,
    /// What their pixels cost, row by row.
    pub costs: Vec<PixelCost>,
}

impl Record {
    /// Makes an empty record.
    pub fn new(width: u32, height: u32) -> Self {
        let film = Film::new(width, height);
        let costs = vec![PixelCost::default(); film.pixels().len()];
        Self {
            measurements: Vec::new(),
            film,
            costs,
        }
    }

    /// Returns the CPU seconds spent so far.
    pub fn cpu_secs(&self) -> f64 {
        self.measurements.iter().map(|m| m.secs.cpu).sum()
    }

    /// Returns the rungs that are complete, each as its renders.
    pub fn complete_rungs(&self, seeds: u32) -> impl Iterator<Item = &[Measurement]> {
        self.measurements.chunks_exact(seeds.max(1) as usize)
    }

    /// Returns the render that comes next, or `None` at the end of the ladder.
    pub fn next_step(&self, extent: &Extent) -> Option<Step> {
        let done = u32::try_from(self.measurements.len()).ok()?;
        let seeds = extent.seeds.max(1);
        let step = Step {
            rung: done / seeds,
            repeat: done % seeds,
        };
        if step.rung > LAST_RUNG || step.spp() > extent.max_spp.max(1) {
            return None;
        }
        let affordable = || {
            let last: f64 = self
                .complete_rungs(seeds)
                .last()
                .map_or(0.0, |rung| rung.iter().map(|m| m.secs.cpu).sum());
            self.cpu_secs() + 2.0 * last <= extent.budget_secs
        };
        (step.repeat > 0 || affordable()).then_some(step)
    }

    /// Adds one render's pixels and costs.
    fn merge(&mut self, film: &Film, costs: &[PixelCost]) {
        for (all, one) in self.film.pixels_mut().iter_mut().zip(film.pixels()) {
            all.merge(one);
        }
        for (all, one) in self.costs.iter_mut().zip(costs) {
            all.values_read += one.values_read;
            all.null_collisions += one.null_collisions;
        }
    }
}

/// What a render is compared with, and where.
#[derive(Clone, Copy, Debug)]
pub struct Comparison<'a> {
    /// The reference.
    pub reference: &'a Reference,
    /// Indices of the pixels that errors are taken over.
    pub covered: &'a [usize],
}

/// Renders one step of the ladder and adds it to `record`; returns whether it was finished.
///
/// Sets the samples and the seed of `scene`; everything else is as the caller set it. `clock`
/// tells the seconds since any fixed moment.
pub fn measure(
    record: &mut Record,
    scene: &mut Scene,
    step: Step,
    seed: u64,
    comparison: Option<Comparison<'_>>,
    clock: &dyn Fn() -> Seconds,
    (progress, cancel): (&dyn Progress, &AtomicBool),
) -> bool {
    scene.spp = step.spp();
    scene.seed = seed;
    let before = clock();
    let (rendered, costs) = render_with_costs(scene, progress, cancel);
    let after = clock();
    if !rendered.complete {
        return false;
    }
    let errors = comparison.map(|c| errors(&rendered.film, c.reference, c.covered));
    let first = comparison.filter(|_| step.repeat == 0);
    record.measurements.push(Measurement {
        spp: step.spp(),
        repeat: step.repeat,
        secs: Seconds {
            cpu: after.cpu - before.cpu,
            wall: after.wall - before.wall,
        },
        first_tile_secs: rendered.first_tile_secs,
        counts: rendered.counts,
        errors,
        flip: first.map(|c| flip::mean_flip(&rendered.film, c.reference)),
    });
    record.merge(&rendered.film, &costs);
    true
}

#[cfg(test)]
mod tests {
    use super::*;

    fn record(cpu: &[f64]) -> Record {
        let mut record = Record::new(1, 1);
        record.measurements = cpu
            .iter()
            .map(|&cpu| Measurement {
                spp: 1,
                repeat: 0,
                secs: Seconds { cpu, wall: cpu },
                first_tile_secs: 0.0,
                counts: Counts::default(),
                errors: None,
                flip: None,
            })
            .collect();
        record
    }

    #[test]
    fn the_ladder_ends_before_the_budget_and_within_the_samples() {
        let extent = Extent {
            seeds: 2,
            budget_secs: 7.0,
            max_spp: 4,
        };
        let next = |cpu: &[f64]| record(cpu).next_step(&extent).map(|s| (s.spp(), s.repeat));
        assert_eq!(next(&[]), Some((1, 0)));
        assert_eq!(
            next(&[9.0]),
            Some((1, 1)),
            "a rung that was begun is finished"
        );
        assert_eq!(next(&[9.0, 9.0]), None);
        // 2 s are spent and 4 more expected; then 6 and 8.
        assert_eq!(next(&[1.0, 1.0]), Some((2, 0)));
        assert_eq!(next(&[1.0, 1.0, 2.0, 2.0]), None);
        assert_eq!(next(&[0.0; 4]), Some((4, 0)));
        assert_eq!(next(&[0.0; 6]), None, "8 samples are too many");
    }

    #[test]
    fn no_two_renders_share_a_seed() {
        let mut seeds: Vec<u64> = (0..3)
            .flat_map(|ladder| {
                (0..=LAST_RUNG).flat_map(move |rung| {
                    (0..20).map(move |repeat| Step { rung, repeat }.seed(7, ladder))
                })
            })
            .collect();
        let count = seeds.len();
        seeds.sort_unstable();
        seeds.dedup();
        assert_eq!(seeds.len(), count);
    }
}

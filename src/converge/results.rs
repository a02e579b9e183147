//! Everything that a comparison found, as JSON and as a table.
//!
//! Fields named `timing` depend on the machine and on what else it did; everything else is the
//! same in every run, interrupted or not.

use std::fmt::Write as _;

use serde::Serialize;

use super::Summary;
use super::estimator::Estimator;

/// One comparison of estimators.
#[derive(Clone, Debug, Serialize)]
pub struct Results {
    /// Version of the program.
    pub version: &'static str,
    /// The scene file.
    pub scene: String,
    /// Its hash.
    pub scene_hash: String,
    /// Columns and rows.
    pub resolution: [u32; 2],
    /// Pixels that errors are taken over.
    pub covered_pixels: usize,
    /// Renders of a rung.
    pub seeds: u32,
    /// CPU seconds for each estimator.
    pub budget_secs: f64,
    /// relMSE that times are given for.
    pub target_rel_mse: f64,
    /// Whether no estimator has renders left to do.
    pub complete: bool,
    /// What images are compared with.
    pub references: Vec<ReferenceInfo>,
    /// The estimators, in the order asked for.
    pub estimators: Vec<EstimatorResults>,
    /// What depends on the machine.
    pub timing: RunTiming,
}

/// Where a reference comes from.
#[derive(Clone, Debug, Serialize)]
pub struct ReferenceInfo {
    /// The estimator that rendered it, or the file.
    pub source: String,
    /// Samples a pixel, where they are known.
    pub spp: Option<u64>,
    /// Whether its noise is known; else it counts as exact.
    pub noise_known: bool,
    /// relMSE that a perfect image would show.
    pub rel_mse_noise: f64,
}

/// One estimator.
#[derive(Clone, Debug, Serialize)]
pub struct EstimatorResults {
    /// Its name, which parses to it.
    pub name: String,
    /// Whether it is biased by design, however little of it is seen.
    pub approximate: bool,
    /// Index of the reference that it is compared with.
    pub reference: usize,
    /// What its measurements come to.
    #[serde(flatten)]
    pub summary: Summary,
}

/// What depends on the machine.
#[derive(Clone, Debug, Serialize)]
pub struct RunTiming {
    /// The processor's name, where the system tells.
    pub processor: Option<String>,
    /// Threads that rendered.
    pub threads: usize,
    /// Mean number of busy processes over 1, 5 and 15 minutes, at the end, where the system tells.
    pub load_average: Option<[f64; 3]>,
    /// Wall-clock seconds to read the volume.
    pub load_secs: f64,
    /// Wall-clock seconds to compute bounds.
    pub build_secs: f64,
    /// CPU seconds of each reference; zero for a file.
    pub reference_cpu_secs: Vec<f64>,
}

impl Results {
    /// Returns the estimators from the most efficient to the least; those of unknown
    /// efficiency last.
    pub fn by_efficiency(&self) -> Vec<&EstimatorResults> {
        let efficiency =
            |e: &EstimatorResults| e.summary.timing.efficiency.map_or(0.0, |x| x.value);
        let mut sorted: Vec<_> = self.estimators.iter().collect();
        sorted.sort_by(|a, b| efficiency(b).total_cmp(&efficiency(a)));
        sorted
    }

    /// Returns one line for each point of each curve, with a header. Empty fields are unknown.
    pub fn to_csv(&self) -> String {
        let mut out = String::from(
            "estimator,spp,seeds,cpu_secs,wall_secs,values_read,mse,mse_standard_error,rel_mse,\
             rel_mse_standard_error,rel_mse_trimmed,rel_variance,flip\n",
        );
        let text = |x: Option<f64>| x.map_or(String::new(), |x| x.to_string());
        for EstimatorResults { name, summary, .. } in &self.estimators {
            for p in &summary.points {
                let fields = [
                    name.clone(),
                    p.spp.to_string(),
                    self.seeds.to_string(),
                    p.timing.cpu.to_string(),
                    p.timing.wall.to_string(),
                    p.values_read.to_string(),
                    p.mse.mean.to_string(),
                    text(p.mse.standard_error),
                    p.rel_mse.mean.to_string(),
                    text(p.rel_mse.standard_error),
                    p.rel_mse_trimmed.mean.to_string(),
                    text(p.rel_variance.map(|v| v.mean)),
                    text(p.flip),
                ];
                writeln!(out, "{}", fields.join(",")).expect("writing to a string cannot fail");
            }
        }
        out
    }
}

/// Returns which of the two automatic references an estimator is compared with: not one of its
/// own kind.
pub fn independent_reference(estimator: &Estimator, has_shadow_rays: bool) -> usize {
    usize::from(estimator.is_same(&Estimator::exact(), has_shadow_rays))
}

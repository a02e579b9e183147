//! What the images of `converge` are compared with: a given file, or rendered by estimators that
//! are not the one under test.

use std::sync::atomic::AtomicBool;

use majorant::converge::Reference;
use majorant::converge::estimator::{Estimator, has_shadow_rays};
use majorant::converge::ladder::{Extent, Record};
use majorant::converge::results::independent_reference;
use majorant::output::{self, Identity, Provenance, SampleRanges};
use majorant::scene::Scene;

use super::super::progress::LadderProgress;
use super::super::{Failure, memory, report};
use super::{Run, interruption};

/// The automatic reference has at most so many times the samples of the longest render.
const REFERENCE_SAMPLES: u32 = 16;

/// Rounding of a half, relative to its value.
const HALF_ROUNDING: f64 = 1.0 / 2048.0;

/// What images are compared with, and where it comes from.
pub(super) struct KnownReference {
    pub(super) reference: Reference,
    pub(super) source: String,
    pub(super) spp: Option<u64>,
    pub(super) cpu_secs: f64,
}

impl Run<'_> {
    /// Reads or renders what images are compared with: one or, where the first is rendered by an
    /// estimator that is itself under test, two.
    pub(super) fn references(
        &mut self,
        cancel: &AtomicBool,
    ) -> Result<Vec<KnownReference>, Failure> {
        if self.args.reference.as_os_str() != "auto" {
            return Ok(vec![self.given_reference()?]);
        }
        let mut references = vec![self.automatic_reference(1, Estimator::exact(), cancel)?];
        if self.estimators.iter().any(|e| self.reference_index(e) == 1) {
            references.push(self.automatic_reference(2, Estimator::textbook(), cancel)?);
        }
        Ok(references)
    }

    pub(super) fn reference_index(&self, estimator: &Estimator) -> usize {
        if self.args.reference.as_os_str() == "auto" {
            independent_reference(estimator, has_shadow_rays(&self.scene))
        } else {
            0
        }
    }

    fn given_reference(&self) -> Result<KnownReference, Failure> {
        let path = &self.args.reference;
        let image = output::read_exr(path).map_err(|e| Failure::BadInput(report::chain(&e)))?;
        let shown = path.display();
        let Scene { width, height, .. } = self.scene;
        if (image.width, image.height) != (width as usize, height as usize) {
            return Err(Failure::BadInput(format!(
                "{shown}: is {} by {} pixels, expected the scene's {width} by {height}; \
                 --resolution changes the latter",
                image.width, image.height
            )));
        }
        if image.variance.is_none() {
            tracing::warn!(
                "{shown}: has no finite variance.R, .G and .B: its noise is unknown and counts as \
                 error of the estimators"
            );
        }
        Ok(KnownReference {
            reference: Reference {
                width,
                height,
                mean: image.colours,
                variance: image.variance,
                relative_rounding: if image.is_half { HALF_ROUNDING } else { 0.0 },
            },
            source: shown.to_string(),
            spp: None,
            cpu_secs: 0.0,
        })
    }

    fn automatic_reference(
        &mut self,
        number: u8,
        estimator: Estimator,
        cancel: &AtomicBool,
    ) -> Result<KnownReference, Failure> {
        let name = format!("reference-{number}");
        let source = estimator.to_string();
        let key = self.key(&source, "itself");
        let mut record = self.read_record(&name, &key)?;
        let budget_secs = self.args.reference_budget.unwrap_or(2.0 * self.args.budget);
        let extent = Extent {
            seeds: 1,
            budget_secs,
            max_spp: self.extent.max_spp.saturating_mul(REFERENCE_SAMPLES),
        };
        // Once anything has been compared with it, it stays as it is.
        let is_used = self.estimators.iter().any(|e| {
            self.reference_index(e) + 1 == usize::from(number)
                && self.checkpoint(&e.to_string()).exists()
        });
        let mut progress = LadderProgress::start("reference", budget_secs);
        estimator.apply(&mut self.scene);
        while let Some(step) = record.next_step(&extent).filter(|_| !is_used) {
            let seed = step.seed(self.seed, number);
            if !self.render(&mut record, step, seed, None, cancel) {
                return Err(interruption(&self.folder));
            }
            self.write_record(&name, &key, &record)?;
            progress.advance(record.cpu_secs(), &format!("{source}, {} spp", step.spp()));
        }
        drop(progress);
        self.write_reference(&name, &record)?;
        Ok(KnownReference {
            reference: Reference::from_film(&record.film),
            source,
            spp: Some(record.measurements.iter().map(|m| u64::from(m.spp)).sum()),
            cpu_secs: record.cpu_secs(),
        })
    }

    /// Writes the image for other programs, and for `--reference` of another run.
    fn write_reference(&self, name: &str, record: &Record) -> Result<(), Failure> {
        let command_line: Vec<_> = std::env::args_os().collect();
        let words = command_line.iter().map(|w| w.to_string_lossy());
        let samples: u64 = record.measurements.iter().map(|m| u64::from(m.spp)).sum();
        let provenance = Provenance {
            camera_from_world: self.scene.camera.camera_from_world(),
            half_size: self.scene.camera.half_size(),
            identity: Identity {
                version: env!("CARGO_PKG_VERSION").to_owned(),
                scene_hash: self.scene_hash,
                samples: SampleRanges::one(0..samples.max(1)).expect("not empty"),
                noise_limit: None,
            },
            seed: self.seed,
            frame: self.scene.frame,
            command_line: words.collect::<Vec<_>>().join(" "),
            render_secs: record.measurements.iter().map(|m| m.secs.wall).sum(),
            peak_memory_bytes: memory::peak_bytes(),
            stats_json: "{}".to_owned(),
        };
        let path = self.folder.join(format!("{name}.exr"));
        output::write_float_exr(&path, &record.film, &provenance).map_err(Failure::failed)
    }
}

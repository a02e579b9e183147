//! Error against run time: which estimator is best for a volume, and whether it is right.
//!
//! ```text
//! Extent ─ Record::next_step ─► Step ─ measure ─► Measurement ──► Summary ──► report, CSV
//!                                 ▲      render    errors against      points, efficiency,
//!                              Record ◄── merge    Reference           BiasTest
//! ```
//!
//! ```
//! use std::sync::atomic::AtomicBool;
//! use majorant::converge::estimator::Estimator;
//! use majorant::converge::ladder::{Comparison, Extent, Record, Seconds, measure};
//! use majorant::converge::{Reference, covered_pixels, summarise};
//! use majorant::render::NoProgress;
//! use majorant::scene::desc::unplaced;
//! use majorant::scene::{LoadOptions, SceneFile};
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let mut file = SceneFile::read("data/scenes/tower.toml".as_ref())?;
//! file.desc.image.resolution = unplaced([8, 14]);
//! let checked = file.check(1 << 30)?;
//! let volumes = checked.load_volumes(&LoadOptions::default(), &mut |_| {})?;
//! let mut scene = checked.into_scene(&volumes)?;
//! let covered = covered_pixels(&scene);
//!
//! // Two renders each of 1, 2 and 4 samples a pixel; a clock that stands still never ends early.
//! let extent = Extent { seeds: 2, budget_secs: 1.0, max_spp: 4 };
//! let mut climb = |estimator: &Estimator, ladder: u8, comparison: Option<Comparison<'_>>| {
//!     estimator.apply(&mut scene);
//!     let mut record = Record::new(scene.width, scene.height);
//!     while let Some(step) = record.next_step(&extent) {
//!         let seed = step.seed(0, ladder);
//!         let watch = (&NoProgress as _, &AtomicBool::new(false));
//!         let clock = || Seconds::default();
//!         measure(&mut record, &mut scene, step, seed, comparison, &clock, watch);
//!     }
//!     record
//! };
//! let reference = Reference::from_film(&climb(&Estimator::exact(), 1, None).film);
//! let comparison = Comparison { reference: &reference, covered: &covered };
//! let record = climb(&Estimator::textbook(), 0, Some(comparison));
//! let summary = summarise(&record, extent.seeds, comparison, 0.01);
//! assert!(summary.points[2].rel_mse.mean < summary.points[0].rel_mse.mean);
//! # Ok(())
//! # }
//! ```
//!
//! Assumes a scene in memory, whose samples, seed and transport settings it changes. Loads and
//! writes nothing and reads no clock: the caller brings all three.

pub mod bias;
pub mod bootstrap;
pub mod checkpoint;
mod covered;
pub mod estimator;
pub mod flip;
pub mod ladder;
pub mod metrics;
pub mod picture;
mod reference;
pub mod report;
pub mod results;
mod summary;

pub use covered::{LEAST_DEPTH, covered_pixels};
pub use reference::Reference;
pub use summary::{Estimate, Mean, Point, Summary, Timing, summarise};

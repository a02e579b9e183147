//! Error against run time: which estimator is best for a volume, and whether it is right.
//!
//! ```text
//! Extent ─ Record::next_step ─► Step ─ measure ─► Measurement ──► Summary ──► report, CSV
//!                                 ▲      render    errors against      points, efficiency,
//!                              Record ◄── merge    Reference           BiasTest
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

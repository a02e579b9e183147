//! The conformance suite and the stiffness certificate: the renderer held against physics.
//!
//! Everything measured goes through the code that renders: trees and their bounds, media,
//! tracking, integrators, frames. Everything expected comes from elsewhere: closed forms,
//! published tables, symmetries, or a slow second reading of the voxels (`oracle`, `volumes`).
//!
//! * [`Suite::Conformance`] asks whether light transport is right.
//! * [`Suite::Stiff`] asks whether it stays right, and ends, where numbers are extreme.
//!
//! Seeds are fixed: a row that fails on one machine is a defect there, not bad luck. Nothing is
//! printed here, and no file is read.
//!
//! ```
//! use majorant::verify::{Suite, checks};
//! let check = checks(Suite::Conformance).into_iter().find(|c| c.matches("reflected at mu 1,"));
//! let rows = check.expect("that check exists").run();
//! assert!(rows.iter().all(|row| row.pass));
//! ```

mod estimators;
mod flight;
mod furnace;
mod measure;
mod oracle;
mod paths;
mod row;
mod scattering;
mod slabs;
mod stiff;
mod symmetry;
mod volumes;

use std::fmt;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::Instant;

use measure::Seen;

pub use row::{Group, LIMIT, Row};

/// Which checks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Suite {
    /// Light transport against closed forms, tables and symmetries.
    Conformance,
    /// Extreme numbers: the right mean, finite, in bounded steps.
    Stiff,
}

/// What a check adds its rows to, and where its seeds come from.
struct Rows {
    rows: Vec<Row>,
    seed: u64,
}

impl Rows {
    /// Starts with seeds that belong to this check alone.
    fn new(check: &Check) -> Self {
        // FNV-1a: any function of the name would do that is the same everywhere.
        let name = format!("{check:?}");
        let seed = name.bytes().fold(0xcbf2_9ce4_8422_2325_u64, |hash, byte| {
            (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3)
        });
        Self {
            rows: Vec::new(),
            seed,
        }
    }

    fn push(&mut self, row: Row) {
        self.rows.push(row);
    }

    /// Returns a seed for one more measurement: rows of one check are independent.
    fn seed(&mut self) -> u64 {
        self.seed = self.seed.wrapping_add(1);
        self.seed
    }
}

/// Something to measure, which gives one or more rows.
pub struct Check {
    group: &'static Group,
    name: String,
    measure: Box<dyn Fn(&mut Rows) + Send + Sync>,
}

impl fmt::Debug for Check {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.group.name, self.name)
    }
}

impl Check {
    fn new(
        group: &'static Group,
        name: impl Into<String>,
        measure: impl Fn(&mut Rows) + Send + Sync + 'static,
    ) -> Self {
        Self {
            group,
            name: name.into(),
            measure: Box::new(measure),
        }
    }

    /// Returns what the check is about.
    pub fn group(&self) -> &'static Group {
        self.group
    }

    /// Returns the name, which those of its rows begin with.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Returns whether `text` occurs in the group and name, written `group: name`; capitals do
    /// not matter.
    pub fn matches(&self, text: &str) -> bool {
        let name = format!("{self:?}").to_lowercase();
        name.contains(&text.to_lowercase())
    }

    /// Measures.
    ///
    /// # Cost
    /// From milliseconds to some seconds of one thread.
    pub fn run(&self) -> Vec<Row> {
        let start = Instant::now();
        let mut rows = Rows::new(self);
        // A broken invariant is a panic; here it is what the suite is looking for.
        if catch_unwind(AssertUnwindSafe(|| (self.measure)(&mut rows))).is_err() {
            let row = Row::exact("", 0.0, 1.0, &Seen::default());
            rows.push(row.demanding(false, "the check panicked"));
        }
        let mut rows = rows.rows;
        let seconds = start.elapsed().as_secs_f64();
        for row in &mut rows {
            row.group = self.group.name;
            row.oracle = self.group.oracle;
            let own = std::mem::take(&mut row.name);
            row.name = if own.is_empty() {
                self.name.clone()
            } else {
                format!("{} {own}", self.name)
            };
            row.seconds = seconds;
        }
        rows
    }
}

/// Returns the checks of a suite, in the order of their report.
pub fn checks(suite: Suite) -> Vec<Check> {
    let mut out = Vec::new();
    match suite {
        Suite::Conformance => {
            flight::checks(&mut out);
            scattering::checks(&mut out);
            slabs::checks(&mut out);
            furnace::checks(&mut out);
            symmetry::checks(&mut out);
        }
        Suite::Stiff => stiff::checks(&mut out),
    }
    out
}

/// Runs checks on `threads` threads and returns their rows in order.
///
/// `done` hears of each check as it ends, from any thread. Rows do not depend on the number of
/// threads, but for their seconds.
pub fn run(checks: &[Check], threads: usize, done: &(dyn Fn(&Check, &[Row]) + Sync)) -> Vec<Row> {
    // Not rayon: a thread that waits for a frame would take up another check meanwhile, and
    // count its seconds twice.
    let next = AtomicUsize::new(0);
    let results = Mutex::new(Vec::new());
    let work = || {
        while let Some((index, check)) = take(checks, &next) {
            let rows = check.run();
            done(check, &rows);
            let mut results = results.lock().unwrap_or_else(PoisonError::into_inner);
            results.push((index, rows));
        }
    };
    std::thread::scope(|scope| {
        for _ in 1..threads.clamp(1, checks.len().max(1)) {
            scope.spawn(work);
        }
        work();
    });
    let mut results = results.into_inner().unwrap_or_else(PoisonError::into_inner);
    results.sort_by_key(|(index, _)| *index);
    results.into_iter().flat_map(|(_, rows)| rows).collect()
}

/// Takes the next check that no thread has taken.
fn take<'a>(checks: &'a [Check], next: &AtomicUsize) -> Option<(usize, &'a Check)> {
    let index = next.fetch_add(1, Ordering::Relaxed);
    Some((index, checks.get(index)?))
}

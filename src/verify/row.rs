//! What a check reports: expected against measured, and a verdict that can be argued about.
//!
//! A *statistical* row holds a mean against an oracle: `z` is its distance in standard errors,
//! after the oracle's own uncertainty is taken off, and passes below [`LIMIT`]. It says the
//! smallest relative bias that it could have seen. A *deterministic* row has a tolerance with its
//! derivation instead. Both fail on any value above its bound, any number that is not finite, and
//! any ray that took more steps than the check allows.

use serde::Serialize;

use super::measure::{Moments, Seen};

/// A row passes below this many standard errors: by chance 6 of 10 million rows do not.
pub const LIMIT: f64 = 5.0;

/// Rows of one kind, and where their expected values come from.
#[derive(Debug, PartialEq, Eq)]
pub struct Group {
    /// What the rows are about.
    pub name: &'static str,
    /// Where expected values come from.
    pub oracle: &'static str,
}

/// One comparison of expected and measured.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Row {
    /// What the row is about: the name of its [`Group`].
    pub group: &'static str,
    /// What was measured.
    pub name: String,
    /// Where the expected value comes from.
    pub oracle: &'static str,
    /// What the oracle says.
    pub expected: f64,
    /// What came out.
    pub measured: f64,
    /// Standard error of the difference; `None` for a deterministic row.
    pub standard_error: Option<f64>,
    /// How far the oracle itself may be off, or a deterministic row's difference may be.
    pub tolerance: f64,
    /// Where a tolerance that is not zero comes from.
    pub tolerance_reason: &'static str,
    /// Distance in standard errors, beyond the tolerance; `None` for a deterministic row.
    pub z: Option<f64>,
    /// The relative bias that would have made the row fail; `None` where nothing is expected.
    pub smallest_bias_seen: Option<f64>,
    /// Segments, collisions and voxel cells of the ray or path that had most of them.
    pub worst_steps: u64,
    /// How many it may have; `None` where steps are not what the row is about.
    pub steps_limit: Option<u64>,
    /// What else is wrong, if anything.
    pub problems: Vec<String>,
    /// Whether the row is as it should be.
    pub pass: bool,
    /// Wall-clock seconds of the whole check, which may give several rows.
    pub seconds: f64,
}

impl Row {
    /// Makes a statistical row: the mean of a sample.
    pub(super) fn mean(
        name: impl Into<String>,
        expected: f64,
        moments: &Moments,
        seen: &Seen,
    ) -> Self {
        Self::statistical(
            name,
            expected,
            moments.mean(),
            moments.standard_error(),
            seen,
        )
    }

    /// Makes a statistical row: the variance of a sample.
    pub(super) fn variance(
        name: impl Into<String>,
        expected: f64,
        moments: &Moments,
        seen: &Seen,
    ) -> Self {
        let (measured, error) = (moments.variance(), moments.standard_error_of_variance());
        Self::statistical(name, expected, measured, error, seen)
    }

    /// Makes a statistical row: two samples that must have one mean.
    pub(super) fn same_mean(
        name: impl Into<String>,
        reference: &Moments,
        moments: &Moments,
        seen: &Seen,
    ) -> Self {
        let error = reference.standard_error().hypot(moments.standard_error());
        Self::statistical(name, reference.mean(), moments.mean(), error, seen)
    }

    /// Makes a statistical row: a fraction of `n` that has the probability `expected`.
    ///
    /// The standard error is that of the expected value, so that 0 of n is a measurement, too;
    /// one event is its least.
    pub(super) fn fraction(
        name: impl Into<String>,
        expected: f64,
        moments: &Moments,
        seen: &Seen,
    ) -> Self {
        let n = moments.count();
        let error = (expected * (1.0 - expected) / n).sqrt().max(1.0 / n);
        Self::statistical(name, expected, moments.mean(), error, seen)
    }

    /// Makes a statistical row: cells of equal probability hold equally many of `n` draws.
    ///
    /// The smallest bias is that of the probability of half of the cells against the other.
    pub(super) fn chi_square(name: impl Into<String>, cells: &[u32], seen: &Seen) -> Self {
        let n: f64 = cells.iter().map(|&c| f64::from(c)).sum();
        let each = n / cells.len() as f64;
        let chi2: f64 = cells
            .iter()
            .map(|&c| (f64::from(c) - each).powi(2) / each)
            .sum();
        let degrees = cells.len() as f64 - 1.0;
        let error = (2.0 * degrees).sqrt();
        let mut row = Self::statistical(name, degrees, chi2, error, seen);
        row.smallest_bias_seen = Some((LIMIT * error / n).sqrt());
        row
    }

    /// Makes a statistical row.
    pub(super) fn statistical(
        name: impl Into<String>,
        expected: f64,
        measured: f64,
        standard_error: f64,
        seen: &Seen,
    ) -> Self {
        let mut row = Self::new(name.into(), expected, measured, seen);
        row.standard_error = Some(standard_error);
        row.judged()
    }

    /// Makes a deterministic row.
    pub(super) fn exact(
        name: impl Into<String>,
        expected: f64,
        measured: f64,
        seen: &Seen,
    ) -> Self {
        Self::new(name.into(), expected, measured, seen).judged()
    }

    /// Says how far expected and measured may differ, and why.
    #[must_use]
    pub(super) fn tolerance(mut self, tolerance: f64, reason: &'static str) -> Self {
        self.tolerance = tolerance;
        self.tolerance_reason = reason;
        self.judged()
    }

    /// Says how many steps a ray or path may take.
    #[must_use]
    pub(super) fn steps_within(mut self, limit: u64) -> Self {
        self.steps_limit = Some(limit);
        if self.worst_steps > limit {
            let worst = self.worst_steps;
            self.problems
                .push(format!("{worst} steps, more than {limit}"));
        }
        self.judged()
    }

    /// Demands something that is no number.
    #[must_use]
    pub(super) fn demanding(mut self, holds: bool, otherwise: &str) -> Self {
        if !holds {
            self.problems.push(otherwise.to_owned());
        }
        self.judged()
    }

    fn new(name: String, expected: f64, measured: f64, seen: &Seen) -> Self {
        let mut problems = Vec::new();
        let violations = seen.counts.bound_violations;
        if violations > 0 {
            problems.push(format!("{violations} values above their bound"));
        }
        let non_finite = seen.non_finite + seen.counts.non_finite_samples;
        if non_finite > 0 {
            problems.push(format!("{non_finite} values that are not finite"));
        }
        Self {
            group: "",
            name,
            oracle: "",
            expected,
            measured,
            standard_error: None,
            tolerance: 0.0,
            tolerance_reason: "",
            z: None,
            smallest_bias_seen: None,
            worst_steps: seen.worst_steps,
            steps_limit: None,
            problems,
            pass: false,
            seconds: 0.0,
        }
    }

    /// Comes to the verdict on the numbers as they stand.
    fn judged(mut self) -> Self {
        let difference = self.measured - self.expected;
        let beyond = (difference.abs() - self.tolerance).max(0.0);
        let least = self.standard_error.map_or(0.0, |e| LIMIT * e) + self.tolerance;
        // Zero: nothing is expected, and a bias has nothing to be relative to.
        self.smallest_bias_seen = (self.expected != 0.0).then(|| least / self.expected.abs());
        self.z = self.standard_error.map(|error| {
            // Zero over zero is agreement; anything else over zero is infinitely far.
            if beyond == 0.0 {
                0.0
            } else {
                beyond.copysign(difference) / error
            }
        });
        // A difference that is not a number is no agreement: `max` has dropped it above.
        let close = match self.z {
            Some(z) => z.abs() < LIMIT,
            None => beyond == 0.0,
        };
        self.pass = close && difference.is_finite() && self.problems.is_empty();
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn seen() -> Seen {
        Seen::default()
    }

    #[test]
    fn rows_fail_when_they_should() {
        let row = |measured, error| Row::statistical("x", 1.0, measured, error, &seen());
        assert!(row(1.04, 0.01).pass, "4 standard errors");
        assert!(!row(1.06, 0.01).pass, "6 standard errors");
        assert!(row(1.0, 0.0).pass, "exactly right");
        assert!(!row(1.0 + 1e-12, 0.0).pass, "no error to excuse it");
        assert!(!row(f64::NAN, 0.01).pass, "not a number");
        assert!(!row(1.0, f64::NAN).demanding(false, "no").pass, "a demand");
        assert!(row(1.06, 0.01).tolerance(0.02, "given").pass, "4 beyond");
        assert!(!Row::exact("x", 1.0, 1.1, &seen()).pass, "not equal");
        assert!(!Row::exact("x", f64::NAN, f64::NAN, &seen()).pass, "NaN");
        let violated = Seen {
            counts: crate::stats::Counts {
                bound_violations: 1,
                ..Default::default()
            },
            ..seen()
        };
        assert!(!Row::exact("x", 1.0, 1.0, &violated).pass, "a bound");
        let long = Seen {
            worst_steps: 11,
            ..seen()
        };
        let long = Row::exact("x", 1.0, 1.0, &long);
        assert!(long.clone().steps_within(11).pass && !long.steps_within(10).pass);
    }

    #[test]
    fn uneven_cells_are_seen() {
        assert!(Row::chi_square("x", &[1000, 1010, 990, 1000], &seen()).pass);
        assert!(!Row::chi_square("x", &[1100, 1100, 900, 900], &seen()).pass);
    }
}

//! `majorant verify`: the conformance suite and the stiffness certificate.

use std::fmt::Write as _;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Instant;

use majorant::verify::{self, Check, Row, Suite};

use super::args::VerifyArgs;
use super::{Failure, render, report};

pub(super) fn run(args: &VerifyArgs) -> Result<(), Failure> {
    render::start_threads(args.threads)?;
    let suite = if args.stiff {
        Suite::Stiff
    } else {
        Suite::Conformance
    };
    let mut checks = verify::checks(suite);
    if let Some(text) = &args.filter {
        checks.retain(|check| check.matches(text));
        if checks.is_empty() {
            let message = format!("--filter {text}: no check has that in its group or name");
            return Err(Failure::Usage(message));
        }
    }
    let start = Instant::now();
    let rows = measure(&checks);
    let table = if args.json {
        let json = serde_json::to_string_pretty(&rows).map_err(Failure::failed)?;
        format!("{json}\n")
    } else {
        table(&rows)
    };
    report::print(&table)?;
    tracing::info!("{:.1} s", start.elapsed().as_secs_f64());
    let failed = failed_count(&rows);
    if failed == 0 {
        Ok(())
    } else {
        Err(Failure::failed(format!(
            "{failed} of {} rows failed",
            rows.len()
        )))
    }
}

fn failed_count(rows: &[Row]) -> usize {
    rows.iter().filter(|row| !row.pass).count()
}

/// Runs the checks, with a line on stderr for each.
fn measure(checks: &[Check]) -> Vec<Row> {
    let ended = AtomicUsize::new(0);
    let total = checks.len();
    verify::run(checks, rayon::current_num_threads(), &|check, rows| {
        let n = ended.fetch_add(1, Ordering::Relaxed) + 1;
        let seconds = rows.first().map_or(0.0, |row| row.seconds);
        let failed = failed_count(rows);
        let fate = if failed == 0 {
            String::new()
        } else {
            format!(", {failed} FAILED")
        };
        tracing::info!("[{n}/{total}] {check:?}: {seconds:.1} s{fate}");
    })
}

/// Columns of a row's name.
const NAME: usize = 56;

fn table(rows: &[Row]) -> String {
    let mut out = String::new();
    let mut group = "";
    for row in rows {
        if row.group != group {
            group = row.group;
            let blank = if out.is_empty() { "" } else { "\n" };
            push(
                &mut out,
                format_args!("{blank}{group}\n  expected: {}\n", row.oracle),
            );
            push(
                &mut out,
                format_args!(
                    "  {:NAME$} {:>10} {:>10} {:>8} {:>6} {:>8} {:>7}\n",
                    "", "expected", "measured", "+-", "z", "sees", "steps"
                ),
            );
        }
        push_row(&mut out, row);
    }
    let failed = failed_count(rows);
    let passed = rows.len() - failed;
    push(
        &mut out,
        format_args!("\n{passed} passed, {failed} failed\n"),
    );
    out
}

fn push(out: &mut String, text: std::fmt::Arguments<'_>) {
    out.write_fmt(text)
        .expect("writing to a string cannot fail");
}

fn push_row(out: &mut String, row: &Row) {
    let error = match row.standard_error {
        Some(error) => small(error),
        // A deterministic row: what may differ.
        None if row.tolerance == 0.0 => "exact".to_owned(),
        None => format!("<{}", small(row.tolerance)),
    };
    let z = row.z.map_or("-".to_owned(), |z| format!("{z:+.2}"));
    let sees = match row.smallest_bias_seen {
        None => "-".to_owned(),
        Some(bias) if bias > 1.0 => ">1".to_owned(),
        Some(bias) => small(bias),
    };
    let verdict = if row.pass { "ok" } else { "FAIL" };
    push(
        out,
        format_args!(
            "  {:NAME$} {:>10} {:>10} {error:>8} {z:>6} {sees:>8} {:>7} {verdict}\n",
            row.name,
            number(row.expected),
            number(row.measured),
            row.worst_steps,
        ),
    );
    for problem in &row.problems {
        push(out, format_args!("    {problem}\n"));
    }
}

/// A value with six or seven digits.
fn number(x: f64) -> String {
    match x.abs() {
        0.0 => "0".to_owned(),
        a if (1e-3..1e4).contains(&a) => format!("{x:.6}"),
        _ => format!("{x:.4e}"),
    }
}

/// An error with two digits.
fn small(x: f64) -> String {
    format!("{x:.1e}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_fit_their_column() {
        for suite in [Suite::Conformance, Suite::Stiff] {
            for check in verify::checks(suite) {
                assert!(check.name().len() < NAME, "{check:?}");
            }
        }
    }
}

//! The suites that `majorant verify` runs, with debug assertions: every row passes.
//!
//! What each row proves, at which power and against which oracle is in `docs/numerics.md`.

use std::fmt::Write as _;
use std::thread::available_parallelism;

use majorant::verify::{Row, Suite, checks, run};

fn all_pass(suite: Suite) {
    let threads = available_parallelism().map_or(1, usize::from);
    let rows = run(&checks(suite), threads, &|_, _| {});
    let failed = rows.iter().filter(|row| !row.pass);
    let table = failed.fold(String::new(), |mut out, row| {
        let Row {
            group,
            name,
            expected,
            measured,
            z,
            problems,
            ..
        } = row;
        let line =
            format!("{group}: {name}: {measured}, expected {expected}, z {z:?} {problems:?}");
        writeln!(out, "{line}").expect("writing to a string cannot fail");
        out
    });
    assert!(table.is_empty(), "rows that fail:\n{table}");
    assert!(rows.len() > 200, "only {} rows", rows.len());
    let blind = rows
        .iter()
        .filter(|row| row.smallest_bias_seen.is_some_and(|b| b > 0.05));
    assert!(
        blind.count() * 5 < rows.len(),
        "a fifth of the rows would not see a bias of 5 %"
    );
}

#[test]
fn light_transport_is_what_physics_says() {
    all_pass(Suite::Conformance);
}

#[test]
fn extreme_numbers_end_in_the_right_mean() {
    all_pass(Suite::Stiff);
}

#[test]
fn rows_do_not_depend_on_the_number_of_threads() {
    let one = |threads| {
        let mut some = checks(Suite::Stiff);
        some.retain(|c| c.matches("g near"));
        let mut rows = run(&some, threads, &|_, _| {});
        for row in &mut rows {
            row.seconds = 0.0;
        }
        rows
    };
    assert_eq!(one(1), one(3));
}

//! `majorant verify`: what it prints, and its exit codes.

use crate::support::{code, majorant, stderr, stdout};
use serde_json::Value;

#[test]
fn a_table_on_stdout_and_progress_on_stderr() {
    let run = majorant(&["verify", "-j", "2", "--filter", "first order flux, tau 1"]);
    assert_eq!(code(&run), 0, "{}", stderr(&run));
    let out = stdout(&run);
    assert!(out.starts_with("slab, single scattering\n"), "{out}");
    assert!(out.ends_with("\n4 passed, 0 failed\n"), "{out}");
    assert!(out.lines().all(|line| line.chars().count() <= 120), "{out}");
    assert!(stderr(&run).contains("[1/1] slab, single scattering"));
    let quiet = majorant(&["-q", "verify", "--filter", "reflected at mu 1,"]);
    assert_eq!((code(&quiet), stderr(&quiet)), (0, String::new()));
}

#[test]
fn json_has_every_field() {
    let run = majorant(&["verify", "--stiff", "--json", "--filter", "CONSTANT bricks"]);
    assert_eq!(code(&run), 0, "{}", stderr(&run));
    let rows: Value = serde_json::from_str(&stdout(&run)).expect("an array");
    let rows = rows.as_array().expect("an array");
    assert_eq!(rows.len(), 4, "{rows:?}");
    for key in [
        "group",
        "name",
        "oracle",
        "expected",
        "measured",
        "standard_error",
        "tolerance",
        "tolerance_reason",
        "z",
        "smallest_bias_seen",
        "worst_steps",
        "steps_limit",
        "problems",
        "pass",
        "seconds",
    ] {
        assert!(rows[0].get(key).is_some(), "no {key} in {:?}", rows[0]);
    }
    assert_eq!(rows[0]["pass"], Value::Bool(true));
}

#[test]
fn a_filter_that_finds_nothing_is_wrong_usage() {
    let run = majorant(&["verify", "--filter", "no such thing"]);
    assert_eq!(code(&run), 2, "{}", stderr(&run));
    assert!(
        stderr(&run).contains("no check has that"),
        "{}",
        stderr(&run)
    );
}

//! Damaged files never panic, abort, hang or crash the loader.
//!
//! Each mutant (bytes flipped, set or cut off, in header, topology or payload) is loaded by
//! `vdb_support/vdb_load` in a process of its own, in a 2 GiB address space and 20 s. The quick
//! run takes the fixtures; the full run of 2,000 mutants takes matrix and real files as well:
//!
//! ```text
//! cargo build --release --example vdb_load
//! MAJORANT_VDB_LOAD=target/release/examples/vdb_load \
//!     cargo test --test files vdb_mutants -- --ignored --nocapture
//! ```
//!
//! `MAJORANT_MUTANTS` asks for another number than 2,000. A mutant that fails is kept in
//! `target/vdb-mutants`; minimised, it belongs into `tests/regressions/vdb`, which
//! `vdb_regressions.rs` loads for ever.

#![expect(clippy::print_stdout, reason = "the counts are for people")]

use std::fmt::Write;
use std::fs;
use std::os::unix::process::ExitStatusExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use crate::vdb_support::{in_crate, vdb_files};
use rand_core::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;

const ADDRESS_SPACE_KIB: u64 = 2 << 20;
const TIME_LIMIT: Duration = Duration::from_secs(20);

#[derive(Debug, Default)]
struct Counts {
    ok: usize,
    clean_error: usize,
    panic: usize,
    abort: usize,
    hang: usize,
    signal: usize,
}

/// Where the damage is done.
#[derive(Clone, Copy, Debug)]
enum Region {
    Header,
    Topology,
    Payload,
}

/// Damages `bytes`; the header is what lies before the first tree, half of the rest topology.
fn mutate(bytes: &mut Vec<u8>, rng: &mut Pcg64Mcg) -> String {
    let below = |rng: &mut Pcg64Mcg, n: usize| rng.next_u32() as usize % n.max(1);
    if below(rng, 8) == 0 {
        let len = below(rng, bytes.len());
        bytes.truncate(len);
        return format!("cut to {len}");
    }
    let region = [Region::Header, Region::Topology, Region::Payload][below(rng, 3)];
    let len = bytes.len();
    let header = len.min(700);
    let (low, high) = match region {
        Region::Header => (0, header),
        Region::Topology => (header, header + (len - header) / 3),
        Region::Payload => (header + (len - header) / 3, len),
    };
    // Half of the mutants have one byte changed: the damage that is hardest to see. Lengths are
    // where bytes of 0 and 0xff hurt; runs hit whole fields.
    let subtle = below(rng, 2) == 0;
    let count = if subtle { 1 } else { 1 + below(rng, 4) };
    let mut done = format!("{region:?}");
    for _ in 0..count {
        let at = low + below(rng, high - low);
        let run = if subtle { 1 } else { [1, 4, 8][below(rng, 3)] };
        let value = [0, 0xff, 0x80, 0x7f, rng.next_u64().to_le_bytes()[0]][below(rng, 5)];
        let flip = below(rng, 2) == 0;
        for b in bytes.iter_mut().skip(at).take(run) {
            *b = if flip {
                *b ^ (1 << below(rng, 8))
            } else {
                value
            };
        }
        let _ = write!(done, " {at}+{run}");
    }
    done
}

/// The loader: as built for this test run, unless the environment names another build.
fn loader() -> PathBuf {
    if let Some(path) = std::env::var_os("MAJORANT_VDB_LOAD") {
        return in_crate(&path.to_string_lossy());
    }
    let mut path = std::env::current_exe().expect("tests know their own path");
    path.pop();
    path.pop();
    path.join("examples/vdb_load")
}

/// Loads `file` in a limited process and counts what happened; returns whether that is fine.
fn run(loader: &Path, file: &Path, counts: &mut Counts) -> bool {
    let log = file.with_extension("log");
    let stderr = fs::File::create(&log).expect("target is writable");
    let mut child = Command::new("sh")
        .arg("-c")
        .arg(format!(
            "ulimit -v {ADDRESS_SPACE_KIB}; exec \"$0\" --limit 1024 \"$1\""
        ))
        .arg(loader)
        .arg(file)
        // Each thread's stack and arena count as address space.
        .env("RAYON_NUM_THREADS", "2")
        .stdout(Stdio::null())
        .stderr(stderr)
        .spawn()
        .expect("sh starts");
    let start = Instant::now();
    let status = loop {
        match child.try_wait().expect("the child can be waited for") {
            Some(status) => break Some(status),
            None if start.elapsed() > TIME_LIMIT => {
                child.kill().expect("our own child can be ended");
                child.wait().expect("the child can be waited for");
                break None;
            }
            None => std::thread::sleep(Duration::from_millis(2)),
        }
    };
    let said = fs::read_to_string(&log).unwrap_or_default();
    let (field, fine) = match status.map(|s| (s.code(), s.signal())) {
        None => (&mut counts.hang, false),
        Some((_, Some(6))) => (&mut counts.abort, false),
        Some((_, Some(_))) => (&mut counts.signal, false),
        // A panic that is caught still shows on stderr, and is a panic.
        Some((Some(0), _)) if !said.contains("panicked") => (&mut counts.ok, true),
        Some((Some(3), _)) if !said.contains("panicked") => (&mut counts.clean_error, true),
        Some(_) => (&mut counts.panic, false),
    };
    *field += 1;
    fine
}

fn mutants(title: &str, files: &[PathBuf], total: usize) {
    let loader = loader();
    assert!(
        loader.is_file(),
        "{} is missing: build the examples",
        loader.display()
    );
    let folder = in_crate("target/vdb-mutants");
    fs::create_dir_all(&folder).expect("target is writable");
    let mut rng = Pcg64Mcg::seed_from_u64(20_260_101);
    let (mut counts, mut failures) = (Counts::default(), Vec::new());
    for n in 0..total {
        let source = &files[n % files.len()];
        let mut bytes = fs::read(source).expect("test files are readable");
        let done = mutate(&mut bytes, &mut rng);
        let path = folder.join(format!("{title}_{n}.vdb"));
        fs::write(&path, &bytes).expect("target is writable");
        if run(&loader, &path, &mut counts) {
            fs::remove_file(&path).expect("our own file");
            fs::remove_file(path.with_extension("log")).expect("our own file");
        } else {
            failures.push(format!("{}: {}: {done}", path.display(), source.display()));
        }
    }
    println!(
        "{title}: {total} mutants of {} files: {counts:?}",
        files.len()
    );
    assert!(
        counts.ok > 0 && counts.clean_error > 0,
        "mutants should be of both kinds"
    );
    assert!(failures.is_empty(), "{}", failures.join("\n"));
}

#[test]
fn sixty_mutants_of_the_fixtures_end_cleanly() {
    mutants("quick", &vdb_files("tests/fixtures/vdb"), 60);
}

#[test]
#[ignore = "2,000 processes; half a minute"]
fn slow_two_thousand_mutants_end_cleanly() {
    let mut files = vdb_files("tests/fixtures/vdb");
    let small = |p: &PathBuf| fs::metadata(p).is_ok_and(|m| m.len() < 1 << 20);
    files.extend(vdb_files("../shared/vdb-matrix").into_iter().filter(small));
    files.extend(vdb_files("../shared/volumes").into_iter().filter(small));
    let total = std::env::var("MAJORANT_MUTANTS").ok();
    let total = total.and_then(|n| n.parse().ok()).unwrap_or(2000);
    mutants("full", &files, total);
}

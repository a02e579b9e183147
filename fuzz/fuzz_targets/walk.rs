//! Walks arbitrary bytes as a .vdb file and loads what the walk lets through.
//!
//! ```text
//! cp tests/fixtures/vdb/*.vdb tests/regressions/vdb/*.vdb fuzz/corpus/walk/
//! RUSTC_BOOTSTRAP=1 cargo fuzz run walk -- -max_len=65536 -rss_limit_mb=2048 -timeout=20
//! ```

#![no_main]

use libfuzzer_sys::fuzz_target;
use majorant::vdb::{Archive, LoadOptions};

fuzz_target!(|data: &[u8]| {
    let Ok(archive) = Archive::from_bytes("fuzz.vdb", data.to_vec()) else {
        return;
    };
    // Enough for any honest file of this length, little enough to run often.
    let options = LoadOptions {
        max_memory_bytes: 64 << 20,
        sanitize: true,
    };
    for (i, grid) in archive.grids().iter().enumerate() {
        let _ = archive.find(&grid.address);
        let _ = archive.load(i, &options);
        let _ = archive.load_density(i, &options);
    }
});

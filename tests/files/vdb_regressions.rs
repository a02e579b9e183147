//! Files that once broke a loader, or were made to: each ends in values or in a clean error.
//!
//! `tests/regressions/vdb/README.md` says what each of them attacks.

#![expect(clippy::print_stdout, reason = "the messages are for people")]

use crate::vdb_support::writer::Writer;
use crate::vdb_support::{in_crate, vdb_files};
use majorant::vdb::{Archive, LoadOptions, VdbError};

/// Loads every grid both ways; the limit is what a test machine has to spare.
fn load_all(path: &std::path::Path) -> Result<usize, VdbError> {
    let options = LoadOptions {
        max_memory_bytes: 256 << 20,
        sanitize: true,
    };
    let archive = Archive::open(path)?;
    for (i, info) in archive.grids().iter().enumerate() {
        if info.refused.is_none() {
            archive.load(i, &options)?;
            if info.background.len() == 1 {
                archive.load_density(i, &options)?;
            }
        }
    }
    Ok(archive.grids().len())
}

#[test]
fn hostile_files_end_cleanly() {
    let files = vdb_files("tests/regressions/vdb");
    assert!(!files.is_empty(), "the corpus is part of the repository");
    for path in files {
        let name = path
            .file_name()
            .unwrap_or_default()
            .to_string_lossy()
            .into_owned();
        let outcome = load_all(&path);
        println!(
            "  {name}: {}",
            outcome
                .as_ref()
                .map_or_else(ToString::to_string, |n| format!("{n} grids"))
        );
        // Names say what is expected.
        assert_eq!(
            outcome.is_ok(),
            name.starts_with("ok_"),
            "{name}: {outcome:?}"
        );
    }
}

/// A chunk of the stated length, whatever follows.
fn chunk(stated: i64, body: &[u8]) -> Vec<u8> {
    [&stated.to_le_bytes()[..], body].concat()
}

fn zip(chunk: Vec<u8>) -> Vec<u8> {
    let w = Writer {
        codec: 1,
        chunk: Some(chunk),
        ..Writer::default()
    };
    w.file()
}

fn blosc(chunk: Vec<u8>) -> Vec<u8> {
    let w = Writer {
        codec: 4,
        chunk: Some(chunk),
        ..Writer::default()
    };
    w.file()
}

/// A file whose blosc frame has this header and 32 bytes of garbage.
fn blosc_frame(type_size: u8, nbytes: u32, block_size: u32, cbytes: u32) -> Vec<u8> {
    let mut frame = vec![2, 1, 0x21, type_size];
    for n in [nbytes, block_size, cbytes] {
        frame.extend(n.to_le_bytes());
    }
    frame.extend((0..32_u8).map(|i| i.wrapping_mul(37)));
    blosc(chunk(48, &frame))
}

/// Chunks that lie; three active values take 12 bytes.
fn hostile_chunks() -> Vec<(&'static str, Vec<u8>)> {
    vec![
        ("bad_zip_length_huge", zip(chunk(i64::MAX, &[0; 16]))),
        ("bad_zip_length_negative", zip(chunk(i64::MIN, &[0; 16]))),
        ("bad_zip_plain_length_wrong", zip(chunk(-16, &[0; 16]))),
        ("bad_zip_garbage", zip(chunk(16, &[0xa5; 16]))),
        ("bad_blosc_length_huge", blosc(chunk(1 << 50, &[0; 16]))),
        (
            "bad_blosc_length_negative",
            blosc(chunk(-(1 << 50), &[0; 16])),
        ),
        ("bad_blosc_frame_short", blosc(chunk(8, &[2; 8]))),
        ("bad_blosc_nbytes_huge", blosc_frame(4, 0x7fff_fff0, 12, 48)),
        ("bad_blosc_nbytes_odd", blosc_frame(4, 15, 12, 48)),
        ("bad_blosc_cbytes_beyond", blosc_frame(4, 12, 12, 4096)),
        ("bad_blosc_block_zero", blosc_frame(4, 12, 0, 48)),
        ("bad_blosc_block_huge", blosc_frame(4, 12, u32::MAX, 48)),
        ("bad_blosc_type_size_zero", blosc_frame(0, 12, 12, 48)),
        ("bad_blosc_garbage", blosc_frame(4, 12, 12, 48)),
    ]
}

/// Writers whose files lie in other ways, or are odd and have to load.
fn hostile_writers() -> Vec<(&'static str, Writer)> {
    let mut all = Vec::new();
    let mut add = |name, change: &dyn Fn(&mut Writer)| {
        let mut w = Writer::default();
        change(&mut w);
        all.push((name, w));
    };
    add("bad_grid_count", &|w| w.grid_count = Some(u32::MAX));
    add("bad_metadata_count", &|w| w.metadata_count = Some(u32::MAX));
    add("bad_root_tile_count", &|w| {
        w.root_tile_count = Some(u32::MAX);
    });
    add("bad_root_unaligned", &|w| {
        w.root_origins = vec![[i32::MAX; 3]];
    });
    add("bad_root_twice", &|w| w.root_origins = vec![[0; 3]; 2]);
    add("bad_root_tile_on_child", &|w| {
        w.root_tiles = vec![([0; 3], 1.0, true)];
    });
    add("bad_value_kind", &|w| w.kind = 7);
    add("bad_instance_of_itself", &|w| w.parent = "density");
    add("ok_name_not_utf8", &|w| {
        w.name = vec![0xff, 0xfe, 0x1e, b'0'];
    });
    add("ok_at_the_end_of_index_space", &|w| {
        w.root_origins = vec![[i32::MIN; 3], [i32::MAX - 4095; 3]];
        w.root_tiles = vec![([i32::MAX - 4095, 0, 0], f32::MAX, true)];
    });
    add("ok_kind_without_active_mask", &|w| {
        w.active_mask = false;
        w.kind = 5;
        w.inactive = vec![1.0, f32::NAN];
    });
    all
}

/// Files that lie after they have been written.
fn hostile_edits() -> Vec<(&'static str, Vec<u8>)> {
    let mut long_name = Writer::default().file();
    long_name[65..69].copy_from_slice(&u32::MAX.to_le_bytes());
    // Voxel 10 instead of 9, so that the number of values stays right.
    let mut mismatched = Writer::default().file();
    let leaf_mask = mismatched.len() - 64 - 1 - 12;
    mismatched[leaf_mask + 1] ^= 0b110;
    // The second grid is said to begin where the first one does: its positions follow its type.
    let second = Writer {
        name: b"b".to_vec(),
        ..Writer::default()
    };
    let mut overlapping = Writer::file_of(&[Writer::default(), second]);
    let its_type = overlapping
        .windows(16)
        .rposition(|b| b == b"Tree_float_5_4_3");
    let at = its_type.expect("the type is there") + 16 + 4;
    overlapping[at..at + 8].copy_from_slice(&100_u64.to_le_bytes());
    vec![
        ("bad_name_length", long_name),
        ("bad_leaf_mask_differs", mismatched),
        ("bad_offsets_overlap", overlapping),
    ]
}

fn hostile() -> Vec<(&'static str, Vec<u8>)> {
    let written = hostile_writers().into_iter().map(|(n, w)| (n, w.file()));
    [hostile_chunks(), written.collect(), hostile_edits()].concat()
}

#[test]
#[ignore = "writes the corpus anew; needed after a change to `hostile` only"]
fn write_hostile_files() {
    for (name, bytes) in hostile() {
        let path = in_crate("tests/regressions/vdb").join(format!("{name}.vdb"));
        std::fs::write(path, bytes).expect("the corpus is writable");
    }
}

#[test]
fn hostile_files_are_as_they_were_made() {
    for (name, bytes) in hostile() {
        let path = in_crate("tests/regressions/vdb").join(format!("{name}.vdb"));
        let kept = std::fs::read(&path).unwrap_or_default();
        assert!(
            kept == bytes,
            "{name} differs: run the ignored test to write it"
        );
    }
}

//! Small files made in the test: what versions, names, maps and values are taken, and what the
//! voxel policy and the memory limit do.

use crate::vdb_support::writer::Writer;
use glam::{DVec3, IVec3};
use majorant::vdb::{Archive, Grid, LoadOptions, Place, Refusal, TypedGrid, VdbError};

fn open(w: &Writer) -> Archive {
    Archive::from_bytes("test.vdb", w.file()).unwrap_or_else(|e| panic!("{e}"))
}

fn exact(archive: &Archive) -> TypedGrid<f32> {
    match archive.load(0, &LoadOptions::default()) {
        Ok(Grid::F32(g)) => g,
        other => panic!("expected a float grid, got {other:?}"),
    }
}

fn sanitize() -> LoadOptions {
    LoadOptions {
        sanitize: true,
        ..LoadOptions::default()
    }
}

#[test]
fn a_file_as_simple_writers_make_it_loads() {
    // Half, affine map with y and z exchanged, no grid offsets, all values stored.
    let matrix = [
        0.1, 0.0, 0.0, 0.0, 0.0, 0.0, 0.1, 0.0, 0.0, -0.1, 0.0, 0.0, 1.0, 2.0, 3.0, 1.0,
    ];
    let archive = open(&Writer {
        offsets: false,
        type_name: "Tree_float_5_4_3_HalfFloat",
        map: ("AffineMap", matrix.to_vec()),
        half: true,
        active_mask: false,
        kind: 6,
        ..Writer::default()
    });
    let info = &archive.grids()[0];
    assert!(info.half, "half floats");
    assert_eq!(
        (info.type_name.as_str(), info.codec.as_str()),
        ("float", "none")
    );
    let grid = exact(&archive);
    assert_eq!(grid.tree.probe(IVec3::new(7, 7, 7)).value, 512.0);
    assert_eq!(grid.statistics().sum, [1.0 + 10.0 + 512.0]);
    let p = grid
        .transform
        .world_from_index()
        .transform_point3(DVec3::new(10.0, 20.0, 30.0));
    assert!((p - DVec3::new(2.0, -1.0, 5.0)).length() < 1e-12, "{p}");
}

#[test]
fn inactive_values_follow_their_kind() {
    // Inactive voxel 1 is selected by the mask, voxel 2 is not.
    let (minus, plus) = (-0.5, 0.5);
    for (kind, inactive, selected, other) in [
        (0, vec![], plus, plus),
        (1, vec![], minus, minus),
        (2, vec![3.0], 3.0, 3.0),
        (3, vec![], plus, minus),
        (4, vec![3.0], plus, 3.0),
        (5, vec![3.0, 4.0], 4.0, 3.0),
        (6, vec![], 0.0, 0.0),
    ] {
        for half in [false, true] {
            let archive = open(&Writer {
                background: 0.5,
                half,
                kind,
                inactive: inactive.clone(),
                ..Writer::default()
            });
            let tree = exact(&archive).tree;
            let at = |z| tree.probe(IVec3::new(0, 0, z));
            assert_eq!((at(0).value, at(0).active), (1.0, true), "kind {kind}");
            assert_eq!(
                (at(1).value, at(1).active),
                (selected, false),
                "kind {kind}"
            );
            assert_eq!((at(2).value, at(2).active), (other, false), "kind {kind}");
            assert_eq!(at(8).value, 0.5, "a tile, kind {kind}");
        }
    }
}

#[test]
fn versions_222_to_225_are_taken() {
    for version in 222..=225 {
        let w = Writer {
            version,
            ..Writer::default()
        };
        assert_eq!(
            exact(&open(&w)).statistics().sum,
            [523.0],
            "version {version}"
        );
    }
    for version in [0, 221, 226, 999] {
        let w = Writer {
            version,
            ..Writer::default()
        };
        let e = Archive::from_bytes("old.vdb", w.file()).unwrap_err();
        assert!(
            matches!(e, VdbError::Version { found, .. } if found == version),
            "{e}"
        );
    }
}

#[test]
fn names_are_found_as_people_write_them() {
    let named = |name: &[u8]| Writer {
        name: name.to_vec(),
        ..Writer::default()
    };
    let file = Writer::file_of(&[
        named(b"density\x1e0"),
        named("dichte_äö".as_bytes()),
        named(b"density\x1e1"),
        named(b"\x1e0"),
    ]);
    let archive = Archive::from_bytes("names.vdb", file).unwrap();
    for (name, index) in [
        ("density", 0),
        ("density[0]", 0),
        ("density[1]", 2),
        ("dichte_äö", 1),
        ("", 3),
    ] {
        assert_eq!(archive.find(name).unwrap(), index, "{name:?}");
    }
    let e = archive.find("Dichte").unwrap_err().to_string();
    assert_eq!(
        e,
        "names.vdb: no grid \"Dichte\", did you mean \"dichte_äö\"?; the file holds \
         \"density[0]\", \"dichte_äö\", \"density[1]\", \"\""
    );
}

#[test]
fn instances_share_the_tree_and_keep_their_own_map() {
    let instance = Writer {
        name: b"copy".to_vec(),
        parent: "density",
        map: ("TranslationMap", vec![1.0, 2.0, 3.0]),
        ..Writer::default()
    };
    for offsets in [true, false] {
        let first = Writer {
            offsets,
            ..Writer::default()
        };
        let file = Writer::file_of(&[first, instance.clone()]);
        let archive = Archive::from_bytes("instance.vdb", file).unwrap();
        let info = &archive.grids()[1];
        assert_eq!(info.instance_of.as_deref(), Some("density"));
        assert_eq!(info.active_voxel_count, Some(3));
        let density = archive.load_density(1, &LoadOptions::default()).unwrap();
        assert_eq!(density.tree.probe(IVec3::ZERO).value, 1.0);
        let origin = density.transform.world_from_index().translation;
        assert_eq!(origin, DVec3::new(1.0, 2.0, 3.0));
    }
}

#[test]
fn instances_of_instances_or_of_nothing_are_damage() {
    for parent in ["density", "absent"] {
        let itself = Writer {
            parent,
            ..Writer::default()
        };
        let e = Archive::from_bytes("loop.vdb", itself.file()).unwrap_err();
        assert!(matches!(e, VdbError::Damaged { .. }), "{e}");
    }
}

#[test]
fn refused_grids_are_listed_and_do_not_hide_others() {
    let refused = |type_name, map: (&'static str, Vec<f64>)| Writer {
        name: b"first".to_vec(),
        type_name,
        map,
        ..Writer::default()
    };
    let uniform = Writer::default().map;
    for (w, reason) in [
        (refused("Tree_bool_5_4_3", uniform.clone()), Refusal::Bool),
        (
            refused("Tree_half_5_4_3", uniform.clone()),
            Refusal::ValueType("half".into()),
        ),
        (
            refused("Tree_float_4_3_3", uniform),
            Refusal::Tree("4_3_3".into()),
        ),
        (
            refused("Tree_float_5_4_3", ("Wobble", vec![])),
            Refusal::UnknownMap("Wobble".into()),
        ),
        (
            refused("Tree_float_5_4_3", ("ScaleMap", vec![0.0; 15])),
            Refusal::SingularMap,
        ),
    ] {
        let file = Writer::file_of(&[w.clone(), Writer::default()]);
        let archive = Archive::from_bytes("two.vdb", file).unwrap();
        assert_eq!(archive.grids()[0].refused.as_ref(), Some(&reason));
        let e = archive
            .load_density(0, &LoadOptions::default())
            .unwrap_err();
        assert!(matches!(e, VdbError::Refused { .. }), "{e}");
        assert!(
            archive.load_density(1, &LoadOptions::default()).is_ok(),
            "after {reason}"
        );
    }
}

#[test]
fn without_offsets_a_refused_grid_hides_those_behind_it() {
    let first = Writer {
        offsets: false,
        type_name: "Tree_bool_5_4_3",
        ..Writer::default()
    };
    let file = Writer::file_of(&[first, Writer::default(), Writer::default()]);
    let archive = Archive::from_bytes("stream.vdb", file).unwrap();
    assert_eq!(
        (archive.grids().len(), archive.unreachable_grid_count()),
        (1, 2)
    );
}

#[test]
fn negative_density_is_clamped_and_counted() {
    let mut w = Writer {
        background: -1.0,
        root_tiles: vec![([4096, 0, 0], -2.0, true)],
        kind: 2,
        inactive: vec![-0.25],
        ..Writer::default()
    };
    w.leaf[9] = -3.0;
    let density = open(&w).load_density(0, &LoadOptions::default()).unwrap();
    // 509 inactive voxels, one active, 32768 - 1 and 4096 - 1 tiles, a root tile, the background.
    let expected = 509 + 1 + 32767 + 4095 + 1 + 1;
    assert_eq!(density.report.clamped_negative_count, expected);
    for p in [
        IVec3::ZERO,
        IVec3::new(0, 1, 1),
        IVec3::splat(5000),
        IVec3::new(5000, 0, 0),
    ] {
        assert!(density.tree.probe(p).value >= 0.0, "at {p}");
    }
    assert_eq!(density.tree.probe(IVec3::ZERO).value, 1.0, "others stay");
}

#[test]
fn values_that_are_not_finite_are_an_error_or_zero() {
    for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        let mut in_voxel = Writer::default();
        in_voxel.leaf[9] = bad;
        in_voxel.leaf[511] = bad;
        let in_tile = Writer {
            root_tiles: vec![([-4096, 0, 8192], bad, false)],
            ..Writer::default()
        };
        let in_background = Writer {
            background: bad,
            ..Writer::default()
        };
        for (w, place, least) in [
            (in_voxel, Place::Voxel(IVec3::new(0, 1, 1)), 2),
            (in_tile, Place::Voxel(IVec3::new(-4096, 0, 8192)), 1),
            (in_background, Place::Background, 510),
        ] {
            let archive = open(&w);
            match archive
                .load_density(0, &LoadOptions::default())
                .unwrap_err()
            {
                VdbError::NotFinite { first, count, .. } => {
                    assert_eq!(first, place);
                    assert!(count >= least, "{count} at {place}");
                }
                other => panic!("{other}"),
            }
            let clean = archive.load_density(0, &sanitize()).unwrap();
            assert!(clean.report.sanitized_count >= least, "{place}");
            assert_eq!(clean.report.clamped_negative_count, 0);
            assert_eq!(clean.tree.probe(IVec3::new(-1, 0, 8192)).value, 0.0);
            let voxel = clean.tree.probe(IVec3::new(0, 1, 1)).value;
            assert!(voxel.is_finite(), "{voxel}");
        }
    }
    let mut w = Writer::default();
    w.leaf[9] = f32::NAN;
    let e = open(&w)
        .load_density(0, &LoadOptions::default())
        .unwrap_err();
    assert_eq!(
        e.to_string(),
        "test.vdb: grid \"density\": voxel [0, 1, 1]: found NaN, expected finite values; \
         repair the grid, or read such values as 0 (--sanitize)"
    );
}

#[test]
fn memory_is_estimated_before_loading() {
    let archive = open(&Writer::default());
    let estimate = archive.grids()[0].estimated_memory_bytes;
    let at = |max_memory_bytes| LoadOptions {
        max_memory_bytes,
        sanitize: false,
    };
    let density = archive.load_density(0, &at(estimate)).unwrap();
    assert!(
        density.tree.memory_bytes() as u64 <= estimate,
        "the estimate covers the tree"
    );
    let e = archive.load_density(0, &at(estimate - 1)).unwrap_err();
    assert!(
        matches!(e, VdbError::TooLarge { needed, limit, .. } if needed == estimate && limit == estimate - 1),
        "{e}"
    );
    assert!(
        archive.load(0, &at(estimate - 1)).is_err(),
        "exact loading too"
    );
}

#[test]
fn every_truncation_is_an_error() {
    for offsets in [true, false] {
        let w = Writer {
            offsets,
            ..Writer::default()
        };
        let file = w.file();
        for len in (0..file.len()).filter(|n| *n < 700 || n % 37 == 0 || n + 100 > file.len()) {
            let cut = Archive::from_bytes("cut.vdb", file[..len].to_vec());
            assert!(cut.is_err(), "{len} of {} bytes", file.len());
        }
    }
}

#[test]
fn files_that_are_not_there_or_not_vdb_say_so() {
    let e = Archive::open("/no/such/file.vdb".as_ref()).unwrap_err();
    assert_eq!(e.to_string(), "/no/such/file.vdb: cannot be read");
    let e = Archive::open(env!("CARGO_MANIFEST_DIR").as_ref()).unwrap_err();
    assert!(matches!(e, VdbError::Io { .. }), "{e}");
    let e = Archive::from_bytes("x.exr", vec![0x76, 0x2f, 0x31, 0x01, 2, 0, 0, 0]).unwrap_err();
    assert_eq!(
        e.to_string(),
        "x.exr: not an OpenVDB file: it begins with bytes 76 2f 31 01, expected 20 42 44 56"
    );
    let e = Archive::from_bytes("empty.vdb", Vec::new()).unwrap_err();
    assert!(matches!(e, VdbError::NotVdb { .. }), "{e}");
}

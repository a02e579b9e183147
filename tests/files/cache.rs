//! Cache files that are cut short, damaged, foreign or forged: an answer or a clean error.
//!
//! A flipped bit is found by a checksum, so that most mutants never reach what lies behind. Others
//! are sealed again after the damage, as by someone who means harm: then every index and number
//! has to be checked by itself. All run in this process: a panic or a hang fails the test.

use std::fs;
use std::path::Path;

use glam::{DVec3, IVec3};
use majorant::cache::{self, CacheError, CacheFile, Checksum, Contents, Source, is_cache};
use majorant::grid::{Encoding, TreeBuilder};
use majorant::space::IndexTransform;
use rand_core::{Rng as _, SeedableRng as _};
use rand_pcg::Pcg64Mcg;

/// Bytes of the header that are not zero, its own checksum last.
const HEADER: usize = 192;
/// Where the header says how long nodes and bounds are, and their checksum.
const RESIDENT_LENGTH: usize = 40;
const RESIDENT_CHECKSUM: usize = 48;

/// Writes a cache file with bricks, and tiles of three sizes.
fn write(path: &Path, encoding: Encoding) {
    let mut builder = TreeBuilder::new(0.0);
    builder.set_root_tile(IVec3::new(8192, 0, 0), 0.5, true);
    let upper = builder.upper_node(IVec3::ZERO);
    builder.set_upper_tile(upper, 77, 0.25, true);
    let lower = builder.lower_node(IVec3::ZERO);
    builder.set_lower_tile(lower, 99, 0.125, true);
    for i in 0..20 {
        builder.add_brick(IVec3::new(i % 4, i / 4 % 4, i / 16) * 8);
    }
    let contents = Contents {
        nodes: builder.finish_nodes(),
        transform: IndexTransform::uniform(0.1),
        encoding,
        source: Source {
            file: "made up.vdb".to_owned(),
            bytes: 12,
            checksum: 34,
            grid: "density".to_owned(),
            metadata: vec![("creator".to_owned(), "a test".to_owned())],
        },
        brick: |b: usize, origin: IVec3, out: &mut [f32]| {
            for (i, value) in out.iter_mut().enumerate() {
                *value = ((b + i) % 97) as f32 + origin.x as f32;
            }
        },
    };
    cache::write(path, contents, usize::MAX).expect("temporary files can be written");
}

/// Opens a cache file and sends rays through it.
fn try_out(path: &Path) -> Result<f64, CacheError> {
    let file = CacheFile::open(path, 1 << 30)?;
    let grid = file.grid()?;
    let mut sum = 0.0;
    let mut sampler = grid.sampler();
    for i in 0..8 {
        let direction = DVec3::new(1.0, 0.03 * f64::from(i), 0.02);
        for segment in grid.traverse(DVec3::splat(-5.0), direction, 1e6).take(200) {
            let p = direction * segment.t0 - 5.0;
            sum += f64::from(sampler.trilinear(p));
        }
    }
    grid.world_bounds();
    grid.brick_centres(10);
    Ok(sum)
}

#[test]
fn what_was_written_reads_back() {
    let folder = tempfile::tempdir().expect("room");
    let path = folder.path().join("a.part.of.a.name");
    write(&path, Encoding::F32);
    assert!(is_cache(&path), "by its bytes, not its name");
    let file = CacheFile::open(&path, usize::MAX).expect("fresh");
    assert_eq!(file.source().file, "made up.vdb");
    assert_eq!((file.source().bytes, file.source().checksum), (12, 34));
    assert_eq!(file.source().metadata[0].1, "a test");
    let grid = file.grid().expect("fresh");
    let mut sampler = grid.sampler();
    for (b, number) in (0..20).zip(0_usize..) {
        let origin = IVec3::new(b % 4, b / 4 % 4, b / 16) * 8;
        for i in [0, 100, 511] {
            let p = origin + majorant::grid::brick::voxel_at(i);
            let expected = ((number + i) % 97) as f32 + origin.x as f32;
            assert_eq!(sampler.value(p), expected, "brick {b}, value {i}");
        }
    }
    let lower_tile = IVec3::new(0, 99 / 16, 99 % 16) * 8;
    let upper_tile = IVec3::new(0, 77 / 32, 77 % 32) * 128;
    assert_eq!(sampler.value(lower_tile), 0.125);
    assert_eq!(sampler.value(upper_tile), 0.25);
    assert_eq!(sampler.value(IVec3::new(9000, 5, 5)), 0.5);
    let left_over = fs::read_dir(folder.path()).expect("listed").count();
    assert_eq!(left_over, 1, "no temporary file stays");
}

#[test]
fn foreign_and_short_files_say_what_they_are() {
    let folder = tempfile::tempdir().expect("room");
    let path = folder.path().join("a.mjc");
    let says = |bytes: &[u8]| {
        fs::write(&path, bytes).expect("room");
        CacheFile::open(&path, usize::MAX)
            .expect_err("no cache file")
            .to_string()
    };
    assert!(says(b"").ends_with("not a cache file of majorant"));
    assert!(says(b" BDV and more").ends_with("not a cache file of majorant"));
    write(&path, Encoding::U8);
    let good = fs::read(&path).expect("written");
    let mut other = good.clone();
    other[8] = 9;
    assert!(says(&other).contains("cache format version 9, expected 1"));
    let mut other = good.clone();
    other[8..16].reverse();
    other[8..12].copy_from_slice(&good[8..12].iter().rev().copied().collect::<Vec<_>>());
    other[12..16].copy_from_slice(&good[12..16].iter().rev().copied().collect::<Vec<_>>());
    assert!(says(&other).contains("another byte order"));
    assert!(says(&good[..good.len() - 1]).contains("damaged or was cut short"));
    assert!(says(&good[..100]).contains("damaged or was cut short"));
    fs::write(&path, &good).expect("room");
    let error = CacheFile::open(&path, 1000).expect_err("1000 bytes are little");
    assert!(error.to_string().contains("--max-memory"), "{error}");
}

#[test]
fn a_payload_that_changed_is_found_on_request() {
    let folder = tempfile::tempdir().expect("room");
    let path = folder.path().join("a.mjc");
    write(&path, Encoding::F16);
    let mut bytes = fs::read(&path).expect("written");
    bytes[4096 + 777] ^= 4;
    fs::write(&path, &bytes).expect("room");
    let file = CacheFile::open(&path, usize::MAX).expect("the payload is not read");
    let error = file.verify_payload().expect_err("one bit is off");
    assert!(error.to_string().contains("bricks do not match"), "{error}");
}

fn damage(bytes: &mut [u8], rng: &mut Pcg64Mcg) {
    let at = rng.next_u32() as usize % bytes.len();
    let run = [1, 4, 8][rng.next_u32() as usize % 3];
    let value = [0, 0xff, 0x80, 0x7f, rng.next_u64().to_le_bytes()[0]][rng.next_u32() as usize % 5];
    let flip = rng.next_u32().is_multiple_of(2);
    for b in bytes.iter_mut().skip(at).take(run) {
        *b = if flip { *b ^ (1 << (value % 8)) } else { value };
    }
}

/// Gives damaged bytes the checksums that would belong to them.
fn seal(bytes: &mut [u8]) {
    let length: [u8; 8] = bytes[RESIDENT_LENGTH..][..8].try_into().expect("eight");
    let length = usize::try_from(u64::from_ne_bytes(length)).unwrap_or(usize::MAX);
    let resident = bytes
        .len()
        .checked_sub(length)
        .map(|at| Checksum::of(&bytes[at..]));
    if let Some(sum) = resident {
        bytes[RESIDENT_CHECKSUM..][..8].copy_from_slice(&sum.to_ne_bytes());
    }
    let sum = Checksum::of(&bytes[..HEADER - 8]);
    bytes[HEADER - 8..HEADER].copy_from_slice(&sum.to_ne_bytes());
}

#[test]
fn mutants_are_an_answer_or_a_clean_error() {
    let folder = tempfile::tempdir().expect("room");
    let path = folder.path().join("a.mjc");
    let mut rng = Pcg64Mcg::seed_from_u64(3);
    let (mut answers, mut errors) = ([0, 0], [0, 0]);
    for encoding in [Encoding::F32, Encoding::F16, Encoding::U16, Encoding::U8] {
        write(&path, encoding);
        let good = fs::read(&path).expect("written");
        try_out(&path).expect("nothing is damaged yet");
        let length: [u8; 8] = good[RESIDENT_LENGTH..][..8].try_into().expect("eight");
        let length = usize::try_from(u64::from_ne_bytes(length)).expect("small");
        let resident = good.len() - length;
        for i in 0..400 {
            let mut bytes = good.clone();
            let sealed = i % 2 == 1;
            match i % 8 {
                0 => bytes.truncate(rng.next_u32() as usize % good.len()),
                1 | 2 => damage(&mut bytes[..HEADER - 8], &mut rng),
                3 => damage(&mut bytes[4096..resident], &mut rng),
                // The counts, the names and the first of all else are at the front.
                4 | 5 => damage(&mut bytes[resident..resident + 400], &mut rng),
                _ => damage(&mut bytes[resident..], &mut rng),
            }
            if sealed {
                seal(&mut bytes);
            }
            fs::write(&path, &bytes).expect("room");
            match try_out(&path) {
                // A zero may have been set to zero.
                Ok(_) if bytes == good => {}
                Ok(_) => answers[usize::from(sealed)] += 1,
                Err(_) => errors[usize::from(sealed)] += 1,
            }
        }
    }
    // Unsealed damage, none of it to the payload, is always found; sealed damage to a name, a bound
    // or a slot may leave a right file.
    assert_eq!(answers[0], 0, "{answers:?} got through, {errors:?} did not");
    assert!(
        answers[1] > 100,
        "{answers:?}: seals are wrong, nothing was tried"
    );
    assert!(errors[1] > 100, "{errors:?}: nothing was refused");
}

//! The comparison of estimators finds what is there, and not what is not: noise is subtracted
//! right, a bias is called one, the absence of one is not.

use std::path::Path;
use std::sync::atomic::AtomicBool;

use majorant::converge::bias::{BiasTest, Verdict, test_bias};
use majorant::converge::estimator::{Estimator, EstimatorError, parse_list};
use majorant::converge::ladder::{Comparison, Extent, Record, Seconds, measure};
use majorant::converge::metrics::errors;
use majorant::converge::{Reference, covered_pixels, summarise};
use majorant::film::{Batch, Film, Sample};
use majorant::render::NoProgress;
use majorant::sampling::{Stream, StreamKey};
use majorant::scene::desc::unplaced;
use majorant::scene::{LoadOptions, Scene, SceneFile};
use majorant::spectrum::Rgb;

const WIDTH: u32 = 64;
const HEIGHT: u32 = 48;

/// A film of pixels whose samples are `truth(x, y)` plus exponential noise of standard deviation
/// 0.5, the mean of which is taken off.
fn noisy_film(seed: u64, spp: u64, truth: impl Fn(u32, u32) -> f32) -> Film {
    let mut film = Film::new(WIDTH, HEIGHT);
    for (i, pixel) in (0_u32..).zip(film.pixels_mut()) {
        let mut batch = Batch::default();
        for sample in 0..spp {
            let mut stream = Stream::new(StreamKey {
                seed,
                frame: 0,
                pixel: u64::from(i),
                sample,
            });
            let noise: [f32; 3] = std::array::from_fn(|_| 0.5 * (stream.exponential() - 1.0));
            batch.add(&Sample {
                radiance: Rgb(noise.map(|n| truth(i % WIDTH, i / WIDTH) + n)),
                ..Sample::default()
            });
        }
        *pixel = batch.pixel();
    }
    film
}

fn flat(_x: u32, _y: u32) -> f32 {
    1.0
}

fn all_pixels() -> Vec<usize> {
    (0..(WIDTH * HEIGHT) as usize).collect()
}

/// The error without the reference's noise is the variance of the image: 0.25 / N.
///
/// Over 3072 pixels of three channels the mean of squares, of kurtosis 9 / N + 3, has a relative
/// standard error of 1.6 % at N = 16 for the sum of both variances, 3.2 % for the difference with
/// a reference as noisy as the image; 16 % are five of them. Not subtracted, the error would be
/// twice as large.
#[test]
fn the_noise_of_the_reference_is_subtracted() {
    let reference = Reference::from_film(&noisy_film(1, 16, flat));
    let e = errors(&noisy_film(2, 16, flat), &reference, &all_pixels());
    let expected = 0.25 / 16.0;
    let found = e.mse.value();
    assert!(
        (found / expected - 1.0).abs() < 0.16,
        "{found}, not {expected}"
    );
    assert!(
        e.mse.raw > 1.8 * expected,
        "the noise was there: {}",
        e.mse.raw
    );
    let own = e.variance.expect("16 samples");
    assert!((own / expected - 1.0).abs() < 0.05, "{own}, not {expected}");
}

fn compare(spp: u64, truth: impl Fn(u32, u32) -> f32) -> BiasTest {
    let reference = Reference::from_film(&noisy_film(3, 1024, flat));
    test_bias(&noisy_film(4, spp, truth), &reference, &all_pixels())
}

/// With 256 samples a pixel's mean has a standard error of 0.031, the image's 0.00036: 4.5 of
/// these are 0.2 %.
#[test]
fn nothing_is_found_where_nothing_is() {
    let test = compare(256, flat);
    assert_eq!(test.verdict, Verdict::Unbiased, "{test:?}");
    // 9216 values: the mean has a standard error of 0.0104, the deviation of 0.0074.
    assert!(test.z_mean.abs() < 0.052, "{test:?}");
    assert!((test.z_std - 1.0).abs() < 0.037, "{test:?}");
    assert!(test.z_beyond_3 < 0.006, "{test:?}");
    assert_eq!((test.z_count, test.tile_count), (9216, 48));
}

#[test]
fn a_bias_that_is_the_same_everywhere_is_found_in_the_mean() {
    let test = compare(256, |_, _| 1.004);
    assert_eq!(test.verdict, Verdict::Biased, "{test:?}");
    assert!(test.mean_z > 5.0, "{test:?}");
    assert!((test.mean_difference - 0.004).abs() < 0.002, "{test:?}");
}

#[test]
fn a_bias_that_cancels_is_found_in_the_tiles() {
    let sign = |x: u32, y: u32| {
        if (x / 8 + y / 8).is_multiple_of(2) {
            1.0
        } else {
            -1.0
        }
    };
    let test = compare(256, |x, y| 1.0 + 0.015 * sign(x, y));
    assert_eq!(test.verdict, Verdict::Biased, "{test:?}");
    assert!(test.tile_z > 5.0 && test.mean_z.abs() < 4.5, "{test:?}");
}

#[test]
fn a_bias_of_single_pixels_is_found_in_the_squares() {
    let sign = |x: u32, y: u32| if (x + y).is_multiple_of(2) { 1.0 } else { -1.0 };
    let test = compare(256, |x, y| 1.0 + 0.03 * sign(x, y));
    assert_eq!(test.verdict, Verdict::Biased, "{test:?}");
    assert!(test.squared_bias_z() > 5.0, "{test:?}");
    // 0.03², by the weight 1 / 1.01 of the relative error.
    let expected = 0.0009 / 1.01;
    let error = test.squared_bias_standard_error;
    assert!(
        (test.squared_bias - expected).abs() < 5.0 * error,
        "{test:?}"
    );
    assert!(test.mean_z.abs() < 4.5 && test.tile_z < 4.5, "{test:?}");
}

#[test]
fn an_unknown_reference_is_not_believed() {
    let mut reference = Reference::from_film(&noisy_film(3, 16, flat));
    reference.variance = None;
    let test = test_bias(&noisy_film(4, 1024, flat), &reference, &all_pixels());
    assert_eq!(test.verdict, Verdict::Differs, "{test:?}");
    let one_sample = test_bias(&noisy_film(4, 1, flat), &reference, &all_pixels());
    assert_eq!(one_sample.verdict, Verdict::Unknown, "{one_sample:?}");
}

fn scene(name: &str) -> Scene {
    let path = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("data/scenes")
        .join(name);
    let mut file = SceneFile::read(&path).expect("the project's scene");
    file.desc.image.resolution = unplaced([32, 18]);
    let checked = file.check(1 << 30).expect("a good scene");
    let volumes = checked
        .load_volumes(&LoadOptions::default(), &mut |_| {})
        .expect("the project's volume");
    checked.into_scene(&volumes).expect("a good scene")
}

fn ladder(
    scene: &mut Scene,
    extent: Extent,
    which: u8,
    comparison: Option<Comparison<'_>>,
) -> Record {
    let mut record = Record::new(scene.width, scene.height);
    let no_clock = || Seconds::default();
    while let Some(step) = record.next_step(&extent) {
        let watch = (&NoProgress as _, &AtomicBool::new(false));
        let seed = step.seed(0, which);
        let is_whole = measure(&mut record, scene, step, seed, comparison, &no_clock, watch);
        assert!(is_whole, "nobody cancelled it");
    }
    record
}

/// The reference is a render of 511 samples by exact estimators; each estimator has 4 times 255.
///
/// In the smoke, whose optical depth reaches 3, steps of 64 voxels leave out whole puffs. An
/// error of the mean of 1 % is seen.
#[test]
fn a_biased_estimator_is_called_biased_and_others_are_not() {
    let mut scene = scene("smoke.toml");
    let covered = covered_pixels(&scene);
    assert!(
        (20..200).contains(&covered.len()),
        "{} pixels",
        covered.len()
    );
    let extent = |seeds, max_spp| Extent {
        seeds,
        budget_secs: f64::INFINITY,
        max_spp,
    };
    Estimator::exact().apply(&mut scene);
    let reference = ladder(&mut scene, extent(1, 256), 1, None);
    let reference = Reference::from_film(&reference.film);
    let comparison = Comparison {
        reference: &reference,
        covered: &covered,
    };
    let list = "delta+ratio+global,decomposition+residual-ratio,auto,\
                approx-ray-marching+step=64";
    let estimators = parse_list(list, &scene).expect("good names");
    for estimator in estimators {
        estimator.apply(&mut scene);
        let record = ladder(&mut scene, extent(4, 128), 0, Some(comparison));
        let summary = summarise(&record, 4, comparison, 0.01);
        let is_marching = estimator.to_string().contains("marching");
        let expected = if is_marching {
            Verdict::Biased
        } else {
            Verdict::Unbiased
        };
        let bias = summary.bias;
        assert_eq!(bias.verdict, expected, "{estimator}: {bias:?}");
        assert!(
            bias.mean_standard_error < 0.01 / 4.5,
            "{estimator}: {bias:?}"
        );
        // Eight rungs; MSE falls as 1/N. The slope of four means of four seeds is known to 0.1.
        assert_eq!(summary.points.len(), 8);
        let slope = summary.slope.expect("eight points");
        assert!(
            is_marching || (slope + 1.0).abs() < 0.3,
            "{estimator}: {slope}"
        );
    }
}

/// Two renders of equal seeds are equal, so a cap on bounces can be planted in one.
#[test]
fn a_cap_on_bounces_is_a_bias() {
    let mut scene = scene("cloud.toml");
    let covered = covered_pixels(&scene);
    let extent = Extent {
        seeds: 1,
        budget_secs: f64::INFINITY,
        max_spp: 64,
    };
    Estimator::default().apply(&mut scene);
    let reference = ladder(&mut scene, extent, 1, None);
    let reference = Reference::from_film(&reference.film);
    for (max_bounces, expected) in [(None, Verdict::Unbiased), (Some(8), Verdict::Biased)] {
        scene.transport.max_bounces = max_bounces;
        let record = ladder(&mut scene, extent, 2, None);
        let test = test_bias(&record.film, &reference, &covered);
        assert_eq!(test.verdict, expected, "{max_bounces:?}: {test:?}");
    }
}

#[test]
fn estimators_that_a_scene_does_not_allow_are_refused() {
    let scene = scene("smoke.toml");
    for (name, reason) in [
        ("analog", "analog cannot see a sun of zero diameter"),
        ("closed-form", "closed-form is for homogeneous volumes"),
    ] {
        match parse_list(name, &scene) {
            Err(EstimatorError::Impossible { reason: found, .. }) => {
                assert!(found.starts_with(reason), "{found}");
            }
            other => panic!("{name}: {other:?}"),
        }
    }
    let names = |list: &str, scene: &Scene| -> Vec<String> {
        let list = parse_list(list, scene).expect("good names");
        list.iter().map(ToString::to_string).collect()
    };
    assert_eq!(names("delta,auto, delta ,path", &scene), ["delta", "auto"]);
    let all = names("all", &scene);
    assert_eq!(all.len(), 17, "{all:?}");
    assert!(all.iter().any(|n| n.contains("marching")), "{all:?}");
    let furnace = names("all", &self::scene("furnace.toml"));
    assert!(furnace.contains(&"analog".to_owned()), "{furnace:?}");
    assert!(
        !furnace.iter().any(|n| n.contains("marching")),
        "{furnace:?}"
    );
}

//! `majorant compare`: how far two images are from each other, and whether noise explains it.
//!
//! Over all pixels, in R, G and B. With x the first image and r the second:
//! RMSE² is the mean of (x − r)², relMSE that of (x − r)² / (r² + 0.01), as in `converge`; FLIP is
//! the difference that people see. Where both say the variance of their pixels, z is
//! (x − r) / √(var x + var r): its mean is 0 and its standard deviation 1 if only noise differs.

use std::path::Path;

use majorant::converge::picture::diverging;
use majorant::converge::{Reference, flip, metrics};
use majorant::film::{Film, Pixel, Region};
use majorant::output::{self, ReadImage, read_exr};
use serde::Serialize;

use super::args::CompareArgs;
use super::{Failure, report};

#[derive(Debug, Serialize)]
struct Comparison {
    rmse: f64,
    rel_mse: f64,
    flip: f64,
    max_difference: f64,
    /// `null` where a variance is unknown.
    z: Option<Z>,
}

#[derive(Debug, Serialize)]
struct Z {
    mean: f64,
    standard_deviation: f64,
    /// Of the mean of the image: far from 0 if its brightness differs by more than noise.
    of_image_mean: f64,
    /// Share of channels of pixels beyond 3: 0.0027 if noise is normal.
    beyond_3: f64,
}

pub(super) fn run(args: &CompareArgs) -> Result<(), Failure> {
    let read = |path: &Path| read_exr(path).map_err(|e| Failure::BadInput(report::chain(&e)));
    let (x, r) = (read(&args.image)?, read(&args.reference)?);
    if (x.width, x.height) != (r.width, r.height) {
        return Err(Failure::BadInput(format!(
            "{}: {} by {} pixels, expected {} by {} as in {}",
            args.image.display(),
            x.width,
            x.height,
            r.width,
            r.height,
            args.reference.display()
        )));
    }
    let film = film(&x, &args.image)?;
    let comparison = compare(&x, &r, &film);
    if let Some(path) = &args.difference {
        output::write_rgb_png(path, film.width(), film.height(), &difference(&x, &r))
            .map_err(Failure::failed)?;
    }
    if args.json {
        let json = serde_json::to_string_pretty(&comparison).map_err(Failure::failed)?;
        return report::print(&format!("{json}\n"));
    }
    report::print(&shown(&comparison))
}

fn film(image: &ReadImage, path: &Path) -> Result<Film, Failure> {
    let edge = |n: usize| u32::try_from(n).ok();
    let pixel = |mean: &[f64; 3]| Pixel {
        count: 1,
        mean: *mean,
        ..Pixel::default()
    };
    let pixels = image.colours.iter().map(pixel).collect();
    edge(image.width)
        .zip(edge(image.height))
        .and_then(|(w, h)| Film::from_pixels([w, h], Region::whole(w, h), pixels))
        .ok_or_else(|| Failure::BadInput(format!("{}: not an image", path.display())))
}

fn compare(x: &ReadImage, r: &ReadImage, film: &Film) -> Comparison {
    let pairs = || {
        x.colours
            .as_flattened()
            .iter()
            .zip(r.colours.as_flattened())
    };
    let n = (3 * x.colours.len()).max(1) as f64;
    let squared = |(x, r): (&f64, &f64)| (x - r) * (x - r);
    let relative = |(x, r): (&f64, &f64)| (x - r) * (x - r) * metrics::relative_weight(*r);
    let reference = Reference {
        width: film.width(),
        height: film.height(),
        mean: r.colours.clone(),
        variance: None,
        relative_rounding: 0.0,
    };
    Comparison {
        rmse: (pairs().map(squared).sum::<f64>() / n).sqrt(),
        rel_mse: pairs().map(relative).sum::<f64>() / n,
        flip: flip::mean_flip(film, &reference),
        max_difference: pairs().map(|(x, r)| (x - r).abs()).fold(0.0, f64::max),
        z: z(x, r),
    }
}

fn z(x: &ReadImage, r: &ReadImage) -> Option<Z> {
    /// A half's rounding, relative: uniform, up to 2⁻¹¹.
    const HALF: f64 = 1.0 / 2048.0;
    let rounding = |image: &ReadImage, value: f64| {
        let largest = if image.is_half { value * HALF } else { 0.0 };
        largest * largest / 3.0
    };
    let (vx, vr) = (x.variance.as_ref()?, r.variance.as_ref()?);
    let values = x
        .colours
        .as_flattened()
        .iter()
        .zip(r.colours.as_flattened());
    let variances = vx.as_flattened().iter().zip(vr.as_flattened());
    let (mut sum, mut squares, mut beyond, mut n) = (0.0, 0.0, 0_u64, 0_u64);
    let (mut total, mut noise) = (0.0, 0.0);
    for ((x_value, r_value), (vx, vr)) in values.zip(variances) {
        let difference = x_value - r_value;
        total += difference;
        noise += vx + vr;
        let variance = vx + vr + rounding(x, *x_value) + rounding(r, *r_value);
        // Zero: known exactly in both, as beside the medium; there is no noise to compare with.
        if vx + vr > 0.0 {
            let z = difference / variance.sqrt();
            sum += z;
            squares += z * z;
            beyond += u64::from(z.abs() > 3.0);
            n += 1;
        }
    }
    let n = n as f64;
    // Zero: no pixel has noise.
    (n > 0.0).then(|| Z {
        mean: sum / n,
        standard_deviation: (squares / n - (sum / n) * (sum / n)).max(0.0).sqrt(),
        of_image_mean: total / noise.sqrt(),
        beyond_3: beyond as f64 / n,
    })
}

/// A picture of x − r relative to r, averaged over the channels: blue is darker than the second
/// image, red is brighter, by 10 % or more at full colour.
fn difference(x: &ReadImage, r: &ReadImage) -> Vec<[u8; 3]> {
    /// Relative difference at full colour.
    const FULL: f64 = 0.1;
    let pairs = x.colours.iter().zip(&r.colours);
    pairs
        .map(|(x, r)| {
            let relative = |c: usize| (x[c] - r[c]) * metrics::relative_weight(r[c]).sqrt();
            diverging((relative(0) + relative(1) + relative(2)) / 3.0 / FULL)
        })
        .collect()
}

fn shown(comparison: &Comparison) -> String {
    let Comparison {
        rmse,
        rel_mse,
        flip,
        max_difference,
        z,
    } = comparison;
    let z = match z {
        None => "z         unknown: not both images have variance.R/G/B\n".to_owned(),
        Some(Z {
            mean,
            standard_deviation,
            of_image_mean,
            beyond_3,
        }) => format!(
            "z         mean {mean:.4}, standard deviation {standard_deviation:.4}, {:.3} % beyond 3\n\
             z of mean {of_image_mean:.2}\n",
            100.0 * beyond_3
        ),
    };
    format!(
        "RMSE      {rmse:.6e}\nrelMSE    {rel_mse:.6e}\nFLIP      {flip:.6}\n\
         largest   {max_difference:.6e}\n{z}"
    )
}

//! A comparison as one page that needs nothing else: no scripts, no other files, no network.

mod gallery;

use std::fmt::Write as _;

use super::bias::{BiasTest, THRESHOLD, Verdict};
use super::ladder::Record;
use super::metrics::{EPSILON, TRIMMED_ONE_OF};
use super::picture::Picture;
use super::results::{EstimatorResults, Results};
use super::{Estimate, LEAST_DEPTH, Point, Reference};
use crate::output::srgb_byte;
use crate::plot::{Curve, CurvePoint, LogPlot, escape};

/// Returns the page. `records` are the estimators' of `results`, in the same order.
pub fn html(results: &Results, records: &[&Record], references: &[Reference]) -> String {
    let mut page = Page(String::new());
    page.head(results, references);
    page.findings(results);
    page.curves(results);
    page.table(results);
    page.gallery(results, records, references);
    page.points(results);
    page.method(results);
    page.0.push_str("</main></body></html>\n");
    page.0
}

/// A number with three digits: `0.0123`, `4.57e-6`, `12300`.
fn number(x: f64) -> String {
    if x == 0.0 || !x.is_finite() {
        return if x == 0.0 { "0" } else { "–" }.to_owned();
    }
    #[expect(clippy::cast_possible_truncation, reason = "a power of ten")]
    let power = x.abs().log10().floor() as i32;
    match power {
        -4..=1 => {
            let digits = usize::try_from(2 - power).unwrap_or(0);
            format!("{x:.digits$}")
        }
        2..=4 => format!("{x:.0}"),
        _ => format!("{x:.2e}"),
    }
    .replace('-', "−")
}

fn optional(x: Option<f64>) -> String {
    x.map_or("–".to_owned(), number)
}

fn with_interval(estimate: Option<Estimate>) -> String {
    let Some(Estimate { value, interval }) = estimate else {
        return "–".to_owned();
    };
    let interval = interval.map_or(String::new(), |i| {
        let (low, high) = (number(i.low), number(i.high));
        format!("<br><small>{low}…{high}</small>")
    });
    format!("{}{interval}", number(value))
}

fn percent(x: f64) -> String {
    let x = 100.0 * x;
    let digits = if x.abs() < 0.1 { 3 } else { 2 };
    format!("{x:.digits$} %").replace('-', "−")
}

fn verdict(bias: &BiasTest) -> String {
    match bias.verdict {
        Verdict::Unbiased => "no bias seen".to_owned(),
        Verdict::Biased => "<b class=\"bad\">BIASED</b>".to_owned(),
        Verdict::Differs => {
            "<b class=\"bad\">differs</b> (noise of the reference unknown)".to_owned()
        }
        Verdict::Unknown => "not enough samples".to_owned(),
    }
}

fn is_biased(estimator: &EstimatorResults) -> bool {
    matches!(
        estimator.summary.bias.verdict,
        Verdict::Biased | Verdict::Differs
    )
}

/// Estimators that may be called the best.
fn is_fair(estimator: &EstimatorResults) -> bool {
    !estimator.approximate && !is_biased(estimator)
}

struct Page(String);

impl Page {
    fn push(&mut self, text: std::fmt::Arguments<'_>) {
        self.0
            .write_fmt(text)
            .expect("writing to a string cannot fail");
    }

    fn head(&mut self, results: &Results, references: &[Reference]) {
        let Results {
            version,
            scene,
            scene_hash,
            resolution: [width, height],
            covered_pixels,
            seeds,
            budget_secs,
            timing,
            ..
        } = results;
        let scene = escape(scene);
        let style = STYLE;
        self.push(format_args!(
            "<!doctype html><html lang=\"en\"><head><meta charset=\"utf-8\">\
             <meta name=\"viewport\" content=\"width=device-width\">\
             <title>Error against run time: {scene}</title><style>{style}</style></head>\
             <body><main><h1>Error against run time</h1>"
        ));
        if let Some(reference) = references.first() {
            let picture = preview(reference).data_uri();
            self.push(format_args!(
                "<img class=\"reference\" src=\"{picture}\" alt=\"the reference\">"
            ));
        }
        let processor = escape(timing.processor.as_deref().unwrap_or("unknown processor"));
        let threads = timing.threads;
        let load_average = timing
            .load_average
            .map_or(String::new(), |[one, five, fifteen]| {
                format!("; load average {one:.1}, {five:.1}, {fifteen:.1}")
            });
        let (load, build) = (number(timing.load_secs), number(timing.build_secs));
        self.push(format_args!(
            "<dl><dt>Scene</dt><dd>{scene}, hash {scene_hash}</dd>\
             <dt>Image</dt><dd>{width} × {height} pixels, of which the medium covers \
             {covered_pixels}</dd>\
             <dt>Budget</dt><dd>{budget_secs} CPU s for each estimator, {seeds} seeds a point</dd>"
        ));
        for (i, reference) in results.references.iter().enumerate() {
            let source = escape(&reference.source);
            let spp = reference
                .spp
                .map_or(String::new(), |n| format!(", {n} samples a pixel"));
            let cpu = timing.reference_cpu_secs.get(i).copied().unwrap_or(0.0);
            // Zero: a file, which cost nothing now.
            let cpu = if cpu > 0.0 {
                format!(", {} CPU s", number(cpu))
            } else {
                String::new()
            };
            let noise = if reference.noise_known {
                format!("noise of relMSE {}", number(reference.rel_mse_noise))
            } else {
                "its noise is unknown and counts as error of the others".to_owned()
            };
            let name = if i == 0 { "Reference" } else { "Second" };
            self.push(format_args!(
                "<dt>{name}</dt><dd>{source}{spp}{cpu}; {noise}</dd>"
            ));
        }
        self.push(format_args!(
            "<dt>Before rendering</dt><dd>volume read in {load} s, bounds built in {build} s</dd>\
             <dt>Machine</dt><dd>{processor}, {threads} threads{load_average}</dd><dt>Program</dt><dd>majorant {version}</dd></dl>"
        ));
    }

    fn findings(&mut self, results: &Results) {
        self.push(format_args!("<h2>What came out</h2><ul>"));
        if !results.complete {
            self.push(format_args!(
                "<li><b>Interrupted:</b> some estimators have not spent their budget. \
                 <code>--resume</code> goes on.</li>"
            ));
        }
        let sorted = results.by_efficiency();
        let known: Vec<_> = sorted
            .iter()
            .filter(|e| is_fair(e))
            .filter_map(|e| e.summary.timing.efficiency.map(|x| (&e.name, x)))
            .collect();
        if let [(best, best_value), .., (worst, worst_value)] = &known[..] {
            let (best, worst) = (escape(best), escape(worst));
            let factor = number(best_value.value / worst_value.value);
            self.push(format_args!(
                "<li>Most efficient without bias: <b>{best}</b>; the least, {worst}, \
                 takes {factor} times as long for the same noise.</li>"
            ));
            let close: Vec<_> = known[1..]
                .iter()
                .filter(|(_, x)| match (x.interval, best_value.interval) {
                    (Some(x), Some(best)) => x.high >= best.low,
                    _ => false,
                })
                .map(|(name, _)| escape(name))
                .collect();
            if !close.is_empty() {
                let names = close.join(", ");
                self.push(format_args!(
                    "<li>Not told apart from it, their intervals overlap: {names}.</li>"
                ));
            }
        }
        for e in results.estimators.iter().filter(|e| is_biased(e)) {
            self.bias(e);
        }
        if !results.estimators.iter().any(is_biased) {
            self.push(format_args!(
                "<li>No estimator shows a bias that these budgets can see.</li>"
            ));
        }
        let violations: u64 = results
            .estimators
            .iter()
            .map(|e| e.summary.counts.bound_violations + e.summary.counts.non_finite_samples)
            .sum();
        if violations > 0 {
            self.push(format_args!(
                "<li class=\"bad\"><b>{violations} values above their bound or samples that were \
                 not finite: a bug.</b></li>"
            ));
        }
        self.push(format_args!("</ul>"));
    }

    fn bias(&mut self, estimator: &EstimatorResults) {
        let name = escape(&estimator.name);
        let bias = &estimator.summary.bias;
        let (mean, error) = (
            percent(bias.mean_difference),
            percent(bias.mean_standard_error),
        );
        let (z, tile_z) = (number(bias.mean_z), number(bias.tile_z));
        let word = verdict(bias);
        self.push(format_args!(
            "<li><b>{name}</b>: {word}. The mean differs by {mean} ± {error} (z {z}), its tiles \
             at z {tile_z}."
        ));
        if bias.squared_bias_z() > THRESHOLD {
            let level = number(bias.squared_bias);
            self.push(format_args!(
                " Its curve flattens at relMSE {level}: more time does not help."
            ));
        }
        self.push(format_args!("</li>"));
    }

    fn curves(&mut self, results: &Results) {
        let plot = |x_label: &str, x: fn(&Point) -> f64| {
            let y = |p: &Point| {
                let error = p.rel_mse.standard_error.unwrap_or(0.0);
                Some((p.rel_mse.mean, error))
            };
            LogPlot {
                x_label: x_label.to_owned(),
                y_label: "relMSE, mean over seeds".to_owned(),
                curves: curves(results, x, y),
                guide_slope: Some(-1.0),
                floor: results.references.first().map(|r| {
                    let name = "noise of the reference, subtracted".to_owned();
                    (r.rel_mse_noise, name)
                }),
            }
            .to_svg()
        };
        let by_time = plot("CPU seconds of one render", |p| p.timing.cpu);
        let by_lookups = plot("voxel values read by one render", |p| p.values_read);
        let by_eye = LogPlot {
            x_label: "CPU seconds of one render".to_owned(),
            y_label: "FLIP, first seed".to_owned(),
            curves: curves(results, |p| p.timing.cpu, |p| p.flip.map(|x| (x, 0.0))),
            guide_slope: Some(-0.5),
            floor: None,
        }
        .to_svg();
        self.push(format_args!(
            "<h2>Error against time</h2><p>Lower and further left is better. Without bias the \
             error falls along the dotted lines; dashed curves are biased and flatten. Bars are \
             standard errors over seeds.</p>{by_time}\
             <h2>Error against voxel values read</h2><p>The same without what a processor makes \
             of it: reading voxels is what costs most on large volumes. A trilinear value or a \
             cell that is integrated counts as eight.</p>{by_lookups}\
             <h2>What people see</h2><p>FLIP is 0 where nobody sees a difference and 1 at the \
             largest; it includes the noise of the reference.</p>{by_eye}"
        ));
    }

    fn table(&mut self, results: &Results) {
        let target = results.target_rel_mse;
        self.push(format_args!(
            "<h2>Efficiency</h2><div class=\"wide\"><table><thead><tr><th>Estimator</th>\
             <th>efficiency<br><small>1 / (rel. variance · CPU s)</small></th>\
             <th>of the best</th>\
             <th>by values read<br><small>1 / (rel. variance · 10⁶)</small></th>\
             <th>CPU s to<br>relMSE {target}</th><th>CPU ms<br>a sample</th>\
             <th>values<br>a ray</th><th>null<br>share</th><th>first tile<br>ms</th>\
             <th>slope</th><th>worst 1 %<br>of pixels</th><th>mean less<br>reference</th></tr></thead><tbody>"
        ));
        let sorted = results.by_efficiency();
        let best = sorted.iter().filter(|e| is_fair(e));
        let best = best
            .filter_map(|e| e.summary.timing.efficiency)
            .map(|x| x.value)
            .next();
        for e in sorted {
            let s = &e.summary;
            // Long names may break after each part.
            let (name, counts) = (escape(&e.name).replace('+', "+<wbr>"), &s.counts);
            let share = s
                .timing
                .efficiency
                .zip(best)
                .map(|(x, best)| x.value / best);
            let rays = counts.camera_rays.max(1) as f64;
            let tentative = counts.tentative_collisions.max(1) as f64;
            let row = [
                with_interval(s.timing.efficiency),
                share.map_or("–".to_owned(), |x| format!("{x:.2}")),
                with_interval(s.efficiency_by_values_read),
                s.timing
                    .cpu_secs_to_target
                    .map_or("never".to_owned(), number),
                number(1e3 * s.timing.cpu_secs_per_spp),
                number(counts.values_read() as f64 / rays),
                format!("{:.0} %", 100.0 * counts.null_collisions as f64 / tentative),
                number(1e3 * s.timing.first_tile_secs),
                s.slope
                    .map_or("–".to_owned(), |x| format!("{x:.2}").replace('-', "−")),
                s.worst_share
                    .map_or("–".to_owned(), |x| format!("{:.0} %", 100.0 * x)),
                format!(
                    "{}<br><small>± {}</small>",
                    percent(s.bias.mean_difference),
                    percent(s.bias.mean_standard_error)
                ),
            ];
            let verdict = match s.bias.verdict {
                Verdict::Unbiased if e.approximate => {
                    "<br><small>biased by design</small>".to_owned()
                }
                Verdict::Unbiased => String::new(),
                _ => format!("<br>{}", verdict(&s.bias)),
            };
            self.push(format_args!("<tr><th>{name}{verdict}</th>"));
            for cell in row {
                self.push(format_args!("<td>{cell}</td>"));
            }
            self.push(format_args!("</tr>"));
        }
        self.push(format_args!(
            "</tbody></table></div><p>Ranges are 95 % intervals. A biased estimator has an \
             efficiency too: it counts noise only. The worst hundredth of the pixels makes up the \
             share given of the error of the longest renders: 8 % where noise is the same \
             everywhere and Gaussian, much more where there are fireflies.</p>"
        ));
    }

    fn points(&mut self, results: &Results) {
        self.push(format_args!(
            "<h2>All points</h2><details><summary>Table of every point of every curve</summary>\
             <div class=\"wide\"><table><thead><tr><th>Estimator</th><th>spp</th><th>CPU s</th>\
             <th>wall s</th><th>values read</th><th>relMSE</th><th>± standard error</th>\
             <th>trimmed</th><th>by own samples</th><th>MSE</th><th>FLIP</th></tr></thead><tbody>"
        ));
        for e in &results.estimators {
            for p in &e.summary.points {
                let name = escape(&e.name);
                self.push(format_args!("<tr><th>{name}</th>"));
                for cell in [
                    p.spp.to_string(),
                    number(p.timing.cpu),
                    number(p.timing.wall),
                    number(p.values_read),
                    number(p.rel_mse.mean),
                    optional(p.rel_mse.standard_error),
                    number(p.rel_mse_trimmed.mean),
                    optional(p.rel_variance.map(|v| v.mean)),
                    number(p.mse.mean),
                    optional(p.flip),
                ] {
                    self.push(format_args!("<td>{cell}</td>"));
                }
                self.push(format_args!("</tr>"));
            }
        }
        self.push(format_args!("</tbody></table></div></details>"));
    }

    fn method(&mut self, results: &Results) {
        let share = TRIMMED_ONE_OF;
        let seeds = results.seeds;
        self.push(format_args!(
            "<h2>How it was measured</h2><p>A point is {seeds} independent renders with different \
             seeds; the next one takes twice the samples. CPU seconds are of all threads while \
             rays are traced, loading and building apart. Errors are taken over the pixels \
             through whose centre the optical depth is at least {LEAST_DEPTH}, in R, G and B: \
             relMSE is the mean of (x − r)² / (r² + {EPSILON}), less the reference's own noise. \
             The trimmed figure leaves out the worst pixel of {share}: where it is much lower, a \
             few bright pixels make up the error. “By own samples” is the variance within \
             each render, which knows no reference; where relMSE stays above it, there is bias. \
             An estimator is called biased if the mean of the image, the means of its tiles of \
             8 × 8 pixels or the mean squared bias is beyond {THRESHOLD} standard errors.</p>"
        ));
    }
}

fn curves(
    results: &Results,
    x: fn(&Point) -> f64,
    y: impl Fn(&Point) -> Option<(f64, f64)>,
) -> Vec<Curve> {
    let point = |p: &Point| {
        let (value, error) = y(p)?;
        Some(CurvePoint {
            x: x(p),
            y: value,
            error,
        })
    };
    let curve = |e: &EstimatorResults| Curve {
        name: e.name.clone(),
        points: e.summary.points.iter().filter_map(point).collect(),
        dashed: !is_fair(e),
    };
    results.estimators.iter().map(curve).collect()
}

/// The reference as a screen shows it.
fn preview(reference: &Reference) -> Picture {
    Picture {
        width: reference.width,
        height: reference.height,
        pixels: reference.mean.iter().map(|m| m.map(srgb_byte)).collect(),
    }
}

const STYLE: &str = include_str!("style.css");

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_have_three_digits() {
        for (x, text) in [
            (0.012_345, "0.0123"),
            (4.567e-6, "4.57e−6"),
            (12_345.0, "12345"),
            (1.0, "1.00"),
            (-25.0, "−25.0"),
            (0.0, "0"),
            (f64::INFINITY, "–"),
            (3.2e7, "3.20e7"),
        ] {
            assert_eq!(number(x), text);
        }
    }
}

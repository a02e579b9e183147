//! A profile as one page that needs nothing else: no scripts, no other files, no network.
//!
//! All numbers are in it a second time, as JSON in an element of the name `data`.

use std::fmt::{Arguments, Write as _};

use super::measure::{Measured, REPEATS, Work};
use super::reuse::MEMORIES;
use majorant::converge::picture::{Picture, colour_bar, heat};
use majorant::film::{Film, PixelCost};
use majorant::output::srgb_byte;
use majorant::plot::escape;
use majorant::stats::Counts;

/// What a page shows.
#[derive(Clone, Copy, Debug)]
pub(super) struct Report<'a> {
    /// Name of the scene.
    pub(super) title: &'a str,
    /// Facts about scene and machine, by name.
    pub(super) facts: &'a [(&'a str, String)],
    /// The whole image.
    pub(super) film: &'a Film,
    /// What its pixels cost, row by row from the top.
    pub(super) costs: &'a [PixelCost],
    /// What its rays did.
    pub(super) counts: &'a Counts,
    /// CPU seconds of all threads for it, if there is such a clock.
    pub(super) cpu_secs: Option<f64>,
    /// What was measured of some of its tiles.
    pub(super) measured: &'a Measured,
    /// Everything, as JSON.
    pub(super) json: &'a str,
}

/// Colours of the kinds of work, the last for the rest.
const COLOURS: [&str; 5] = ["#0072b2", "#56b4e9", "#009e73", "#e69f00", "#b9b9b9"];

/// How each kind of work is measured.
const METHODS: [&str; 5] = [
    "rays of the paths placed in the grid, nothing else",
    "the same rays, stepping through the same segments; empty cells between them are in it",
    "and reading at the same places",
    "and drawing distances and deciding, as the estimators do",
    "what is left of the whole: phase functions, lights, roulette, sums of pixels",
];

struct Page(String);

impl Page {
    fn push(&mut self, text: Arguments<'_>) {
        self.0
            .write_fmt(text)
            .expect("writing to a string cannot fail");
    }
}

/// Returns the page.
pub(super) fn html(report: &Report<'_>) -> String {
    let mut page = Page(String::new());
    page.head(report);
    page.time(report.measured);
    page.counts(report);
    page.memory(report.measured);
    page.maps(report);
    page.method(report);
    // An element of a script ends at the first end tag, even inside of a string.
    let json = report.json.replace("</", "<\\/");
    page.push(format_args!(
        "<script type=\"application/json\" id=\"data\">{json}</script></main></body></html>\n"
    ));
    page.0
}

impl Page {
    fn head(&mut self, report: &Report<'_>) {
        let title = escape(report.title);
        let style = include_str!("style.css");
        let film = report.film;
        let image = Picture {
            width: film.width(),
            height: film.height(),
            pixels: film
                .pixels()
                .iter()
                .map(|p| p.mean.map(srgb_byte))
                .collect(),
        };
        self.push(format_args!(
            "<!DOCTYPE html><html lang=\"en\"><head><meta charset=\"utf-8\"><title>Profile of \
             {title}</title><style>{style}</style></head><body><main>\
             <img class=\"image\" src=\"{}\" alt=\"the image\"><h1>Profile of {title}</h1><dl>",
            image.data_uri()
        ));
        for (name, value) in report.facts {
            self.push(format_args!("<dt>{name}<dd>{}", escape(value)));
        }
        self.push(format_args!("</dl>"));
    }

    fn time(&mut self, measured: &Measured) {
        let all = measured.nanoseconds_per_path();
        let [of, tiles] = measured.tiles;
        self.push(format_args!(
            "<h2>Where the time goes</h2><p>A path takes <b>{}</b> of CPU time, the mean of {} \
             paths in {of} of {tiles} tiles that show the medium, alone on one thread.</p>",
            duration(all),
            grouped(measured.paths),
        ));
        let work = measured.work();
        self.push(format_args!(
            "<svg class=\"shares\" viewBox=\"0 0 1000 46\" preserveAspectRatio=\"none\" \
             role=\"img\" aria-label=\"shares of the time\">"
        ));
        let mut left = 0.0;
        for (work, colour) in work.iter().zip(COLOURS) {
            let width = 1000.0 * work.share.max(0.0);
            self.push(format_args!(
                "<rect x=\"{left:.2}\" width=\"{width:.2}\" height=\"46\" fill=\"{colour}\">\
                 <title>{}: {}</title></rect>",
                work.name,
                percent(work.share)
            ));
            left += width;
        }
        self.push(format_args!(
            "</svg><table><thead><tr><th>Work<th>Share<th>Time of a path<th>Counted<th>in a \
             path<th>Time of one<th class=\"text\">Timed by</thead><tbody>"
        ));
        for ((work, colour), method) in work.iter().zip(COLOURS).zip(METHODS) {
            let Work {
                name,
                event,
                events_per_path,
                nanoseconds,
                nanoseconds_per_path,
                share,
            } = *work;
            self.push(format_args!(
                "<tr><th><i style=\"background:{colour}\"></i>{name}<td><b>{}</b><td>{}<td>\
                 {}<td>{}<td>{}<td class=\"text\">{method}",
                percent(share),
                duration(nanoseconds_per_path),
                if event == "vertex" {
                    "vertices".to_owned()
                } else {
                    format!("{event}s")
                },
                number(events_per_path),
                duration(nanoseconds),
            ));
        }
        self.push(format_args!("</tbody></table>"));
    }

    fn counts(&mut self, report: &Report<'_>) {
        let Counts {
            camera_rays,
            scattered_rays,
            shadow_rays,
            segments,
            tentative_collisions,
            null_collisions,
            real_collisions,
            lookups,
            emission_lookups,
            voxel_cells,
            bound_violations,
            roulette_kills,
            non_finite_samples,
        } = *report.counts;
        self.push(format_args!(
            "<div class=\"two\"><section><h2>What rays did</h2><p>In the whole image, and a sample of a pixel; exact.</p>\
             <table><thead><tr><th>Event<th>Number<th>in a sample</thead><tbody>"
        ));
        for (name, count) in [
            ("camera rays", camera_rays),
            ("scattered rays", scattered_rays),
            ("shadow rays", shadow_rays),
            ("steps through segments with density", segments),
            ("tentative collisions", tentative_collisions),
            ("null collisions", null_collisions),
            ("real collisions", real_collisions),
            ("lookups", lookups),
            ("lookups of emission", emission_lookups),
            ("voxel cells integrated", voxel_cells),
            ("paths ended by roulette", roulette_kills),
            ("values above their bound", bound_violations),
            ("samples that are not finite", non_finite_samples),
        ] {
            let per_sample = count as f64 / camera_rays.max(1) as f64;
            self.push(format_args!(
                "<tr><th>{name}<td>{}<td>{}",
                grouped(count),
                number(per_sample)
            ));
        }
        let ratio = Measured::null_ratio(report.counts);
        self.push(format_args!(
            "</tbody></table><p><b>{}</b> of the tentative collisions are null.</p></section>",
            percent(ratio)
        ));
    }

    fn memory(&mut self, measured: &Measured) {
        let reuse = &measured.reuse;
        let [value_bytes, cell_bytes] = measured.bytes_per_event;
        let per = |count: u64, of: u64| count as f64 / of.max(1) as f64;
        let steps = per(measured.recorded.segments, measured.paths);
        let reads = per(reuse.reads, measured.paths);
        let lines = per(reuse.lines_of_paths, measured.paths);
        let cells = per(reuse.cells_of_paths, measured.paths);
        let read = reads * value_bytes as f64 + steps * cell_bytes as f64;
        let touched = lines * 64.0 + cells * cell_bytes as f64;
        self.push(format_args!(
            "<section><h2>What memory they touch</h2><table><thead><tr><th>A path<th></thead><tbody>\
             <tr><th>reads voxel values and bounds<td>{}\
             <tr><th>touches, in whole cache lines of values, and cells<td>{}\
             <tr><th>different bricks of 8³ voxels, if it reads any<td>{}\
             <tr><th>all paths of a tile: bricks<td>{}\
             <tr><th>reads for each brick of a tile<td>{}</tbody></table>",
            bytes(read),
            bytes(touched),
            number(per(reuse.bricks_of_paths, reuse.paths)),
            number(per(reuse.bricks_of_tiles, reuse.tiles)),
            number(per(reuse.reads, reuse.bricks_of_tiles)),
        ));
        self.push(format_args!(
            "<p>How often the brick of a read is among the last <i>N</i> different ones that the \
             thread has read; a brick of this scene is {}.</p><div class=\"found\">",
            bytes(512.0 * value_bytes as f64)
        ));
        for (found, memory) in reuse.found.iter().zip(MEMORIES) {
            let share = per(*found, reuse.reads);
            self.push(format_args!(
                "<span>N = {memory}</span><span class=\"bar\"><i style=\"width:{:.1}%\"></i>\
                 </span><b>{}</b>",
                100.0 * share,
                percent(share)
            ));
        }
        self.push(format_args!(
            "</div><p class=\"caption\">Cache misses are not read: this program asks no counters \
             of the machine, which virtual machines mostly hide. Where there are any, <code>perf \
             stat -e cache-misses majorant render …</code> counts them.</p></section></div>"
        ));
    }

    fn maps(&mut self, report: &Report<'_>) {
        let Report { film, costs, .. } = *report;
        let per_sample = |count: fn(&PixelCost) -> u64| {
            let pixels = film.pixels().iter().zip(costs);
            let map = pixels.map(move |(p, c)| count(c) as f64 / p.count.max(1) as f64);
            map.collect::<Vec<_>>()
        };
        let values = per_sample(|c| c.values_read);
        let nulls = per_sample(|c| c.null_collisions);
        self.push(format_args!(
            "<h2>Where the work is</h2><p>Of a sample, by pixel: counted, so the same on any \
             machine. The scale is logarithmic from a tenth.</p><div class=\"row\">"
        ));
        for (name, map) in [("voxel values read", values), ("null collisions", nulls)] {
            let most = map.iter().copied().fold(1.0, f64::max);
            let colour = |x: &f64| heat((x * 10.0).max(1.0).log10() / (most * 10.0).log10());
            let picture = Picture {
                width: film.width(),
                height: film.height(),
                pixels: map.iter().map(colour).collect(),
            };
            let bar = colour_bar(heat, (0.0, 1.0), ["0.1", &number(most)]);
            self.push(format_args!(
                "<figure><img src=\"{}\" alt=\"{name}\"><figcaption>{name} {bar}</figcaption>\
                 </figure>",
                picture.data_uri()
            ));
        }
        self.push(format_args!("</div>"));
    }

    fn method(&mut self, report: &Report<'_>) {
        let measured = report.measured;
        let whole = report.cpu_secs.map_or(String::new(), |secs| {
            let per_sample = 1e9 * secs / report.counts.camera_rays.max(1) as f64;
            format!(
                " The whole image, on all threads, took {} a sample, those beside the medium \
                 included.",
                duration(per_sample)
            )
        });
        let share = |a: u64, b: u64| percent(a as f64 / b.max(1) as f64);
        self.push(format_args!(
            "<h2>How it was measured</h2><p>Rendering has no clocks inside: reading one takes as \
             long as a lookup. The pixels of {} tiles were rendered and timed as a whole: {} a \
             path.{whole} Rays of plain paths from the same pixels were then walked in four \
             passes, each with more of the work than the one before; the difference of two \
             passes over its number of events is the time of one event. A share is that time, \
             times the events that rendering counted. Plain paths fly in directions of the phase \
             function and cast as many shadow rays for a vertex as the integrator, without its \
             choices among directions: they took {} of its steps and {} of its lookups. Each \
             tile was in the caches, as far as it fits, before it was timed; the shortest of {} \
             runs counts. The last row is a difference and has the errors of all others; below \
             zero it says that an event is slower alone than in its place.</p>",
            measured.tiles[0],
            duration(measured.nanoseconds_per_path()),
            share(measured.tracked.segments, measured.counts.segments),
            share(
                measured.tracked.values_read(),
                measured.counts.values_read()
            ),
            REPEATS,
        ));
    }
}

fn percent(x: f64) -> String {
    format!("{:.1} %", 100.0 * x).replace('-', "−")
}

/// A number with three digits.
fn number(x: f64) -> String {
    match x {
        0.0 => "0".to_owned(),
        ..0.01 => format!("{x:.1e}"),
        ..1.0 => format!("{x:.3}"),
        ..10.0 => format!("{x:.2}"),
        ..100.0 => format!("{x:.1}"),
        _ => format!("{x:.0}"),
    }
    .replace('-', "−")
}

/// A time given in nanoseconds.
fn duration(nanoseconds: f64) -> String {
    let size = nanoseconds.abs();
    let text = if size < 1e3 {
        format!("{nanoseconds:.1} ns")
    } else if size < 1e6 {
        format!("{:.2} µs", nanoseconds * 1e-3)
    } else {
        format!("{:.2} ms", nanoseconds * 1e-6)
    };
    text.replace('-', "−")
}

fn bytes(x: f64) -> String {
    if x < 10_000.0 {
        format!("{x:.0} B")
    } else {
        format!("{:.1} kB", x * 1e-3)
    }
}

/// A whole number with thin spaces between thousands.
fn grouped(x: u64) -> String {
    let digits = x.to_string();
    let groups: Vec<_> = digits.as_bytes().rchunks(3).rev().collect();
    let text = |group: &&[u8]| String::from_utf8_lossy(group).into_owned();
    let groups: Vec<_> = groups.iter().map(text).collect();
    groups.join("\u{202f}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_read_well() {
        assert_eq!(grouped(1_234_567), "1\u{202f}234\u{202f}567");
        assert_eq!((grouped(0), grouped(100)), ("0".into(), "100".into()));
        assert_eq!(
            (duration(-3.26), duration(4100.0)),
            ("−3.3 ns".into(), "4.10 µs".into())
        );
        assert_eq!(
            (number(0.0), number(0.5), number(123.4)),
            ("0".into(), "0.500".into(), "123".into())
        );
        assert_eq!(
            (bytes(512.0), bytes(20_480.0)),
            ("512 B".into(), "20.5 kB".into())
        );
    }
}

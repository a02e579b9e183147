//! How far a render is: a bar on a terminal, a line every tenth elsewhere, or what a farm reads.
//!
//! | `--progress` | on | form |
//! |---|---|---|
//! | `bar`, `lines` | stderr | for people; the first on a terminal, the second elsewhere, unless asked for |
//! | `alf` | stdout | `ALF_PROGRESS 42%`, as Tractor and its kin read it |
//! | `openjd` | stdout | `openjd_progress: 42.5`, as Open Job Description reads it |
//! | `json` | stdout | an object a line |
//!
//! The last three tell of the whole run, frame after frame, at most ten times a second.

use std::io::Write as _;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

use indicatif::ProgressStyle;
use tracing::Span;
use tracing_indicatif::span_ext::IndicatifSpanExt as _;

use super::args::ProgressArg;
use super::report;

/// Which frame of how many.
#[derive(Clone, Copy, Debug)]
pub(super) struct Place {
    pub(super) frame: i32,
    pub(super) index: usize,
    pub(super) count: usize,
}

/// Shows progress of one frame until dropped; under `-q`, bars and lines are silent.
pub(super) struct RenderProgress {
    form: Form,
    place: Place,
    start: Instant,
    /// Where this process began, if it goes on with what another did.
    first: u64,
    /// Milliseconds from `start` to the last report.
    shown_at: AtomicU64,
    /// The estimated relative error of the image, as bits; NaN: not known yet.
    error: AtomicU64,
}

enum Form {
    Bar(Span),
    Lines { shown_tenths: AtomicU64 },
    Alf,
    OpenJd,
    Json,
}

/// Time between two lines: frames of a sequence that take a moment need none.
const LINE_MILLISECONDS: u64 = 1000;

/// Time between two reports to a farm.
const REPORT_MILLISECONDS: u64 = 100;

impl RenderProgress {
    /// Starts showing a render of which `done` samples are there.
    pub(super) fn start(asked: Option<ProgressArg>, place: Place, done: u64) -> Self {
        let by_itself = if report::is_terminal() {
            ProgressArg::Bar
        } else {
            ProgressArg::Lines
        };
        let form = match asked.unwrap_or(by_itself) {
            ProgressArg::Bar => Form::Bar(bar(place)),
            ProgressArg::Lines => Form::Lines {
                shown_tenths: AtomicU64::new(0),
            },
            ProgressArg::Alf => Form::Alf,
            ProgressArg::Openjd => Form::OpenJd,
            ProgressArg::Json => Form::Json,
        };
        Self {
            form,
            place,
            start: Instant::now(),
            first: done,
            shown_at: AtomicU64::new(0),
            error: AtomicU64::new(f64::NAN.to_bits()),
        }
    }

    /// Whether anybody wants to know the error.
    pub(super) fn shows_error(&self) -> bool {
        matches!(self.form, Form::Bar(_) | Form::Json)
    }

    /// Says what the relative error of the image is by now.
    pub(super) fn set_error(&self, error: f64) {
        self.error.store(error.to_bits(), Ordering::Relaxed);
        if let Form::Bar(span) = &self.form
            && error.is_finite()
        {
            span.pb_set_message(&format!("error {:.2} %", 100.0 * error));
        }
    }

    /// Says that `done` of `total` samples are finished. Called from many threads.
    pub(super) fn advance(&self, done: u64, total: u64) {
        let elapsed = self.start.elapsed().as_secs_f64();
        let left = elapsed * (total - done) as f64 / (done - self.first).max(1) as f64;
        match &self.form {
            Form::Bar(span) => {
                span.pb_set_length(total);
                span.pb_set_position(done);
            }
            Form::Lines { shown_tenths } => {
                let tenths = done.saturating_mul(10) / total.max(1);
                // Of several threads that reach a tenth at once, one prints it. The last
                // tenth is left to the summary.
                if self.is_due(elapsed, LINE_MILLISECONDS)
                    && tenths < 10
                    && shown_tenths.fetch_max(tenths, Ordering::Relaxed) < tenths
                {
                    self.shown_at
                        .store(milliseconds(elapsed), Ordering::Relaxed);
                    let percent = tenths * 10;
                    tracing::info!("{percent} % in {elapsed:.1} s, about {left:.1} s left");
                }
            }
            Form::Alf | Form::OpenJd | Form::Json => {
                if !self.is_due(elapsed, REPORT_MILLISECONDS) && done < total {
                    return;
                }
                self.shown_at
                    .store(milliseconds(elapsed), Ordering::Relaxed);
                let part = done as f64 / total.max(1) as f64;
                let Place {
                    frame,
                    index,
                    count,
                } = self.place;
                let percent = 100.0 * (index as f64 + part) / count as f64;
                say(&match self.form {
                    Form::Alf => format!("ALF_PROGRESS {:.0}%", percent.floor()),
                    Form::OpenJd => format!("openjd_progress: {percent:.1}"),
                    _ => {
                        let error = f64::from_bits(self.error.load(Ordering::Relaxed));
                        let error = serde_json::Number::from_f64(error);
                        serde_json::json!({
                            "event": "progress", "frame": frame, "percent": percent,
                            "samples": done, "samples_total": total, "seconds": elapsed,
                            "seconds_left": left, "relative_error": error,
                        })
                        .to_string()
                    }
                });
            }
        }
    }

    fn is_due(&self, elapsed: f64, interval: u64) -> bool {
        milliseconds(elapsed) >= self.shown_at.load(Ordering::Relaxed) + interval
    }
}

fn bar(place: Place) -> Span {
    let frame = if place.count > 1 {
        format!(
            "frame {} ({} of {})",
            place.frame,
            place.index + 1,
            place.count
        )
    } else {
        "rendering".to_owned()
    };
    let template = format!(
        "{frame} {{wide_bar}} {{percent:>3}} %  {{human_pos}} of {{human_len}} samples  {{msg}}  \
         {{elapsed}} / {{eta}} left"
    );
    let style =
        ProgressStyle::with_template(&template).expect("the template is constant but for numbers");
    let span = tracing::info_span!("render");
    span.pb_set_style(&style);
    span.pb_start();
    span
}

/// Says to a farm how a run ended.
pub(super) fn say_end(asked: Option<ProgressArg>, failure: Option<&str>) {
    match (asked, failure) {
        (Some(ProgressArg::Openjd), Some(why)) => {
            say(&format!("openjd_fail: {}", why.replace('\n', " ")));
        }
        (Some(ProgressArg::Json), why) => {
            say(&serde_json::json!({"event": "end", "failure": why}).to_string());
        }
        _ => {}
    }
}

/// Says to a farm what is done now.
pub(super) fn say_status(asked: Option<ProgressArg>, place: Place, what: &str) {
    let Place {
        frame,
        index,
        count,
    } = place;
    match asked {
        Some(ProgressArg::Openjd) => {
            let number = index + 1;
            say(&format!(
                "openjd_status: frame {frame} ({number} of {count}): {what}"
            ));
        }
        Some(ProgressArg::Json) => say(
            &serde_json::json!({"event": "frame", "frame": frame, "index": index, "count": count,
                "what": what})
            .to_string(),
        ),
        _ => {}
    }
}

/// Writes a line to stdout at once: farms read it as it comes.
fn say(line: &str) {
    let mut stdout = std::io::stdout().lock();
    // A farm that no longer listens is no reason to stop.
    let _ = writeln!(stdout, "{line}").and_then(|()| stdout.flush());
}

/// How much of a budget is spent, and what was found last: a bar on a terminal, a line for each
/// find elsewhere.
pub(super) struct LadderProgress {
    bar: Option<Span>,
    budget_secs: f64,
}

impl LadderProgress {
    /// Starts showing how `budget_secs` of CPU time are spent on `what`.
    pub(super) fn start(what: &str, budget_secs: f64) -> Self {
        let bar = report::is_terminal().then(|| {
            let template = format!("{what} {{wide_bar}} {{percent:>3}} %  {{elapsed}}  {{msg}}");
            let style = ProgressStyle::with_template(&template)
                .expect("the template is constant but for a plain word");
            let span = tracing::info_span!("converge");
            span.pb_set_style(&style);
            span.pb_set_length(milliseconds(budget_secs));
            span.pb_start();
            span
        });
        Self { bar, budget_secs }
    }

    /// Says that `spent_secs` are spent by now, and what on.
    pub(super) fn advance(&mut self, spent_secs: f64, found: &str) {
        if let Some(span) = &self.bar {
            span.pb_set_position(milliseconds(spent_secs));
            span.pb_set_message(found);
        } else {
            tracing::info!("{spent_secs:.1} of {:.0} CPU s: {found}", self.budget_secs);
        }
    }
}

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "times are not negative; a saturated bar is full"
)]
fn milliseconds(secs: f64) -> u64 {
    (secs * 1e3) as u64
}

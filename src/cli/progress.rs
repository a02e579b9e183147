//! How far a render is: a bar on a terminal, a line every tenth elsewhere.

use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

use indicatif::ProgressStyle;
use majorant::render::Progress;
use tracing::Span;
use tracing_indicatif::span_ext::IndicatifSpanExt as _;

use super::report;

/// Shows progress until dropped; silent under `-q`, whose log level drops both forms.
pub(super) enum RenderProgress {
    Bar(Span),
    Lines {
        start: Instant,
        /// Where this process began, if it goes on with what another did.
        first: u64,
        shown_tenths: AtomicU64,
        /// Milliseconds from `start` to the last line.
        shown_at: AtomicU64,
    },
}

/// Time between two lines: frames of a sequence that take a moment need none.
const LINE_MILLISECONDS: u64 = 1000;

impl RenderProgress {
    /// Starts showing a render of which `done` samples are there.
    pub(super) fn start(done: u64) -> Self {
        if !report::is_terminal() {
            return Self::Lines {
                start: Instant::now(),
                first: done,
                shown_tenths: AtomicU64::new(0),
                shown_at: AtomicU64::new(0),
            };
        }
        let template = "rendering {wide_bar} {percent:>3} %  {human_pos} of {human_len} samples  \
                        {elapsed} / {eta} left";
        let style = ProgressStyle::with_template(template).expect("the template is constant");
        let span = tracing::info_span!("render");
        span.pb_set_style(&style);
        span.pb_start();
        Self::Bar(span)
    }
}

impl Progress for RenderProgress {
    fn advance(&self, done: u64, total: u64) {
        match self {
            Self::Bar(span) => {
                span.pb_set_length(total);
                span.pb_set_position(done);
            }
            Self::Lines {
                start,
                first,
                shown_tenths,
                shown_at,
            } => {
                let tenths = done.saturating_mul(10) / total.max(1);
                let elapsed = start.elapsed().as_secs_f64();
                let now = milliseconds(elapsed);
                let is_late = now >= shown_at.load(Ordering::Relaxed) + LINE_MILLISECONDS;
                // Of several threads that reach a tenth at once, one prints it. The last
                // tenth is left to the summary.
                if is_late
                    && tenths < 10
                    && shown_tenths.fetch_max(tenths, Ordering::Relaxed) < tenths
                {
                    shown_at.store(now, Ordering::Relaxed);
                    let left = elapsed * (total - done) as f64 / (done - first).max(1) as f64;
                    tracing::info!(
                        "{} % in {elapsed:.1} s, about {left:.1} s left",
                        tenths * 10
                    );
                }
            }
        }
    }
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

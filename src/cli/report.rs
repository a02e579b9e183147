//! Messages for people, on stderr: log lines, warnings, errors with the scene file's line.

use std::error::Error;
use std::fmt::{self, Write as _};
use std::fs::OpenOptions;
use std::io::{IsTerminal as _, Write as _};
use std::path::Path;
use std::sync::Arc;

use majorant::scene::DescriptionError;
use miette::{Diagnostic, GraphicalReportHandler, GraphicalTheme, LabeledSpan, NamedSource};
use tracing::{Event, Level, Subscriber};
use tracing_indicatif::IndicatifLayer;
use tracing_subscriber::Layer;
use tracing_subscriber::filter::LevelFilter;
use tracing_subscriber::fmt::format::Writer;
use tracing_subscriber::fmt::{FmtContext, FormatEvent, FormatFields};
use tracing_subscriber::layer::SubscriberExt as _;
use tracing_subscriber::registry::LookupSpan;
use tracing_subscriber::util::SubscriberInitExt as _;

use super::Failure;
use super::args::{Args, LogFormatArg};

/// Starts logging to stderr: with a progress bar if that is a terminal.
///
/// With `--log-file` also to a file, which has what stderr has without `-q`, with times.
pub(super) fn start(args: &Args) -> Result<(), Failure> {
    let level = match (args.quiet, args.verbose) {
        (true, _) => LevelFilter::ERROR,
        (false, 0) => LevelFilter::INFO,
        (false, 1) => LevelFilter::DEBUG,
        (false, _) => LevelFilter::TRACE,
    };
    let file = match &args.log_file {
        None => None,
        Some(path) => Some(file_layer(
            path,
            args.log_format,
            level.max(LevelFilter::INFO),
        )?),
    };
    let registry = tracing_subscriber::registry().with(file);
    let lines = tracing_subscriber::fmt::layer()
        .event_format(PlainLine)
        .with_ansi(has_colour());
    if is_terminal() {
        let bars = IndicatifLayer::new();
        let lines = lines.with_writer(bars.get_stderr_writer());
        registry
            .with(lines.with_filter(level))
            .with(bars.with_filter(level))
            .init();
    } else {
        let lines = lines.with_writer(std::io::stderr);
        registry.with(lines.with_filter(level)).init();
    }
    Ok(())
}

/// Appends to a file, line by line, so that it can be watched and survives a kill.
fn file_layer<S>(
    path: &Path,
    format: LogFormatArg,
    level: LevelFilter,
) -> Result<Box<dyn Layer<S> + Send + Sync>, Failure>
where
    S: Subscriber + for<'a> LookupSpan<'a>,
{
    let file = OpenOptions::new().create(true).append(true).open(path);
    let file = file.map_err(|e| Failure::failed(format!("{}: {e}", path.display())))?;
    let layer = tracing_subscriber::fmt::layer()
        .with_ansi(false)
        .with_target(false)
        .with_writer(Arc::new(file));
    Ok(match format {
        LogFormatArg::Text => layer.with_filter(level).boxed(),
        LogFormatArg::Json => layer.json().with_filter(level).boxed(),
    })
}

/// Whether stderr is a terminal.
pub(super) fn is_terminal() -> bool {
    std::io::stderr().is_terminal()
}

/// Whether stderr may get colours: a terminal, and `NO_COLOR` not set to anything.
fn has_colour() -> bool {
    is_terminal() && std::env::var_os("NO_COLOR").is_none_or(|v| v.is_empty())
}

/// A log line without time or module: `warning: …`, or the message alone.
struct PlainLine;

impl<S, N> FormatEvent<S, N> for PlainLine
where
    S: Subscriber + for<'a> LookupSpan<'a>,
    N: for<'a> FormatFields<'a> + 'static,
{
    fn format_event(
        &self,
        ctx: &FmtContext<'_, S, N>,
        mut writer: Writer<'_>,
        event: &Event<'_>,
    ) -> fmt::Result {
        match (*event.metadata().level(), writer.has_ansi_escapes()) {
            (Level::WARN, true) => writer.write_str("\x1b[1;33mwarning:\x1b[0m ")?,
            (Level::WARN, false) => writer.write_str("warning: ")?,
            _ => {}
        }
        ctx.format_fields(writer.by_ref(), event)?;
        writeln!(writer)
    }
}

/// Prints why the program ends, or why a frame failed; scene errors with the line and an arrow.
pub(super) fn failure(failure: &Failure) {
    let text = match failure {
        Failure::Scene(e) => match e.place() {
            Some(place) => diagnostic(place, e),
            None => error_line(&chain(e)),
        },
        other => match reason(other) {
            Some(reason) => error_line(&reason),
            None => return,
        },
    };
    print_error(&text);
}

/// Returns why a frame failed, in one line; `None` if that has been said.
pub(super) fn reason(failure: &Failure) -> Option<String> {
    match failure {
        Failure::Usage(message) | Failure::BadInput(message) => Some(message.clone()),
        Failure::Scene(e) => Some(chain(e)),
        Failure::Vdb(e) => Some(chain(e)),
        Failure::Cache(e) => Some(chain(e)),
        Failure::Failed(e) => Some(chain(e.as_ref())),
        Failure::Reported | Failure::SomeFrames | Failure::Stopped | Failure::Interrupted => None,
    }
}

/// Prints an error's line, whatever `-q` says.
pub(super) fn error(message: &str) {
    print_error(&error_line(message));
}

/// Above the progress bar, if there is one.
fn print_error(text: &str) {
    tracing_indicatif::suspend_tracing_indicatif(|| {
        // Nothing can be done about a stderr that is closed.
        let _ = write!(std::io::stderr().lock(), "{text}");
    });
}

fn error_line(message: &str) -> String {
    if has_colour() {
        format!("\x1b[1;31merror:\x1b[0m {message}\n")
    } else {
        format!("error: {message}\n")
    }
}

/// Joins an error and its causes by colons.
pub(super) fn chain(error: &dyn Error) -> String {
    let mut text = error.to_string();
    let mut cause = error.source();
    while let Some(e) = cause {
        let next = e.to_string();
        // Some errors repeat their cause's words.
        if !text.contains(&next) {
            write!(text, ": {next}").expect("writing to a string cannot fail");
        }
        cause = e.source();
    }
    text
}

/// A place in a scene file, for miette.
#[derive(Debug)]
struct Shown<'a> {
    place: &'a DescriptionError,
    message: String,
    source: NamedSource<String>,
}

impl fmt::Display for Shown<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.message)
    }
}

impl Error for Shown<'_> {}

impl Diagnostic for Shown<'_> {
    fn help<'a>(&'a self) -> Option<Box<dyn fmt::Display + 'a>> {
        let help = self.place.help.as_ref()?;
        Some(Box::new(help))
    }

    fn source_code(&self) -> Option<&dyn miette::SourceCode> {
        Some(&self.source)
    }

    fn labels(&self) -> Option<Box<dyn Iterator<Item = LabeledSpan> + '_>> {
        let label = self
            .place
            .expected
            .as_ref()
            .map(|e| format!("expected {e}"));
        let span = self.place.span.clone();
        Some(Box::new(std::iter::once(LabeledSpan::new_with_span(
            label, span,
        ))))
    }
}

fn diagnostic(place: &DescriptionError, error: &(dyn Error + 'static)) -> String {
    // An error about a default or the whole file has no line to show.
    if place.span == (0..0) {
        let expected = place
            .expected
            .as_ref()
            .map_or(String::new(), |e| format!(", expected {e}"));
        let help = place
            .help
            .as_ref()
            .map_or(String::new(), |h| format!("; {h}"));
        return error_line(&format!(
            "{}: {}{expected}{help}",
            place.path.display(),
            place.message
        ));
    }
    let name = place.path.display().to_string();
    let shown = Shown {
        place,
        message: if error.source().is_some() {
            chain(error)
        } else {
            place.message.clone()
        },
        source: NamedSource::new(name, place.text.clone()),
    };
    let theme = if has_colour() {
        GraphicalTheme::unicode()
    } else {
        GraphicalTheme::unicode_nocolor()
    };
    let mut text = String::new();
    let handler = GraphicalReportHandler::new_themed(theme).with_width(100);
    match handler.render_report(&mut text, &shown) {
        Ok(()) => text,
        Err(fmt::Error) => error_line(&place.to_string()),
    }
}

/// Prints results to stdout; a reader that closed the pipe early is no error.
pub(super) fn print(text: &str) -> Result<(), Failure> {
    let mut stdout = std::io::stdout().lock();
    match stdout
        .write_all(text.as_bytes())
        .and_then(|()| stdout.flush())
    {
        Err(e) if e.kind() != std::io::ErrorKind::BrokenPipe => Err(Failure::failed(e)),
        _ => Ok(()),
    }
}

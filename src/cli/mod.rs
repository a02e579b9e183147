//! The command line: one file a subcommand, and the only place that prints.
//!
//! Results go to stdout (`info`, `probe`, `verify`, `--print-scene`), everything else to stderr.

mod args;
mod cache;
mod comfort;
mod compare;
mod converge;
mod farm;
mod info;
mod json;
mod memory;
mod merge;
mod parse;
mod probe;
mod processor;
mod profile;
mod progress;
mod render;
mod report;
mod stats;
mod trace;
mod verify;

use std::process::ExitCode;

use clap::Parser as _;
use majorant::cache::CacheError;

use args::{Args, Command};
pub(crate) use processor::refuse_older;

/// Why a command ended early.
#[derive(Debug)]
enum Failure {
    /// The arguments contradict each other.
    Usage(String),
    /// The scene cannot be rendered.
    Scene(majorant::scene::SceneError),
    /// A volume file cannot be read.
    Vdb(majorant::vdb::VdbError),
    /// A cache file cannot be read or written.
    Cache(CacheError),
    /// Another input cannot be read.
    BadInput(String),
    /// Some inputs could not be read, which has been said.
    Reported,
    /// Some frames of a sequence failed, which has been said.
    SomeFrames,
    /// The run was stopped before its end, and said how to go on.
    Stopped,
    /// The user interrupted the run, which has said what it kept.
    Interrupted,
    /// Something else went wrong, mostly while writing.
    Failed(Box<dyn std::error::Error + Send + Sync>),
}

impl Failure {
    fn failed(error: impl Into<Box<dyn std::error::Error + Send + Sync>>) -> Self {
        Self::Failed(error.into())
    }

    /// The exit codes of `args::EXIT_CODES`.
    fn exit_code(&self) -> u8 {
        match self {
            Self::Failed(_) | Self::Cache(CacheError::Write { .. }) => 1,
            Self::Usage(_) => 2,
            Self::SomeFrames => 4,
            // The code of sysexits.h for "try again".
            Self::Stopped => 75,
            // What shells say of a program that SIGINT ended.
            Self::Interrupted => 130,
            Self::Scene(_) | Self::Vdb(_) | Self::Cache(_) | Self::BadInput(_) | Self::Reported => {
                3
            }
        }
    }
}

impl From<majorant::scene::SceneError> for Failure {
    fn from(error: majorant::scene::SceneError) -> Self {
        Self::Scene(error)
    }
}

impl From<majorant::vdb::VdbError> for Failure {
    fn from(error: majorant::vdb::VdbError) -> Self {
        Self::Vdb(error)
    }
}

impl From<CacheError> for Failure {
    fn from(error: CacheError) -> Self {
        Self::Cache(error)
    }
}

/// Runs the program.
pub(crate) fn run() -> ExitCode {
    let args = Args::parse();
    if let Err(failure) = report::start(&args) {
        report::failure(&failure);
        return ExitCode::from(failure.exit_code());
    }
    let result = match &args.command {
        Command::Render(a) => render::run(a),
        Command::Converge(a) => converge::run(a),
        Command::Merge(a) => merge::run(a),
        Command::Farm(a) => farm::run(a),
        Command::Compare(a) => compare::run(a),
        Command::Completions(a) => comfort::completions(a),
        Command::Schema => comfort::schema(),
        Command::Man(a) => comfort::man(a),
        Command::Cache(a) => cache::run(a),
        Command::Info(a) => info::run(a),
        Command::Probe(a) => probe::run(a),
        Command::Profile(a) => profile::run(a),
        Command::Verify(a) => verify::run(a),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            report::failure(&failure);
            ExitCode::from(failure.exit_code())
        }
    }
}

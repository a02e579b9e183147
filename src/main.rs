//! The `majorant` program: arguments in, exit code out.

mod cli;

use std::process::ExitCode;

fn main() -> ExitCode {
    cli::refuse_older().unwrap_or_else(cli::run)
}

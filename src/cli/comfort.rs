//! `majorant completions`, `man` and `schema`: what shells, manuals and editors know of the program.

use std::path::Path;

use clap::CommandFactory as _;
use majorant::output;

use super::args::{Args, CompletionsArgs, ManArgs};
use super::{Failure, report};

/// Prints a completion script.
pub(super) fn completions(args: &CompletionsArgs) -> Result<(), Failure> {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut Args::command(), "majorant", &mut script);
    report::print(&String::from_utf8_lossy(&script))
}

/// Prints the manual page, or writes one for each command into a folder.
pub(super) fn man(args: &ManArgs) -> Result<(), Failure> {
    let mut command = Args::command();
    command.build();
    let Some(folder) = &args.dir else {
        return report::print(&String::from_utf8_lossy(&page(command)?));
    };
    for sub in command.get_subcommands().filter(|c| c.get_name() != "help") {
        let name = format!("majorant-{}", sub.get_name());
        // The page is named as the command is typed but for the hyphen.
        let sub = sub.clone().display_name(&name);
        write(folder, &name, &page(sub)?)?;
    }
    let whole = page(command)?;
    write(folder, "majorant", &whole)
}

/// Prints the JSON Schema of scene files.
pub(super) fn schema() -> Result<(), Failure> {
    let schema = majorant::scene::schema();
    let text = serde_json::to_string_pretty(&schema).map_err(Failure::failed)?;
    report::print(&format!("{text}\n"))
}

fn page(command: clap::Command) -> Result<Vec<u8>, Failure> {
    let mut page = Vec::new();
    let man = clap_mangen::Man::new(command);
    man.render(&mut page).map_err(Failure::failed)?;
    Ok(page)
}

fn write(folder: &Path, name: &str, page: &[u8]) -> Result<(), Failure> {
    let path = folder.join(format!("{name}.1"));
    output::write_bytes(&path, page).map_err(Failure::failed)?;
    report::print(&format!("{}\n", path.display()))
}

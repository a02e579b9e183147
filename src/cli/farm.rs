//! `majorant farm`: the files that hand a render to a farm.

use std::path::{Path, PathBuf};
use std::process::Command;

use majorant::farm::{FarmFile, FarmJob};
use majorant::output;

use super::args::{FarmArgs, FarmEngine};
use super::{Failure, report};

pub(super) fn run(args: &FarmArgs) -> Result<(), Failure> {
    let options = match &args.engine {
        FarmEngine::Openjd(options) | FarmEngine::Slurm { options, .. } => options,
    };
    if !options.scene.exists() {
        let scene = options.scene.display();
        return Err(Failure::BadInput(format!("{scene}: no such file")));
    }
    let stem = options.scene.file_stem().unwrap_or_default();
    let mut arguments = options.arguments.clone();
    if let Some(spp) = options.spp {
        arguments.splice(0..0, ["--spp".to_owned(), spp.to_string()]);
    }
    let job = FarmJob {
        name: stem.to_string_lossy().into_owned(),
        program: options.program.clone(),
        scene: absolute(&options.scene)?,
        output: absolute(&options.output)?,
        frames: options.frames.clone(),
        chunk: options.chunk as usize,
        shards: options.shards,
        arguments,
        cpus: options.cpus,
        memory: options.memory.clone(),
        time: options.time.clone(),
    };
    let usage = |e: majorant::farm::FarmError| Failure::Usage(e.to_string());
    match &args.engine {
        FarmEngine::Openjd(_) => write(&options.dir, &job.openjd().map_err(usage)?),
        FarmEngine::Slurm { submit, .. } => {
            write(&options.dir, &job.slurm().map_err(usage)?)?;
            if *submit {
                run_script(&options.dir.join("submit.sh"))?;
            }
            Ok(())
        }
    }
}

fn absolute(path: &Path) -> Result<PathBuf, Failure> {
    let shown = path.display();
    std::path::absolute(path).map_err(|e| Failure::failed(format!("{shown}: {e}")))
}

fn write(folder: &Path, files: &[FarmFile]) -> Result<(), Failure> {
    for file in files {
        let path = folder.join(file.name);
        output::write_text(&path, &file.text).map_err(Failure::failed)?;
        if file.is_script {
            make_runnable(&path)?;
        }
        report::print(&format!("{}\n", path.display()))?;
    }
    Ok(())
}

#[cfg(unix)]
fn make_runnable(path: &Path) -> Result<(), Failure> {
    use std::os::unix::fs::PermissionsExt as _;
    let mut permissions = std::fs::metadata(path)
        .map_err(Failure::failed)?
        .permissions();
    // For whoever may read it.
    let mode = permissions.mode();
    permissions.set_mode(mode | (mode & 0o444) >> 2);
    std::fs::set_permissions(path, permissions).map_err(Failure::failed)
}

#[cfg(not(unix))]
fn make_runnable(_path: &Path) -> Result<(), Failure> {
    Ok(())
}

/// Runs what was written, which prints the numbers of its jobs.
fn run_script(path: &Path) -> Result<(), Failure> {
    let path = absolute(path)?;
    let shown = path.display();
    let status = Command::new(&path).status();
    let status = status.map_err(|e| Failure::failed(format!("{shown}: {e}")))?;
    if status.success() {
        Ok(())
    } else {
        Err(Failure::failed(format!("{shown}: ended with {status}")))
    }
}

//! Opens .vdb files and loads every grid both ways, exactly and as density.
//!
//! Exit code 0: all could be loaded or are refused by name; 3: an error, printed. The mutation
//! test runs it in a process of its own for each damaged file. `--limit MIB` sets the memory
//! limit; `--time` prints seconds and peak memory.

#![expect(
    clippy::print_stdout,
    clippy::print_stderr,
    reason = "a command-line tool"
)]

use std::path::Path;
use std::process::ExitCode;
use std::time::Instant;

use majorant::vdb::{Archive, Components, Grid, LoadOptions, Statistics, TypedGrid, VdbError};

fn main() -> ExitCode {
    let mut options = LoadOptions::default();
    let mut timed = false;
    let mut code = ExitCode::SUCCESS;
    let mut args = std::env::args().skip(1);
    while let Some(arg) = args.next() {
        match arg.as_str() {
            "--limit" => {
                let mib = args.next().and_then(|a| a.parse::<u64>().ok());
                options.max_memory_bytes = mib.unwrap_or(1024) << 20;
            }
            "--time" => timed = true,
            path => {
                if let Err(e) = load_all(Path::new(path), &options, timed) {
                    eprintln!("{e}");
                    code = ExitCode::from(3);
                }
            }
        }
    }
    code
}

fn load_all(path: &Path, options: &LoadOptions, timed: bool) -> Result<(), VdbError> {
    let start = Instant::now();
    let archive = Archive::open(path)?;
    if timed {
        println!(
            "{}: walk {:.3} s",
            path.display(),
            start.elapsed().as_secs_f64()
        );
    }
    for (i, info) in archive.grids().iter().enumerate() {
        if let Some(reason) = &info.refused {
            println!("{} {}: refused: {reason}", info.address, info.type_name);
            continue;
        }
        let start = Instant::now();
        if info.background.len() == 1 {
            let density = archive.load_density(
                i,
                &LoadOptions {
                    sanitize: true,
                    ..*options
                },
            )?;
            if timed {
                println!(
                    "  {}: density {:.3} s wall, tree {} MiB, estimate {} MiB, peak {} MiB, cpu {:.3} s",
                    info.address,
                    start.elapsed().as_secs_f64(),
                    density.tree.memory_bytes() >> 20,
                    info.estimated_memory_bytes >> 20,
                    peak_memory_mib(),
                    cpu_seconds(),
                );
                continue;
            }
        }
        let (memory, stats) = describe(&archive.load(i, options)?);
        println!(
            "{} {}: {:?} active, {memory} bytes, sum {:?}",
            info.address, info.type_name, info.active_voxel_count, stats.sum
        );
    }
    Ok(())
}

fn describe(grid: &Grid) -> (usize, Statistics) {
    fn of<V: Components>(g: &TypedGrid<V>) -> (usize, Statistics) {
        (g.tree.memory_bytes(), g.statistics())
    }
    match grid {
        Grid::F32(g) => of(g),
        Grid::F64(g) => of(g),
        Grid::I32(g) => of(g),
        Grid::I64(g) => of(g),
        Grid::Vec3F(g) => of(g),
        Grid::Vec3D(g) => of(g),
        Grid::Vec3I(g) => of(g),
        _ => unreachable!("all value types are listed"),
    }
}

fn peak_memory_mib() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|l| l.strip_prefix("VmHWM:"));
    let kib = line.and_then(|l| l.trim().trim_end_matches(" kB").parse::<u64>().ok());
    kib.unwrap_or(0) >> 10
}

fn cpu_seconds() -> f64 {
    cpu_time::ProcessTime::now().as_duration().as_secs_f64()
}

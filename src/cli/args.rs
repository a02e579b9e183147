//! What the command line accepts.

use std::ops::Range;
use std::path::PathBuf;

use clap::builder::{PossibleValuesParser, TypedValueParser};
use clap::{ArgAction, Parser, Subcommand, ValueEnum};
use glam::{DVec3, IVec3};
use majorant::aov::Aov;
use majorant::film::Region;
use majorant::grid::StorageKind;
use majorant::integrator::{CameraRay, IntegratorKind};
use majorant::sampling::SamplerKind;
use majorant::scene::default_look::UpAxis;
use majorant::sequence::FrameRange;
use majorant::tracking::{BoundsKind, DistanceEstimator, TransmittanceEstimator};

use super::parse::{
    parse_crop, parse_duration, parse_index, parse_point, parse_positive, parse_resolution,
    parse_samples, parse_setting, parse_shard, parse_viewer,
};

const EXIT_CODES: &str = "\
Exit codes: 0 done; 1 failed, such as an output that cannot be written; 2 wrong usage;
3 bad input: a scene or volume that is missing, damaged or says what cannot be;
4 some frames of a sequence failed; 75 stopped early, run again to go on.";

const RENDER_EXAMPLES: &str = "\
Examples:
  majorant render cloud.vdb --preview-png
  majorant render cloud.vdb --print-scene > cloud.toml
  majorant render cloud.toml -r 1920x1080 --spp 256 -o out/cloud.exr
  majorant render fire.toml -f 1001-1100x2 -o out/fire.####.exr --skip-existing --resume

In names #### is the frame in four digits, and so are %04d, $F4, @@@@ and <F4>; # alone is too.

Exit codes: 0 done, 1 failed, 2 wrong usage, 3 bad input, 4 some frames failed, 75 stopped early:
a checkpoint is written, and --resume goes on.";

const CONVERGE_EXAMPLES: &str = "\
Estimators are names joined by + in any order; what is not named is auto:
  free flight  delta, decomposition, regular, closed-form
  shadow rays  ratio, residual-ratio, exact, power-series, approx-ray-marching; transmittance=delta
  bounds       brick, global, hierarchy
  also         rate=X, flight-rate=X, step=X, analog; emission-by-chance: fire is no light to
               draw points from; all: the most useful dozen

Examples:
  majorant converge cloud.toml --estimators delta+ratio,regular+exact,auto --budget 30s
  majorant converge cloud.toml -r 240x135 --seeds 10 --budget 2m -o cloud-study
  majorant converge cloud.toml -r 240x135 --seeds 10 --budget 2m -o cloud-study --resume

Exit codes: 0 done, 1 failed, 2 wrong usage, 3 bad input, 130 interrupted: results so far are
written, and --resume goes on.";

const MERGE_EXAMPLES: &str = "\
Examples:
  majorant render fire.toml --samples 0..256 -o fire.s0.exr
  majorant render fire.toml --samples 256..512 -o fire.s1.exr
  majorant merge fire.s0.exr fire.s1.exr -o fire.exr
  majorant merge out/fire.####.s0.exr out/fire.####.s1.exr -f 1001-1100 -o out/fire.####.exr

Parts of other scenes, versions or sizes are refused, and samples that two parts have.

Exit codes: 0 done, 1 failed, 2 wrong usage, 3 bad input, 4 some frames failed.";

const FARM_EXAMPLES: &str = "\
Examples:
  majorant farm slurm fire.toml -f 1001-1100 --chunk 5 --shards 4 -o out/b.####.exr --dir job
  majorant farm openjd fire.toml -f 1001-1100x2 -o out/b.####.exr --dir job -- --missing hold

Tasks leave alone what is complete and go on with what is not: submit again to resume.

Exit codes: 0 done, 1 failed, 2 wrong usage, 3 bad input.";

const COMPARE_EXAMPLES: &str = "\
Examples:
  majorant compare cloud.exr reference.exr
  majorant compare cloud.exr reference.exr -d difference.png --json

Exit codes: 0 done, however large the difference; 2 wrong usage, 3 bad input.";

const COMPLETIONS_EXAMPLES: &str = "\
Example:
  majorant completions bash > ~/.local/share/bash-completion/completions/majorant";

const SCHEMA_EXAMPLES: &str = "\
Example:
  majorant schema > majorant-scene.schema.json
and above a scene, for editors that check TOML by Taplo:
  #:schema ./majorant-scene.schema.json";

const CACHE_EXAMPLES: &str = "\
Examples:
  majorant cache cloud.vdb
  majorant cache cloud.vdb --grid density --encoding u16 -o /scratch/cloud.mjc
  majorant cache cloud.mjc --check

A cache file stands wherever a .vdb may: it opens at once, and bricks are read from disk when rays
meet them, so that a volume larger than memory renders.

Exit codes: 0 done, 1 failed, 2 wrong usage, 3 bad input.";

const INFO_EXAMPLES: &str = "\
Examples:
  majorant info cloud.vdb
  majorant info --quick --json frames/*.vdb

Exit codes: 0 done, 2 wrong usage, 3 a file could not be read; the others are still listed.";

const PROBE_EXAMPLES: &str = "\
Examples:
  majorant probe cloud.vdb --grid density --at 10,-4,7 --at 0,0,0
  majorant probe cloud.vdb --grid density --world 0.1,0.2,0.3 --json

Exit codes: 0 done, 2 wrong usage, 3 bad input.";

const PROFILE_EXAMPLES: &str = "\
Examples:
  majorant profile cloud.toml
  majorant profile cloud.toml -r 480x270 --spp 16 -o profile.html

Exit codes: 0 done, 1 failed, 2 wrong usage, 3 bad input.";

const VERIFY_EXAMPLES: &str = "\
Examples:
  majorant verify
  majorant verify --stiff
  majorant verify --filter reciprocity --json

Each row has what is expected, what was measured, its standard error (or, for what is exact, how
far it may differ), z in standard errors, the smallest relative bias that would have been seen,
and the steps of the longest path. A row passes below 5 standard errors.

Exit codes: 0 all rows pass, 1 a row fails, 2 wrong usage.";

/// Unbiased rendering of OpenVDB clouds, smoke and fire.
#[derive(Debug, Parser)]
#[command(version, max_term_width = 100, after_help = EXIT_CODES, disable_help_flag = true)]
pub(super) struct Args {
    #[command(subcommand)]
    pub(super) command: Command,
    /// Print errors only
    #[arg(short, long, global = true)]
    pub(super) quiet: bool,
    /// Also write messages to a file, with times
    #[arg(hide_short_help = true, long, global = true, value_name = "FILE")]
    pub(super) log_file: Option<PathBuf>,
    /// Form of the messages in the file
    #[arg(
        hide_short_help = true,
        long,
        global = true,
        value_enum,
        default_value = "text",
        requires = "log_file"
    )]
    pub(super) log_format: LogFormatArg,
    /// Print the plan and where time goes; twice: more
    #[arg(short, long, global = true, action = ArgAction::Count)]
    pub(super) verbose: u8,
    /// Print help; --help: with all options
    // The short help leaves out what few ask for, so that it fits on a screen.
    #[arg(short, long, global = true, action = ArgAction::Help)]
    help: Option<bool>,
}

#[derive(Debug, Subcommand)]
pub(super) enum Command {
    /// Render a scene file, or a bare .vdb with a default look, to OpenEXR
    #[command(after_help = RENDER_EXAMPLES)]
    Render(Box<RenderArgs>),
    /// Put parts of frames together, from render --samples A..B
    #[command(after_help = MERGE_EXAMPLES)]
    Merge(MergeArgs),
    /// Write what a farm needs to render a sequence: Open Job Description or Slurm
    #[command(after_help = FARM_EXAMPLES)]
    Farm(FarmArgs),
    /// Measure how far an image is from another
    #[command(after_help = COMPARE_EXAMPLES)]
    Compare(CompareArgs),
    /// Print a completion script for a shell
    #[command(after_help = COMPLETIONS_EXAMPLES)]
    Completions(CompletionsArgs),
    /// Print the manual page, or write one for each command
    Man(ManArgs),
    /// Print the JSON Schema of scene files, for editors
    #[command(after_help = SCHEMA_EXAMPLES)]
    Schema,
    /// Compare estimators by error against run time
    #[command(after_help = CONVERGE_EXAMPLES)]
    Converge(Box<ConvergeArgs>),
    /// Write a grid as a cache file: ready to render, larger than memory if need be
    #[command(after_help = CACHE_EXAMPLES)]
    Cache(CacheArgs),
    /// List the grids of volume files
    #[command(after_help = INFO_EXAMPLES)]
    Info(InfoArgs),
    /// Read single values of a grid
    #[command(after_help = PROBE_EXAMPLES)]
    Probe(ProbeArgs),
    /// Measure where the time of a scene goes, and the memory that rays touch
    #[command(after_help = PROFILE_EXAMPLES)]
    Profile(ProfileArgs),
    /// Check this build against physics: closed forms, tables, symmetries
    #[command(after_help = VERIFY_EXAMPLES)]
    Verify(VerifyArgs),
}

#[derive(Debug, clap::Args)]
#[expect(clippy::struct_excessive_bools, reason = "each is a flag of its own")]
pub(super) struct RenderArgs {
    /// Scene file, or .vdb volume; smoke_####.vdb for a sequence
    pub(super) input: PathBuf,
    /// Image to write, out.####.exr for a sequence [default: the input's name with .exr]
    #[arg(short, long, value_name = "OUT.exr")]
    pub(super) output: Option<PathBuf>,
    /// Columns and rows of the image
    #[arg(short, long, value_name = "WxH", value_parser = parse_resolution)]
    pub(super) resolution: Option<[u32; 2]>,
    /// Only these pixels: from the first corner to before the second
    #[arg(long, value_name = "X0,Y0,X1,Y1", value_parser = parse_crop)]
    pub(super) crop: Option<Region>,
    /// Samples a pixel
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub(super) spp: Option<u32>,
    /// Only these samples, as a part to merge: 256..512
    #[arg(hide_short_help = true, long, value_name = "A..B", conflicts_with = "spp", value_parser = parse_samples)]
    pub(super) samples: Option<Range<u32>>,
    /// Only the I-th (from 0) of N equal parts of the samples, to merge
    #[arg(hide_short_help = true, long, value_name = "I/N", conflicts_with_all = ["samples", "noise_limit"], value_parser = parse_shard)]
    pub(super) shard: Option<[u32; 2]>,
    /// Stop at this relative error of the image, such as 0.02
    #[arg(long, value_name = "X", conflicts_with = "samples", value_parser = parse_positive)]
    pub(super) noise_limit: Option<f64>,
    /// Set any key of the scene; may be repeated
    #[arg(long, value_name = "PATH.KEY=VALUE", value_parser = parse_setting)]
    pub(super) set: Vec<(String, String)>,
    /// Seed of the noise, 0 to 2^64 - 1
    #[arg(long, value_name = "N")]
    pub(super) seed: Option<u64>,
    #[arg(
        short = 'j',
        long,
        value_name = "N",
        help = "Threads; 0: all [default: SLURM_CPUS_PER_TASK, else all]"
    )]
    pub(super) threads: Option<usize>,
    /// path samples the lights; analog is the short reference
    #[arg(hide_short_help = true, long, value_enum)]
    pub(super) integrator: Option<IntegratorArg>,
    /// Print which estimators, kernels and grids are used and left out, and why
    #[arg(long)]
    pub(super) explain: bool,
    /// Density grid to render, by name
    #[arg(long, value_name = "NAME")]
    pub(super) grid: Option<String>,
    /// Values in memory
    #[arg(hide_short_help = true, long, value_name = "NAME", value_parser = parse_named(StorageKind::ALL, StorageKind::name))]
    pub(super) encoding: Option<StorageKind>,
    /// More channels in the EXR: a name, or several with commas
    #[arg(long, value_name = "NAME", value_delimiter = ',', value_parser = parse_named(Aov::ALL, Aov::name))]
    pub(super) aov: Vec<Aov>,
    /// Axis that points up, for a bare .vdb [default: by the program that wrote it]
    #[arg(hide_short_help = true, long, value_enum)]
    pub(super) up: Option<UpArg>,
    /// Print frames, files, memory and plan, and do not render
    #[arg(long)]
    pub(super) dry_run: bool,
    /// Print the scene as a scene file, and do not render
    #[arg(long)]
    pub(super) print_scene: bool,
    /// Also write an 8 bit sRGB picture [default FILE: the output's name with .png]
    #[arg(long, value_name = "FILE", num_args = 0..=1, require_equals = true)]
    #[expect(
        clippy::option_option,
        reason = "absent, without and with a value are three things"
    )]
    pub(super) preview_png: Option<Option<PathBuf>>,
    /// Rewrite that picture while the image converges: every 5s
    #[arg(hide_short_help = true, long, value_name = "TIME", requires = "preview_png", value_parser = parse_duration)]
    pub(super) preview_every: Option<f64>,
    /// Show the image in the viewer tev as it converges [default: at 127.0.0.1:14158]
    #[arg(hide_short_help = true, long, value_name = "tev[=HOST[:PORT]]", value_parser = parse_viewer)]
    pub(super) preview: Option<String>,
    /// How to say how far it is [default: bar on a terminal, else lines]
    #[arg(long, value_enum)]
    pub(super) progress: Option<ProgressArg>,
    /// Write times, counts and memory as JSON
    #[arg(long, value_name = "FILE")]
    pub(super) stats_json: Option<PathBuf>,
    /// Write what ran when, as JSON for Chrome's tracing or Perfetto
    #[arg(hide_short_help = true, long, value_name = "FILE")]
    pub(super) trace: Option<PathBuf>,
    /// Refuse what needs more memory, such as 8G or 512M [default: 80 % of the machine's]
    #[arg(hide_short_help = true, long, value_name = "SIZE", value_parser = super::memory::parse_size)]
    pub(super) max_memory: Option<u64>,
    /// Read NaN and infinite voxels as 0 instead of refusing the grid
    #[arg(hide_short_help = true, long)]
    pub(super) sanitize: bool,
    #[command(flatten)]
    pub(super) batch: BatchArgs,
    #[command(flatten)]
    pub(super) tracking: TrackingArgs,
}

/// Which frames, and what happens when something stops them.
#[derive(Debug, clap::Args)]
#[command(next_help_heading = "Frames and interruptions")]
pub(super) struct BatchArgs {
    /// Frames: 1001-1100, 1-100x2 (every 2nd), 1,5,9-20
    #[arg(short, long, value_name = "RANGE", allow_hyphen_values = true)]
    pub(super) frames: Option<FrameRange>,
    /// Frames as Open Job Description's workers get them
    #[arg(long, hide = true, value_name = "RANGE", allow_hyphen_values = true,
        conflicts_with = "frames", value_parser = FrameRange::parse_openjd)]
    pub(super) frames_openjd: Option<FrameRange>,
    /// Where a volume file of a frame is missing: fail, leave out, or take the one before
    #[arg(hide_short_help = true, long, value_enum, default_value = "error")]
    pub(super) missing: MissingArg,
    /// Leave out frames that are there, complete and of this scene, samples and version
    #[arg(long)]
    pub(super) skip_existing: bool,
    /// Keep a frame in progress on disk: every 60s, 5m
    #[arg(long, value_name = "TIME", value_parser = parse_duration)]
    pub(super) checkpoint: Option<f64>,
    /// Go on with frames in progress, to the same bits
    #[arg(long)]
    pub(super) resume: bool,
    /// Stop after this time, with a checkpoint and exit code 75
    #[arg(long, value_name = "TIME", value_parser = parse_duration)]
    pub(super) time_limit: Option<f64>,
}

impl BatchArgs {
    /// Returns the frames asked for; `None`: the one that the scene file says.
    pub(super) fn frames(&self) -> Option<&FrameRange> {
        self.frames.as_ref().or(self.frames_openjd.as_ref())
    }
}

/// Who reads how far a render is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(super) enum ProgressArg {
    Bar,
    Lines,
    Alf,
    Openjd,
    Json,
}

/// How messages are written to a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(super) enum LogFormatArg {
    Text,
    Json,
}

/// What becomes of a frame whose volume file is missing.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(super) enum MissingArg {
    Error,
    Skip,
    Hold,
}

/// Which estimators track rays, and which numbers they use.
#[derive(Debug, clap::Args)]
#[command(next_help_heading = "Estimators")]
pub(super) struct TrackingArgs {
    /// Collisions of camera rays
    #[arg(hide_short_help = true, long, value_name = "NAME", value_parser = parse_named(CameraRay::ALL, CameraRay::name))]
    pub(super) camera_ray: Option<CameraRay>,
    /// First numbers of a path
    #[arg(hide_short_help = true, long, value_name = "NAME", value_parser = parse_named(SamplerKind::ALL, SamplerKind::name))]
    pub(super) sampler: Option<SamplerKind>,
    /// Free flight
    #[arg(hide_short_help = true, long, value_name = "NAME", value_parser = parse_named(DistanceEstimator::ALL, DistanceEstimator::name))]
    pub(super) distance: Option<DistanceEstimator>,
    /// Shadow rays
    #[arg(hide_short_help = true, long, value_name = "NAME", value_parser = parse_named(TransmittanceEstimator::ALL, TransmittanceEstimator::name))]
    pub(super) transmittance: Option<TransmittanceEstimator>,
    /// Bounds of both
    #[arg(hide_short_help = true, long, value_name = "NAME", value_parser = parse_named(BoundsKind::ALL, BoundsKind::name))]
    pub(super) bounds: Option<BoundsKind>,
    /// Collisions of shadow rays for each unit of the bound, from 1
    #[arg(hide_short_help = true, long, value_name = "X")]
    pub(super) collision_rate: Option<f64>,
    /// The same of free flight
    #[arg(hide_short_help = true, long, value_name = "X")]
    pub(super) flight_rate: Option<f64>,
    /// Step of approx-ray-marching in voxels
    #[arg(hide_short_help = true, long, value_name = "X")]
    pub(super) march_step: Option<f64>,
}

/// Parses one of `all` by its name.
fn parse_named<T>(
    all: &'static [T],
    name: fn(T) -> &'static str,
) -> impl TypedValueParser<Value = T>
where
    T: Copy + Send + Sync + 'static,
{
    let names = all.iter().map(|&v| name(v));
    PossibleValuesParser::new(names).try_map(move |text| {
        let found = all.iter().find(|&&v| name(v) == text);
        found.copied().ok_or("not one of the possible values")
    })
}

#[derive(Debug, clap::Args)]
pub(super) struct ConvergeArgs {
    /// Scene file
    pub(super) scene: PathBuf,
    /// Estimators with commas between them; below
    #[arg(short, long, value_name = "LIST", default_value = "all")]
    pub(super) estimators: String,
    /// CPU time for each estimator: 90s, 2m or 1h
    #[arg(long, value_name = "TIME", default_value = "60s", value_parser = parse_duration)]
    pub(super) budget: f64,
    /// Image to compare with; auto renders one by an estimator that is not under test
    #[arg(long, value_name = "R.exr|auto", default_value = "auto")]
    pub(super) reference: PathBuf,
    /// CPU time for the automatic reference [default: twice the budget]
    #[arg(long, value_name = "TIME", value_parser = parse_duration)]
    pub(super) reference_budget: Option<f64>,
    /// Folder to write [default: the scene's name with -converge, in the current folder]
    #[arg(short, long, value_name = "DIR")]
    pub(super) output: Option<PathBuf>,
    /// Independent renders for each point of a curve; 10 for good intervals
    #[arg(long, value_name = "N", default_value = "4", value_parser = clap::value_parser!(u32).range(1..=1000))]
    pub(super) seeds: u32,
    /// Most samples a pixel of one render
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub(super) max_spp: Option<u32>,
    /// relMSE that times are given for
    #[arg(long, value_name = "RELMSE", default_value = "0.01", value_parser = parse_positive)]
    pub(super) target: f64,
    /// Go on with an interrupted run in the same folder
    #[arg(long)]
    pub(super) resume: bool,
    /// Columns and rows of the image
    #[arg(short, long, value_name = "WxH", value_parser = parse_resolution)]
    pub(super) resolution: Option<[u32; 2]>,
    #[arg(
        short = 'j',
        long,
        value_name = "N",
        help = "Threads; 0: all [default: SLURM_CPUS_PER_TASK, else all]"
    )]
    pub(super) threads: Option<usize>,
    /// Refuse what needs more memory, such as 8G or 512M [default: 80 % of the machine's]
    #[arg(long, value_name = "SIZE", value_parser = super::memory::parse_size)]
    pub(super) max_memory: Option<u64>,
}

#[derive(Debug, clap::Args)]
pub(super) struct MergeArgs {
    /// Parts of one frame; with -f, names with #### for its number
    #[arg(required = true, value_name = "PART.exr")]
    pub(super) parts: Vec<PathBuf>,
    /// Image to write
    #[arg(short, long, value_name = "OUT.exr")]
    pub(super) output: PathBuf,
    /// Frames: 1001-1100, 1-100x2 (every 2nd), 1,5,9-20
    #[arg(short, long, value_name = "RANGE", allow_hyphen_values = true)]
    pub(super) frames: Option<FrameRange>,
    /// Frames as Open Job Description's workers get them
    #[arg(long, hide = true, value_name = "RANGE", allow_hyphen_values = true,
        conflicts_with = "frames", value_parser = FrameRange::parse_openjd)]
    pub(super) frames_openjd: Option<FrameRange>,
}

#[derive(Debug, clap::Args)]
pub(super) struct FarmArgs {
    #[command(subcommand)]
    pub(super) engine: FarmEngine,
}

#[derive(Debug, Subcommand)]
pub(super) enum FarmEngine {
    /// A template of Open Job Description, and a job bundle for Deadline Cloud
    Openjd(FarmOptions),
    /// Batch scripts for Slurm
    Slurm {
        #[command(flatten)]
        options: FarmOptions,
        /// Also submit them
        #[arg(long)]
        submit: bool,
    },
}

#[derive(Debug, clap::Args)]
pub(super) struct FarmOptions {
    /// Scene file, or .vdb volumes
    pub(super) scene: PathBuf,
    /// Frames: 1001-1100, 1-100x2 (every 2nd), 1,5,9-20
    #[arg(short, long, value_name = "RANGE", allow_hyphen_values = true)]
    pub(super) frames: FrameRange,
    /// Images, with #### for the frame's number
    #[arg(short, long, value_name = "OUT.exr")]
    pub(super) output: PathBuf,
    /// Folder for the files of the job
    #[arg(long, alias = "bundle", alias = "script-dir", value_name = "DIR")]
    pub(super) dir: PathBuf,
    /// Frames of a task
    #[arg(long, value_name = "N", default_value = "5", value_parser = clap::value_parser!(u32).range(1..))]
    pub(super) chunk: u32,
    /// Parts of each frame's samples, rendered apart and merged
    #[arg(long, value_name = "N", default_value = "1", value_parser = clap::value_parser!(u32).range(1..=1000))]
    pub(super) shards: u32,
    /// Samples a pixel
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub(super) spp: Option<u32>,
    /// Processors of a task
    #[arg(long, value_name = "N", default_value = "1", value_parser = clap::value_parser!(u32).range(1..))]
    pub(super) cpus: u32,
    /// Memory of a task, for Slurm, such as 8G
    #[arg(long, value_name = "SIZE")]
    pub(super) memory: Option<String>,
    /// Longest time of a task, for Slurm, such as 1:00:00
    #[arg(long, value_name = "TIME")]
    pub(super) time: Option<String>,
    /// The program, as tasks find it
    #[arg(long, value_name = "PATH", default_value = "majorant")]
    pub(super) program: String,
    /// More options of render, after --
    #[arg(last = true, value_name = "OPTION")]
    pub(super) arguments: Vec<String>,
}

#[derive(Debug, clap::Args)]
pub(super) struct CompareArgs {
    /// Image
    pub(super) image: PathBuf,
    /// Image that it should be
    pub(super) reference: PathBuf,
    /// Write a picture of the difference: blue is darker than it should be, red brighter
    #[arg(short, long, value_name = "OUT.png")]
    pub(super) difference: Option<PathBuf>,
    /// Print JSON
    #[arg(long)]
    pub(super) json: bool,
}

#[derive(Debug, clap::Args)]
pub(super) struct CompletionsArgs {
    /// Shell
    pub(super) shell: clap_complete::Shell,
}

#[derive(Debug, clap::Args)]
pub(super) struct ManArgs {
    /// Folder for majorant.1, majorant-render.1 and so on
    #[arg(long, value_name = "DIR")]
    pub(super) dir: Option<PathBuf>,
}

#[derive(Debug, clap::Args)]
pub(super) struct CacheArgs {
    /// Volume file; with --check, cache file
    pub(super) input: PathBuf,
    /// Cache file to write [default: the input's name with .mjc, in the current folder]
    #[arg(short, long, value_name = "OUT.mjc")]
    pub(super) output: Option<PathBuf>,
    /// Grid, by name [default: the one that render takes]
    #[arg(long, value_name = "NAME")]
    pub(super) grid: Option<String>,
    /// Values in the file: lossless, f32, f16, u16 or u8
    #[arg(long, value_name = "NAME", default_value = "lossless", value_parser = parse_named(StorageKind::ALL, StorageKind::name))]
    pub(super) encoding: StorageKind,
    /// Hold the cache file against its checksums, and write nothing
    #[arg(long, conflicts_with_all = ["output", "grid", "encoding", "sanitize"])]
    pub(super) check: bool,
    /// Read NaN and infinite voxels as 0 instead of refusing the grid
    #[arg(long)]
    pub(super) sanitize: bool,
    #[arg(
        short = 'j',
        long,
        value_name = "N",
        help = "Threads; 0: all [default: SLURM_CPUS_PER_TASK, else all]"
    )]
    pub(super) threads: Option<usize>,
    /// Refuse what needs more memory, such as 8G or 512M [default: 80 % of the machine's]
    #[arg(long, value_name = "SIZE", value_parser = super::memory::parse_size)]
    pub(super) max_memory: Option<u64>,
}

#[derive(Debug, clap::Args)]
pub(super) struct InfoArgs {
    /// Volume files
    #[arg(required = true, value_name = "FILE")]
    pub(super) files: Vec<PathBuf>,
    /// Print JSON
    #[arg(long)]
    pub(super) json: bool,
    /// Do not decode voxels: minimum, maximum and sum stay unknown
    #[arg(long)]
    pub(super) quick: bool,
    /// Refuse what needs more memory, such as 8G or 512M [default: 80 % of the machine's]
    #[arg(long, value_name = "SIZE", value_parser = super::memory::parse_size)]
    pub(super) max_memory: Option<u64>,
}

#[derive(Debug, clap::Args)]
pub(super) struct ProbeArgs {
    /// Volume file
    pub(super) file: PathBuf,
    /// Grid, by name
    #[arg(long, value_name = "NAME")]
    pub(super) grid: String,
    /// Stored value at a voxel; may be repeated
    #[arg(long, value_name = "I,J,K", allow_hyphen_values = true, value_parser = parse_index)]
    pub(super) at: Vec<IVec3>,
    /// Stored values at voxels read from a file, one `i j k` a line
    #[arg(long, value_name = "FILE")]
    pub(super) at_file: Option<PathBuf>,
    /// Trilinearly filtered value at a point of world space; may be repeated
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true, value_parser = parse_point)]
    pub(super) world: Vec<DVec3>,
    /// Print JSON
    #[arg(long)]
    pub(super) json: bool,
    /// Refuse what needs more memory, such as 8G or 512M [default: 80 % of the machine's]
    #[arg(long, value_name = "SIZE", value_parser = super::memory::parse_size)]
    pub(super) max_memory: Option<u64>,
}

#[derive(Debug, clap::Args)]
pub(super) struct ProfileArgs {
    /// Scene file
    pub(super) scene: PathBuf,
    /// Page to write, with pictures
    #[arg(short, long, value_name = "OUT.html")]
    pub(super) output: Option<PathBuf>,
    /// Columns and rows of the image
    #[arg(short, long, value_name = "WxH", value_parser = parse_resolution)]
    pub(super) resolution: Option<[u32; 2]>,
    /// Samples a pixel [default: the scene's, at most 16]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub(super) spp: Option<u32>,
    /// Print JSON
    #[arg(long)]
    pub(super) json: bool,
    #[arg(
        short = 'j',
        long,
        value_name = "N",
        help = "Threads; 0: all [default: SLURM_CPUS_PER_TASK, else all]"
    )]
    pub(super) threads: Option<usize>,
    /// Refuse what needs more memory, such as 8G or 512M [default: 80 % of the machine's]
    #[arg(long, value_name = "SIZE", value_parser = super::memory::parse_size)]
    pub(super) max_memory: Option<u64>,
}

#[derive(Debug, clap::Args)]
pub(super) struct VerifyArgs {
    /// Run extreme cases instead: huge and tiny numbers, odd grids, rays on edges
    #[arg(long)]
    pub(super) stiff: bool,
    /// Only checks with this text in `group: name`
    #[arg(long, value_name = "TEXT")]
    pub(super) filter: Option<String>,
    /// Print JSON
    #[arg(long)]
    pub(super) json: bool,
    #[arg(
        short = 'j',
        long,
        value_name = "N",
        help = "Threads; 0: all [default: SLURM_CPUS_PER_TASK, else all]"
    )]
    pub(super) threads: Option<usize>,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
pub(super) enum IntegratorArg {
    Path,
    Analog,
}

impl From<IntegratorArg> for IntegratorKind {
    fn from(arg: IntegratorArg) -> Self {
        match arg {
            IntegratorArg::Path => Self::Path,
            IntegratorArg::Analog => Self::Analog,
        }
    }
}

#[derive(Clone, Copy, Debug, ValueEnum)]
pub(super) enum UpArg {
    Y,
    Z,
}

impl From<UpArg> for UpAxis {
    fn from(arg: UpArg) -> Self {
        match arg {
            UpArg::Y => Self::Y,
            UpArg::Z => Self::Z,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory as _;

    #[test]
    fn the_command_line_is_consistent() {
        Args::command().debug_assert();
    }

    #[test]
    fn help_of_each_command_fits_a_screen() {
        for command in Args::command().get_subcommands_mut() {
            let help = command.render_help().to_string();
            let lines = help.lines().count();
            assert!(lines <= 50, "{}: {lines} lines", command.get_name());
        }
    }
}

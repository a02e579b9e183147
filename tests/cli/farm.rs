//! `majorant farm` with real engines, where they are installed: what a farm renders is what this
//! machine renders.

use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

use crate::support::{Folder, code, fixture, majorant, stderr};

const PROGRAM: &str = env!("CARGO_BIN_EXE_majorant");

/// A scene with a volume for each of the frames 1001 to 1004.
fn scene(folder: &Folder, spp: u32) -> String {
    for frame in 1001..=1004 {
        let file = folder.path(&format!("v_{frame}.vdb"));
        std::fs::copy(fixture("xf_affine.vdb"), file).expect("copied");
    }
    let text = format!(
        "[image]\nresolution = [24, 18]\n[camera]\nposition = [10, -10, 3]\n\
         look_at = [1.0, 2.0, 3.0]\n[[volume]]\nfile = \"v_####.vdb\"\n\
         [[light]]\ntype = \"constant\"\nradiance = [1, 2, 4]\n[render]\nspp = {spp}\n"
    );
    folder.write("fire.toml", &text)
}

/// Renders frames in three shards each on this machine, and merges them.
fn locally(folder: &Folder, scene: &str) {
    for shard in ["0/3", "1/3", "2/3"] {
        let out = folder.path(&format!("local/b.####.s{}.exr", &shard[..1]));
        let args = [
            "render",
            scene,
            "-f",
            "1001-1004",
            "--shard",
            shard,
            "-o",
            &out,
        ];
        let run = majorant(&args);
        assert_eq!(code(&run), 0, "{}", stderr(&run));
    }
    let parts = [0, 1, 2].map(|i| folder.path(&format!("local/b.####.s{i}.exr")));
    let out = folder.path("local/b.####.exr");
    let merge = [
        "merge",
        &parts[0],
        &parts[1],
        &parts[2],
        "-f",
        "1001-1004",
        "-o",
        &out,
    ];
    let run = majorant(&merge);
    assert_eq!(code(&run), 0, "{}", stderr(&run));
}

fn pixels(path: &str) -> Vec<(String, Vec<u32>)> {
    let image = exr::prelude::read_first_flat_layer_from_file(path)
        .unwrap_or_else(|e| panic!("{path}: {e}"));
    let channels = image.layer_data.channel_data.list.iter();
    channels
        .map(|c| {
            let bits = c.sample_data.values_as_f32().map(f32::to_bits).collect();
            (c.name.to_string(), bits)
        })
        .collect()
}

fn assert_equal(folder: &Folder, there: &str) {
    for frame in 1001..=1004 {
        let name = |out: &str| folder.path(&format!("{out}/b.{frame}.exr"));
        assert!(
            pixels(&name(there)) == pixels(&name("local")),
            "frame {frame}"
        );
    }
}

fn is_installed(program: &str) -> bool {
    let mut command = Command::new(program);
    command
        .arg("--version")
        .stdout(Stdio::null())
        .stderr(Stdio::null());
    command.status().is_ok()
}

#[expect(clippy::print_stderr, reason = "says why nothing was tested")]
fn skip(why: &str) {
    eprintln!("skipped: {why}");
}

fn text(run: &Output) -> String {
    let out = String::from_utf8_lossy(&run.stdout);
    format!("{out}{}", String::from_utf8_lossy(&run.stderr))
}

/// A job bundle is valid, has the steps and tasks that were asked for, and its tasks, run by the
/// engine's own runner, make the frames that this machine makes.
#[test]
fn open_job_description_renders_and_merges() {
    let folder = Folder::new();
    let scene = scene(&folder, 6);
    let (out, dir) = (folder.path("out/b.####.exr"), folder.path("job"));
    let args = [
        "farm",
        "openjd",
        &scene,
        "-f",
        "1001-1004",
        "--chunk",
        "3",
        "--shards",
        "3",
        "-o",
        &out,
        "--dir",
        &dir,
        "--program",
        PROGRAM,
    ];
    let run = majorant(&args);
    assert_eq!(code(&run), 0, "{}", stderr(&run));
    if !is_installed("openjd") {
        return skip("no openjd, of the package openjd-cli");
    }
    let openjd = |args: &[&str]| {
        Command::new("openjd")
            .args(args)
            .output()
            .expect("openjd runs")
    };
    let template = format!("{dir}/template.yaml");
    let parameters = format!("file://{dir}/openjd_parameters.yaml");
    let extensions = ["--extensions", "TASK_CHUNKING"];
    let check = openjd(&[&["check", &template][..], &extensions].concat());
    assert!(check.status.success(), "{}", text(&check));
    // Parameters are expanded here, and not by check.
    let summary = openjd(&[&["summary", &template, "-p", &parameters][..], &extensions].concat());
    assert!(summary.status.success(), "{}", text(&summary));
    let said = text(&summary);
    assert!(said.contains("Render") && said.contains("Merge"), "{said}");
    let run = openjd(&[&["run", &template, "-p", &parameters][..], &extensions].concat());
    let said = text(&run);
    assert!(run.status.success(), "{said}");
    locally(&folder, &scene);
    assert_equal(&folder, "out");
    // Again: everything is there.
    let again = openjd(&[&["run", &template, "-p", &parameters][..], &extensions].concat());
    assert!(
        text(&again).contains("2 complete before") || text(&again).contains("3 complete before"),
        "{}",
        text(&again)
    );
    if !is_installed("deadline") {
        return skip("no deadline, of the package of that name");
    }
    let info = Command::new("deadline")
        .args(["bundle", "info", &dir])
        .output();
    let info = info.expect("deadline runs");
    assert!(info.status.success(), "{}", text(&info));
}

/// A cluster on this machine, gone when dropped.
struct Cluster {
    tool: String,
    folder: String,
}

impl Cluster {
    fn start(folder: &Folder) -> Option<Self> {
        let root = Path::new(env!("CARGO_MANIFEST_DIR"));
        let tool = root.join("../shared/tools/slurm-local/slurm-local.sh");
        if !tool.exists() || !is_installed("sbatch") || !Path::new("/usr/sbin/slurmctld").exists() {
            return None;
        }
        let cluster = Self {
            tool: tool.display().to_string(),
            folder: folder.path("cluster"),
        };
        let mut start = Command::new(&cluster.tool);
        // A port of its own, so that another cluster may run.
        start
            .args(["start", &cluster.folder, "2"])
            .env("SLURM_LOCAL_PORT", "17817");
        let status = start.stdout(Stdio::null()).stderr(Stdio::null()).status();
        status.is_ok_and(|s| s.success()).then_some(cluster)
    }

    /// Runs a client with the cluster's settings.
    fn run(&self, command: &str) -> Output {
        let line = format!(
            "eval \"$('{}' env '{}')\"; {command}",
            self.tool, self.folder
        );
        Command::new("bash")
            .args(["-c", &line])
            .output()
            .expect("bash runs")
    }

    fn wait_until_idle(&self) {
        let begin = Instant::now();
        loop {
            let queue = self.run("squeue -h");
            if queue.status.success() && queue.stdout.is_empty() {
                return;
            }
            assert!(
                begin.elapsed() < Duration::from_mins(4),
                "still there: {}",
                text(&queue)
            );
            std::thread::sleep(Duration::from_millis(200));
        }
    }
}

impl Drop for Cluster {
    fn drop(&mut self) {
        let mut stop = Command::new(&self.tool);
        let stop = stop.args(["stop", &self.folder]).stdout(Stdio::null());
        let _ = stop.stderr(Stdio::null()).status();
    }
}

/// Four frames of three shards each, numbered beyond the largest array index, one of the tasks
/// killed and queued again while it renders: the frames that this machine makes, bit by bit.
#[test]
fn slurm_renders_and_merges_and_survives_a_requeue() {
    let folder = Folder::new();
    let scene = scene(&folder, 30_000);
    let Some(cluster) = Cluster::start(&folder) else {
        return skip("no Slurm, or no ../shared/tools/slurm-local");
    };
    let (out, dir) = (folder.path("out/b.####.exr"), folder.path("job"));
    let args = [
        "farm",
        "slurm",
        &scene,
        "-f",
        "1001-1004",
        "--chunk",
        "1",
        "--shards",
        "3",
        "-o",
        &out,
        "--dir",
        &dir,
        "--program",
        PROGRAM,
    ];
    let run = majorant(&args);
    assert_eq!(code(&run), 0, "{}", stderr(&run));
    let submit = cluster.run(&format!("'{dir}/submit.sh'"));
    assert!(submit.status.success(), "{}", text(&submit));
    // One task, as soon as it runs.
    let begin = Instant::now();
    let requeued = loop {
        let running = cluster.run("squeue -h -t R -o %A");
        let list = String::from_utf8_lossy(&running.stdout).into_owned();
        if let Some(id) = list.split_whitespace().next() {
            let requeue = cluster.run(&format!("scontrol requeue {id}"));
            if requeue.status.success() {
                break id.to_owned();
            }
        }
        assert!(begin.elapsed() < Duration::from_mins(1), "no task ever ran");
        std::thread::sleep(Duration::from_millis(20));
    };
    cluster.wait_until_idle();
    let job = cluster.run(&format!("scontrol show job {requeued}"));
    assert!(text(&job).contains("Restarts=1"), "{}", text(&job));
    locally(&folder, &scene);
    assert_equal(&folder, "out");
    // A hundred frames from 1001 on: array indices of frames would be refused.
    let many = folder.path("many");
    let args = [
        "farm",
        "slurm",
        &scene,
        "-f",
        "1001-1100",
        "-o",
        &out,
        "--dir",
        &many,
    ];
    assert_eq!(code(&majorant(&args)), 0);
    let tested = cluster.run(&format!("'{many}/submit.sh' --test-only"));
    assert!(tested.status.success(), "{}", text(&tested));
}

//! Batch scripts for Slurm.
//!
//! * Frames are not array indices, which end at 1000 by default: the script holds its chunks and is
//!   indexed from 0.
//! * There is one array for each shard, over the same chunks; task *i* of the merge waits for task
//!   *i* of every shard (`aftercorr`), and is cancelled if one of them fails.
//! * A minute before its time is up a task gets TERM, writes a checkpoint, ends with 75 and is
//!   queued again; so does one that is preempted.
//! * `-j` is the processors that were allotted: without a task plugin, a task sees all of the node.

use super::{CHECKPOINT_SECS, FarmError, FarmFile, FarmJob};

/// Most tasks of an array by default: `MaxArraySize` is 1001, and indices stay below it.
pub(super) const MAX_TASKS: usize = 1001;

pub(super) fn files(job: &FarmJob) -> Result<Vec<FarmFile>, FarmError> {
    job.check()?;
    let chunks = job.frames.chunks(job.chunk);
    if chunks.len() > MAX_TASKS {
        let enough = job.frames.frames().len().div_ceil(MAX_TASKS);
        return Err(FarmError::TooManyTasks(chunks.len(), job.chunk, enough));
    }
    let script = |name, text| FarmFile {
        name,
        text,
        is_script: true,
    };
    let list: Vec<_> = chunks
        .iter()
        .map(|c| format!("  {}\n", quoted(c)))
        .collect();
    let list = list.concat();
    let chunks_text = format!("chunks=(\n{list})\nframes=${{chunks[$SLURM_ARRAY_TASK_ID]}}\n");
    let mut files = vec![script("render.sh", render(job, &chunks_text))];
    if job.shards > 1 {
        files.push(script("merge.sh", merge(job, &chunks_text)));
    }
    files.push(script("submit.sh", submit(job, chunks.len())));
    Ok(files)
}

fn head(job: &FarmJob, name: &str, cpus: u32) -> String {
    let mut head = format!(
        "#!/bin/bash\n#SBATCH --job-name={name}\n#SBATCH --cpus-per-task={cpus}\n\
         #SBATCH --output=%x.%A_%a.log\n#SBATCH --open-mode=append\n#SBATCH --requeue\n"
    );
    if let Some(memory) = &job.memory {
        head.push_str("#SBATCH --mem=");
        head.push_str(memory);
        head.push('\n');
    }
    head
}

fn render(job: &FarmJob, chunks: &str) -> String {
    let mut text = head(job, &plain(&job.name), job.cpus);
    if let Some(time) = &job.time {
        text.push_str("#SBATCH --time=");
        text.push_str(time);
        text.push('\n');
    }
    let shard = if job.shards > 1 {
        format!(" --shard \"$1/{}\"", job.shards)
    } else {
        String::new()
    };
    let output = job.output.to_string_lossy();
    let output = if job.shards > 1 {
        // The shell puts the shard in.
        quoted(&job.shard_output(&output, "SHARD")).replace("sSHARD", "s'\"$1\"'")
    } else {
        quoted(&output)
    };
    let arguments: Vec<_> = job.arguments.iter().map(|a| quoted(a)).collect();
    let (program, scene) = (quoted(&job.program), quoted(&job.scene.to_string_lossy()));
    let script = format!(
        "#SBATCH --signal=B:TERM@60\nset -u\n{chunks}\n\
         # A task that is stopped leaves a checkpoint and ends with 75: it is queued again.\n\
         trap 'kill -TERM \"$child\"' TERM INT\n\
         {program} render {scene} --frames-openjd \"$frames\"{shard} \\\n  -o {output} \\\n  \
         -j \"${{SLURM_CPUS_PER_TASK:-1}}\" --skip-existing --resume --checkpoint {CHECKPOINT_SECS}s \
         {} &\nchild=$!\n\
         wait \"$child\"; code=$?\n\
         # The signal ends the first wait before the program has ended.\n\
         while kill -0 \"$child\" 2>/dev/null; do wait \"$child\"; code=$?; done\n\
         if [ \"$code\" = 75 ]; then scontrol requeue \"$SLURM_JOB_ID\"; fi\n\
         exit \"$code\"\n",
        arguments.join(" "),
    );
    text + &script
}

fn merge(job: &FarmJob, chunks: &str) -> String {
    let text = head(job, &format!("{}-merge", plain(&job.name)), 1);
    let output = job.output.to_string_lossy();
    let shards = 0..job.shards;
    let parts = shards.map(|i| {
        format!(
            "  {} \\\n",
            quoted(&job.shard_output(&output, &i.to_string()))
        )
    });
    let script = format!(
        "set -u\n{chunks}\nexec {} merge --frames-openjd \"$frames\" \\\n{}  -o {}\n",
        quoted(&job.program),
        parts.collect::<Vec<_>>().concat(),
        quoted(&output),
    );
    text + &script
}

fn submit(job: &FarmJob, task_count: usize) -> String {
    let array = format!("--array=0-{}", task_count - 1);
    let head = "#!/bin/bash\n\
        # Submits all; once more: what is complete is left as it is, the rest goes on.\n\
        set -eu\ncd \"$(dirname \"$0\")\"\n";
    if job.shards <= 1 {
        return format!("{head}sbatch --parsable {array} \"$@\" render.sh\n");
    }
    let shards = 0..job.shards;
    let render = |i| format!("s{i}=$(sbatch --parsable {array} \"$@\" render.sh {i})\n");
    let renders: Vec<_> = shards.clone().map(render).collect();
    let ids: Vec<_> = shards.map(|i| format!(":${{s{i}%%;*}}")).collect();
    let (renders, ids) = (renders.concat(), ids.concat());
    format!(
        "{head}{renders}# Each merge waits for the same task of every shard.\n\
         sbatch --parsable {array} --kill-on-invalid-dep=yes --dependency=\"aftercorr{ids}\" \"$@\" \
         merge.sh\n"
    )
}

/// A word that the shell leaves as it is.
fn quoted(text: &str) -> String {
    format!("'{}'", text.replace('\'', "'\\''"))
}

/// A name that a comment of Slurm can hold.
fn plain(name: &str) -> String {
    let keep = |c: char| {
        if c.is_ascii_alphanumeric() || "._-".contains(c) {
            c
        } else {
            '_'
        }
    };
    name.chars().map(keep).collect()
}

//! A render for a farm: files for the engines that studios have, which call `render` and `merge`.
//!
//! * `openjd`: an Open Job Description template, and a job bundle for Deadline Cloud around it.
//! * `slurm`: batch scripts.
//!
//! Frames come in chunks; each frame may be split into shards, parts of its samples, which are
//! merged when all are there. Retries, queues and placement stay the engine's: every task leaves
//! alone what is complete and goes on with what is not, so that running it again is always right.
//!
//! Text alone: nothing here writes files or submits.

mod openjd;
mod slurm;

use std::path::PathBuf;

use crate::sequence::{FrameRange, Pattern};

/// Seconds between two checkpoints of a task: what a machine that is lost costs.
const CHECKPOINT_SECS: u32 = 60;

/// A render, and how it is to be cut.
#[derive(Clone, Debug, PartialEq)]
pub struct FarmJob {
    /// Its name on the farm.
    pub name: String,
    /// The program, as tasks call it.
    pub program: String,
    /// The scene file or volume, absolute.
    pub scene: PathBuf,
    /// Images, absolute, with a mark for the frame's number.
    pub output: PathBuf,
    /// Frames.
    pub frames: FrameRange,
    /// Frames of a task.
    pub chunk: usize,
    /// Parts of the samples of each frame.
    pub shards: u32,
    /// More arguments of `render`.
    pub arguments: Vec<String>,
    /// Processors of a task.
    pub cpus: u32,
    /// Memory of a task in the engine's form, such as `8G`.
    pub memory: Option<String>,
    /// Longest time of a task in the engine's form, such as `1:00:00`.
    pub time: Option<String>,
}

/// A file to write.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FarmFile {
    /// Its name in the job's folder.
    pub name: &'static str,
    /// Its text.
    pub text: String,
    /// Whether it is to be run.
    pub is_script: bool,
}

/// A render that a farm cannot take.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum FarmError {
    /// Images would be written over each other.
    #[error("{}: no mark for the frame's number, expected #### in it", .0.display())]
    NoNumber(PathBuf),
    /// More tasks than an array of Slurm takes by default.
    #[error(
        "{0} chunks of {1} frames, expected at most {max}, the tasks of an array: --chunk {2}",
        max = slurm::MAX_TASKS
    )]
    TooManyTasks(usize, usize, usize),
    /// A path that cannot be written into a template.
    #[error("{}: not Unicode, expected a name that is", .0.display())]
    NotUnicode(PathBuf),
}

impl FarmJob {
    /// Returns the files for Slurm: `render.sh`, `merge.sh` if there are shards, `submit.sh`.
    ///
    /// # Errors
    /// If the output has no frame number, or there are more chunks than tasks in an array.
    pub fn slurm(&self) -> Result<Vec<FarmFile>, FarmError> {
        slurm::files(self)
    }

    /// Returns the files for Open Job Description and Deadline Cloud: `template.yaml`, its
    /// parameters in the form of each, and `asset_references.yaml`.
    ///
    /// # Errors
    /// If the output has no frame number.
    pub fn openjd(&self) -> Result<Vec<FarmFile>, FarmError> {
        openjd::files(self)
    }

    /// Returns the name of a shard's images: `out/b.####.s0.exr`, where `shard` is `0`.
    fn shard_output(&self, output: &str, shard: &str) -> String {
        let stem = output.strip_suffix(".exr").unwrap_or(output);
        if self.shards > 1 {
            format!("{stem}.s{shard}.exr")
        } else {
            output.to_owned()
        }
    }

    fn check(&self) -> Result<(), FarmError> {
        for path in [&self.scene, &self.output] {
            if path.to_str().is_none() {
                return Err(FarmError::NotUnicode(path.clone()));
            }
        }
        match Pattern::of(&self.output) {
            Some(_) => Ok(()),
            None => Err(FarmError::NoNumber(self.output.clone())),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn job(frames: &str, shards: u32) -> FarmJob {
        FarmJob {
            name: "fire".to_owned(),
            program: "majorant".to_owned(),
            scene: "/show/it's/fire.toml".into(),
            output: "/show/out/b.####.exr".into(),
            frames: frames.parse().unwrap(),
            chunk: 2,
            shards,
            arguments: ["--spp", "64", "--set", "light.0.irradiance=[1, 2, 3]"]
                .map(str::to_owned)
                .to_vec(),
            cpus: 4,
            memory: Some("8G".to_owned()),
            time: Some("1:00:00".to_owned()),
        }
    }

    fn text(files: &[FarmFile]) -> String {
        let file = |f: &FarmFile| format!("=== {}\n{}", f.name, f.text);
        files.iter().map(file).collect()
    }

    #[test]
    fn slurm_scripts_are_fit_to_read() {
        insta::assert_snapshot!(text(&job("1001-1009x2", 3).slurm().unwrap()));
    }

    #[test]
    fn a_bundle_is_fit_to_read() {
        insta::assert_snapshot!(text(&job("1001-1009x2", 3).openjd().unwrap()));
    }

    #[test]
    fn without_shards_there_is_nothing_to_merge() {
        let files = job("1-3", 1).slurm().unwrap();
        let names: Vec<_> = files.iter().map(|f| f.name).collect();
        assert_eq!(names, ["render.sh", "submit.sh"]);
        assert!(!text(&files).contains("merge"), "{}", text(&files));
        let files = text(&job("1-3", 1).openjd().unwrap());
        assert!(
            !files.contains("Merge") && !files.contains("shard"),
            "{files}"
        );
    }

    /// Frame numbers are no array indices: 1001 to 1100 are tasks 0 to 49.
    #[test]
    fn indices_of_tasks_count_from_zero() {
        let files = text(&job("1001-1100", 1).slurm().unwrap());
        assert!(files.contains("--array=0-49"), "{files}");
        assert!(files.contains("'1099-1100'"), "{files}");
        let many = job("1-3000", 1).slurm().unwrap_err();
        assert_eq!(many, FarmError::TooManyTasks(1500, 2, 3));
        let mut plain = job("1-2", 1);
        plain.output = "/show/out/b.exr".into();
        assert!(plain.slurm().is_err() && plain.openjd().is_err());
    }
}

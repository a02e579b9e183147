//! An Open Job Description template, and a Deadline Cloud job bundle around it.
//!
//! * Frames are ascending and no two parts of the range overlap, with `:` before steps: `x`, and
//!   what is named twice, are errors there.
//! * The engine makes chunks (`TASK_CHUNKING`); a task is handed `1-5:2` or `7,9`, which
//!   `--frames-openjd` reads.
//! * Shards are written out: a range from a parameter would need one more extension.
//! * A Deadline bundle holds its parameters as a list, the command line of Open Job Description
//!   wants them as a plain map: both are written.

use std::path::Path;

use super::{CHECKPOINT_SECS, FarmError, FarmFile, FarmJob};

pub(super) fn files(job: &FarmJob) -> Result<Vec<FarmFile>, FarmError> {
    job.check()?;
    let file = |name, text| FarmFile {
        name,
        text,
        is_script: false,
    };
    let folder = job.output.parent().unwrap_or(Path::new("/"));
    let scene = job.scene.to_string_lossy();
    let output = folder.to_string_lossy();
    let frames = job.frames.to_openjd();
    let parameters = [
        ("Frames", frames.as_str()),
        ("Scene", &scene),
        ("OutputDir", &output),
        ("Majorant", &job.program),
    ];
    let list =
        parameters.map(|(name, value)| format!("  - name: {name}\n    value: {}\n", json(value)));
    let map = parameters.map(|(name, value)| format!("{name}: {}\n", json(value)));
    let scene_folder = job
        .scene
        .parent()
        .unwrap_or(Path::new("/"))
        .to_string_lossy();
    let assets = format!(
        "assetReferences:\n  inputs:\n    filenames:\n      - {}\n    directories:\n      - {}\n  \
         outputs:\n    directories:\n      - {}\n",
        json(&scene),
        json(&scene_folder),
        json(&output),
    );
    Ok(vec![
        file("template.yaml", template(job)),
        file(
            "parameter_values.yaml",
            format!("parameterValues:\n{}", list.concat()),
        ),
        file("openjd_parameters.yaml", map.concat()),
        file("asset_references.yaml", assets),
    ])
}

fn template(job: &FarmJob) -> String {
    let name = job.output.file_name().unwrap_or_default().to_string_lossy();
    let output = format!("{{{{Param.OutputDir}}}}/{name}");
    let mut arguments = vec![
        "render".to_owned(),
        "{{Param.Scene}}".to_owned(),
        "--frames-openjd={{Task.Param.Frame}}".to_owned(),
    ];
    if job.shards > 1 {
        arguments.push(format!("--shard={{{{Task.Param.Shard}}}}/{}", job.shards));
    }
    let image = job.shard_output(&output, "{{Task.Param.Shard}}");
    arguments.extend(["-o".to_owned(), image]);
    arguments.extend(["--skip-existing", "--resume"].map(str::to_owned));
    arguments.push(format!("--checkpoint={CHECKPOINT_SECS}s"));
    arguments.push("--progress=openjd".to_owned());
    arguments.extend(job.arguments.iter().cloned());
    let frames = format!(
        "          - name: Frame\n            type: CHUNK[INT]\n            \
         range: \"{{{{Param.Frames}}}}\"\n            chunks:\n              \
         defaultTaskCount: {}\n              rangeConstraint: NONCONTIGUOUS\n",
        job.chunk
    );
    let shards = if job.shards > 1 {
        let last = job.shards - 1;
        format!("          - name: Shard\n            type: INT\n            range: \"0-{last}\"\n")
    } else {
        String::new()
    };
    let mut text = format!(
        "specificationVersion: jobtemplate-2023-09\nextensions:\n  - TASK_CHUNKING\nname: {}\n\
         parameterDefinitions:\n  - name: Frames\n    type: STRING\n    default: {}\n  \
         - name: Scene\n    type: PATH\n    objectType: FILE\n    dataFlow: IN\n  \
         - name: OutputDir\n    type: PATH\n    objectType: DIRECTORY\n    dataFlow: OUT\n  \
         - name: Majorant\n    type: STRING\n    default: {}\nsteps:\n",
        json(&job.name),
        json(&job.frames.to_openjd()),
        json(&job.program),
    );
    let requirements = format!(
        "    hostRequirements:\n      amounts:\n        - name: amount.worker.vcpu\n          \
         min: {}\n",
        job.cpus
    );
    text.push_str(&step(
        "Render",
        &format!("{frames}{shards}"),
        &arguments,
        &requirements,
    ));
    if job.shards > 1 {
        let mut arguments = vec![
            "merge".to_owned(),
            "--frames-openjd={{Task.Param.Frame}}".to_owned(),
        ];
        let parts = 0..job.shards;
        arguments.extend(parts.map(|i| job.shard_output(&output, &i.to_string())));
        arguments.extend(["-o".to_owned(), output]);
        let after = "    dependencies:\n      - dependsOn: Render\n";
        text.push_str(&step("Merge", &frames, &arguments, after));
    }
    text
}

fn step(name: &str, parameters: &str, arguments: &[String], more: &str) -> String {
    let arguments = arguments
        .iter()
        .map(|a| format!("            - {}\n", json(a)));
    format!(
        "  - name: {name}\n{more}    parameterSpace:\n      taskParameterDefinitions:\n{parameters}\
         \x20   script:\n      actions:\n        onRun:\n          \
         command: \"{{{{Param.Majorant}}}}\"\n          args:\n{}",
        arguments.collect::<Vec<_>>().concat()
    )
}

/// A text as YAML takes it: JSON's form is one of its own.
fn json(text: &str) -> String {
    serde_json::Value::String(text.to_owned()).to_string()
}

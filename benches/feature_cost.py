#!/usr/bin/env python3
"""What each feature costs a scene that does not use it, in instructions.

Takes a feature's code out of a copy of the source, by replacing text, builds that and counts the
instructions of two scenes under callgrind, one thread, for 32 samples a pixel more than a few, so that
loading does not count. A feature that costs nothing leaves the number as it is.

    benches/feature_cost.py             all features, and all at once
    benches/feature_cost.py emission    those whose name contains a word

A release build each, and a minute of callgrind. Needs valgrind. Prints rows of a Markdown table.
"""

import os
import pathlib
import re
import shutil
import subprocess
import sys
import tempfile

ROOT = pathlib.Path(__file__).resolve().parent.parent
TARGET = pathlib.Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target"))
SCENES = ["cloud", "smoke"]
FEW, MORE = 4, 36

# name: (file, text that occurs there once, what takes its place)...
FEATURES = {
    "emission": [
        ("src/integrator/emission.rs", "self.all.is_empty()\n", "true\n"),
    ],
    "several volumes": [
        ("src/integrator/media.rs", "self.all.len() > 1", "false"),
    ],
    "skies from images, lamps": [
        (
            "src/integrator/path.rs",
            "let has_surroundings = lamps.is_some() || !lights.maps.is_empty();",
            "let (has_surroundings, lamps) = (false, &None::<Lamps<'_>>);",
        ),
        ("src/integrator/path.rs", "if !lights.maps.is_empty() {", "if false {"),
        ("src/integrator/primary.rs", "if !lights.local.is_empty() {", "if false {"),
    ],
    "colours": [
        ("src/medium.rs", "if self.medium.colour.is_none() {", "if true {"),
        (
            "src/integrator/primary.rs",
            "chromatic::sample_radiance(context, ray, stream, counts)",
            "analog(context, ray, stream, counts)",
        ),
    ],
    "output variables": [
        ("src/render.rs", "let path = if scene.aovs.is_empty() {", "let path = if true {"),
    ],
    "other phase functions": [
        (
            "src/phase/mod.rs",
            "    pub fn eval(self, cos_theta: f64) -> f32 {\n        match self {",
            "    pub fn eval(self, cos_theta: f64) -> f32 {\n"
            "        if let Self::HenyeyGreenstein { g } = self {\n"
            "            return eval_henyey_greenstein(g, 1.0 - cos_theta);\n"
            "        }\n"
            "        return 0.0;\n"
            "        #[allow(unreachable_code)]\n"
            "        match self {",
        ),
        (
            "src/phase/mod.rs",
            "_ => self.sample_lobe(stream.uniform(), stream.uniform_positive()),",
            "_ => 0.0,",
        ),
    ],
}


def build(patches):
    """Returns the program built from a copy of the source with `patches`."""
    # Always the same folder, or cargo would keep each; times of change are new.
    copy = TARGET / "feature-cost"
    shutil.rmtree(copy, ignore_errors=True)
    copy.mkdir(parents=True)
    for name in ["Cargo.toml", "Cargo.lock", "README.md"]:
        shutil.copy(ROOT / name, copy)
    for name in ["src", "benches", "examples", "tests"]:
        shutil.copytree(ROOT / name, copy / name, copy_function=shutil.copy)
    for path, find, put in patches:
        text = (copy / path).read_text()
        if text.count(find) != 1:
            sys.exit(f"{path}: {text.count(find)} times: {find}")
        (copy / path).write_text(text.replace(find, put))
    env = os.environ | {"CARGO_TARGET_DIR": str(TARGET)}
    command = ["cargo", "build", "--release", "--bin", "majorant", "--quiet"]
    subprocess.run(command, cwd=copy, env=env, check=True)
    program = copy / "majorant"
    shutil.copy(TARGET / "release/majorant", program)
    return program


def instructions(program, scene):
    """Returns how many it takes for the samples between FEW and MORE."""
    counts = []
    for spp in [FEW, MORE]:
        with tempfile.TemporaryDirectory() as folder:
            command = ["valgrind", "--tool=callgrind", "--callgrind-out-file=/dev/null"]
            command += [program, "render", ROOT / f"data/scenes/{scene}.toml", "-q", "-j", "1"]
            command += ["-r", "64x36", "--spp", str(spp), "-o", f"{folder}/image.exr"]
            log = subprocess.run(command, capture_output=True, text=True, check=True).stderr
            counts.append(int(re.search(r"Collected : (\d+)", log)[1]))
    return counts[1] - counts[0]


def main():
    words = sys.argv[1:]
    variants = {"nothing": [], "all of these": sum(FEATURES.values(), [])} | FEATURES
    base = {}
    print("| without | " + " | ".join(f"{s}: M instructions | %" for s in SCENES) + " |")
    print("|---" * (1 + 2 * len(SCENES)) + "|")
    for name, patches in variants.items():
        if patches and words and not any(word in name for word in words):
            continue
        program = build(patches)
        row = [name]
        for scene in SCENES:
            count = instructions(program, scene)
            base.setdefault(scene, count)
            row += [f"{count / 1e6:,.1f}", f"{100 * (count / base[scene] - 1):+.2f}"]
        print("| " + " | ".join(row) + " |", flush=True)


main()

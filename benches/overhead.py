#!/usr/bin/env python3
"""What statistics and traces cost: instructions by callgrind, and CPU times in pairs.

    benches/overhead.py target/release/majorant --uncounted DIR/majorant [SCENE.toml...]
    benches/overhead.py --make-uncounted DIR      a copy of the source that counts nothing

Counters are part of every render. To say what they cost, the copy has the lines deleted that count in rays
(but for camera rays, by which a render knows its end); build it, and name its program by --uncounted. Prints a
table as docs/performance.md has it. Instructions are those of 21 samples of 24 by 14 pixels less those of 5,
without loading: with passes of 1, 4 and 16 samples that no clock decides. Times are those of whole runs of 384 by
216 pixels and as many samples as take --secs, in pairs. Needs Python 3.9 and valgrind.
"""
import argparse
import re
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
COUNTS = re.compile(r"^\s*(?:stream\.)?counts\.(?!camera_rays)\w+ \+= [^;]*;\n", re.M)


def make_uncounted(folder):
    for part in ["Cargo.toml", "Cargo.lock", "README.md", "src", "benches", "tests"]:
        copy = shutil.copytree if (ROOT / part).is_dir() else shutil.copy
        folder.mkdir(parents=True, exist_ok=True)
        copy(ROOT / part, folder / part)
    deleted = 0
    files = [folder / "src/medium.rs", *(folder / "src").glob("tracking/*.rs"), *(folder / "src").glob("integrator/*.rs")]
    for path in files:
        text, count = COUNTS.subn("", path.read_text())
        path.write_text(text)
        deleted += count
    print(f"{folder}: {deleted} lines that count are deleted; build by `cargo build --release` there")


def command(program, scene, size, spp, folder, options):
    return [program, "render", scene, "-r", size, "--spp", str(spp), "-j", "1", "-q",
            "-o", f"{folder}/i.exr"] + [o.format(folder=folder) for o in options]


def instructions(program, scene, spp, folder, options):
    callgrind = ["valgrind", "--tool=callgrind", "--callgrind-out-file=/dev/null"]
    run = subprocess.run(callgrind + command(program, scene, "24x14", spp, folder, options),
                         capture_output=True, text=True, check=True)
    return int(re.search(r"Collected : (\d+)", run.stderr)[1])


def cpu_secs(program, scene, spp, folder, options):
    import resource
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(command(program, scene, "384x216", spp, folder, options), check=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("program", nargs="?", default=str(ROOT / "target/release/majorant"))
    parser.add_argument("scenes", nargs="*", default=[])
    parser.add_argument("--uncounted")
    parser.add_argument("--make-uncounted", type=Path)
    parser.add_argument("--pairs", type=int, default=10)
    parser.add_argument("--secs", type=float, default=2)
    parser.add_argument("--spp", type=int, nargs=2, default=[5, 21])
    args = parser.parse_args()
    if args.make_uncounted:
        return make_uncounted(args.make_uncounted)
    scenes = args.scenes or [str(ROOT / f"data/scenes/{name}.toml") for name in ("cloud", "smoke", "campfire")]
    runs = [("as ever", args.program, []),
            ("`--stats-json`", args.program, ["--stats-json={folder}/s.json"]),
            ("`--trace`", args.program, ["--trace={folder}/t.json"]),
            ("both", args.program, ["--stats-json={folder}/s.json", "--trace={folder}/t.json"])]
    if args.uncounted:
        runs.insert(0, ("nothing counted", args.uncounted, []))
    few, many = args.spp
    print("| scene | run | million instructions | beside the first | CPU time beside the first, of pairs |")
    print("| --- | --- | --- | --- | --- |")
    for scene in scenes:
        with tempfile.TemporaryDirectory() as folder:
            base = None
            trial = cpu_secs(runs[0][1], scene, 16, folder, [])
            spp = max(1, round(16 * args.secs / trial))
            for name, program, options in runs:
                counts = [instructions(program, scene, n, folder, options) for n in (few, many)]
                rays = counts[1] - counts[0]
                base = base or rays
                ratios = []
                for pair in range(args.pairs):
                    order = [0, 1] if pair % 2 else [1, 0]
                    secs = {}
                    for which in order:
                        _, p, o = [runs[0], (name, program, options)][which]
                        secs[which] = cpu_secs(p, scene, spp, folder, o)
                    ratios.append(secs[1] / secs[0])
                error = statistics.stdev(ratios) / len(ratios) ** 0.5 if len(ratios) > 1 else float("nan")
                change = 100 * (statistics.mean(ratios) - 1)
                paired = "–" if name == runs[0][0] else f"{change:+.1f} ± {100 * error:.1f} %"
                print(f"| {Path(scene).stem} | {name} | {rays * 1e-6:.1f} | {100 * (rays / base - 1):+.2f} % | {paired} |",
                      flush=True)
    load = Path("/proc/loadavg").read_text().split()[0]
    print(f"\n*Measured: {time.strftime('%Y-%m-%d')}, load {load}, {few} and {many} samples, {args.pairs} pairs.*")


if __name__ == "__main__":
    sys.exit(main())

#!/usr/bin/env python3
"""Renders the comparison scenes with majorant, Cycles and Mitsuba in turn, and prints the ratios.

    run.py                          all scenes and renderers until --minutes are over
    run.py --minutes 2 --rounds 2   a look
    run.py --table RUNS             only the tables of an earlier run

A turn renders one block of samples with one renderer in a process of its own. Turns alternate, so
that a busy or slow moment of the machine hits all alike; a round is a turn of every renderer on
every scene. Blocks have different seeds and serve as each other's reference. After --minutes, no
turn begins that would exceed them, judged by the last one of its kind. See README.md.
"""
import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
sys.path.insert(0, str(HERE.parent))
sys.dont_write_bytecode = True

# Samples a pixel of one block. Seven rounds make 112 samples where it is 16. Mitsuba takes several
# times longer a sample than Cycles on the thick clouds: its few samples are stated in the tables.
SPP = {
    "cloud": {"majorant": 16, "cycles": 16, "mitsuba": 1},
    "cloud_a999": {"majorant": 16, "cycles": 16, "mitsuba": 1},
    "smoke": {"majorant": 16, "cycles": 16, "mitsuba": 16},
    "absorb": {"majorant": 16, "cycles": 16, "mitsuba": 4},
}
PACKAGES = {"cycles": "bpy", "mitsuba": "mitsuba"}


def parse():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenes", default=",".join(SPP), help="names of data/scenes, by commas")
    parser.add_argument("--renderers", default="majorant,cycles,mitsuba", help="by commas")
    parser.add_argument("--rounds", type=int, default=7, help="at most this many [7]")
    parser.add_argument("--minutes", type=float, default=15, help="stop after this long [15]")
    parser.add_argument("--spp", type=int, help="samples a block, for all [see SPP in the source]")
    parser.add_argument("--threads", type=int, default=os.cpu_count(), help="[all]")
    parser.add_argument("--runs", type=Path, help="folder for images [a temporary one]")
    parser.add_argument("--table", type=Path, metavar="RUNS", help="print the tables of RUNS only")
    parser.add_argument("--record", action="store_true", help="write a file to benches/record")
    parser.add_argument("--python", default=sys.executable, help="that has mitsuba and bpy [this]")
    parser.add_argument("--binary", type=Path, help="majorant to measure [built from this source]")
    return parser.parse_args()


def build(args):
    """Builds majorant and the exporter; returns their paths."""
    command = ["cargo", "build", "--release", "--quiet", "--bin", "majorant", "--example", "peers_export"]
    subprocess.run(command, cwd=ROOT, check=True)
    release = Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target")) / "release"
    return args.binary or release / "majorant", release / "examples" / "peers_export"


def is_installed(renderer, python):
    if renderer not in PACKAGES:
        return True
    package = PACKAGES[renderer]
    # A package that is found but does not load (bpy needs its own Python version) is not there.
    tried = subprocess.run([python, "-c", f"import {package}"], capture_output=True, cwd=HERE)
    if tried.returncode != 0:
        print(f"{renderer}: skipped, {python} has no working package `{package}` (README.md)")
    return tried.returncode == 0


def run_peer(renderer, scene, export, image, spp, seed, args):
    command = [args.python, "-B", HERE / f"{renderer}_driver.py", scene, export, image,
               "--spp", spp, "--seed", seed, "--threads", args.threads]
    ran = subprocess.run([str(c) for c in command], capture_output=True, text=True, cwd=HERE)
    if ran.returncode != 0:
        tail = "\n".join((ran.stdout + ran.stderr).splitlines()[-15:])
        raise SystemExit(f"{renderer} failed on {scene}:\n{tail}")
    return json.loads(ran.stdout.strip().splitlines()[-1])


def run_majorant(binary, scene, image, spp, seed, args):
    import numpy as np
    import OpenEXR

    with tempfile.TemporaryDirectory() as folder:
        exr, stats = Path(folder, "image.exr"), Path(folder, "stats.json")
        command = [binary, "render", scene, "-q", "-o", exr, "--stats-json", stats,
                   "--spp", spp, "--seed", seed, "-j", args.threads]
        subprocess.run([str(c) for c in command], check=True)
        told = json.loads(stats.read_text())
        with OpenEXR.File(str(exr), separate_channels=True) as opened:
            planes = opened.channels()
            np.save(image, np.stack([planes[c].pixels.astype(np.float32) for c in "RGB"], -1))
    wall, cpu, counts = told["seconds"], told["cpu_seconds"], told["counts"]
    return {
        "wall": wall["render"], "cpu": cpu["render"], "version": f"majorant {told['version']}",
        "load_wall": wall["load"] + wall["build"], "load_cpu": cpu["load"] + cpu["build"],
        "rss_mb": told["peak_memory_bytes"] / 2**20, "lookups": counts["lookups"],
    }


def main():
    args = parse()
    import record
    import table

    if args.table:
        table.show(args.table, None)
        return
    kept = record.Record()
    temporary = None
    if args.runs is None:
        temporary = tempfile.TemporaryDirectory()
        args.runs = Path(temporary.name)
    args.runs.mkdir(parents=True, exist_ok=True)
    binary, export = build(args)
    names = args.scenes.split(",")
    renderers = [r for r in args.renderers.split(",") if is_installed(r, args.python)]
    for name in names:
        scene = ROOT / "data" / "scenes" / f"{name}.toml"
        subprocess.run([export, scene, args.runs / name], check=True)

    # A block that was rendered before, by an earlier run into the same folder, would be its own
    # reference: its error against itself is zero.
    log = args.runs / "runs.jsonl"
    seeds = [json.loads(line)["seed"] for line in log.read_text().splitlines()] if log.exists() else []
    first = max(seeds, default=99) + 1

    end = time.monotonic() + 60 * args.minutes
    took = {}
    for turn in ((seed, name, r) for seed in range(first, first + args.rounds) for name in names for r in renderers):
        seed, name, renderer = turn
        begin = time.monotonic()
        if begin + took.get((name, renderer), 0) > end:
            continue
        scene = ROOT / "data" / "scenes" / f"{name}.toml"
        spp = args.spp or SPP.get(name, {}).get(renderer, 16)
        image = args.runs / f"{name}.{renderer}.{spp}.{seed}.npy"
        load = round(os.getloadavg()[0], 2)
        if renderer == "majorant":
            told = run_majorant(binary, scene, image, spp, seed, args)
        else:
            told = run_peer(renderer, scene, args.runs / name, image, spp, seed, args)
        took[name, renderer] = time.monotonic() - begin
        line = {"scene": name, "renderer": renderer, "spp": spp, "seed": seed, "file": image.name,
                "threads": args.threads, "load": load, "time": time.strftime("%H:%M:%S"), **told}
        with open(args.runs / "runs.jsonl", "a") as runs:
            runs.write(json.dumps(line) + "\n")
        print(f"{line['time']} {name} {renderer}: {spp} spp, {told['cpu']:.2f} CPU s, "
              f"load {load}", flush=True)
    table.show(args.runs, kept)
    if args.record:
        print(kept.save())
    if temporary:
        temporary.cleanup()


if __name__ == "__main__":
    main()

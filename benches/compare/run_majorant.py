#!/usr/bin/env python3
"""Render a renderer-neutral scene with majorant and record image, time and memory.

    run_majorant.py SCENE.json RUNS --spp 1,4,16x3@100 [--binary PATH] [--threads N]

`16x3@100` are three images of 16 samples a pixel with seeds 100, 101, 102; the first seed is 1
where none is given. Writes, for each, RUNS/<scene>.<renderer>.<spp>.<seed>.npy (height, width, 3;
float32, linear, top row first) and a line of RUNS/runs.jsonl. See README.md for its keys.

Needs numpy and OpenEXR 3.3 or later, both from PyPI.
"""
import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import OpenEXR

BINARY = Path(__file__).resolve().parents[2] / "target" / "release" / "majorant"


def parse_spp(spec):
    """Returns (spp, seed) of each image asked for."""
    images = []
    for part in spec.split(","):
        part, _, first_seed = part.partition("@")
        spp, _, repeats = part.partition("x")
        first = int(first_seed or 1)
        images += [(int(spp), first + i) for i in range(int(repeats or 1))]
    return images


def toml(scene, folder):
    """Returns the scene as majorant's TOML."""
    camera, medium = scene["camera"], scene["medium"]
    if "emission" in medium:
        sys.exit(f"{scene['info']['name']}: majorant does not render emission yet")
    phase = f'type = "henyey-greenstein", g = {medium["g"]}' if medium["g"] else 'type = "isotropic"'
    bounces = scene["path"]["max_bounces"]
    if bounces >= 0:
        sys.exit(f"{scene['info']['name']}: max_bounces {bounces}: only -1 (no limit) is compared")

    def vector(v):
        return json.dumps([float(x) for x in v])

    # A JSON string is a valid TOML basic string.
    lines = [
        "[image]", f"resolution = {json.dumps(scene['resolution'])}",
        "[camera]", f"position = {vector(camera['position'])}",
        f"look_at = {vector(camera['look_at'])}", f"up = {vector(camera['up'])}",
        f"vertical_fov_degrees = {float(camera['vfov_deg'])}",
        "[[volume]]", f"file = {json.dumps(str(folder / medium['vdb']))}",
        f"density = {{ grid = {json.dumps(medium['density'])}, scale = {float(medium['sigma_t_scale'])} }}",
        f"albedo = {vector([medium['albedo']] * 3)}", f"phase = {{ {phase} }}",
    ]
    for light in scene["lights"]:
        if light["type"] == "constant":
            lines += ["[[light]]", 'type = "constant"', f"radiance = {vector(light['radiance'])}"]
        else:
            lines += [
                "[[light]]", 'type = "distant"',
                f"direction_to_light = {vector(light['direction_to_light'])}",
                f"irradiance = {vector(light['irradiance'])}",
                f"angular_diameter_degrees = {float(light['angle_deg'])}",
            ]
    return "\n".join(lines) + "\n"


def read_rgb(path):
    with OpenEXR.File(str(path), separate_channels=True) as image:
        channels = image.channels()
        return np.stack([channels[c].pixels.astype(np.float32) for c in "RGB"], -1)


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("scene", type=Path)
    parser.add_argument("runs", type=Path)
    parser.add_argument("--spp", default="1,4,16")
    parser.add_argument("--binary", type=Path, default=BINARY)
    parser.add_argument("--threads", type=int)
    parser.add_argument("--tag", default="", help="appended to the renderer's name")
    args = parser.parse_args()
    scene = json.loads(args.scene.read_text())
    name, renderer = scene["info"]["name"], "majorant" + args.tag
    args.runs.mkdir(parents=True, exist_ok=True)

    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        scene_file, exr, stats_file = (folder / f for f in ("scene.toml", "x.exr", "stats.json"))
        scene_file.write_text(toml(scene, args.scene.resolve().parent))
        for spp, seed in parse_spp(args.spp):
            command = [args.binary, "render", scene_file, "-q", "-o", exr, "--spp", spp,
                       "--seed", seed, "--stats-json", stats_file]
            if args.threads:
                command += ["-j", args.threads]
            subprocess.run([str(c) for c in command], check=True)
            stats = json.loads(stats_file.read_text())
            wall, cpu = stats["seconds"], stats["cpu_seconds"]
            image = f"{name}.{renderer}.{spp}.{seed}.npy"
            np.save(args.runs / image, read_rgb(exr))
            line = json.dumps({
                "scene": name, "renderer": renderer, "spp": spp, "seed": seed, "file": image,
                "wall": wall["render"], "cpu": cpu["render"],
                "load_wall": wall["load"] + wall["build"], "load_cpu": cpu["load"] + cpu["build"],
                "rss_mb": stats["peak_memory_bytes"] / 2**20,
                "load1": round(os.getloadavg()[0], 2), "time": time.strftime("%H:%M:%S"),
            })
            with open(args.runs / "runs.jsonl", "a") as runs:
                runs.write(line + "\n")
            print(line, flush=True)


if __name__ == "__main__":
    main()

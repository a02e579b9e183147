"""A comparison scene, read from majorant's own scene file, and what all drivers share.

Only what the compared renderers have in common is accepted: one volume of gray extinction and
albedo, an isotropic or Henyey-Greenstein phase function, parallel suns and a constant sky.
"""
import argparse
import json
import resource
import time
import tomllib
from dataclasses import dataclass
from pathlib import Path

import numpy as np


@dataclass
class Scene:
    resolution: list
    camera: dict
    vdb: Path
    grid: str
    sigma_t_scale: float
    albedo: float
    g: float
    sky: list
    suns: list


def read(path):
    """Returns the scene of a .toml file; stops with a message where peers could not follow."""
    path = Path(path)
    text = tomllib.loads(path.read_text())

    def refuse(what):
        raise SystemExit(f"{path}: {what}: the other renderers cannot be compared on it")

    if len(text["volume"]) != 1:
        refuse(f"{len(text['volume'])} volumes")
    volume = text["volume"][0]
    albedo = volume["albedo"]
    if len(set(albedo)) != 1:
        refuse(f"coloured albedo {albedo}")
    phase = volume["phase"]
    if phase["type"] not in ("isotropic", "henyey-greenstein"):
        refuse(f"phase function {phase['type']}")
    sky, suns = [0.0, 0.0, 0.0], []
    for light in text["light"]:
        if light["type"] == "constant":
            sky = light["radiance"]
        elif light["type"] == "distant" and light["angular_diameter_degrees"] == 0:
            suns.append(light)
        else:
            refuse(f"light of type {light['type']}, or a sun with a disk")
    return Scene(
        resolution=text["image"]["resolution"],
        camera=text["camera"],
        vdb=(path.parent / volume["file"]).resolve(),
        grid=volume["density"]["grid"],
        sigma_t_scale=volume["density"]["scale"],
        albedo=albedo[0],
        g=phase.get("g", 0.0),
        sky=sky,
        suns=suns,
    )


def arguments(description):
    """Parses a driver's command line."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("scene", help="scene file")
    parser.add_argument("export", type=Path, help="folder with density.vol of the scene")
    parser.add_argument("image", help=".npy to write: height, width, 3; linear, top row first")
    parser.add_argument("--spp", type=int, required=True)
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--threads", type=int, required=True)
    return parser.parse_args()


class Clock:
    """Wall and CPU seconds of this process since a moment."""

    def __init__(self):
        self.start = self.now()

    @staticmethod
    def now():
        usage = resource.getrusage(resource.RUSAGE_SELF)
        return time.perf_counter(), usage.ru_utime + usage.ru_stime

    def read(self):
        now = self.now()
        return now[0] - self.start[0], now[1] - self.start[1]


def finish(path, image, load, render, version):
    """Writes the image, and one line about the run as the last of the standard output.

    `load` and `render` are pairs of wall and CPU seconds.
    """
    np.save(path, np.ascontiguousarray(image[..., :3], np.float32))
    rss = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    keys = ("load_wall", "load_cpu", "wall", "cpu")
    run = dict(zip(keys, (*load, *render)), rss_mb=rss, version=version)
    print("\n" + json.dumps(run), flush=True)

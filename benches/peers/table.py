"""Errors, costs and ratios of the runs of run.py.

Error is taken over the pixels whose optical depth is above 0.01, in linear RGB:

    relMSE = mean over pixels and channels of (x - r)^2 / (q^2 + 0.01)

* r is the mean of the renderer's other blocks, whose own noise is taken out: E|x - r|^2 =
  K/N + K/M for a block of N samples against M others, and K is what is wanted. So each renderer's
  noise is measured against itself, and a small difference between renderers (colour, spectra)
  does not count as noise.
* q, in the denominator only, is the mean of the renderer with the least noise, for all alike.
* CPU seconds to a relMSE of 0.01 are K / 0.01 samples times the CPU seconds of one: 1/N is assumed.
* Cost comes from quiet runs: those whose CPU time exceeded 0.85 of wall time times threads, so that
  nothing else ran. Where there are none the cheapest run counts, and is marked *.
* Bias shows elsewhere: each renderer's mean over those pixels is held against that of all others, with the
  standard errors of both from the scatter of their blocks.
"""
import json
from collections import defaultdict
from pathlib import Path

import numpy as np

EPSILON = 0.01
SEEN = 0.01
TARGET = 0.01


class Blocks:
    """All images of one renderer on one scene."""

    def __init__(self, runs, folder, mask):
        self.runs = runs
        self.images = [np.load(folder / r["file"]).astype(np.float64)[mask] for r in runs]
        self.spp = np.array([r["spp"] for r in runs], float)
        self.mean = np.tensordot(self.spp, np.stack(self.images), 1) / self.spp.sum()
        quiet = [r["cpu"] / r["spp"] for r in runs if r["cpu"] > 0.85 * r["wall"] * r["threads"]]
        self.is_quiet = bool(quiet)
        self.cost = float(np.median(quiet)) if quiet else min(r["cpu"] / r["spp"] for r in runs)
        self.load_cpu = min(r["load_cpu"] for r in runs)
        self.rss = max(r["rss_mb"] for r in runs)

    def noise(self, denominator):
        """Returns relMSE times samples, and its standard error from the scatter of the blocks."""
        total = self.spp.sum()
        constants = []
        for image, spp in zip(self.images, self.spp):
            others = (self.mean * total - image * spp) / (total - spp)
            error = ((image - others) ** 2 / denominator).mean()
            constants.append(error / (1 / spp + 1 / (total - spp)))
        constants = np.array(constants)
        return constants.mean(), constants.std(ddof=1) / len(constants) ** 0.5

    def level(self):
        """Returns the mean over pixels and channels, and its standard error."""
        means = np.array([i.mean() for i in self.images])
        mean = (means * self.spp).sum() / self.spp.sum()
        scatter = ((means - mean) ** 2 * self.spp).sum() / (len(means) - 1)
        return mean, (scatter / self.spp.sum()) ** 0.5


def load(folder):
    """Returns {scene: {renderer: Blocks}}, without renderers of a single block."""
    runs = defaultdict(lambda: defaultdict(list))
    for line in (folder / "runs.jsonl").read_text().splitlines():
        run = json.loads(line)
        runs[run["scene"]][run["renderer"]].append(run)
    scenes = {}
    for scene, renderers in runs.items():
        depth = np.fromfile(folder / scene / "depth.f32", np.float32)
        shape = np.load(folder / next(iter(renderers.values()))[0]["file"], mmap_mode="r").shape
        mask = depth.reshape(shape[:2]) > SEEN
        print(f"{scene}: {mask.sum()} of {mask.size} pixels see the medium")
        scenes[scene] = {}
        for name, of in renderers.items():
            if len(of) < 2:
                print(f"{scene}: {name} has one block only, and no error without another: left out")
            else:
                scenes[scene][name] = Blocks(of, folder, mask)
    return scenes


def show(folder, record):
    """Prints the tables of the runs in `folder`, and adds their numbers to `record` if given."""
    for scene, renderers in load(Path(folder)).items():
        if not renderers:
            continue
        # Least noise at its own number of samples; the choice needs no denominator.
        best = min(renderers.values(), key=lambda b: b.noise(1.0)[0] / b.spp.sum())
        denominator = best.mean**2 + EPSILON
        noise = {name: blocks.noise(denominator) for name, blocks in renderers.items()}
        seconds = {n: noise[n][0] / TARGET * renderers[n].cost for n in renderers}
        peers = [seconds[n] for n in renderers if n != "majorant"]
        print(f"\n### {scene}\n\n| renderer | samples | CPU ms a sample | relMSE x samples | "
              "CPU s to relMSE 0.01 | best peer / it | load, CPU s | memory, MB | mean | off the others |")
        print("|---|---|---|---|---|---|---|---|---|---|")
        notes = []
        for name in sorted(renderers, key=seconds.get):
            blocks = renderers[name]
            (constant, error), (mean, standard_error) = noise[name], blocks.level()
            ratio = min(peers) / seconds[name] if peers else float("nan")
            others = [renderers[n].level() for n in renderers if n != name]
            weights = np.array([1 / s**2 for _, s in others])
            off = "-"
            if others:
                middle = sum(w * m for w, (m, _) in zip(weights, others)) / weights.sum()
                combined = (standard_error**2 + 1 / weights.sum()) ** 0.5
                off = f"{100 * (mean / middle - 1):+.2f} ± {100 * combined / middle:.2f} %"
            star = "" if blocks.is_quiet else "*"
            print(f"| {blocks.runs[0]['version']} | {blocks.spp.sum():.0f} | {1e3 * blocks.cost:.4g}{star} | "
                  f"{constant:.3g} ± {error:.1g} | {seconds[name]:.3g} | {ratio:.3g} | "
                  f"{blocks.load_cpu:.2f} | {blocks.rss:.0f} | {mean:.5f} | {off} |")
            if name == "majorant" and "lookups" in blocks.runs[0]:
                cpu = sum(r["cpu"] for r in blocks.runs) / sum(r["lookups"] for r in blocks.runs)
                notes.append(f"{scene}: majorant takes {1e9 * cpu:.1f} ns of CPU a density lookup, all in")
                if record:
                    record.add(f"peers/{scene}/{name}", "cpu_time_per_lookup", 1e9 * cpu, "ns/lookup")
            if record:
                for metric, value, unit in (
                    ("samples", blocks.spp.sum(), "1"),
                    ("cpu_time" + star, 1e3 * blocks.cost, "ms/spp"),
                    ("relmse_times_spp", constant, "1"),
                    ("cpu_time_to_relmse_0.01", seconds[name], "s"),
                    ("best_peer_over_this", ratio, "1"),
                    ("load_cpu_time", blocks.load_cpu, "s"),
                    ("peak_memory", blocks.rss, "MB"),
                    ("mean", mean, "1"),
                ):
                    record.add(f"peers/{scene}/{name}", metric, value, unit)
        print("\n" + "\n".join([*notes, "* no quiet run: the cheapest one"]))

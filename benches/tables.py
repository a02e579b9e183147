#!/usr/bin/env python3
"""Fills the tables of docs/performance.md from records.

    benches/tables.py benches/record/CPU/A.csv [B.csv ...]

A table stands between <!-- table NAME --> and <!-- end -->; it is replaced if the records have any
of its numbers, and left alone if not. Where two records have the same number the later file counts.
Below each table stands what was measured: date, commit, processor and load.
"""
import csv
import re
import sys
from pathlib import Path

DOCUMENT = Path(__file__).resolve().parents[1] / "docs" / "performance.md"


class Numbers:
    """(bench, metric) to value, and where the numbers that were asked for came from."""

    def __init__(self, paths):
        self.rows = {}
        for path in paths:
            with open(path) as stream:
                for row in csv.DictReader(stream):
                    self.rows[row["bench"], row["metric"].rstrip("*")] = row
        self.used = {}

    def get(self, bench, metric="time", digits=3, scale=1.0):
        row = self.rows.get((bench, metric))
        if row is None:
            return ""
        source = f"{row['date'][:10]}, {row['commit']}, {row['cpu']}, load {row['load']}, {row['flags']}"
        self.used[source] = True
        value = float(row["value"]) * scale
        text = f"{value:.{digits}g}"
        return f"{value:,.0f}" if "e" in text or abs(value) >= 1000 else text

    def benches(self, prefix):
        return [b[len(prefix):] for b, _ in self.rows if b.startswith(prefix)]


def markdown(head, rows):
    """Returns a table of the rows that have any number; an empty string if none has."""
    rows = [r for r in rows if any(r[1:])]
    if not rows:
        return ""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def unique(names):
    return list(dict.fromkeys(names))


def lookup(n):
    ways = unique(b for b in n.benches("lookup/cloud/path/") if "latency" not in b)
    rows = [
        [way, *(n.get(f"lookup/cloud/{p}/{way}") for p in ("uniform", "ray", "path")),
         n.get(f"lookup/cloud/path/{way}, latency")]
        for way in ways
    ]
    return markdown(["ns a lookup", "uniform", "ray", "path", "path, latency"], rows)


def sizes(n):
    names = unique(b.split("/")[0] for b in n.benches("lookup/size/"))
    ways = unique(b.split("/", 2)[2] for b in n.benches("lookup/size/"))
    rows = [
        [f"{way}: {pattern}", *(n.get(f"lookup/size/{size}/{pattern}/{way}") for size in names)]
        for pattern in ("uniform", "jumps") for way in ways
    ]
    return markdown(["ns a lookup", *names], rows)


def traversal(n):
    kinds = [f"{s}/{k}" for s in ("cloud", "smoke") for k in ("crossing", "missing")]
    rows = [
        [kind, n.get(f"traversal/{kind}", "cells"), n.get(f"traversal/{kind}", "segments"),
         n.get(f"traversal/{kind}, blocks", "segments"), n.get(f"traversal/{kind}"),
         n.get(f"traversal/{kind}, blocks"), n.get(f"traversal/{kind}, flat")]
        for kind in [*kinds, "sparse"]
    ]
    head = ["rays", "cells a ray", "segments a ray: bricks", "blocks", "ns a cell: bricks", "blocks", "flat DDA"]
    return markdown(head, rows)


def bounds(n):
    order = ["4 voxels", "8 voxels", "16 voxels", "32 voxels", "64 voxels", "64 an axis", "global",
             "library, bricks", "library, hierarchy", "library, whole"]
    metrics = ("steps", "segments", "collisions")
    rows = [
        [cells, *(n.get(f"traversal/{scene}/{cells}", f"{m}_per_optical_thickness")
                  for scene in ("cloud", "smoke") for m in metrics)]
        for cells in order
    ]
    head = [f"{scene}: {m}" for scene in ("cloud", "smoke") for m in metrics]
    return markdown(["cells", *head], rows)


def load(n):
    rows = []
    for name in ("cloud", "smoke", "blosc", "zip", "none"):
        bench = f"load/{name}/"
        ours = ["read", "decode, 1 threads", "decode, 2 threads", "build, 1 threads", "build, 2 threads"]
        rows.append([name, *(n.get(bench + b) for b in ours), n.get(bench + "OpenVDB read", "cpu_time")])
    head = ["ns an active voxel", "read", "decode, 1 thread", "2 threads", "build, 1 thread",
            "2 threads", "OpenVDB, CPU"]
    return markdown(head, rows)


def frame(n):
    scenes = ("cloud", "cloud_a999", "smoke", "absorb")
    variants = unique(b.split("/")[1] for b in n.benches("frame/"))
    rows = [[v, *(n.get(f"frame/{s}/{v}", scale=1e-3) for s in scenes)] for v in variants]
    return markdown(["CPU µs a camera sample", *scenes], rows)


def growth(n):
    xs = sorted({int(b.split("/")[1]) for b in n.benches("growth/resolution/")})
    kinds = unique(b.split("/")[0] for b in n.benches("growth/resolution/"))
    rows = [
        [f"{x}³", *(n.get(f"growth/resolution/{k}/{x}", "cpu_time") for k in kinds),
         n.get(f"growth/resolution/auto/{x}", "segments"), n.get(f"growth/resolution/auto/{x}", "lookups"),
         n.get(f"growth/resolution/auto/{x}", "vertices"),
         n.get(f"growth/resolution/auto/{x}", "start_up_cpu_time")]
        for x in xs
    ]
    head = ["resolution", *(f"{k}, µs a sample" for k in kinds), "segments a sample", "lookups", "vertices", "start-up of a frame, CPU ms"]
    return markdown(head, rows)


def memory(n):
    names = unique(n.benches("growth/memory/"))
    rows = [
        [name.replace("/", ", ") + "³", *(n.get(f"growth/memory/{name}", m) for m in
         ("bricks", "occupied", "bits", "memory", "memory_per_stored_byte", "build_cpu_time"))]
        for name in names
    ]
    head = ["storage, resolution", "bricks", "of all", "bits a voxel", "MB", "bytes / (stored voxels × bytes of the encoding)",
            "building, ns a stored voxel"]
    return markdown(head, rows)


def thickness(n):
    xs = sorted({b.split("/")[1] for b in n.benches("growth/thickness/")}, key=float)
    kinds = unique(b.split("/")[0] for b in n.benches("growth/thickness/"))
    rows = [
        [x, *(n.get(f"growth/thickness/{k}/{x}", "cpu_time") for k in kinds),
         *(n.get(f"growth/thickness/auto/{x}", m) for m in ("vertices", "segments", "lookups"))]
        for x in xs
    ]
    head = ["optical thickness", *(f"{k}, µs a sample" for k in kinds), "vertices", "segments", "lookups"]
    return markdown(head, rows)


def threads(n):
    xs = sorted({b for b in n.benches("growth/threads/")}, key=float)
    rows = [[x, *(n.get(f"growth/threads/{x}", m) for m in ("wall_time", "cpu_time"))] for x in xs]
    return markdown(["threads", "wall µs a sample", "CPU µs a sample"], rows)


def peers(n):
    rows = []
    for scene in ("cloud", "cloud_a999", "smoke", "absorb"):
        for renderer in ("majorant", "cycles", "mitsuba"):
            metrics = ("samples", "cpu_time", "relmse_times_spp", "cpu_time_to_relmse_0.01",
                       "best_peer_over_this", "load_cpu_time", "peak_memory")
            rows.append([f"{scene}: {renderer}", *(n.get(f"peers/{scene}/{renderer}", m) for m in metrics)])
    head = ["scene: renderer", "samples", "CPU ms a sample a pixel", "relMSE × samples",
            "CPU s to relMSE 0.01", "best peer / it", "load, CPU s", "memory, MB"]
    return markdown(head, rows)


def per_lookup(n):
    scenes = ("cloud", "cloud_a999", "smoke", "absorb")
    cells = [n.get(f"peers/{scene}/majorant", "cpu_time_per_lookup") for scene in scenes]
    return markdown(["", *scenes], [["ns of CPU a density lookup, all in", *cells]])


TABLES = [lookup, sizes, traversal, bounds, load, frame, growth, thickness, memory, threads, peers, per_lookup]


def main():
    paths = sys.argv[1:]
    if not paths or paths[0].startswith("-"):
        sys.exit(__doc__.strip())
    text = DOCUMENT.read_text()
    for table in TABLES:
        numbers = Numbers(paths)
        made = table(numbers)
        name = table.__name__
        pattern = re.compile(rf"(<!-- table {name} -->\n).*?(<!-- end -->)", re.S)
        if not pattern.search(text):
            sys.exit(f"{DOCUMENT}: no table named {name}")
        if made:
            sources = "\n".join(f"*Measured: {s}.*" for s in numbers.used)
            text = pattern.sub(lambda m: f"{m[1]}{made}\n\n{sources}\n{m[2]}", text)
            print(f"{name}: filled")
    DOCUMENT.write_text(text)


if __name__ == "__main__":
    main()

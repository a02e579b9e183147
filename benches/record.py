#!/usr/bin/env python3
"""Runs benches and keeps what they measured: benches/record/<cpu>/<date>-<commit>.csv.

    benches/record.py                       all criterion benches, about 9 minutes
    benches/record.py lookup traversal      only these
    benches/record.py growth -- --to 1024   with options for the bench
    benches/record.py --dry-run lookup      print the file instead of writing it

Times are medians of criterion's samples, for one element where the bench names elements. What is
not a time comes from lines of "note", bench, metric, value and unit, between tabs, on the benches' standard error. Needs
Python 3.9 and nothing else. README.md in the folder of records explains the columns.
"""
import argparse
import csv
import datetime
import json
import os
import platform
import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
COLUMNS = ["date", "commit", "cpu", "load", "flags", "bench", "metric", "value", "unit"]
CRITERION = ["lookup", "traversal", "load", "frame"]


def output(*command):
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout.strip()


def cpu():
    """Returns the name of the processor and the number of CPUs, and a name for its folder."""
    names = re.findall(r"^model name\s*:\s*(.*)$", Path("/proc/cpuinfo").read_text(), re.M)
    name = names[0] if names else "unknown"
    # "AMD EPYC" and "Intel(R) Xeon(R) Processor" alone do not tell the generations apart.
    numbers = re.findall(r"^(?:cpu family|model)\s*:\s*(\d+)$", Path("/proc/cpuinfo").read_text(), re.M)
    family, model = (int(number) for number in numbers[:2] or (0, 0))
    is_zen4 = 0x10 <= model < 0x20 or 0x60 <= model < 0x80 or 0xa0 <= model < 0xb0
    amd = {25: "zen4" if is_zen4 else "zen3", 26: "zen5"}.get(family, "")
    intel = {143: "sapphire rapids", 207: "emerald rapids"}.get(model, "")
    generation = amd if "AMD" in name else intel if "Intel" in name else ""
    words = re.sub(r"\(R\)| Processor", "", f"{name} {generation}")
    return f"{name} [{os.cpu_count()}]", re.sub(r"[^a-z0-9]+", "-", words.lower()).strip("-")


def rust_flags():
    """Returns the flags of the compiler: of the environment, which goes first, or of the project."""
    if "RUSTFLAGS" in os.environ:
        return os.environ["RUSTFLAGS"]
    config = (ROOT / ".cargo" / "config.toml").read_text()
    [flags] = re.findall(r"^rustflags = \[(.*)\]$", config, re.M)
    return " ".join(json.loads(f"[{flags}]")) if platform.machine() in ("x86_64", "AMD64") else None


class Record:
    """What is the same in all rows of a file. Begin one before measuring: it notes the load."""

    def __init__(self):
        self.date = datetime.datetime.now(datetime.timezone.utc)
        self.load = round(os.getloadavg()[0], 2)
        self.rows = []

    def add(self, bench, metric, value, unit):
        self.rows.append((bench, metric, f"{value:.6g}", unit))

    def write(self, stream):
        changed = output("git", "status", "--porcelain", "--untracked-files=no")
        commit = output("git", "rev-parse", "--short=7", "HEAD") + ("+" if changed else "")
        flags = ", ".join(filter(None, [
            " ".join(output("rustc", "--version").split()[:2]), rust_flags(), "release",
        ]))
        same = [self.date.strftime("%Y-%m-%dT%H:%M:%SZ"), commit, cpu()[0], self.load, flags]
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(COLUMNS)
        writer.writerows([*same, *row] for row in self.rows)

    def save(self):
        """Writes a new file and returns its path: one that is there is never changed."""
        folder = ROOT / "benches" / "record" / cpu()[1]
        folder.mkdir(parents=True, exist_ok=True)
        commit = output("git", "rev-parse", "--short=7", "HEAD")
        stem = f"{self.date:%Y-%m-%d}-{commit}"
        names = (f"{stem}{suffix}.csv" for suffix in ["", *(f"-{i}" for i in range(2, 1000))])
        path = next(folder / name for name in names if not (folder / name).exists())
        with open(path, "w") as stream:
            self.write(stream)
        return path


def collect_criterion(record, since):
    """Adds the times of all benches that ran after `since`."""
    target = Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target"))
    for found in sorted(target.glob("criterion/**/new/estimates.json")):
        if found.stat().st_mtime < since:
            continue
        bench = json.loads(found.with_name("benchmark.json").read_text())
        nanoseconds = json.loads(found.read_text())["median"]["point_estimate"]
        elements = (bench.get("throughput") or {}).get("Elements")
        unit = "ns/element" if elements else "ns"
        record.add(bench["full_id"], "time", nanoseconds / (elements or 1), unit)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("benches", nargs="*", default=CRITERION, metavar="BENCH")
    parser.add_argument("--dry-run", action="store_true", help="print instead of writing")
    own, _, passed = " ".join(sys.argv[1:]).partition(" -- ")
    args = parser.parse_args(own.split())
    # Building is neither measured nor part of the load.
    subprocess.run(["cargo", "bench", "--no-run", "-q"], cwd=ROOT, check=True)
    record = Record()
    since = record.date.timestamp()
    for bench in args.benches:
        command = ["cargo", "bench", "-q", "--bench", bench, "--", *passed.split()]
        run = subprocess.Popen(command, cwd=ROOT, stdout=sys.stderr, stderr=subprocess.PIPE, text=True)
        for line in run.stderr:
            sys.stderr.write(line)
            if line.startswith("note\t"):
                _, name, metric, value, unit = line.strip().split("\t")
                record.add(name, metric, float(value), unit)
        if run.wait() != 0:
            sys.exit(f"record.py: bench {bench} failed")
    collect_criterion(record, since)
    if args.dry_run:
        record.write(sys.stdout)
    else:
        print(record.save())


if __name__ == "__main__":
    main()

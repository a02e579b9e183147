#!/usr/bin/env python3
"""What features cost a scene that does not use them, in instructions.

Renders two scenes under callgrind, at few and at more samples a pixel, so that the difference is
rendering alone. Each instruction of the program belongs to a line of source, and through inlining to
the lines that call it: those of a feature's own code and of the questions whether it is there are
summed up. Neither scene uses any of them, so what is counted is what the others pay. What a feature
does to the compiler's choices elsewhere is not counted.

    cargo build --release && benches/feature_cost.py      one minute; prints a Markdown table

Needs valgrind and addr2line.
"""

import collections
import pathlib
import re
import subprocess
import tempfile

ROOT = pathlib.Path(__file__).resolve().parent.parent
PROGRAM = ROOT / "target/release/majorant"
SCENES = ["cloud", "smoke"]
FEW, MORE = 16, 80

# name: (files, what its lines say)...
FEATURES = {
    "emission": [
        ("src/integrator/(path|primary).rs", "emitters|Emission|steering"),
        ("src/integrator/(emission|steering).rs", ""),
    ],
    "several volumes": [
        ("src/integrator/path.rs", "are_several|nearer|except"),
        ("src/integrator/media.rs", ""),
    ],
    "skies from images, lamps": [
        ("src/integrator/(path|primary).rs", r"lamps|lamplight|has_surroundings|maps|lights\.local"),
        ("src/integrator/surroundings.rs", ""),
    ],
    "colours of albedo and extinction": [
        ("src/medium.rs", "colour"),
        ("src/integrator/primary.rs", "Chromatic"),
        ("src/(integrator|tracking)/chromatic.*", ""),
    ],
    "output variables": [
        ("src/render.rs", "aovs|extent"),
        ("src/integrator/parts.rs", "order|meet|split|each"),
    ],
    "other phase functions": [("src/phase/mod.rs", "match self|sample_lobe")],
}


def instructions(scene, spp, folder):
    """Returns how many instructions are at which address of the program, and of all together."""
    out = f"{folder}/callgrind"
    command = ["valgrind", "--tool=callgrind", "--dump-instr=yes", f"--callgrind-out-file={out}"]
    command += [PROGRAM, "render", ROOT / f"data/scenes/{scene}.toml", "-q", "-j", "1"]
    command += ["-r", "32x18", "--spp", str(spp), "-o", f"{folder}/image.exr"]
    subprocess.run(command, capture_output=True, check=True)
    names, counts, total = {}, collections.Counter(), 0
    is_program, is_call, address = False, False, 0
    for row in open(out):
        if found := re.match(r"ob=\((\d+)\)(?: (.*))?$", row):
            names.setdefault(found[1], found[2])
            is_program = names[found[1]] == str(PROGRAM)
        elif found := re.match(r"cob=\((\d+)\) (.*)$", row):
            names.setdefault(found[1], found[2])
        elif row.startswith("calls="):
            is_call = True
        elif found := re.match(r"(0x[0-9a-f]+|[+-]\d+|\*) \S+ (\d+)$", row):
            if found[1].startswith("0x"):
                address = int(found[1], 16)
            elif found[1] != "*":
                address += int(found[1])
            # The row after a call counts what was called: it is counted where it is.
            if not is_call:
                total += int(found[2])
                if is_program:
                    counts[address] += int(found[2])
            is_call = False
    return counts, total


def lines_of(addresses):
    """Returns the lines of source of each address: its own, and those it is inlined into."""
    command = ["addr2line", "-e", PROGRAM, "-a", "-i"]
    asked = "\n".join(map(hex, addresses))
    text = subprocess.run(command, input=asked, capture_output=True, text=True, check=True).stdout
    lines, address = collections.defaultdict(set), 0
    for row in text.splitlines():
        if row.startswith("0x"):
            address = int(row, 16)
        elif (found := re.search(r"(src/[\w/]+\.rs):(\d+)", row)) and str(ROOT) in row:
            lines[address].add((found[1], int(found[2])))
    return lines


def features_of(lines):
    """Returns the features that lines are about."""
    texts = [(path, (ROOT / path).read_text().splitlines()[n - 1]) for path, n in lines if n > 0]
    return {
        name
        for name, places in FEATURES.items()
        for files, words in places
        for path, text in texts
        if re.fullmatch(files, path) and re.search(words, text)
    }


def main():
    found = {}
    for scene in SCENES:
        with tempfile.TemporaryDirectory() as folder:
            few, few_total = instructions(scene, FEW, folder)
            counts, total = instructions(scene, MORE, folder)
        counts.subtract(few)
        total -= few_total
        lines = lines_of(sorted(counts))
        sums = collections.Counter()
        for address, count in counts.items():
            for name in features_of(lines[address]):
                sums[name] += count
        found[scene] = (sums, total)
    print("| feature | " + " | ".join(f"{s}: M instructions | %" for s in SCENES) + " |")
    print("|---" * (1 + 2 * len(SCENES)) + "|")
    rows = {name: [found[scene][0][name] for scene in SCENES] for name in FEATURES}
    rows["all of the render"] = [found[scene][1] for scene in SCENES]
    for name, counts in rows.items():
        cells = zip(counts, SCENES)
        cells = [f"{n / 1e6:,.2f} | {100 * n / found[scene][1]:.2f}" for n, scene in cells]
        print(f"| {name} | " + " | ".join(cells) + " |")


main()

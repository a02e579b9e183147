#!/usr/bin/env python3
"""Re-encode the float grids of a .vdb file: half floats, Blosc and active mask, class fog volume.

    reencode.py IN.vdb OUT.vdb GRID [GRID ...]

Voxels that hold the background become inactive, leaves without active voxels are dropped and the
metadata that other programs left behind is not copied. Prints the largest rounding error, which
must stay within half a unit in the last place: 2^-11 of the value (half floats have 11 significant
bits and round to nearest) or, for values below 2^-14, 2^-25.

Needs numpy and OpenVDB's Python module 10 or later (Debian: python3-openvdb).
"""
import sys

import numpy as np

try:
    import pyopenvdb as vdb
except ImportError:
    import openvdb as vdb


def dense(grid, box):
    (lo, hi) = box
    out = np.zeros([h - l + 1 for l, h in zip(lo, hi)], np.float32)
    grid.copyToArray(out, ijk=lo)
    return out


def main():
    source, target, names = sys.argv[1], sys.argv[2], sys.argv[3:]
    made, boxes = [], []
    for name in names:
        old = vdb.read(source, name)
        box = old.evalActiveVoxelBoundingBox()
        new = vdb.FloatGrid(old.background)
        new.name, new.gridClass, new.saveFloatAsHalf = name, vdb.GridClass.FOG_VOLUME, True
        new.transform = old.transform
        new.copyFromArray(dense(old, box), ijk=box[0])
        made.append(new)
        boxes.append((old, box))
    vdb.write(target, grids=made, metadata={})
    for old, box in boxes:
        a, b = dense(old, box), dense(vdb.read(target, old.name), box)
        error = np.abs(a - b)
        if (error > np.maximum(np.abs(a) * 2.0**-11, 2.0**-25)).any():
            sys.exit(f"{target}: {old.name}: rounding error above half a unit in the last place")
        back = vdb.read(target, old.name)
        print(f"{target}: {old.name}: {old.activeVoxelCount()} -> {back.activeVoxelCount()} active voxels,"
              f" largest error {error.max():.3g}, sum {a.sum(dtype=float):.6f} -> {b.sum(dtype=float):.6f}")


if __name__ == "__main__":
    main()

#!/usr/bin/env python3
"""Write the damaged .vdb files of this folder, and the table of them in README.md.

    make.py

Each file is one small valid file with one thing wrong. Needs Python 3.9 or later, nothing else.
"""
import os
import struct
import zlib

HERE = os.path.dirname(os.path.abspath(__file__))
MAGIC = 0x56444220
ACTIVE_MASK, ZIP, BLOSC = 2, 1, 4
NODE5, NODE4, LEAF = 32768, 4096, 512


def u32(x):
    return struct.pack("<I", x & 0xFFFFFFFF)


def i64(x):
    return struct.pack("<q", x)


def f32(*x):
    return struct.pack(f"<{len(x)}f", *x)


def string(s):
    return u32(len(s)) + s.encode()


def metadata(entries, count=None):
    body = b"".join(string(k) + string(t) + u32(len(v)) + v for k, t, v in entries)
    return u32(len(entries) if count is None else count) + body


def mask(bits, size):
    return sum(1 << b for b in bits).to_bytes(size // 8, "little")


def header(magic=MAGIC, version=224, file_metadata=None, grids=1):
    uuid = b"00000000-0000-4000-8000-000000000000"
    meta = metadata([]) if file_metadata is None else file_metadata
    return i64(magic) + u32(version) + u32(10) + u32(0) + b"\1" + uuid + meta + u32(grids)


def uniform_scale(size):
    # scale, voxel size, scale inverse, inverse squared, half inverse: all three-vectors
    def v(x):
        return struct.pack("<3d", x, x, x)

    inverse = 1 / size if size else float("inf")
    half = v(0.5 / size if size else float("inf"))
    return string("UniformScaleMap") + v(size) + v(size) + v(inverse) + v(inverse * inverse) + half


class Grid:
    """A FloatGrid of one leaf at the origin with four active voxels, and knobs to spoil it."""

    def __init__(self, **changes):
        self.name, self.type, self.parent = "density", "Tree_float_5_4_3", ""
        self.name_length = None
        self.compression = ACTIVE_MASK
        self.meta = metadata([("class", "string", b"fog volume"), ("name", "string", b"density")])
        self.transform = uniform_scale(0.1)
        self.buffers, self.root_tiles, self.root_children = 1, 0, 1
        self.origins = [(0, 0, 0)]
        self.voxels = {0: 1.0, 9: 0.5, 73: 0.25, 511: 0.125}
        self.buffer_mask = None
        self.payload = None
        self.body = None
        self.grid_offset = None
        self.end_shift = 0
        for key, value in changes.items():
            assert hasattr(self, key), key
            setattr(self, key, value)

    def topology(self):
        out = f32(0.0) + u32(self.root_tiles) + u32(self.root_children)
        for origin in self.origins:
            out += struct.pack("<3i", *origin)
            for size in (NODE5, NODE4):  # child mask, value mask, no active tiles
                out += mask([0], size) + mask([], size) + b"\0" + self.empty_values()
            out += mask(self.voxels, LEAF)
        return out

    def empty_values(self):
        if self.compression & ZIP:
            return i64(0)
        if self.compression & BLOSC:  # an empty chunk, stored raw: size not above zero
            return i64(0)
        return b""

    def leaf_buffers(self):
        payload = self.payload
        if payload is None:
            payload = f32(*(self.voxels[k] for k in sorted(self.voxels)))
        bits = self.voxels if self.buffer_mask is None else self.buffer_mask
        return (mask(bits, LEAF) + b"\0" + payload) * len(self.origins)

    def bytes_at(self, start):
        """The descriptor with absolute offsets, then the body."""
        length = len(self.name) if self.name_length is None else self.name_length
        head = u32(length) + self.name.encode() + string(self.type) + string(self.parent)
        begin = start + len(head) + 24
        front = u32(self.compression) + self.meta + self.transform + u32(self.buffers)
        blocks = self.topology()
        body = front + blocks + self.leaf_buffers() if self.body is None else self.body
        at_blocks = begin + (len(front + blocks) if self.body is None else 0)
        end = begin + len(body) + self.end_shift
        first = begin if self.grid_offset is None else self.grid_offset
        return head + i64(first) + i64(at_blocks) + i64(end) + body


def archive(*grids, **head):
    out = header(grids=head.pop("grids", len(grids)), **head)
    for g in grids:
        out += g.bytes_at(len(out))
    return out


def one(**changes):
    return archive(Grid(**changes))


def blosc_header(nbytes, blocksize, cbytes):
    # format version 2, lz4 version 1, shuffled, 4 bytes a value
    return struct.pack("<BBBBIII", 2, 1, 0x21, 4, nbytes, blocksize, cbytes)


VALID = one()
TOPOLOGY = VALID.index(string("UniformScaleMap")) + len(uniform_scale(1)) + 4

# name, what is wrong, `info`, `render`. "listed": the grid is named, with the reason why it
# cannot be rendered; "error": exit code other than 0 and a message with file and position.
CASES = [
    ("valid.vdb", VALID, "nothing: the file that the others are made from", "ok", "ok"),
    ("empty.vdb", b"", "no bytes at all", "error", "error"),
    ("text.vdb", b"P3\n# not a volume, whatever the name says\n" * 4, "another format", "error", "error"),
    ("magic_swapped.vdb", struct.pack(">q", MAGIC) + VALID[8:], "magic number in big-endian order", "error", "error"),
    ("version_999.vdb", archive(Grid(), version=999), "version 999", "error", "error"),
    ("version_200.vdb", archive(Grid(), version=200), "version 200, older than what is read", "error", "error"),
    ("cut_in_header.vdb", VALID[:30], "ends within the header", "error", "error"),
    ("cut_in_metadata.vdb", archive(Grid(), file_metadata=metadata([("note", "string", b"x" * 80)]))[:90],
     "ends within the file's metadata", "error", "error"),
    ("cut_in_topology.vdb", VALID[:TOPOLOGY + 3000], "ends within the node masks", "error", "error"),
    ("cut_in_values.vdb", VALID[:-6], "ends within the last leaf's values", "error", "error"),
    ("huge_name.vdb", one(name_length=0xFFFFFFF0), "grid name of 4 GiB", "error", "error"),
    ("huge_metadata_value.vdb",
     archive(file_metadata=u32(1) + string("note") + string("string") + u32(0xFFFFFFF0), grids=1),
     "metadata value of 4 GiB", "error", "error"),
    ("huge_metadata_count.vdb", archive(file_metadata=metadata([], 0xFFFFFFFF), grids=1),
     "four billion metadata entries", "error", "error"),
    ("huge_grid_count.vdb", archive(grids=0x7FFFFFFF), "two billion grids", "error", "error"),
    ("negative_grid_count.vdb", archive(Grid(), grids=-1), "minus one grids", "error", "error"),
    ("no_grids.vdb", archive(), "a valid file without any grid", "ok", "error"),
    ("missing_parent.vdb", one(parent="nowhere", body=u32(ACTIVE_MASK) + metadata([]) + uniform_scale(0.1)),
     "instance of a grid that is not there", "error", "error"),
    ("own_parent.vdb", one(parent="density", body=u32(ACTIVE_MASK) + metadata([]) + uniform_scale(0.1)),
     "instance of itself", "error", "error"),
    ("offset_beyond_end.vdb", one(grid_offset=1 << 40), "grid starts a terabyte behind the end", "error", "error"),
    ("offset_negative.vdb", one(grid_offset=-1), "grid starts before the file", "error", "error"),
    ("offset_in_header.vdb", one(grid_offset=20), "grid starts within the header", "error", "error"),
    ("end_beyond_file.vdb", one(end_shift=1 << 40), "grid ends a terabyte behind the end", "error", "error"),
    ("points.vdb", one(type="Tree_ptdataidx32_5_4_3", body=u32(ACTIVE_MASK) + metadata([]) + uniform_scale(0.1)),
     "a points grid, which has no density", "listed", "error"),
    ("tree_4_3.vdb", one(type="Tree_float_4_3"), "a tree of another shape", "listed", "error"),
    ("type_nonsense.vdb", one(type="Tree_\x01\x02"), "a grid type that does not exist", "listed", "error"),
    ("huge_root_children.vdb", one(root_children=0xFFFFFFFF), "four billion root children", "error", "error"),
    ("huge_root_tiles.vdb", one(root_tiles=0x7FFFFFFF), "two billion root tiles", "error", "error"),
    ("root_unaligned.vdb", one(origins=[(8, 0, 0)]), "root child that is not at a multiple of 4096", "error", "error"),
    ("root_twice.vdb", one(root_children=2, origins=[(0, 0, 0)] * 2), "two root children in one place", "error", "error"),
    ("buffers_two.vdb", one(buffers=2), "leaves of two buffers", "error", "error"),
    ("leaf_masks_differ.vdb", one(buffer_mask={0, 1, 2, 3}), "values under another mask than the topology's", "error", "error"),
    ("compression_unknown.vdb", one(compression=0x40), "a codec that does not exist", "error", "error"),
    ("zip_huge_chunk.vdb", one(compression=ZIP | ACTIVE_MASK, payload=i64(1 << 60)), "zip chunk of an exabyte", "error", "error"),
    ("zip_bomb.vdb", one(compression=ZIP | ACTIVE_MASK, payload=(lambda z: i64(len(z)) + z)(zlib.compress(bytes(1 << 24), 9)[:4096])),
     "zip chunk of 16 MiB where 16 bytes belong: no more are inflated", "ok", "ok"),
    ("zip_garbage.vdb", one(compression=ZIP | ACTIVE_MASK, payload=i64(16) + b"\x78\x9c" + b"\xff" * 14),
     "zip chunk that is no zip", "error", "error"),
    ("blosc_huge.vdb", one(compression=BLOSC | ACTIVE_MASK, payload=i64(20) + blosc_header(0x7FFFFFFF, 0x7FFFFFFF, 20) + b"\0" * 4),
     "blosc header that promises 2 GiB", "error", "error"),
    ("blosc_short.vdb", one(compression=BLOSC | ACTIVE_MASK, payload=i64(3) + b"\2\1\x21"),
     "blosc chunk shorter than its own header", "error", "error"),
    ("blosc_cbytes.vdb", one(compression=BLOSC | ACTIVE_MASK, payload=i64(20) + blosc_header(16, 16, 9999) + b"\0" * 4),
     "blosc header that claims more bytes than its chunk has", "error", "error"),
    ("blosc_raw_huge.vdb", one(compression=BLOSC | ACTIVE_MASK, payload=i64(-(1 << 50)) + b"\0" * 16),
     "uncompressed blosc chunk of a petabyte", "error", "error"),
    ("map_unknown.vdb", one(transform=string("SpiralMap") + b"\0" * 24), "a transform that does not exist", "listed", "error"),
    ("voxel_size_zero.vdb", one(transform=uniform_scale(0.0)), "voxels without volume", "listed", "error"),
    ("voxel_size_nan.vdb", one(transform=uniform_scale(float("nan"))), "voxels of size NaN", "listed", "error"),
    ("nan_values.vdb", one(voxels={0: 1.0, 9: float("nan"), 73: float("inf"), 511: 0.125}),
     "NaN and infinite densities; `--sanitize` makes them 0", "ok", "error"),
    ("negative_values.vdb", one(voxels={0: 1.0, 9: -0.5, 73: -1e30, 511: 0.125}),
     "negative densities: clamped to 0 and counted", "ok", "ok"),
]

INTRO = """# Damaged files

Small files with one thing wrong each, written by `make.py`; CC0. No file may crash, hang or
exhaust the memory of any program that opens it.

What must happen: `error` is an exit code other than 0 and a message that names the file and what
is wrong with it; `listed` means that `info` shows the grid with the reason why it cannot be
rendered; `ok` means success.

| File | Bytes | What is wrong | `info` | `render` |
|---|---|---|---|---|
"""


def main():
    rows = []
    for name, data, what, info, render in CASES:
        with open(os.path.join(HERE, name), "wb") as f:
            f.write(data)
        rows.append(f"| {name} | {len(data)} | {what} | {info} | {render} |\n")
    with open(os.path.join(HERE, "README.md"), "w") as f:
        f.write(INTRO + "".join(rows))


if __name__ == "__main__":
    main()

"""Headers that state more data than the file contains are refused without allocating that much
memory.
"""

from __future__ import annotations

import json
import struct
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from helpers.argoverse2_files import write_table
from helpers.readable_files import bag, every_scan
from helpers.resource_limits import memory_ends_after
from helpers.scan_folders import WRITERS, XYZ

from dynaviz.errors import DataError
from dynaviz.io.feather import read_feather
from dynaviz.io.fields import read_points
from dynaviz.io.kitti import read_tracklets

LIMIT = 200 << 20  # bytes of memory; every header here states more, and every file is much smaller

READERS: dict[str, Callable[[Path], Any]] = {
    "points": read_points,
    "feather": lambda path: read_feather(path, ("x",)),
    "xml": read_tracklets,
    "bag": every_scan("rosbag"),
}


def pcd(data: str, body: bytes = b"1 2 3\n") -> bytes:
    fields = "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\n"
    return (
        f"{fields}WIDTH 300000000000\nHEIGHT 1\nPOINTS 300000000000\nDATA {data}\n".encode() + body
    )


def ply(order: str) -> bytes:
    properties = "".join(f"property float {axis}\n" for axis in "xyz")
    head = f"ply\nformat {order} 1.0\nelement vertex 99999999999999\n{properties}end_header\n"
    return f"{head}1 2 3\n".encode()


def npy() -> bytes:
    head = "{'descr': '<f4', 'fortran_order': False, 'shape': (99999999999, 3)}".ljust(117) + "\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(head)) + head.encode() + bytes(12)


def las(version: int, counts: bytes, at: int) -> bytes:
    content = bytearray(500)
    content[:4], content[24:26] = b"LASF", bytes([1, version])
    size = 375 if version == 4 else 227
    struct.pack_into(
        "<HIIBH", content, 94, size, size, 0, 1 if version < 4 else 6, 28 if version < 4 else 30
    )
    struct.pack_into("<3d", content, 131, 0.001, 0.001, 0.001)
    content[at : at + len(counts)] = counts
    return bytes(content)


ENTITY_EXPANSION = (
    '<?xml version="1.0"?><!DOCTYPE x [<!ENTITY a0 "ha">'
    + "".join(f'<!ENTITY a{k + 1} "{f"&a{k};" * 10}">' for k in range(12))
    + "]><x><tracklets><item>&a12;</item></tracklets></x>"
).encode()

# By name: suffix, content and reader of a file whose header states too much.
FILES: dict[str, tuple[str, bytes, str]] = {
    "pcd, ascii": (".pcd", pcd("ascii"), "points"),
    "pcd, binary": (".pcd", pcd("binary"), "points"),
    "pcd, compressed": (
        ".pcd",
        pcd("binary_compressed", struct.pack("<II", 20, 2**32 - 1) + bytes(20)),
        "points",
    ),
    "ply, ascii": (".ply", ply("ascii"), "points"),
    "ply, binary": (".ply", ply("binary_little_endian"), "points"),
    "npy": (".npy", npy(), "points"),
    "las 1.2, points": (".las", las(2, struct.pack("<I", 2**32 - 1), 107), "points"),
    "las 1.4, points": (".las", las(4, struct.pack("<Q", 2**60), 247), "points"),
    "las, records": (".las", las(2, struct.pack("<I", 2**32 - 1), 100), "points"),
    "xml": (".xml", ENTITY_EXPANSION, "xml"),
}


def false_sizes(content: bytes, kind: str) -> Iterator[tuple[str, int, bytes]]:
    """Positions of sizes in a valid file, with a size that the file cannot have."""
    if kind == "laz":
        (points_at,) = struct.unpack_from("<I", content, 96)
        (chunks,) = struct.unpack_from("<q", content, points_at)
        yield "chunks", chunks + 4, struct.pack("<I", 2**32 - 1)
    elif kind == "feather":
        yield "footer", len(content) - 10, struct.pack("<I", 2**31 - 10)
    elif kind == "ros1":
        yield "header", 13, struct.pack("<I", 2**32 - 1)
    elif kind == "mcap":
        yield "record", 9, struct.pack("<Q", 2**62)


def jobs(folder: Path) -> Iterator[tuple[str, str, Path]]:
    """Name, reader and path of each file.

    Valid files come first, so that all libraries are loaded.
    """
    write_table(folder / "a.feather", {"x": XYZ[0, :, 0]})
    valid = {"feather": ("feather", folder / "a.feather")}
    for suffix in (".las", ".laz", ".npy", ".pcd", ".ply"):
        WRITERS[suffix](folder / f"a{suffix}", XYZ[0])
        valid[suffix[1:]] = "points", folder / f"a{suffix}"
    for kind in ("ros1", "mcap"):
        (folder / kind).mkdir()
        valid[kind] = "bag", bag(kind).make(folder / kind)
    for kind, (reader, path) in valid.items():
        yield f"valid {kind}", reader, path
    for name, (suffix, content, reader) in FILES.items():
        path = folder / f"{name}{suffix}"
        path.write_bytes(content)
        yield name, reader, path
    for kind, (reader, path) in valid.items():
        file = path if path.is_file() else next(path.glob("*.mcap"))
        for what, at, size in false_sizes(content := file.read_bytes(), kind):
            damaged = folder / f"{kind} {what}{file.suffix}"
            damaged.write_bytes(content[:at] + size + content[at + len(size) :])
            yield f"{kind}, {what}", reader, damaged


def read_with_little_memory(jobs: list[tuple[str, str, str]]) -> None:
    """Run in a child process: read each file and print the outcome."""
    for name, reader, path in jobs:
        with memory_ends_after(8 << 30 if name.startswith("valid") else LIMIT):
            try:
                READERS[reader](Path(path))
                outcome = "read"
            except DataError as error:
                outcome = f"refused: {error}"
            except Exception as error:
                outcome = f"{type(error).__name__}: {error}"
        print(json.dumps([name, outcome]), flush=True)


def test_false_sizes_are_refused_with_little_memory(tmp_path: Path) -> None:
    work = [(name, reader, str(path)) for name, reader, path in jobs(tmp_path)]
    tests = Path(__file__).parents[1]
    folders = [str(tests), str(tests / "fuzz")]
    script = (
        f"import json, sys; sys.path[:0] = {folders!r}\n"
        "from test_header_sizes import "
        "read_with_little_memory\nread_with_little_memory(json.load(sys.stdin))"
    )
    child = subprocess.run(
        [sys.executable, "-c", script],
        input=json.dumps(work),
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )
    outcomes = dict(json.loads(line) for line in child.stdout.splitlines())
    assert list(outcomes) == [name for name, _, _ in work], (
        f"the reader exited with {child.returncode}: {child.stderr}"
    )
    for name, outcome in outcomes.items():
        assert outcome.startswith("read" if name.startswith("valid") else "refused"), (
            f"{name}: {outcome}"
        )
        assert "llocate" not in outcome, f"{name}: the stated size was allocated: {outcome}"

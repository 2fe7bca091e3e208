"""Speed of reading scans, as a ratio to reading the same bytes without parsing.

    python benchmarks/reading.py [POINTS] [FILES]

Writes scans to a temporary folder and reads them in several ways, which alternate over several rounds; the best round
is used. The files are in the page cache, so the disk is not measured.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from dynaviz.io.pcd import read_pcd, write_pcd
from dynaviz.io.velodyne import read_velodyne
from dynaviz.sources.datasets import open_sequence

ROUNDS = 7


def write_scans(folder: Path, points: int, files: int) -> None:
    random = np.random.default_rng(0)
    cloud = []
    for k in range(files):
        azimuth, distance = random.uniform(-np.pi, np.pi, points), random.gamma(2.0, 8.0, points)
        xyz = np.round(
            np.column_stack([distance * np.cos(azimuth), distance * np.sin(azimuth), random.normal(size=points)]), 3
        )
        fields = dict(zip(("x", "y", "z", "intensity"), np.c_[xyz, random.random(points)].astype("f4").T, strict=True))
        write_pcd(folder / f"sequence/pcd/{k:06d}.pcd", fields, np.eye(4))
        np.column_stack(list(fields.values())).tofile(folder / f"{k:06d}.bin")
        cloud.append({**fields, "intensity": (random.random(points) < 0.01).astype("f4")})
    together = {name: np.concatenate([scan[name] for scan in cloud]) for name in cloud[0]}
    write_pcd(folder / "sequence/gt_cloud.pcd", together)


def seconds(ways: dict[str, Callable[[], Any]]) -> dict[str, float]:
    """Best time of each way; each round runs all ways, so other programs affect all of them."""
    best = dict.fromkeys(ways, np.inf)
    for _ in range(ROUNDS):
        for name, way in ways.items():
            start = time.perf_counter()
            way()
            best[name] = min(best[name], time.perf_counter() - start)
    return best


def main(points: int = 120_000, files: int = 20) -> None:
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        write_scans(folder, points, files)
        pcds = sorted(folder.glob("sequence/pcd/*.pcd"))
        bins = sorted(folder.glob("*.bin"))
        sequence = open_sequence(str(folder / "sequence"))
        plain, fromfile = "plain read() of the binary files", "np.fromfile of the .bin files"
        took = seconds(
            {
                plain: lambda: [path.read_bytes() for path in pcds],
                fromfile: lambda: [np.fromfile(path, np.float32) for path in bins],
                "velodyne .bin": lambda: [read_velodyne(path) for path in bins],
                "PCD binary, rows": lambda: [read_pcd(path) for path in pcds],
                "PCD binary, xyz": lambda: [read_pcd(path).xyz for path in pcds],
                "benchmark's layout, scans with labels": lambda: [sequence[k] for k in range(len(sequence))],
            }
        )
    megabytes = 16 * points * files / 1e6
    title = f"{files} scans of {points:,} points"
    table = Table("way", "ms per scan", "MB/s of points", "x plain", "x fromfile", title=title)
    for name, time_taken in took.items():
        ratios = (f"{time_taken / took[base]:.2f}" for base in (plain, fromfile))
        table.add_row(name, f"{time_taken / files * 1e3:.2f}", f"{megabytes / time_taken:,.0f}", *ratios)
    Console(width=120).print(table)


if __name__ == "__main__":
    main(*map(int, sys.argv[1:3]))

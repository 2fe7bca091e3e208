"""Seconds a frame of BeautyMap, step by step, and the memory of its map.

    python benchmarks/beautymap.py                   60 frames of a street, 120 000 points each, made here
    python benchmarks/beautymap.py FOLDER            the pcd/*.pcd of a folder in the benchmark's layout
    python benchmarks/beautymap.py FOLDER --frames 30

Everything is measured in one process, after a first round that compiles; the least of three rounds counts.
"""

from __future__ import annotations

import argparse
import resource
import time
from collections import defaultdict
from pathlib import Path

import numpy as np
from octomap import read, street, timed

from dynaviz import kernels
from dynaviz.method import Context
from dynaviz.scan import Scan
from dynaviz.survey import Extent
from dynaviz_methods.beautymap import BeautyMap

ENCODE = ("bounds", "directory", "lowest", "level", "fill", "histograms")
STEPS = ("look", "judge", "split", "reasons")
ROUNDS = 3


def run(scans: list[Scan], raw_map: np.ndarray) -> tuple[float, float, BeautyMap, np.ndarray]:
    """Seconds to encode the map, seconds a frame, the method, and all labels."""
    method = BeautyMap(BeautyMap.Params())
    start = time.perf_counter()
    method.begin(Context(Extent.of(scans[0]), raw_map=raw_map))
    begun = time.perf_counter()
    for scan in scans:
        method.observe(scan)
    labels = [method.label(scan) for scan in scans]
    return begun - start, (time.perf_counter() - begun) / len(scans), method, np.concatenate(labels)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, nargs="?")
    parser.add_argument("--frames", type=int)
    arguments = parser.parse_args()
    scans = read(arguments.folder, arguments.frames) if arguments.folder else street(arguments.frames or 60)
    raw_map = np.concatenate([scan.points for scan in scans])
    print(f"{len(scans)} frames of {np.mean([len(s) for s in scans]):.0f} points; {kernels.set_threads(None)} threads")

    run(scans[:2], raw_map)  # compile
    profile: defaultdict[str, list[float]] = defaultdict(list)
    for step in ENCODE + STEPS:
        setattr(kernels.columns, step, timed(getattr(kernels.columns, step), profile[step]))
    rounds = []
    for _ in range(ROUNDS):
        for seconds in profile.values():
            seconds.clear()
        encoded, frame, method, labels = run(scans, raw_map)
        rounds.append((frame, encoded, {step: sum(profile[step]) for step in profile}))
    frame, encoded, spent = min(rounds, key=lambda r: r[0])
    print(f"map: {encoded:.2f} s for {len(raw_map)} points, before the first frame")
    for step in ENCODE:
        print(f"  {step:20} {1000 * spent[step]:7.1f} ms")
    print(f"{frame:.4f} s a frame; {labels.mean():.2%} of the points removed")
    for step in STEPS:
        print(f"  {step:20} {1000 * spent[step] / len(scans):7.2f} ms")
    rest = frame - sum(spent[step] for step in STEPS) / len(scans)
    print(f"  {'the rest, in numpy':20} {1000 * rest:7.2f} ms")

    arrays = [value for value in vars(method).values() if isinstance(value, np.ndarray)] + [method._grid[2]]
    columns = int(np.isfinite(method._base).sum())
    print(
        f"map: {sum(a.nbytes for a in arrays) / 1e6:.1f} MB; {columns} columns with points, {method._rows[-1]} slices"
    )
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"peak memory of all this: {peak:.0f} MB, all scans and the raw map included")


if __name__ == "__main__":
    main()

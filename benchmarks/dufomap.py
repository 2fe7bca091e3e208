"""Seconds a frame of DUFOMap, step by step, its memory, and its ratio to the public program where that is installed.

    python benchmarks/dufomap.py                      a street of 120 000 points a frame, made here
    python benchmarks/dufomap.py FOLDER               the pcd/*.pcd of a folder in the benchmark's layout
    python benchmarks/dufomap.py FOLDER --frames 30

Everything is measured in one process, after a first round that compiles. The public program (``pip install dufomap``)
runs on the first frames only, in turn with ours, on as many threads; of each the fastest round counts.
"""

from __future__ import annotations

import argparse
import importlib
import resource
import sys
import time
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from octomap import read, street, timed

from dynaviz import kernels
from dynaviz.method import Context
from dynaviz.scan import Scan
from dynaviz.survey import Extent
from dynaviz_methods.dufomap import DufoMap
from dynaviz_methods.voids import VoidGrid

STEPS = {
    "points: locate": ("blocks", "locate"),  # both when observing and when labelling
    "points: range": ("voids", "in_range"),
    "hit: mark": ("voids", "hit"),
    "observed: mark": ("voids", "observe"),
    "collect": ("raycast", "collect"),
    "void: sides": ("voids", "sides"),
    "void: erode": ("voids", "erode"),
}
ROUNDS, FEW = 3, 20


def run(scans: list[Scan], extent: Extent, **values: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Seconds of each frame, observing and labelling, and all labels."""
    method = DufoMap(DufoMap.Params(**values))
    method.begin(Context(extent))
    observed, labelled, labels = [], [], []
    for scan in scans:
        start = time.perf_counter()
        method.observe(scan)
        observed.append(time.perf_counter() - start)
    for scan in scans:
        start = time.perf_counter()
        labels.append(method.label(scan))
        labelled.append(time.perf_counter() - start)
    return np.array(observed), np.array(labelled), np.concatenate(labels)


def load_public() -> Any:
    """The public program's module, which has the name of this file."""
    sys.path[:] = [path for path in sys.path if Path(path).resolve() != Path(__file__).resolve().parent]
    return importlib.import_module("dufomap")


def public(scans: list[Scan], threads: int) -> tuple[float, np.ndarray]:
    """Seconds a frame of the public program, and its labels, with its example's limits of range."""
    program = load_public().dufomap(0.1, 0.2, 1, threads)
    near = [np.linalg.norm(scan.points - scan.position.astype(np.float32), axis=1) for scan in scans]
    chosen = [scan.points[(r > 0.2) & (r < 50)] for scan, r in zip(scans, near, strict=True)]
    start = time.perf_counter()
    for scan, points in zip(scans, chosen, strict=True):
        program.run(points, scan.T_world_sensor, False)
    labels = [program.segment(scan.points, scan.T_world_sensor, False) for scan in scans]
    return (time.perf_counter() - start) / len(scans), np.concatenate(labels) > 0


def compare(scans: list[Scan], threads: int) -> None:
    """Ours and the public program in turn."""
    try:
        load_public()
    except ImportError:
        print("\nthe public program is not installed: pip install dufomap")
        return
    extent, times = Extent.of(*scans), defaultdict(list)
    for _ in range(ROUNDS):
        observed, labelled, ours = run(scans, extent, max_range=50.0)
        times["ours"].append(observed.mean() + labelled.mean())
        seconds, theirs = public(scans, threads)
        times["theirs"].append(seconds)
    least = {name: min(seconds) for name, seconds in times.items()}
    print(f"\npublic program on {len(scans)} frames up to 50 m: {least['theirs']:.4f} s a frame, {threads} threads")
    print(f"dufomap on the same: {least['ours']:.4f} s, {least['theirs'] / least['ours']:.2f} times as fast")
    print(
        f"same label: {100 * (ours == theirs).mean():.5f} % of points, {100 * ours[theirs].mean():.3f} % of its removed"
    )


def fastest(call: Callable[[], tuple[np.ndarray, ...]]) -> tuple[np.ndarray, ...]:
    """Of some rounds the one with the least sum of its first two answers."""
    return min((call() for _ in range(ROUNDS)), key=lambda answer: answer[0].sum() + answer[1].sum())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, nargs="?")
    parser.add_argument("--frames", type=int)
    arguments = parser.parse_args()
    scans = read(arguments.folder, arguments.frames) if arguments.folder else street(arguments.frames or 60)
    extent, threads = Extent.of(*scans), kernels.set_threads(None)
    print(f"{len(scans)} frames of {np.mean([len(s) for s in scans]):.0f} points; {threads} threads")

    run(scans[:2], extent)  # compile
    profile: defaultdict[str, list[float]] = defaultdict(list)
    for step, (module, name) in STEPS.items():
        setattr(getattr(kernels, module), name, timed(getattr(getattr(kernels, module), name), profile[step]))
    observed, labelled, labels = fastest(lambda: run(scans, extent))
    total = observed.mean() + labelled.mean()
    print(f"\ndufomap: {total:.4f} s a frame; observe {observed.mean():.4f}, label {labelled.mean():.4f}")
    steps = {step: sum(s) / len(scans) / ROUNDS for step, s in profile.items() if s}
    for step, mean in (steps | {"the rest, in numpy": total - sum(steps.values())}).items():
        print(f"  {step:20} {1000 * mean:7.2f} ms")
    kernels.set_threads(1)
    alone, _, same = fastest(lambda: run(scans, extent))
    kernels.set_threads(threads)
    print(f"  on one thread {alone.mean() / observed.mean():.2f} times as long; same labels: {(same == labels).all()}")
    for margin in (2, 3):
        observed, labelled, _ = run(scans, extent, unknown_margin=margin)
        print(f"  with unknown_margin {margin}: {observed.mean() + labelled.mean():.4f} s a frame")

    print("\nmemory, and time as the map grows")
    for frames in sorted({len(scans) // 4, len(scans) // 2, len(scans)} - {0}):
        extent = Extent.of(*scans[:frames])
        last = run(scans[:frames], extent)[0][-frames // 4 :].mean()
        grid = VoidGrid(extent, 0.1, 0.2, 1)
        print(
            f"  {frames:5}: {last:.4f} s for each of the last; {len(extent.cells)} blocks with points, {len(grid)} with"
        )
        print(f"         those around, {len(grid) * (16 + 8 + 1) * 8 / 1e6:.0f} MB")
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"peak memory of all this: {peak:.0f} MB, all scans included")
    compare(scans[:FEW], threads)


if __name__ == "__main__":
    main()

"""Seconds a frame of Dynablox, step by step, and its ratio to the same signed distances in plain numpy.

    python benchmarks/dynablox.py                      a street of 120 000 points a frame, made here
    python benchmarks/dynablox.py FOLDER               the pcd/*.pcd of a folder in the benchmark's layout
    python benchmarks/dynablox.py FOLDER --frames 30

Everything is measured in one process, after a first round that compiles. numpy runs on the first frames only.
"""

from __future__ import annotations

import argparse
import resource
import time
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
from octomap import read, street, timed

from dynaviz import kernels
from dynaviz.method import Context
from dynaviz.params import resolve
from dynaviz.scan import Scan
from dynaviz.sensors import load_sensor
from dynaviz.survey import Extent
from dynaviz_methods.dynablox import Dynablox

SENSOR = load_sensor("hdl64e")
PARAMS = resolve(Dynablox, preset="kitti").params
STEPS = {
    "range image: pixels": ("signed_distance", "pixels"),
    "range image: nearest": ("signed_distance", "image"),
    "distances: blocks in view": ("signed_distance", "in_view"),
    "distances: average": ("signed_distance", "integrate"),
    "free: points": ("ever_free", "put"),
    "free: occupied": ("ever_free", "occupy"),
    "free: release": ("ever_free", "release"),
    "free: revoke": ("ever_free", "revoke"),
    "moving: look up": ("ever_free", "get"),
    "moving: grow": ("clusters", "grow"),
    "moving: merge": ("clusters", "merge"),
    "locate": ("blocks", "locate"),
}
PLAIN_FRAMES = 3


def run(scans: list[Scan]) -> tuple[Any, np.ndarray, np.ndarray]:
    """The method, seconds of each frame to observe, and of each to label."""
    method = Dynablox(PARAMS)
    method.begin(Context(Extent.of(*scans), SENSOR))
    observed: list[float] = []
    labelled: list[float] = []
    observe, label = timed(method.observe, observed), timed(method.label, labelled)
    for scan in scans:
        observe(scan)
        label(scan)
    return method, np.array(observed), np.array(labelled)


def plain(method: Any, scans: list[Scan]) -> tuple[float, np.ndarray]:
    """Seconds a frame in numpy for the distances of all voxels where points can lie, and those distances."""
    p, space = PARAMS, method._map
    blocks = np.flatnonzero(space._inner)
    voxels = (512 * blocks[:, None] + np.arange(512)).ravel()
    centres = (space.grid.keys(voxels) + 0.5) * p.resolution
    distance, weight = np.zeros(len(voxels), np.float32), np.zeros(len(voxels), np.float32)
    rows, columns, top, per_row, per_column = space._view.numbers
    start = time.perf_counter()

    def pixels(xyz: np.ndarray, scan: Scan) -> tuple[np.ndarray, np.ndarray]:
        x, y, z = ((xyz - scan.position) @ scan.T_world_sensor[:3, :3]).T
        row = np.floor((top - np.arctan2(z, np.hypot(x, y))) * per_row + 0.5)
        column = np.floor((np.arctan2(y, x) + np.pi) * per_column + 0.5) % columns
        inside = (row >= 0) & (row < rows)
        return np.where(inside, row * columns + column, rows * columns).astype(int), np.sqrt(x * x + y * y + z * z)

    for scan in scans:
        image = np.full(int(rows * columns) + 1, np.inf)
        at, ranges = pixels(scan.points, scan)
        np.minimum.at(image, at, np.where(ranges < p.min_range, np.inf, ranges))
        image[-1] = np.inf
        at, ranges = pixels(centres, scan)
        behind = image[at] - ranges
        told = np.flatnonzero(np.isfinite(behind) & (behind >= -p.truncation))
        total = distance[told] * weight[told] + np.minimum(behind[told], p.truncation)
        weight[told] += 1
        distance[told] = total / weight[told]
    return (time.perf_counter() - start) / len(scans), distance


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, nargs="?")
    parser.add_argument("--frames", type=int)
    arguments = parser.parse_args()
    scans = read(arguments.folder, arguments.frames) if arguments.folder else street(arguments.frames or 60)
    print(f"{len(scans)} frames of {np.mean([len(s) for s in scans]):.0f} points; {kernels.set_threads(None)} threads")

    run(scans[:8])  # compile
    profile: defaultdict[str, list[float]] = defaultdict(list)
    for step, (module, name) in STEPS.items():
        setattr(getattr(kernels, module), name, timed(getattr(getattr(kernels, module), name), profile[step]))
    runs = {}
    for threads in (None, 1):
        for spent in profile.values():
            spent.clear()
        n = kernels.set_threads(threads)
        method, observed, labelled = runs[threads] = run(scans)
        mean = observed.mean() + labelled.mean()
        print(f"\n{n} threads: {mean:.4f} s a frame, median {np.median(observed):.4f}, label {labelled.mean():.4f}")
        steps = {step: sum(spent) / len(scans) for step, spent in profile.items()}
        for step, seconds in (steps | {"the rest, in numpy": mean - sum(steps.values())}).items():
            print(f"  {step:26} {1000 * seconds:7.2f} ms")
    kernels.set_threads(None)
    same = all((runs[None][0].label(scan) == runs[1][0].label(scan)).all() for scan in scans)
    print(f"\nsame labels on one thread: {same}")

    print("\non more and more frames")
    for frames in sorted({len(scans) // 4, len(scans) // 2, len(scans)} - {0}):
        method, observed, _ = run(scans[:frames])
        space = method._map
        held = sum(array.nbytes for array in vars(space).values() if isinstance(array, np.ndarray))
        kept = sum(bits.nbytes for bits in method._reasons.values())
        print(
            f"  {frames:5}: {np.median(observed[-frames // 4 :]):.4f} s for each of the last; {held / 1e6:.0f} MB in "
            f"{space._inner.sum()} blocks with points, {held / space._inner.sum() / 1e3:.1f} kB each; "
            f"{kept / 1e6:.1f} MB of reasons"
        )
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"peak memory of all this: {peak:.0f} MB, all scans included")

    few = scans[:PLAIN_FRAMES]
    for spent in profile.values():
        spent.clear()
    method, *_ = run(few)
    ours = sum(sum(spent) for step, spent in profile.items() if step.startswith(("range", "distances"))) / len(few)
    seconds, expected = plain(method, few)
    space = method._map
    first = (space._first[np.flatnonzero(space._inner)][:, None] + np.arange(512)).ravel()
    agree = np.abs(space._distance[first] - expected) < 1e-4
    print(
        f"\ndistances in numpy: {seconds:.3f} s a frame; the same here: {ours:.4f} s, {seconds / ours:.1f} times faster"
    )
    print(f"same distance: {100 * agree.mean():.4f} % of voxels")


if __name__ == "__main__":
    main()

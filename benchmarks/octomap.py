"""Seconds a frame of the OctoMap family, step by step, and their ratio to a plain walk through a dense grid.

    python benchmarks/octomap.py                      a street of 120 000 points a frame, made here
    python benchmarks/octomap.py FOLDER               the pcd/*.pcd of a folder in the benchmark's layout
    python benchmarks/octomap.py FOLDER --frames 30

Everything is measured in one process, after a first round that compiles. The plain walk is one numba loop on one thread
that steps from voxel to voxel in double precision; it runs on the first frames only.
"""

from __future__ import annotations

import argparse
import math
import resource
import time
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numba import njit

from dynaviz import kernels
from dynaviz.blocks import BlockGrid
from dynaviz.io.pcd import read_pcd
from dynaviz.method import Context
from dynaviz.scan import Scan
from dynaviz.survey import Extent
from dynaviz_methods import octomap

FAMILY = (octomap.OctoMap, octomap.OctoMapG, octomap.OctoMapGF)
STEPS = {
    "noise: tree": ("neighbours", "tree"),
    "noise: neighbours": ("neighbours", "mean_distances"),
    "ground: samples": ("plane", "from_samples"),
    "rays: mark": ("raycast", "mark"),
    "rays: collect": ("raycast", "collect"),
    "update log-odds": ("raycast", "update_log_odds"),
    "label: locate": ("blocks", "locate"),
}
PLAIN_FRAMES = 6
STATE = 512 * 4 + 16 * 8  # bytes of a block


def street(frames: int) -> list[Scan]:
    """A sensor of 64 rings drives 0.8 m a frame between house fronts; parked boxes, and three that drive."""
    random = np.random.default_rng(0)
    azimuth, elevation = np.meshgrid(np.linspace(-np.pi, np.pi, 1900), np.radians(np.linspace(-24.8, 8.0, 64)))
    flat = np.cos(elevation)
    direction = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)], -1).reshape(-1, 3)
    parked = [(x, y, 0.8) for x in range(-60, 160, 9) for y in (-5.0, 5.5)]
    scans = []
    for index in range(frames):
        T_world_sensor = np.eye(4)
        T_world_sensor[:3, 3] = origin = 0.8 * index, 0.1 * math.sin(index), 1.73
        driving = [(15 + 1.5 * index, -2.0, 0.8), (-30 + 2.0 * index, 2.0, 0.8), (120 - index, 2.5, 0.8)]
        with np.errstate(divide="ignore"):
            inverse = 1.0 / direction
        reach = np.full(len(direction), 80.0)
        down, level = direction[:, 2] < 0, direction[:, 1] != 0
        reach[down] = np.minimum(reach[down], -origin[2] * inverse[down, 2])
        front = np.where(direction[:, 1] > 0, 11.0 - origin[1], -9.0 - origin[1]) * inverse[:, 1]
        reach[level] = np.minimum(reach, front)[level]
        for centre in parked + driving:
            corner = np.array([2.0, 0.9, 0.8])
            near, far = np.sort([(centre + side * corner - origin) * inverse for side in (-1, 1)], 0)
            enter = near.max(1)
            reach = np.where((enter > 0) & (enter < far.min(1)), np.minimum(reach, enter), reach)
        seen = reach < 80.0
        points = origin + direction[seen] * (reach + random.normal(0, 0.02, len(reach)))[seen, None]
        scans.append(Scan(index, points.astype(np.float32), T_world_sensor))
    return scans


def read(folder: Path, frames: int | None) -> list[Scan]:
    clouds = (read_pcd(path) for path in sorted((folder / "pcd").glob("*.pcd"))[:frames])
    return [Scan(index, cloud.xyz, cloud.T_world_sensor) for index, cloud in enumerate(clouds)]


@njit(cache=True)
def plain_walk(points, origin, per_metre, low, shape, stamps, stamp, odds, miss, hit, least, most, touched):
    """Every voxel of every ray in a dense grid, then the update; bit 1 of a stamp is free, bit 2 is occupied."""
    n = 0
    for p in range(len(points)):
        o, d, k, goal, step, t, dt = np.empty((7, 3))
        for a in range(3):
            o[a] = origin[a] * per_metre
            d[a] = points[p, a] * per_metre - o[a]
            k[a], goal[a] = math.floor(o[a]), math.floor(points[p, a] * per_metre)
            step[a] = 1.0 if d[a] > 0 else -1.0
            t[a] = (k[a] + (d[a] > 0) - o[a]) / d[a] if k[a] != goal[a] else np.inf
            dt[a] = 1.0 / abs(d[a]) if d[a] != 0.0 else np.inf
        while True:
            v = (int(k[0] - low[0]) * shape[1] + int(k[1] - low[1])) * shape[2] + int(k[2] - low[2])
            end = k[0] == goal[0] and k[1] == goal[1] and k[2] == goal[2]
            if stamps[v] >> 2 != stamp:
                stamps[v] = stamp << 2
                touched[n] = v
                n += 1
            stamps[v] |= 2 if end else 1
            if end:
                break
            a = 0 if t[0] < t[1] and t[0] < t[2] else (1 if t[1] < t[2] else 2)
            k[a] += step[a]
            t[a] = t[a] + dt[a] if k[a] != goal[a] else np.inf
    for i in range(n):
        v = touched[i]
        if stamps[v] & 1:
            odds[v] = max(odds[v] + miss, least)
        if stamps[v] & 2:
            odds[v] = min(odds[v] + hit, most)


def plain_octomap(scans: list[Scan], resolution: float) -> tuple[float, list[np.ndarray]]:
    """Seconds a frame, and the labels."""
    per_metre = 1.0 / resolution
    extent = Extent.of(*scans)
    low = np.floor(extent.low * per_metre).astype(np.int64) - 1
    shape = np.floor(extent.high * per_metre).astype(np.int64) + 2 - low
    size = int(np.prod(shape))
    stamps, odds, touched = np.zeros(size, np.uint16), np.zeros(size, np.float32), np.empty(size, np.int64)
    logits = [np.float32(math.log(p / (1 - p))) for p in (0.4, 0.7, 0.12, 0.97)]
    seconds = []
    for stamp, scan in enumerate(scans, 1):
        start = time.perf_counter()
        plain_walk(scan.points, scan.position, per_metre, low, shape, stamps, stamp, odds, *logits, touched)
        seconds.append(time.perf_counter() - start)
    keys = (np.floor(scan.points.astype(np.float64) * per_metre).astype(np.int64) - low for scan in scans)
    return float(np.mean(seconds[1:])), [odds[np.ravel_multi_index(k.T, shape)] < 0 for k in keys]


def timed(call: Callable[..., Any], seconds: list[float]) -> Callable[..., Any]:
    def wrapped(*arguments: Any) -> Any:
        start = time.perf_counter()
        answer = call(*arguments)
        seconds.append(time.perf_counter() - start)
        return answer

    return wrapped


def run(method: Any, scans: list[Scan], extent: Extent) -> tuple[np.ndarray, np.ndarray]:
    """Seconds of each frame, observing and labelling, and all labels."""
    ran = method(method.Params())
    ran.begin(Context(extent))
    observed, labelled, labels = [], [], []
    for scan in scans:
        start = time.perf_counter()
        ran.observe(scan)
        observed.append(time.perf_counter() - start)
    for scan in scans:
        start = time.perf_counter()
        labels.append(ran.label(scan))
        labelled.append(time.perf_counter() - start)
    return np.add(observed, labelled), np.concatenate(labels)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, nargs="?")
    parser.add_argument("--frames", type=int)
    arguments = parser.parse_args()
    scans = read(arguments.folder, arguments.frames) if arguments.folder else street(arguments.frames or 60)
    extent = Extent.of(*scans)
    print(f"{len(scans)} frames of {np.mean([len(s) for s in scans]):.0f} points; {kernels.set_threads(None)} threads")

    for method in FAMILY:  # compile
        run(method, scans[:2], extent)
    plain_octomap(scans[:2], 0.1)
    profile: defaultdict[str, list[float]] = defaultdict(list)
    for step, (module, name) in STEPS.items():
        setattr(getattr(kernels, module), name, timed(getattr(getattr(kernels, module), name), profile[step]))

    for method in FAMILY:
        for seconds in profile.values():
            seconds.clear()
        seconds, labels = run(method, scans, extent)
        print(f"\n{method.info.name}: {seconds.mean():.4f} s a frame")
        steps = {step: sum(s) / len(scans) for step, s in profile.items() if s}
        for step, mean in (steps | {"the rest, in numpy": seconds.mean() - sum(steps.values())}).items():
            print(f"  {step:20} {1000 * mean:7.2f} ms")
        kernels.set_threads(1)
        alone, same = run(method, scans, extent)
        kernels.set_threads(None)
        ratio = alone.mean() / seconds.mean()
        print(f"  on one thread {ratio:.2f} times as long; same labels: {(same == labels).all()}")

    print("\noctomap on more and more frames")
    for frames in sorted({len(scans) // 4, len(scans) // 2, len(scans)} - {0}):
        extent = Extent.of(*scans[:frames])
        last = run(octomap.OctoMap, scans[:frames], extent)[0][-frames // 4 :].mean()
        blocks = len(BlockGrid(extent, 0.1))
        print(f"  {frames:5}: {last:.4f} s for each of the last; {blocks * STATE / 1e6:.0f} MB in {blocks} blocks")
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"peak memory of all this: {peak:.0f} MB, all scans included")

    few = scans[:PLAIN_FRAMES]
    plain, expected = plain_octomap(few, 0.1)
    seconds, labels = run(octomap.OctoMap, few, Extent.of(*few))
    agree = (labels == np.concatenate(expected)).mean()
    print(f"\nplain walk, dense grid, one thread: {plain:.4f} s a frame on {len(few)} frames")
    print(f"octomap on the same: {seconds[1:].mean():.4f} s, {plain / seconds[1:].mean():.1f} times faster")
    print(f"same label: {100 * agree:.4f} % of points")


if __name__ == "__main__":
    main()

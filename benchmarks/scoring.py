"""Cost of scoring: metrics per frame and at the end, neighbour search compared with scipy's k-d
tree, a whole map.

Usage: python benchmarks/scoring.py [FRAMES]      (141 frames of 123 000 points, like KITTI 00, take
about a minute)
       python benchmarks/scoring.py map [SEQ]     OctoMap's map of a sequence, or of 141 frames of a
       simulated street
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

import dynaviz as dv
from dynaviz import kernels
from dynaviz.arrays import F32
from dynaviz.contracts.method import MethodInfo, Reason
from dynaviz.contracts.metric import Labelled
from dynaviz.contracts.scan import Scan, stream
from dynaviz.io.fields import read_points
from dynaviz.spatial.nearest import Nearest, nearest_distance
from dynaviz_eval.breakdown import BreakdownMetric
from dynaviz_eval.confusion import Confusion
from dynaviz_eval.error_distance import ErrorDistance
from dynaviz_eval.reasons import ReasonsMetric

INFO = MethodInfo("m", "M", "none", tuple(Reason(f"reason_{k}", "") for k in range(6)))
METRICS = (Confusion, ErrorDistance, BreakdownMetric, ReasonsMetric)


def street(position: float, rng: np.random.Generator, n: int) -> F32:
    """(n, 3) float32, metres: ground and house walls around a sensor, denser near it."""
    distance = 2 + rng.exponential(12, n)
    azimuth = rng.uniform(-np.pi, np.pi, n)
    x = position + distance * np.cos(azimuth)
    y = distance * np.sin(azimuth)
    z = rng.normal(-1.7, 0.02, n)
    wall = np.abs(y) > 15
    y[wall] = np.sign(y[wall]) * 15 + rng.normal(0, 0.03, wall.sum())
    z[wall] = rng.uniform(-1.7, 8, wall.sum())
    return np.stack([x, y, z], 1).astype(np.float32)


def labelled_street(frame: int, n: int = 123_000) -> Labelled:
    """A frame with a car and bad labels.

    6 m patches of ground and a tenth of all other points are removed.
    """
    rng = np.random.default_rng(frame)
    points = street(frame, rng, n)
    car = (np.abs(points[:, 0] - frame - 10) < 2) & (np.abs(points[:, 1]) < 1)
    patch = (np.floor(points[:, :2] / 6).sum(1) % 5 == 0) & (points[:, 2] < -1)
    removed = np.where(car, rng.random(n) < 0.9, patch | (rng.random(n) < 0.1))
    pose = np.eye(4)
    pose[0, 3] = frame
    scan = Scan(frame, points, pose, labels=car.astype(np.uint8), instances=car.astype(np.int32))
    return Labelled.of(frame, scan, removed, rng.integers(0, 6, n).astype(np.uint8))


def metrics(frames: int) -> None:
    first = labelled_street(0)
    for metric in METRICS:  # compiles or loads the kernels
        warm = metric(INFO)
        warm.update(first)
        warm.finish()
    run = [metric(INFO) for metric in METRICS]
    spent = defaultdict(list)
    for frame in range(frames):
        labelled = labelled_street(frame)
        for metric in run:
            start = time.perf_counter()
            metric.update(labelled)
            spent[metric].append(time.perf_counter() - start)
    print(f"{'metric':14s} {'update, median':>15s} {'finish':>9s}")
    for metric in run:
        start = time.perf_counter()
        section = metric.finish()
        seconds = time.perf_counter() - start
        print(
            f"{type(metric).__name__:14s} {np.median(spent[metric]) * 1e3:12.2f} ms {seconds:7.2f} "
            "s"
        )
        if isinstance(metric, ErrorDistance):
            counts = {kind: found.count for kind, found in section["error_distance"].items()}
    print(f"{frames} frames of {len(first.scan)} points; {counts}")
    print(f"peak memory {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3:.0f} MB")


def neighbours(n: int, m: int, limit: float) -> None:
    rng = np.random.default_rng(0)
    query = street(0, rng, n)
    reference = street(0, rng, m)
    nearest_distance(query[:10], reference[:10], limit)
    start = time.perf_counter()
    found = nearest_distance(query, reference, limit)
    own = time.perf_counter() - start
    start = time.perf_counter()
    expected, _ = cKDTree(reference).query(query, distance_upper_bound=limit, workers=-1)
    tree = time.perf_counter() - start
    inside = np.isfinite(expected) & np.isfinite(found)
    error = np.abs(found[inside] - expected[inside]).max()
    times = f"{own:6.2f} s, k-d tree {tree:6.2f} s, ratio {tree / own:4.1f}"
    print(f"{n:>10,} in {m:>10,} within {limit} m: {times}; largest difference {error:.0e} m")


def timed(call: Callable[[], Any], rounds: int = 3) -> tuple[Any, float]:
    """The result, and the seconds of the fastest round."""
    best = np.inf
    for _ in range(rounds):
        start = time.perf_counter()
        result = call()
        best = min(best, time.perf_counter() - start)
    return result, best


def whole_map(sequence: Path, folder: Path) -> None:
    """Score OctoMap's map of a sequence.

    First only the tree and the queries, then the whole command.
    """
    dv.run("octomap", sequence, out=folder, record="none")
    path = folder / "static_map.pcd"
    points = read_points(path)
    Nearest(points[:100]).within(points[:100], 0.05)  # compiles or loads the kernels
    tree, built = timed(lambda: Nearest(points))
    scans = [scan.points for scan in stream(dv.open(sequence))]
    print(f"{sum(map(len, scans)):,} points in a map of {len(points):,}: tree {built:.2f} s")
    removed = {}
    for threads in (None, 1):
        used = kernels.set_threads(threads)
        removed[used], seconds = timed(
            lambda: sum(int((~tree.within(scan, 0.05)).sum()) for scan in scans)
        )
        print(f"all queries on {used} threads: {seconds:.2f} s")
    assert len(set(removed.values())) == 1, removed
    start = time.perf_counter()
    cKDTree(points).query(np.concatenate(scans[::10]), distance_upper_bound=0.06, workers=-1)
    print(f"k-d tree, all threads, a tenth of the scans: {time.perf_counter() - start:.2f} s")
    for record in ("none", "errors"):
        start = time.perf_counter()
        words = ["score", path, sequence, "-o", folder / "scored", "--record", record]
        command = subprocess.Popen(
            [sys.executable, "-c", "from dynaviz.cli import main; main()", *words]
        )
        _, status, usage = os.wait4(command.pid, 0)
        seconds = time.perf_counter() - start
        cpu = usage.ru_utime + usage.ru_stime
        memory = usage.ru_maxrss / 1e3
        print(
            f"dynaviz score --record {record}: {seconds:.1f} s, {cpu:.1f} s of processor time, "
            f"{memory:.0f} MB"
        )
        assert status == 0


def simulated(folder: Path) -> Path:
    subprocess.run([sys.executable, "-c", "from dynaviz.cli import main; "
    "main()", "simulate", "street_hdl64",
                    folder / "street", "--frames", "141"], check=True)  # fmt: skip
    return folder / "street"


if __name__ == "__main__":
    if sys.argv[1:2] == ["map"]:
        with tempfile.TemporaryDirectory() as place:
            whole_map(
                Path(sys.argv[2]) if sys.argv[2:] else simulated(Path(place)), Path(place) / "run"
            )
        sys.exit()
    metrics(int(sys.argv[1]) if len(sys.argv) > 1 else 141)
    for limit in (0.05, 2.0):
        for size in (200_000, 2_000_000):
            neighbours(size, size, limit)

"""Cost of many small scans on a drive that never returns.

``python benchmarks/one_way.py [METHOD ...]``.

A sensor drives straight ahead, 1 m per scan, and sees 60 points in each. Prints the milliseconds of
CPU time per scan on one thread, over more and more scans: where they grow, the work of a method
grows with its map, not with the scan.
"""

from __future__ import annotations

import sys
import time

import numpy as np

from dynaviz import kernels
from dynaviz.contracts import registry
from dynaviz.contracts.extent import Extent
from dynaviz.contracts.method import Context
from dynaviz.contracts.scan import Scan
from dynaviz.testing.world import SENSOR

FRAMES = (300, 1200, 4800)
# per scan; metres between scans; metres to the farthest point
POINTS = 60
STEP = 1.0
FAR = 30.0


def drive(frames: int) -> list[Scan]:
    """Scans of ground and of things up to 2.5 m high, along a straight road."""
    random = np.random.default_rng(0)
    scans = []
    for index in range(frames):
        T_world_sensor = np.eye(4)
        T_world_sensor[:3, 3] = STEP * index, 0.0, 1.7
        angle = random.uniform(0, 2 * np.pi, POINTS)
        distance = random.uniform(3, FAR, POINTS)
        height = random.uniform(0, 2.5, POINTS) * (random.random(POINTS) < 0.5)
        points = np.column_stack(
            [STEP * index + distance * np.cos(angle), distance * np.sin(angle), height]
        )
        scans.append(Scan(index, points.astype(np.float32), T_world_sensor))
    return scans


def measure(name: str, scans: list[Scan]) -> float:
    """Milliseconds of CPU time per scan."""
    kind = registry.load("methods", name)
    raw_map = np.concatenate([scan.points for scan in scans]) if kind.info.needs_map else None
    method = kind(kind.Params())
    method.begin(Context(Extent.of(*scans), SENSOR, raw_map=raw_map))
    start = time.process_time()
    for step in (method.observe, method.label):
        for scan in scans:
            step(scan)
    return 1000 * (time.process_time() - start) / len(scans)


def main() -> None:
    """Print a row for each method."""
    kernels.set_threads(1)
    scans = drive(max(FRAMES))
    print(f"{'scans':12}" + "".join(f"{frames:>9,}" for frames in FRAMES))
    for name in sys.argv[1:] or [handle.name for handle in registry.handles("methods")]:
        measure(name, scans[:5])  # compile
        row = "".join(f"{measure(name, scans[:frames]):9.2f}" for frames in FRAMES)
        print(f"{name:12}{row}", flush=True)


if __name__ == "__main__":
    main()

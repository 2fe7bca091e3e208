"""Time, points per frame and dynamic share of each preset: ``python benchmarks/simulate.py [PRESET?frames=N ...]``."""

from __future__ import annotations

import os
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from dynaviz.io.pcd import read_pcd
from dynaviz.synthetic.simulate import PRESETS, simulate
from dynaviz.synthetic.simulate.options import Chosen


def main(names: list[str]) -> None:
    import open3d  # noqa: F401  # loaded before the measurement

    for name in names or PRESETS:
        frames = Chosen.parse(name).frames
        with tempfile.TemporaryDirectory() as folder:
            start, used = time.perf_counter(), sum(os.times()[:4])
            out = simulate(name, Path(folder) / "scene")
            seconds, used = time.perf_counter() - start, sum(os.times()[:4]) - used
            dynamic = read_pcd(out / "gt_cloud.pcd")["intensity"]
            per_100 = 100 / frames
            print(
                f"{name:15} {frames:4d} frames {seconds:6.1f} s ({per_100 * seconds:5.1f} s per 100 frames, "
                f"{per_100 * used:5.1f} s of processor time) {len(dynamic) / frames:9,.0f} points per frame "
                f"{100 * np.mean(dynamic, dtype=float):5.2f} % dynamic",
                flush=True,
            )


if __name__ == "__main__":
    main(sys.argv[1:])

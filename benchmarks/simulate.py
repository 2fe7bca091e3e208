"""Time, points per frame and dynamic share of each preset: ``python benchmarks/simulate.py [PRESET ...]``."""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from dynaviz.io.pcd import read_pcd
from dynaviz.simulate import PRESETS, simulate


def main(names: list[str]) -> None:
    import open3d  # noqa: F401  # loaded before the measurement

    for name in names or PRESETS:
        frames = PRESETS[name].frames
        with tempfile.TemporaryDirectory() as folder:
            start = time.perf_counter()
            out = simulate(name, Path(folder) / name)
            seconds = time.perf_counter() - start
            dynamic = read_pcd(out / "gt_cloud.pcd")["intensity"]
            print(
                f"{name:15} {frames:4d} frames {seconds:6.1f} s ({100 * seconds / frames:5.1f} s per 100 frames) "
                f"{len(dynamic) / frames:9,.0f} points per frame {100 * np.mean(dynamic, dtype=float):5.2f} % dynamic",
                flush=True,
            )


if __name__ == "__main__":
    main(sys.argv[1:])

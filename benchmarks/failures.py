"""Group five million wrong points into failure cases: ``python benchmarks/failures.py``."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from dynaviz.engine.loop import peak_rss_mb
from dynaviz_eval.cases import GAP, Cases, summed

FRAMES, POINTS = 143, 35_000


def main() -> None:
    """All ground points around a sensor that moves 1 m per frame are removed by mistake."""
    for first in (True, False):
        small: list[Any] = []
        spent, cases, rng = 0.0, Cases(8, span=20.0, forgotten=small.extend), np.random.default_rng(0)
        for frame in range(FRAMES):
            points = rng.normal([frame, 0.0, 0.0], [18.0, 18.0, 0.05], (POINTS, 3)).astype(np.float32)
            groups, codes = np.zeros(POINTS, np.int64), np.zeros(POINTS, np.uint8)
            ranges = np.hypot(points[:, 0] - frame, points[:, 1])
            start = time.perf_counter()
            cases.add(frame, points, groups, codes, ranges, codes > 0)
            spent += time.perf_counter() - start
        start = time.perf_counter()
        cases.settle(FRAMES + GAP)
        spent += time.perf_counter() - start
        if not first:  # the first round compiles
            found = len(summed(cases.rows)) + len(small)
            print(f"{FRAMES * POINTS:,} points, {found:,} cases: {spent:.1f} s, peak {peak_rss_mb():.0f} MB")


if __name__ == "__main__":
    main()

"""Memory of every method as frames go by over the same ground: ``python benchmarks/streaming.py [METHOD ...]``.

A little world of 24 scans is driven through again and again, 500 and then 4500 frames, read one at a time. Each run is
a process of its own; printed is what it holds at most, beyond what it held before. Whoever kept the points would need
518 MB more for the longer run; the raw map, which offline methods are given, is such, and told beside.
"""

from __future__ import annotations

import multiprocessing
import sys
import time

from scenes import Drive

from dynaviz import registry
from dynaviz.engine.loop import RunSpec, execute, peak_rss_mb
from dynaviz.scan import Scan
from dynaviz.testing.world import SENSOR, crossing

SHORT, LONG = 500, 4500


def again(scans: list[Scan], frames: int) -> Drive:
    """Scans over and over on the same ground, as one long sequence."""
    return Drive(scans, frames, farther=0.0, sensor=SENSOR)


def measure(name: str, frames: int) -> None:
    """Run, and print what it took."""
    method, scans = registry.load("methods", name), crossing(24)
    execute(RunSpec(method(method.Params()), again(scans, 24), method.Params()))  # compile
    before, start = peak_rss_mb(), time.perf_counter()
    execute(RunSpec(method(method.Params()), again(scans, frames), method.Params()))
    seconds = (time.perf_counter() - start) / frames
    raw = f", of it the raw map {frames * len(scans[0]) * 12 / 1e6:.0f} MB" if method.info.needs_map else ""
    print(
        f"{name:11} {frames:5} frames: {peak_rss_mb() - before:7.1f} MB{raw}; {1000 * seconds:.1f} ms a frame",
        flush=True,
    )


def main(names: list[str]) -> None:
    for name in names or [handle.name for handle in registry.handles("methods")]:
        for frames in (SHORT, LONG):
            process = multiprocessing.get_context("spawn").Process(target=measure, args=(name, frames))
            process.start()
            process.join()


if __name__ == "__main__":
    main(sys.argv[1:])

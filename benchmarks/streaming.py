"""Memory of every method over many frames on the same ground: ``python benchmarks/streaming.py [METHOD ...]``.

A small world of 24 scans is repeated for 500 and for 4500 frames, read one at a time. Each run has its own process; the
increase of its peak memory is printed. A method that stored all points would need 518 MB more for the longer run. The
raw map that offline methods receive has this size; it is printed separately.
"""

from __future__ import annotations

import multiprocessing
import sys
import time

from scenes import Drive

from dynaviz.contracts import registry
from dynaviz.contracts.scan import Scan
from dynaviz.engine.loop import RunSpec, execute, peak_rss_mb
from dynaviz.testing.world import SENSOR, crossing

SHORT, LONG = 500, 4500


def again(scans: list[Scan], frames: int) -> Drive:
    """Scans repeated on the same ground as one long sequence."""
    return Drive(scans, frames, block_length=0.0, sensor=SENSOR)


def measure(name: str, frames: int) -> None:
    """Run a method and print memory and time."""
    method, scans = registry.load("methods", name), crossing(24)
    execute(RunSpec(method(method.Params()), again(scans, 24), method.Params()))  # compile
    before, start = peak_rss_mb(), time.perf_counter()
    execute(RunSpec(method(method.Params()), again(scans, frames), method.Params()))
    seconds = (time.perf_counter() - start) / frames
    raw = f", including the raw map of {frames * len(scans[0]) * 12 / 1e6:.0f} MB" if method.info.needs_map else ""
    print(
        f"{name:11} {frames:5} frames: {peak_rss_mb() - before:7.1f} MB{raw}; {1000 * seconds:.1f} ms per frame",
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

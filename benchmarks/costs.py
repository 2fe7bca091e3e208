"""Cost of a step for a number of points per frame and frames.

Processor seconds on one thread, and memory.

    python benchmarks/costs.py 30000 24 FOLDER method octomap     one of the functions below

A function returns figures: ``seconds`` for the whole drive, and ``memory_mb``, the increase of the
peak memory. Code is compiled and loaded beforehand, on two frames. The files of a run stay in
FOLDER for later steps.
"""

from __future__ import annotations

import json
import os
import shutil
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from scenes import SENSOR, Drive

from dynaviz import api, kernels
from dynaviz.contracts import registry
from dynaviz.contracts.method import Context
from dynaviz.contracts.metric import Labelled
from dynaviz.contracts.scan import Scan, stream
from dynaviz.engine.loop import RunSpec, execute, peak_rss_mb
from dynaviz.reports.reporting import report as write_report
from dynaviz.sources.datasets import open_sequence
from dynaviz.sources.summary import summarize

Figures = dict[str, Any]
QUICKEST = (
    "octomap"  # fastest method that labels each point individually; recorded and compared here
)
SHORT = 100  # frames up to which a method runs twice, and the better round is used
COARSE = ("resolution=0.2",)  # settings of a second run for the comparison


def spent(*calls: Callable[[], Any]) -> float:
    """Processor seconds of some calls in sequence."""
    start = time.process_time()
    for call in calls:
        call()
    return time.process_time() - start


def reference(points: int, frames: int, folder: Path) -> Figures:
    """The reference: a plain walk along the rays of each frame, best of three rounds over six
    frames.
    """
    from plain import dense_octomap

    scans = list(Drive.of(points, 6, folder.parent))
    dense_octomap(scans[:1], 0.1)
    return {
        "seconds": frames * min(dense_octomap(scans, 0.1, time.process_time)[0] for _ in range(3))
    }


def public_dufomap(points: int, frames: int, folder: Path) -> Figures:
    """The public implementation of DUFOMap."""
    from plain import public_dufomap as program

    scans = list(Drive.of(points, frames, folder.parent))
    before = peak_rss_mb()
    return {
        "seconds": frames * program(scans, 1, time.process_time)[0],
        "memory_mb": peak_rss_mb() - before,
    }


def method(points: int, frames: int, folder: Path, name: str) -> Figures:
    """A method without the runner: ``begin``, ``observe`` and ``label``.

    Memory beyond the drive and the raw map.
    """
    kernels.set_threads(1)
    kind = registry.load("methods", name)
    drive = Drive.of(points, frames, folder.parent)
    execute(RunSpec(kind(kind.Params()), Drive(drive.block, 2), kind.Params()))
    raw_map = np.concatenate([scan.points for scan in drive]) if kind.info.needs_map else None
    context = Context(summarize(drive).extent, SENSOR, raw_map=raw_map)
    before = peak_rss_mb()

    def cleaned() -> float:
        running = kind(kind.Params())
        return spent(lambda: running.begin(context)) + sum(
            spent(lambda: step(scan))  # noqa: B023
            for step in (running.observe, running.label)
            for scan in map(Scan.without_truth, drive)
        )

    seconds = cleaned()
    held = peak_rss_mb() - before
    return {"seconds": min(seconds, cleaned()) if frames <= SHORT else seconds, "memory_mb": held}


def reading(points: int, frames: int, folder: Path) -> Figures:
    """Reading a folder of .bin files with poses; and only the files with ``np.fromfile``."""
    scans = folder / "scans"
    block = Drive.of(points, frames, folder.parent).block
    scans.mkdir(parents=True)
    for scan in block:
        local = scan.points - scan.position.astype(np.float32)
        np.column_stack([local, np.ones(len(local), np.float32)]).tofile(
            scans / f"block{scan.index}"
        )
    for index in range(frames):
        os.link(scans / f"block{index % len(block)}", scans / f"{index:06d}.bin")
    poses = np.tile(np.eye(4)[:3].ravel(), (frames, 1))
    poses[:, 3] = 0.75 * np.arange(frames)
    np.savetxt(folder / "poses.txt", poses)
    files = sorted(scans.glob("*.bin"))
    before = peak_rss_mb()
    plain = spent(*(lambda file=file: np.fromfile(file, np.float32) for file in files))
    seconds = spent(
        lambda: [
            len(scan) for scan in stream(open_sequence(str(scans), poses=str(folder / "poses.txt")))
        ]
    )
    shutil.rmtree(scans)
    return {"seconds": seconds, "memory_mb": peak_rss_mb() - before, "fromfile": plain}


def metrics(points: int, frames: int, folder: Path) -> Figures:
    """All metrics, on labels that remove patches of ground and nine tenths of the
    dynamic points.
    """
    drive = Drive.of(points, frames, folder.parent)
    kind = registry.load("methods", QUICKEST)

    def scored(some: Drive) -> Iterator[float]:
        run = [handle.load()(kind.info) for handle in registry.handles("metrics")]
        for frame, scan in enumerate(some):
            x, y = scan.points[:, :2].T
            dynamic = (np.floor(x / 6) % 5 == 0) & (np.abs(y) < 3) | (
                (scan.labels > 0) & (np.arange(len(x)) % 10 > 0)
            )
            labelled = Labelled.of(frame, scan, dynamic, np.zeros(len(x), np.uint8))
            yield from (spent(lambda: metric.update(labelled)) for metric in run)  # noqa: B023
        yield from (spent(metric.finish) for metric in run)

    sum(scored(Drive(drive.block, 2)))
    before = peak_rss_mb()
    return {"seconds": sum(scored(drive)), "memory_mb": peak_rss_mb() - before}


def recorded(points: int, frames: int, folder: Path, way: str) -> Figures:
    """A complete run: summary, method, metrics, files, with or without a recording."""
    drive = Drive.of(points, frames, folder.parent)
    mode = way
    settings = ()
    if way == "coarse":
        mode = "errors"
        settings = COARSE
    api.run(
        QUICKEST,
        Drive(drive.block, 2),
        out=folder / "first",
        record=mode,
        settings=settings,
        threads=1,
    )
    before = peak_rss_mb()
    out = folder / way
    seconds = spent(
        lambda: api.run(QUICKEST, drive, out=out, record=mode, settings=settings, threads=1)
    )
    size = (out / "run.rrd").stat().st_size / 1e6 if mode != "none" else 0.0
    return {"seconds": seconds, "memory_mb": peak_rss_mb() - before, "file_mb": size}


def compare(points: int, frames: int, folder: Path) -> Figures:
    """Comparing two recordings of the drive, with a merged recording."""
    recordings = [folder / name / "run.rrd" for name in ("errors", "coarse")]
    before = peak_rss_mb()
    api.compare(*recordings)
    seconds = spent(lambda: api.compare(*recordings, out=folder / "compare.rrd"))
    size = (folder / "compare.rrd").stat().st_size / 1e6
    return {"seconds": seconds, "memory_mb": peak_rss_mb() - before, "file_mb": size}


def report(points: int, frames: int, folder: Path) -> Figures:
    """A report on two runs of the drive, with figures and a picture of each map."""
    write_report(folder / "first", out=folder / "first.html")
    before = peak_rss_mb()
    seconds = spent(
        lambda: write_report(folder / "errors", folder / "coarse", out=folder / "page.html")
    )
    return {"seconds": seconds, "memory_mb": peak_rss_mb() - before}


def score(points: int, frames: int, folder: Path) -> Figures:
    """Scoring a cleaned map on the drive, without a recording."""
    drive = Drive.of(points, frames, folder.parent)
    api.score(folder / "first/static_map.pcd", Drive(drive.block, 2), threads=1)
    before = peak_rss_mb()
    seconds = spent(lambda: api.score(folder / "errors/static_map.pcd", drive, threads=1))
    return {"seconds": seconds, "memory_mb": peak_rss_mb() - before}


STEPS = (reference, public_dufomap, method, reading, metrics, recorded, compare, report, score)

if __name__ == "__main__":
    size, folder, step, *more = sys.argv[1:3], sys.argv[3], *sys.argv[4:]
    found = {call.__name__: call for call in STEPS}[step](
        int(size[0]), int(size[1]), Path(folder), *more
    )
    print(json.dumps(found))

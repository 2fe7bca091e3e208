"""What is wrong with a sequence, before a method stumbles over it: ``dynaviz.doctor``."""

from __future__ import annotations

import os
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

from dynaviz.diagnosis import placing, trajectory
from dynaviz.diagnosis.finding import Confidence, Diagnosis, Finding
from dynaviz.diagnosis.scans import ScanWalk
from dynaviz.errors import DataError
from dynaviz.progress import Progress, silent
from dynaviz.scan import Scan, Sequence

__all__ = ["Confidence", "Diagnosis", "Finding", "doctor"]

MOST, STRETCH = 400, 20  # frames that are read of a long sequence, and how many of them in a row
FEW = 50  # cells with points, below which scans are not compared
LOCAL = ("ground height",)  # of the findings on poses, those that leave distances from the sensor as they are


def doctor(sequence: Sequence | str | os.PathLike[str], *, progress: Progress = silent) -> Diagnosis:
    """Say what is wrong with a sequence.

    Of more than ``MOST`` frames some stretches are read, spread over the whole.

    Args:
        sequence: an open sequence, or a path; options go through ``dynaviz.open``.
        progress: called with a phase, and how many of how many steps are done.

    Returns:
        The findings; printing it shows them.

    Raises:
        DataError: where nothing known is at the path, or not one frame can be read.
    """
    if not isinstance(sequence, Sequence):
        from dynaviz import api

        sequence = api.open(sequence)
    walk, findings, errors = ScanWalk(sequence), list[Finding](), list[DataError]()
    if not len(sequence):
        raise DataError(sequence.name, "has no frame", hint="Give the folder of a sequence")
    chosen = _chosen(len(sequence))
    for done, (position, scan) in enumerate(_read(sequence, chosen), 1):
        if isinstance(scan, DataError):
            errors.append(scan)
        else:
            walk.visit(position, scan)
        progress("reading", done, len(chosen))
    if not walk.positions:
        raise errors[0]
    findings += _unreadable(errors)
    placed = list(_placed(walk, progress))
    misplaced = any(finding.name not in LOCAL for finding in placed)
    findings += placed  # first of what is equally sure: the rest may follow from it
    findings += (finding for finding in walk.findings() if not (misplaced and finding.name == "ego points"))
    if len(walk.positions) > 1:
        findings += trajectory.jumps(walk.positions, walk.indices, walk.poses)
    return Diagnosis.of(sequence.name, len(sequence), len(chosen), findings)


def _chosen(frames: int) -> list[int]:
    """Positions of the frames to read: all, or stretches."""
    if frames <= MOST:
        return list(range(frames))
    starts = np.linspace(0, frames - STRETCH, MOST // STRETCH).astype(int)
    return sorted({int(start) + k for start in starts for k in range(STRETCH)})


def _read(sequence: Sequence, positions: list[int]) -> Iterator[tuple[int, Scan | DataError]]:
    """Frames, the next read ahead; one that cannot be read gives its error and ends nothing."""

    def read(position: int) -> Scan | DataError:
        try:
            return sequence[position]
        except DataError as error:
            return error

    with ThreadPoolExecutor(1) as pool:
        ahead = pool.submit(read, positions[0])
        for position, following in zip(positions, [*positions[1:], None], strict=True):
            scan = ahead.result()
            if following is not None:
                ahead = pool.submit(read, following)
            yield position, scan


def _unreadable(errors: list[DataError]) -> Iterator[Finding]:
    """A finding for each kind of error, naming the first file."""
    groups: dict[str | None, list[DataError]] = {}
    for error in errors:
        groups.setdefault(error.hint, []).append(error)
    for hint, alike in groups.items():
        first = alike[0]
        also = f"; so are {len(alike) - 1:,} more files" if len(alike) > 1 else ""
        place = f"{first.at}: " if first.at else ""
        labels = any("label" in part for part in Path(first.path).parts[-2:])
        name = "labels do not fit" if labels else "unreadable frame"
        yield Finding(name, Confidence.CERTAIN, f"{place}{first.problem}{also}",
                      f"{hint or 'Write or copy the file again'}", (), len(alike), first.path)  # fmt: skip


_MISSING = (
    "Give the sensor's poses: --poses FILE for files:PATH, VIEWPOINT in PCD files; any odometry, such as KISS-ICP, "
    "makes them"
)
_LIDAR = "Give the pose of the lidar itself, not of the car or the IMU, in the world frame of the points"


def _placed(walk: ScanWalk, progress: Progress) -> Iterator[Finding]:
    """Whether poses and clouds fit each other; the first that explains them is told."""
    same = trajectory.standing(walk.poses) if len(walk.poses) > 1 else None
    if same:
        for gap in (1, 10):
            if moving := placing.moving_clouds(_views(walk, walk.pairs_apart(gap), progress)):
                yield Finding("poses missing", moving[1], f"{same}, but {moving[0]}", _MISSING)
                return
    views = _views(walk, placing.pairs(walk.positions, walk.poses, walk.usable), progress)
    if found := [*(placing.other_reading(views) if views else ()), *trajectory.upright(walk.poses)]:
        yield found[0]
    elif views and (words := placing.elsewhere(views, 1.5 if same else 2.0)):
        if same:
            yield Finding("poses missing", Confidence.LIKELY, f"{same}, but {words}", _MISSING)
        else:
            yield Finding("origin elsewhere", Confidence.PERHAPS, words, _LIDAR)
    elif found := list(walk.outside_finding()):
        yield from found
    else:
        yield from placing.ground(views, walk.sequence.sensor.height, walk.sequence.sensor.title)


def _views(
    walk: ScanWalk, pairs: list[tuple[int, int]], progress: Progress
) -> list[tuple[placing.ScanView, placing.ScanView]]:
    """Read pairs of scans once more."""
    views = []
    for done, rows in enumerate(pairs, 1):
        a, b = (placing.ScanView(walk.sequence[walk.positions[row]]) for row in rows)
        if min(len(a.points), len(b.points)) > FEW:
            views.append((a, b))
        progress("comparing", done, len(pairs))
    return views

"""Diagnose a sequence and suggest fixes: ``dynaviz.doctor``."""

from __future__ import annotations

import os
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

from dynaviz.diagnosis import alignment, trajectory
from dynaviz.diagnosis.finding import Confidence, Diagnosis, Finding
from dynaviz.diagnosis.scans import ScanChecker
from dynaviz.errors import DataError
from dynaviz.progress import Progress, silent
from dynaviz.scan import Scan, Sequence

__all__ = ["Confidence", "Diagnosis", "Finding", "doctor"]

MAX_FRAMES, STRETCH = 400, 20  # frames read of a long sequence, and consecutive frames in each stretch
MIN_POINTS = 50  # downsampled points that a scan needs to be compared
KEEPS_RANGES = ("ground height",)  # findings on poses that do not affect distances from the sensor


def doctor(sequence: Sequence | str | os.PathLike[str], *, progress: Progress = silent) -> Diagnosis:
    """Diagnose a sequence and suggest fixes.

    If the sequence has more than ``MAX_FRAMES`` frames, stretches of ``STRETCH`` frames are read, spread over the whole
    sequence.

    Args:
        sequence: an open sequence, or a path. To pass options, open the path with ``dynaviz.open``.
        progress: called with the phase, the number of steps done and the total.

    Returns:
        The diagnosis; printing it shows the findings.

    Raises:
        DataError: if the path is not a recognised sequence, or no frame can be read.
    """
    if not isinstance(sequence, Sequence):
        from dynaviz import api

        sequence = api.open(sequence)
    checker, findings, errors = ScanChecker(sequence), list[Finding](), list[DataError]()
    if not len(sequence):
        raise DataError(sequence.name, "contains no frame", hint="Give the folder of a sequence")
    chosen = _positions_to_read(len(sequence))
    for done, (position, scan) in enumerate(_read(sequence, chosen), 1):
        if isinstance(scan, DataError):
            errors.append(scan)
        else:
            checker.check(position, scan)
        progress("reading", done, len(chosen))
    if not checker.positions:
        raise errors[0]
    findings += _unreadable(errors)
    alignment_findings = list(_check_alignment(checker, progress))
    misaligned = any(finding.name not in KEEPS_RANGES for finding in alignment_findings)
    findings += alignment_findings  # first among equal confidence: other findings may follow from these
    findings += (finding for finding in checker.findings() if not (misaligned and finding.name == "ego points"))
    if len(checker.positions) > 1:
        findings += trajectory.jumps(checker.positions, checker.indices, checker.poses)
    return Diagnosis.of(sequence.name, len(sequence), len(chosen), findings)


def _positions_to_read(frames: int) -> list[int]:
    """Positions of the frames to read: all of a short sequence, stretches of a long one."""
    if frames <= MAX_FRAMES:
        return list(range(frames))
    starts = np.linspace(0, frames - STRETCH, MAX_FRAMES // STRETCH).astype(int)
    return sorted({int(start) + k for start in starts for k in range(STRETCH)})


def _read(sequence: Sequence, positions: list[int]) -> Iterator[tuple[int, Scan | DataError]]:
    """Frames in order, reading one ahead; an unreadable frame yields its error instead of a scan."""

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
    """One finding per kind of error, with the first file."""
    groups: dict[str | None, list[DataError]] = {}
    for error in errors:
        groups.setdefault(error.hint, []).append(error)
    for hint, group in groups.items():
        first = group[0]
        also = f"; {len(group) - 1:,} more files have the same problem" if len(group) > 1 else ""
        place = f"{first.at}: " if first.at else ""
        labels = any("label" in part for part in Path(first.path).parts[-2:])
        name = "labels do not fit" if labels else "unreadable frame"
        yield Finding(name, Confidence.CERTAIN, f"{place}{first.problem}{also}",
                      f"{hint or 'Write or copy the file again'}", (), len(group), first.path)  # fmt: skip


_MISSING = (
    "Give the sensor's poses: --poses FILE for files:PATH, or VIEWPOINT in PCD files. Any odometry, such as KISS-ICP, "
    "can compute them"
)
_LIDAR = "Give the pose of the lidar, not of the vehicle or the IMU, in the world frame of the points"


def _check_alignment(checker: ScanChecker, progress: Progress) -> Iterator[Finding]:
    """Check whether poses and clouds match; the first explanation found is the only one reported."""
    same = trajectory.identical(checker.poses) if len(checker.poses) > 1 else None
    if same:
        for gap in (1, 10):
            if motion := alignment.moving_clouds(_views(checker, checker.pairs_apart(gap), progress)):
                yield Finding("poses missing", motion[1], f"{same}, but {motion[0]}", _MISSING)
                return
    views = _views(checker, alignment.pairs(checker.positions, checker.poses, checker.usable), progress)
    if found := [*(alignment.better_interpretation(views) if views else ()), *trajectory.check_tilt(checker.poses)]:
        yield found[0]
    elif views and (problem := alignment.measured_elsewhere(views, 1.5 if same else 2.0)):
        if same:
            yield Finding("poses missing", Confidence.LIKELY, f"{same}, but {problem}", _MISSING)
        else:
            yield Finding("origin elsewhere", Confidence.PERHAPS, problem, _LIDAR)
    elif found := list(checker.outside_finding()):
        yield from found
    else:
        yield from alignment.ground(views, checker.sequence.sensor.height, checker.sequence.sensor.title)


def _views(
    checker: ScanChecker, pairs: list[tuple[int, int]], progress: Progress
) -> list[tuple[alignment.ScanView, alignment.ScanView]]:
    """Read pairs of scans again for comparison; pairs with too few points are left out."""
    views = []
    for done, rows in enumerate(pairs, 1):
        a, b = (alignment.ScanView(checker.sequence[checker.positions[row]]) for row in rows)
        if min(len(a.points), len(b.points)) > MIN_POINTS:
            views.append((a, b))
        progress("comparing", done, len(pairs))
    return views

"""Diagnose a sequence and suggest fixes: ``dynaviz.doctor``."""

from __future__ import annotations

import os
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from dynaviz.contracts.scan import Scan, Sequence, SequenceView, base_of
from dynaviz.diagnosis import placement, trajectory, upright
from dynaviz.diagnosis.alignment import Pairs, better_interpretation
from dynaviz.diagnosis.columns import check_columns
from dynaviz.diagnosis.drift import AWAY, DRIFT, check_drift, looks
from dynaviz.diagnosis.finding import Confidence, Diagnosis, Finding
from dynaviz.diagnosis.sampling import looks as looks_at_places
from dynaviz.diagnosis.sampling import sampling
from dynaviz.diagnosis.scans import ScanChecker
from dynaviz.diagnosis.units import FACTORS, check_units
from dynaviz.diagnosis.views import ScanView, around, pairs
from dynaviz.errors import DataError
from dynaviz.progress import Progress, silent
from dynaviz.sources.datasets import open_sequence
from dynaviz.sources.datasets.in_memory import ArraySequence
from dynaviz.sources.origin import PoseFinding
from dynaviz.sources.pose_noise import PoseNoiseMeter

__all__ = ["DRIFT", "Confidence", "Diagnosis", "Finding", "doctor", "quick_check"]

MAX_FRAMES, STRETCH = 400, 20  # frames read of a long sequence, and consecutive frames in each stretch
QUICK_PAIRS, QUICK_GAP = 3, 5  # pairs of frames of a quick check, and frames from one to the other
QUICK_POINTS = 30_000  # of each of these frames, at most
PAIRS = 6  # pairs of scans that are compared
PLACES, QUICK_PLACES = 12, 5  # scans whose places are looked for in later ones, to find drift
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
    if isinstance(sequence, str | os.PathLike):
        sequence = open_sequence(os.fspath(sequence))
    elif not isinstance(sequence, Sequence):
        sequence = ArraySequence.of(sequence)
    checker, findings, errors = ScanChecker(sequence), list[Finding](), list[DataError]()
    if not len(sequence):
        raise DataError(sequence.name, "contains no frame", hint="Give the folder of a sequence")
    chosen, noise = _positions_to_read(len(sequence)), PoseNoiseMeter(len(sequence))
    for done, (position, scan) in enumerate(_read(sequence, chosen), 1):
        if isinstance(scan, DataError):
            errors.append(scan)
        else:
            checker.check(position, scan)
            noise.add(position, scan)
        progress("reading", done, len(chosen))
    if not checker.positions:
        raise errors[0]
    findings += _unreadable(errors)
    if columns := list(check_columns(sequence, checker.indices[0], checker.positions[0])):
        return Diagnosis.of(
            sequence.name, len(sequence), len(chosen), columns + findings, of_poses=columns
        )  # the rest follows
    alignment_findings = list(_check_alignment(checker, progress))
    misaligned = any(finding.name not in KEEPS_RANGES for finding in alignment_findings)
    findings += alignment_findings  # first among equal confidence: other findings may follow from these
    other_unit = any(finding.name in FACTORS for finding in alignment_findings)
    follow = {"ego points", *(("far points",) if other_unit else ())} if misaligned else set[str]()
    findings += (finding for finding in checker.findings() if finding.name not in follow)
    jumps = list[Finding]()
    if len(checker.positions) > 1 and not other_unit:
        findings += (jumps := list(trajectory.jumps(checker.positions, checker.indices, checker.poses)))
    if not misaligned and not jumps:
        places = looks(checker.positions, checker.poses, checker.usable, PLACES)
        drift = list(check_drift(_views(checker, list(places), progress)))
        findings += drift
        alignment_findings += drift
    diagnosis = Diagnosis.of(sequence.name, len(sequence), len(chosen), findings, of_poses=alignment_findings)
    if misaligned:
        return diagnosis
    positions = [pose[:3, 3] for pose in checker.poses]
    seen = looks_at_places(positions, checker.positions, len(sequence))
    return replace(diagnosis, pose_noise=noise.result(), sampling=sampling(seen, sequence.sensor.rings))


def quick_check(sequence: Sequence) -> tuple[PoseFinding, ...]:
    """Compare a few scans with each other; if they do not fit, the likely findings of ``doctor`` on poses and frames.

    Takes about a second if they fit. Simulated sequences, and copies with implants, are not checked: reading them
    is slow.
    Errors of reading are not reported: reading the whole sequence reports them.
    """
    if getattr(type(base_of(sequence)), "nested", False) or len(sequence) < 2:
        return ()
    gap = min(QUICK_GAP, len(sequence) - 1)
    starts = np.linspace(0, len(sequence) - 1 - gap, QUICK_PAIRS).astype(int)
    few = _FewPoints(sequence, {})
    checker = ScanChecker(few)
    try:
        for position in sorted({int(start) + k for start in starts for k in (0, gap)}):
            checker.check(position, few[position])
        columns = list(check_columns(sequence, checker.indices[0], checker.positions[0]))
        found = columns or list(_check_alignment(checker, silent, quick=True)) or list(_quick_drift(few, checker, gap))
        if all(each.confidence > Confidence.LIKELY for each in found):
            return ()
        of_poses = doctor(sequence).of_poses
    except DataError:
        return ()
    likely = (each for each in of_poses if each.confidence <= Confidence.LIKELY)
    return tuple(PoseFinding(each.name, each.problem, each.fix, each.option) for each in likely)


def _quick_drift(few: _FewPoints, checker: ScanChecker, gap: int) -> Iterator[Finding]:
    """Compare scans over the whole sequence with those that the sensor measures after about ``AWAY``."""
    ends = np.array([pose[:3, 3] for pose in checker.poses])
    speed = float(np.median(np.linalg.norm(ends[1::2] - ends[::2], axis=1))) / gap if len(ends) % 2 == 0 else 0.0
    later = min(int(AWAY / speed) + 1 if speed > AWAY / len(few) else len(few), len(few) - 1)
    starts = sorted({*np.linspace(0, len(few) - 1 - later, QUICK_PLACES).astype(int).tolist()})
    yield from check_drift((ScanView(few[k]), ScanView(few[k + later])) for k in starts)


@dataclass(frozen=True)
class _FewPoints(SequenceView):
    """A sequence of which each frame is read once, with at most ``QUICK_POINTS`` points."""

    whole: Sequence
    kept: dict[int, Scan]

    def __getitem__(self, position: int) -> Scan:
        if position not in self.kept:
            scan = self.whole[position].without_truth()
            step = -(-len(scan) // QUICK_POINTS) or 1
            origins = scan.origins if len(scan.origins) == 1 else scan.origins[::step]
            times = None if scan.times is None else scan.times[::step]
            self.kept[position] = replace(scan, points=scan.points[::step], origins=origins, times=times)
        return self.kept[position]


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
    "Give the sensor's poses: --poses FILE for files:PATH, or VIEWPOINT in PCD files. --poses small-gicp estimates them"
)
_LIDAR = "Give the pose of the lidar, not of the vehicle or the IMU, in the world frame of the points"


def _check_alignment(checker: ScanChecker, progress: Progress, quick: bool = False) -> Iterator[Finding]:
    """Check whether poses and clouds match; the first explanation found is the only one reported."""
    if found := check_units(checker.read, checker.with_points, checker.positions, checker.poses):
        yield found
        return
    same = trajectory.identical(checker.poses) if len(checker.poses) > 1 else None
    if same:
        for gap in (1, 10):
            if motion := placement.moving_clouds(_views(checker, checker.pairs_apart(gap), progress)):
                yield Finding("poses missing", motion[1], f"{same}, but {motion[0]}", _MISSING)
                return
    track, number = (checker.positions, checker.poses, checker.usable), QUICK_PAIRS if quick else PAIRS
    views = _views(checker, pairs(*track, number), progress)
    others = lambda: _views(checker, pairs(*track, number, skipped=1), progress)  # noqa: E731
    if explained := [*(better_interpretation(views, others) if views else ()), *upright.check_up(views, checker.poses)]:
        yield explained[0]
    elif views and not quick and (problem := placement.measured_elsewhere(views, 1.5 if same else 2.0)):
        if same:
            yield Finding("poses missing", Confidence.LIKELY, f"{same}, but {problem}", _MISSING)
        else:
            yield Finding("origin elsewhere", Confidence.PERHAPS, problem, _LIDAR)
    elif outside := list(checker.outside_finding()):
        yield from outside
    else:
        yield from upright.ground(views, checker.sequence.sensor.height, checker.sequence.sensor.title)


def _views(checker: ScanChecker, chosen: list[tuple[int, int]], progress: Progress) -> Pairs:
    """Read pairs of scans again for comparison; pairs with too few points are left out."""
    views = []
    track = checker.positions, checker.poses, checker.stamps
    for done, rows in enumerate(chosen, 1):
        a, b = (ScanView(checker.read(row), around(row, *track)) for row in rows)
        if min(len(a.points), len(b.points)) > MIN_POINTS:
            views.append((a, b))
        progress("comparing", done, len(chosen))
    return views

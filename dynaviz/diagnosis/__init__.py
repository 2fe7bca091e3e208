"""Diagnose a sequence and suggest fixes: ``dynaviz.doctor``.

Private: other packages do not import it.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np

from dynaviz.contracts.scan import Scan, Sequence
from dynaviz.diagnosis import placement, rivals, trajectory, upright
from dynaviz.diagnosis.alignment import Pairs, better_interpretation
from dynaviz.diagnosis.columns import check_columns
from dynaviz.diagnosis.drift import AWAY, DRIFT, check_drift, looks
from dynaviz.diagnosis.finding import Confidence, Diagnosis, Finding
from dynaviz.diagnosis.frame_groups import GROUPS, FrameGroups
from dynaviz.diagnosis.precision import check_precision
from dynaviz.diagnosis.sampling import looks as looks_at_places
from dynaviz.diagnosis.sampling import sampling
from dynaviz.diagnosis.scans import ScanChecker
from dynaviz.diagnosis.units import check_units, unusual_size
from dynaviz.errors import DataError
from dynaviz.progress import Progress, silent
from dynaviz.sources.datasets import open_sequence
from dynaviz.sources.datasets.in_memory import ArraySequence
from dynaviz.sources.drive import Drive
from dynaviz.sources.hypotheses.sizes import FACTORS
from dynaviz.sources.hypotheses.views import ScanView, comparable
from dynaviz.sources.origin import PoseFinding
from dynaviz.sources.pose_noise import PoseNoiseMeter

__all__ = ["OF_POSES", "Confidence", "Diagnosis", "Finding", "doctor", "quick_check"]

# frames read of a long sequence, and consecutive frames in each stretch
MAX_FRAMES = 400
STRETCH = 20
# scans whose places are looked for in later ones, to find drift
PLACES = 12
QUICK_PLACES = 5
SPARSE = 0.55  # overlap of neighbouring scans below which they are registered to each other
OF_POSES = (DRIFT, rivals.DELAY)  # findings that poses with ground truth may have
UPS = ("world not z-up", "tilted")  # findings that a mount may explain better
KEEPS_RANGES = ("ground height",)  # findings on poses that do not affect distances from the sensor


def doctor(
    sequence: Sequence | str | os.PathLike[str], *, progress: Progress = silent
) -> Diagnosis:
    """Diagnose a sequence and suggest fixes.

    If the sequence has more than ``MAX_FRAMES`` frames, stretches of ``STRETCH`` frames are read,
    spread over the whole sequence.

    Args:
        sequence: an open sequence, or a path. To pass options, open the path with ``dynaviz.open``.
        progress: called with the phase, the number of steps done and the total.

    Returns:
        The diagnosis; printing it shows the findings.

    Raises:
        DataError: if the path is not a recognised sequence, or no frame can be read.
    """
    if isinstance(sequence, str | os.PathLike):
        drive = open_sequence(os.fspath(sequence))
    elif isinstance(sequence, Sequence):
        drive = Drive.of(sequence)
    else:
        drive = Drive.of(ArraySequence.of(sequence))
    return _diagnosed(drive, progress)


def _diagnosed(sequence: Drive, progress: Progress) -> Diagnosis:
    """The diagnosis of a drive; arguments and errors as those of ``doctor``."""
    checker = ScanChecker(sequence)
    findings = list[Finding]()
    errors = list[DataError]()
    if not len(sequence):
        raise DataError(sequence.name, "contains no frame", hint="Give the folder of a sequence")
    chosen = _positions_to_read(len(sequence))
    noise = PoseNoiseMeter(len(sequence))
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
    if files := _of_files(sequence, checker):
        # the rest follows
        return Diagnosis.of(
            sequence.name, len(sequence), len(chosen), files + findings, of_poses=files
        )
    groups = FrameGroups(sequence)
    alignment_findings = list(_check_alignment(groups, progress))
    misaligned = any(finding.name not in KEEPS_RANGES for finding in alignment_findings)
    findings += (
        alignment_findings  # first among equal confidence: other findings may follow from these
    )
    other_unit = any(finding.name in FACTORS for finding in alignment_findings)
    follow = {"ego points", *(("far points",) if other_unit else ())} if misaligned else set[str]()
    findings += (finding for finding in checker.findings() if finding.name not in follow)
    jumps = list[Finding]()
    if len(checker.positions) > 1 and not other_unit:
        findings += (
            jumps := list(trajectory.jumps(checker.positions, checker.indices, checker.poses))
        )
    if not misaligned and not jumps:
        places = looks(checker.positions, checker.poses, checker.usable, PLACES)
        ends = {(checker.positions[a], checker.positions[b]) for a, b in places} | set(
            _quick_places(groups)
        )
        drift = _drift(groups, sorted(ends), progress)
        findings += drift
        alignment_findings += drift
    diagnosis = Diagnosis.of(
        sequence.name, len(sequence), len(chosen), findings, of_poses=alignment_findings
    )
    if misaligned:
        return diagnosis
    positions = [pose[:3, 3] for pose in checker.poses]
    seen = looks_at_places(positions, checker.positions, len(sequence))
    return replace(
        diagnosis, pose_noise=noise.result(), sampling=sampling(seen, sequence.sensor.rings)
    )


def quick_check(sequence: Drive) -> tuple[PoseFinding, ...]:
    """The likely findings of ``doctor`` on poses, frames and units, from the same few frames.

    At most 52.

    Takes about a second if the frames fit, since then only half of the pairs are compared.
    Simulated sequences, and copies with implants, are not checked: reading them is slow. Errors of
    reading are not reported: reading the whole sequence reports them.
    """
    if sequence.exact or len(sequence) < 2:
        return ()
    groups = FrameGroups(sequence)
    if not groups.checker.positions:
        return ()
    try:
        found = _of_files(sequence, groups.checker)
        if not found and any(_check_alignment(groups, silent, quick=True)):
            found = list(_check_alignment(groups, silent))
        if not any(each.name not in KEEPS_RANGES for each in found):
            found += _drift(groups, _quick_places(groups), silent)
    except DataError:
        return ()
    likely = (each for each in found if each.confidence <= Confidence.LIKELY)
    return tuple(PoseFinding(each.name, each.problem, each.fix, each.option) for each in likely)


def _of_files(sequence: Drive, checker: ScanChecker) -> list[Finding]:
    """Findings on the first file, from which all others would follow."""
    position = checker.positions[0]
    return [
        *check_columns(sequence, checker.indices[0], position),
        *check_precision(sequence, position),
    ]


def _quick_places(groups: FrameGroups) -> list[tuple[int, int]]:
    """Positions of frames over the whole sequence, and of those that the sensor measures after
    about ``AWAY``.
    """
    track = groups.checker
    frames = len(groups.few)
    if len(track.positions) < 2:
        return []
    ways = np.linalg.norm(np.diff(np.array(track.poses)[:, :3, 3], axis=0), axis=1) / np.diff(
        track.positions
    )
    speed = float(np.median(ways))
    later = min(int(AWAY / speed) + 1 if speed > AWAY / frames else frames, frames - 1)
    return [
        (k, k + later)
        for k in np.unique(np.linspace(0, frames - 1 - later, QUICK_PLACES).astype(int)).tolist()
    ]


def _seen(groups: FrameGroups, places: list[tuple[int, int]], progress: Progress) -> Pairs:
    """Pairs of scans by their positions; those with too few points are left out."""
    views = []
    for done, pair in enumerate(places, 1):
        seen = [ScanView(scan) for position in pair if (scan := groups.scan(position)) is not None]
        if len(seen) == 2 and comparable(seen):
            views.append((seen[0], seen[1]))
        progress("comparing", done, len(places))
    return views


def _drift(groups: FrameGroups, places: list[tuple[int, int]], progress: Progress) -> list[Finding]:
    """Poses that drift, or what else explains that places are not where they were."""
    views = _seen(groups, places, progress)
    found = list(check_drift(views))
    if not found:
        return found
    pairs = groups.views(groups.pairs(), progress)
    near = lambda: groups.views(groups.pairs_apart(2), progress)  # noqa: E731
    path = groups.few.pose_path
    explained = (
        (path and rivals.delay_finding(views, pairs, path))
        or rivals.mount_finding(views, near, drifts=True)
        or _out_of_order(groups)
        or rivals.misplaced(pairs, near, path)
    )
    return [explained] if explained else found


def _out_of_order(groups: FrameGroups) -> Finding | None:
    way = rivals.unsteady_way(groups.checker.positions, groups.checker.poses)
    return rivals.cannot_tell(way) if way else None


def _positions_to_read(frames: int) -> list[int]:
    """Positions of the frames to read: all of a short sequence, stretches of a long one."""
    if frames <= MAX_FRAMES:
        return list(range(frames))
    starts = np.linspace(0, frames - STRETCH, MAX_FRAMES // STRETCH).astype(int)
    return sorted({int(start) + k for start in starts for k in range(STRETCH)})


def _read(sequence: Sequence, positions: list[int]) -> Iterator[tuple[int, Scan | DataError]]:
    """Frames in order, reading one ahead.

    An unreadable frame yields its error instead of a scan.
    """

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
        yield Finding(
            name,
            Confidence.CERTAIN,
            f"{place}{first.problem}{also}",
            f"{hint or 'Write or copy the file again'}",
            (),
            len(group),
            first.path,
        )


def _not_compared(checker: ScanChecker) -> list[Finding]:
    """Why scans cannot be compared: points that are far from the sensor."""
    size = unusual_size(checker.read, checker.with_points)
    return list(checker.outside_finding()) or ([size] if size else [])


_MISSING = (
    "Give the poses of the sensor: --poses FILE (KITTI, TUM or CSV), or VIEWPOINT in PCD files. "
    "Without such a file, --poses small-gicp estimates them"
)
_LIDAR = (
    "Give the pose of the lidar, not of the vehicle or the IMU, in the world frame of the points"
)


def _check_alignment(
    groups: FrameGroups, progress: Progress, quick: bool = False
) -> Iterator[Finding]:
    """Check whether poses and clouds match; the first explanation found is the only one reported.

    Args:
        groups: the frames.
        progress: called for each pair of frames.
        quick: compare every other pair, if there is one for each group.
    """
    checker = groups.checker
    if not checker.positions:
        return
    if found := check_units(checker.read, checker.with_points, checker.positions, checker.poses):
        yield found
        return
    several = len(checker.poses) > 1
    same = trajectory.identical(checker.poses, groups.posed) if several else None
    if same:
        for gap in (1, 10):
            if motion := placement.moving_clouds(groups.views(groups.pairs_apart(gap), progress)):
                yield Finding("poses missing", motion[1], f"{same}, but {motion[0]}", _MISSING)
                return
    pairs = groups.pairs()
    views = groups.views(pairs[::2] if quick and len(pairs) == GROUPS else pairs, progress)
    others = lambda: groups.views(groups.pairs(skipped=1), progress)  # noqa: E731
    near = lambda: groups.views(groups.pairs_apart(2), progress)  # noqa: E731
    distant = lambda: _seen(groups, _quick_places(groups), progress)  # noqa: E731
    if not views and (apart := _not_compared(checker)):
        yield from apart
    elif explained := better_interpretation(views, others, distant):
        yield rivals.weighed(*explained, views, near, distant, groups.few.pose_path)
    elif up := next(upright.check_up(views, checker.poses), None):
        yield (up.name in UPS and rivals.mount_finding(views, near)) or up
    elif beside := rivals.upside_down(views, near):
        yield beside
    elif not same and (wrong := rivals.misplaced(views, near, groups.few.pose_path, SPARSE)):
        yield wrong
    elif (
        views
        and (same or not quick)
        and (problem := placement.measured_elsewhere(views, 1.5 if same else 2.0))
    ):
        if same:
            yield Finding("poses missing", Confidence.LIKELY, f"{same}, but {problem}", _MISSING)
        else:
            yield Finding("origin elsewhere", Confidence.PERHAPS, problem, _LIDAR)
    elif outside := list(checker.outside_finding()):
        yield from outside
    else:
        yield from upright.ground(
            views, checker.sequence.sensor.height, checker.sequence.sensor.title
        )

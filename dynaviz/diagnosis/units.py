"""Check units: points or positions in millimetres or centimetres."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynaviz.arrays import F64
from dynaviz.contracts.scan import Scan
from dynaviz.diagnosis.finding import Confidence, Finding
from dynaviz.sources.hypotheses import sizes
from dynaviz.sources.hypotheses.sizes import FACTORS, FAR_POINTS, LONG_STEPS, median_range
from dynaviz.sources.hypotheses.views import ScanView, comparable, hidden, pairs

USUAL = 1.2, 60.0  # metres; median range of a scan in metres
SMALLEST = 0.3  # metres; median range of a scan that is measured by a lidar, at least
USUAL_STEP = 6.0  # metres; median way between two frames
MIN_OVERLAP = 0.25  # share of a scan that must overlap the other after the correction

Read = Callable[[int], Scan]
Points = NDArray[np.floating[Any]]
Convert = Callable[[Scan, float], tuple[Points, F64]]
_DIVIDE = "divide {what} by {factor:.0f} when you write them"


def _everything(scan: Scan, k: float) -> tuple[Points, F64]:
    return scan.points / k, scan.position / k


def _points_in_sensor_frame(scan: Scan, k: float) -> tuple[Points, F64]:
    return (scan.points - scan.position) / k + scan.position, scan.position


def _points_in_world_frame(scan: Scan, k: float) -> tuple[Points, F64]:
    return scan.points / k, scan.position


def _positions(scan: Scan, k: float) -> tuple[Points, F64]:
    """Of points that were transformed by the pose."""
    return scan.points - scan.position + scan.position / k, scan.position / k


def _positions_only(scan: Scan, k: float) -> tuple[Points, F64]:
    return scan.points.astype(np.float64), scan.position / k


HYPOTHESES: tuple[tuple[str, str, Convert], ...] = (
    ("points and positions", "points and the positions of poses", _everything),
    ("points", "points", _points_in_sensor_frame),
    ("points", "points", _points_in_world_frame),
    ("positions", "the positions of poses", _positions),
    ("positions", "the positions of poses", _positions_only),
)


def check_units(
    read: Read, rows: Sequence[int], positions: Sequence[int], poses: Sequence[F64]
) -> Finding | None:
    """A finding if scans are too far or steps too long for metres, and fit together in another
    unit.

    Args:
        read: reads the scan of a row.
        rows: of scans with finite points.
        positions, poses: of all rows.
    """
    if not rows:
        return None
    reach = _usual_reach(read, rows)
    step = _step(positions, poses)
    if reach < FAR_POINTS and step < LONG_STEPS:
        return None
    found = []
    for unit, factor in FACTORS.items():
        for what, words, convert in HYPOTHESES:
            if (step if what == "positions" else reach) < (
                LONG_STEPS if what == "positions" else FAR_POINTS
            ):
                continue
            pair = _overlap(read, rows, positions, poses, convert, factor)
            if pair is not None and pair[0] > MIN_OVERLAP:
                found.append((*pair, unit, factor, what, words))
    if not found:
        return None
    most = max(row[0] for row in found)
    overlap, _, unit, factor, what, words = min(
        (row for row in found if row[0] > most - 0.03), key=lambda row: round(row[1], 2)
    )
    given = _overlap(read, rows, positions, poses, _positions_only, 1.0, check=False) or (0.0, 0.0)
    if overlap < given[0] + 0.06 and reach < FAR_POINTS:
        return None
    problem = (
        f"{words} are in {unit}, not in metres: the median range is {reach:,.0f}, the way between "
        f"frames {step:,.1f}. "
        f"Divided by {factor:.0f}, {overlap:.0%} of a scan overlaps the other, instead of "
        f"{given[0]:.0%}"
    )
    return Finding(
        unit,
        Confidence.CERTAIN,
        problem,
        f"Write metres: {_DIVIDE.format(what=what, factor=factor)}",
    )


def unusual_size(read: Read, rows: Sequence[int]) -> Finding | None:
    """A finding if scans that cannot be compared are too large or too small for metres.

    Args:
        read: reads the scan of a row; rows: of scans with finite points.
    """
    reach = _usual_reach(read, rows) if len(rows) > 1 else 1.0
    if SMALLEST <= reach < FAR_POINTS:
        return None
    problem = (
        f"the points of a scan are {reach:,.3g} m from the sensor in the median, so scans cannot "
        "be compared, and nobody can tell whether poses fit"
    )
    return Finding(
        "unusual size", Confidence.LIKELY, problem, "Give points and positions in metres"
    )


def _usual_reach(read: Read, rows: Sequence[int]) -> float:
    """Median range of the points of three scans, given units."""

    def points(row: int) -> F64:
        scan = read(rows[row])
        return scan.points.astype(np.float64) - scan.position

    return sizes.reach(points, len(rows))


def _reach(points: Points, position: F64) -> float:
    """Median range of the finite points, given units."""
    return median_range(points.astype(np.float64) - position)


def _extent(points: Points) -> float:
    """Median distance of the finite points from their middle, given units."""
    finite = points[np.isfinite(points).all(1)]
    return _reach(finite, np.median(finite, axis=0)) if len(finite) else 0.0


def _step(positions: Sequence[int], poses: Sequence[F64]) -> float:
    """Median way between neighbouring frames, given units."""
    ways = np.linalg.norm(np.diff(np.array(poses)[:, :3, 3], axis=0), axis=1)
    near = np.diff(positions) == 1
    return float(np.median(ways[near])) if near.any() else 0.0


def _overlap(
    read: Read,
    rows: Sequence[int],
    positions: Sequence[int],
    poses: Sequence[F64],
    convert: Convert,
    factor: float,
    check: bool = True,
) -> tuple[float, float] | None:
    """Mean overlap and share of hidden points of three pairs in another unit.

    None if sizes are then not usual.
    """
    moved = []
    for pose in poses:
        T = pose.copy()
        T[:3, 3] /= factor if convert in (_everything, _positions, _positions_only) else 1.0
        moved.append(T)
    if check and _step(positions, moved) > USUAL_STEP:
        return None
    usable = np.isin(np.arange(len(poses)), rows)
    figures = []
    for chosen in pairs(positions, moved, [bool(ok) for ok in usable], 3):
        views = []
        for row in chosen:
            scan = read(row)
            points, position = convert(scan, factor)
            if check and not (
                USUAL[0] < _reach(points, position) < USUAL[1] and USUAL[0] < _extent(points)
            ):
                break
            T = scan.T_world_sensor.copy()
            T[:3, 3] = position
            views.append(ScanView(Scan(scan.index, points.astype(np.float32), T, scan.stamp_ns)))
        if len(views) == 2 and comparable(views):
            a, b = views
            figures.append((a.surface.overlap(b.points), hidden(b.sample, b.T[None, :3, 3])))
    if not figures:
        return None
    overlap, hides = np.mean(figures, axis=0)
    return float(overlap), float(hides)

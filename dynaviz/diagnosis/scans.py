"""Checks of single scans and of neighbours, over streamed frames; what is kept of a scan is a few numbers."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np

from dynaviz.arrays import F32, F64, I64, Bool
from dynaviz.diagnosis.finding import SHOWN, Confidence, Finding, settable
from dynaviz.scan import Label, Scan, Sequence
from dynaviz.spatial import geometry
from dynaviz.spatial.extent import FAR

HOUSING = 0.05  # metres; nothing is measured nearer: a sensor without return wrote its own place
NEAR = 0.5  # metres; what hides a direction at this range hides everything
COLUMNS = 360  # of azimuth
SLOTS = 8192  # points that neighbours are compared by

_DROP = "Leave such points out when writing the scans"


class ScanStatistics:
    """A scan with what several checks ask of it.

    Attributes:
        before: the scan before it, if that is its neighbour.
    """

    def __init__(self, scan: Scan, before: Scan | None) -> None:
        self.scan, self.before = scan, before

    def __len__(self) -> int:
        return len(self.scan)

    @cached_property
    def columns(self) -> list[F32]:
        """x, y and z: numpy is much faster by columns."""
        return [np.ascontiguousarray(self.scan.points[:, axis]) for axis in range(3)]

    @cached_property
    def finite(self) -> Bool:
        """(N,) bool: points without NaN or infinity."""
        x, y, z = (np.isfinite(column) for column in self.columns)
        finite: Bool = x & y & z
        return finite

    @cached_property
    def zero(self) -> Bool:
        """(N,) bool: points at exactly (0, 0, 0)."""
        x, y, z = (column == 0 for column in self.columns)
        zero: Bool = x & y & z
        return zero

    @cached_property
    def ranges(self) -> F64:
        """(N,) metres from each ray's origin; infinite for points that are not finite."""
        squares = np.zeros(len(self))
        with np.errstate(invalid="ignore", over="ignore"):
            for axis, column in enumerate(self.columns):
                squares += (column - self.scan.origins[:, axis]) ** 2
        return np.where(self.finite, np.sqrt(squares), np.inf)

    @cached_property
    def box(self) -> tuple[F64, F64]:
        """Low and high corner of all finite points; zeros without any."""
        kept = self.columns if self.finite.all() else [column[self.finite] for column in self.columns]
        if not len(kept[0]):
            return np.zeros(3), np.zeros(3)
        low, high = (np.array([getattr(column, end)() for column in kept], np.float64) for end in ("min", "max"))
        return low, high


def empty(seen: ScanStatistics) -> float:
    """1 where no point is usable."""
    return float(not seen.finite.any())


def not_finite(seen: ScanStatistics) -> float:
    """Share of points that are NaN or infinite."""
    return _share(~seen.finite)


def far(seen: ScanStatistics) -> float:
    """Kilometres of the farthest finite coordinate, or ray origin, from the world's origin."""
    return max(float(np.abs(part).max(initial=0)) for part in (*seen.box, seen.scan.origins)) / 1000


def no_return(seen: ScanStatistics) -> float:
    """Number of points at the ray's own origin, or at exactly (0, 0, 0) by the dozen."""
    return float((seen.zero if seen.zero.sum() > 12 else seen.ranges < HOUSING).sum())


def ego(seen: ScanStatistics) -> float:
    """Share of azimuth columns in which something is nearer than ``NEAR``."""
    near = (seen.ranges >= HOUSING) & (seen.ranges < NEAR)
    if not near.any():
        return 0.0
    xyz = geometry.apply(geometry.inverse(seen.scan.T_world_sensor), seen.scan.points[near])
    turn = np.arctan2(xyz[:, 1], xyz[:, 0]) / (2 * np.pi) + 0.5
    return len(np.unique(np.floor(turn * COLUMNS))) / COLUMNS


def duplicates(seen: ScanStatistics) -> float:
    """Share of points with the coordinates of another one, not counting those without return."""
    x, y, z = (column.view(np.uint32).astype(np.uint64) for column in seen.columns)
    with np.errstate(over="ignore"):
        key = x * np.uint64(0x9E3779B97F4A7C15) + y * np.uint64(0xC2B2AE3D27D4EB4F) + z * np.uint64(0x165667B19E3779F9)
    key = np.sort(key[seen.finite & ~seen.zero & (seen.ranges >= HOUSING)])
    return _share(key[1:] == key[:-1])


def repeated(seen: ScanStatistics) -> float:
    """1 where the scan is the one before it, in the world frame or in the sensor's."""
    scan, before = seen.scan, seen.before
    if before is None or len(scan) != len(before) or not seen.finite.any():
        return 0.0
    some = slice(None, None, max(len(scan) // SLOTS, 1))
    if np.array_equal(scan.points[some], before.points[some], equal_nan=True):
        return 1.0
    with np.errstate(invalid="ignore"):
        a, b = (geometry.apply(geometry.inverse(s.T_world_sensor), s.points[some]) for s in (scan, before))
    rounding = 1e-6 * max(float(np.abs(corner).max()) for corner in seen.box)
    return float(np.allclose(a, b, rtol=0, atol=1e-3 + rounding, equal_nan=True))


def outside(seen: ScanStatistics) -> float:
    """Metres from the sensor to the box around its points, where that is far for a cloud of this size; else 0."""
    (low, high), position = seen.box, seen.scan.position
    gap = float(np.linalg.norm(np.maximum(0, np.maximum(low - position, position - high))))
    return gap if seen.finite.any() and gap > max(10.0, 0.1 * float(np.linalg.norm(high - low))) else 0.0


def _share(hits: Bool) -> float:
    return float(hits.mean()) if len(hits) else 0.0


@dataclass(frozen=True)
class Check:
    """A figure of a scan, and from where on it is a finding.

    Attributes:
        name: of the finding.
        measure: the figure.
        limit: the figure is a finding above it.
        says: a sentence with ``{worst}``, the largest figure.
        mend: a sentence, where needed with ``{near}``, how methods leave out near points.
    """

    name: str
    measure: Callable[[ScanStatistics], float]
    limit: float
    sure: Confidence
    says: str
    mend: str


CHECKS = (
    Check("empty frame", empty, 0, Confidence.CERTAIN, "no point that is finite",
          "Leave such frames out: choose others with --frames A:B, or remove the files together with their poses"),
    Check("not finite", not_finite, 0, Confidence.CERTAIN, "up to {worst:.2%} of a scan's points are NaN or infinite",
          f"{_DROP}; methods keep them all, so they only cost time and score"),
    Check("far points", far, FAR / 1000, Confidence.CERTAIN,
          "something lies {worst:,.0f} km from the world's origin, where float32 is too coarse",
          "Move the world's origin to the first pose (subtract its position from poses and points), or drop them"),
    Check("no return", no_return, 0, Confidence.CERTAIN,
          "up to {worst:,.0f} points lie at the sensor itself or at exactly (0, 0, 0): rays without return, "
          "which block every other ray that starts there",
          f"{_DROP}, or have methods leave them out: {{near}}"),
    Check("ego points", ego, 0.01, Confidence.CERTAIN,
          f"in up to {{worst:.0%}} of all directions something nearer than {NEAR} m, "
          "the sensor's carrier, blocks the rays",
          f"Have methods leave out near points: {{near}}; for others: {_DROP.lower()}"),
    Check("duplicate points", duplicates, 0.001, Confidence.CERTAIN,
          "up to {worst:.1%} of a scan's points have the coordinates of another one, and weigh twice in all scores",
          "Write each return once; after merging lidars or clouds, drop repeated rows"),
    Check("duplicate frame", repeated, 0, Confidence.CERTAIN, "the scan is the one before it once more",
          "Remove one of the two, with its pose; in a bag, choose the one topic that is not republished"),
)  # fmt: skip


@dataclass
class Notes:
    """Where one check struck: how often, where first, and its largest figure."""

    frames: list[int] = field(default_factory=list)
    count: int = 0
    worst: float = 0.0

    def add(self, index: int, figure: float = 0.0) -> None:
        """One more frame."""
        self.count += 1
        self.worst = max(self.worst, figure)
        if len(self.frames) < SHOWN:
            self.frames.append(index)


class ScanWalk:
    """Sees scan after scan; keeps a pose, a number and a stamp of each, and what the checks noted."""

    def __init__(self, sequence: Sequence) -> None:
        self.sequence = sequence
        self.positions: list[int] = []
        self.indices: list[int] = []
        self.stamps: list[int | None] = []
        self.poses: list[F64] = []
        self.usable: list[bool] = []
        self._notes = [Notes() for _ in CHECKS]
        self._labels: I64 = np.zeros(256, np.int64)
        self._outside = Notes()
        self._before: Scan | None = None

    def visit(self, position: int, scan: Scan) -> None:
        """Check a scan."""
        neighbour = self._before if self.positions and self.positions[-1] == position - 1 else None
        seen = ScanStatistics(scan, neighbour)
        figures = [check.measure(seen) for check in CHECKS]
        for check, notes, figure in zip(CHECKS, self._notes, figures, strict=True):
            if figure > check.limit:
                notes.add(scan.index, figure)
        if scan.labels is not None:
            self._labels += np.bincount(scan.labels, minlength=256)
        if (gap := outside(seen)) > 0:
            self._outside.add(scan.index, gap)
        self.positions.append(position)
        self.indices.append(scan.index)
        self.stamps.append(scan.stamp_ns)
        self.poses.append(scan.T_world_sensor)
        self.usable.append(bool(seen.finite.any()) and far(seen) <= FAR / 1000)
        self._before = scan

    def pairs_apart(self, gap: int, number: int = 6) -> list[tuple[int, int]]:
        """Pairs of usable frames over the whole sequence that lie a number of frames apart; rows of what is kept."""
        gap = min(gap, len(self.positions) - 1)
        rows = [k for k in range(len(self.positions) - gap) if self.usable[k] and self.usable[k + gap]]
        return (
            [(rows[k], rows[k] + gap) for k in sorted({*np.linspace(0, len(rows) - 1, number).astype(int)})]
            if rows
            else []
        )

    def findings(self) -> Iterator[Finding]:
        """What was noted, frames, labels and times."""
        for check, notes in zip(CHECKS, self._notes, strict=True):
            if notes.count:
                what = check.says.format(worst=notes.worst)
                mend = check.mend
                if "{near}" in mend:
                    mend = mend.format(near=settable("min_range", f"{NEAR + 0.1}"))
                yield self._finding(check.name, check.sure, what, mend, notes)
        yield from self._label_findings()
        yield from self._order()

    def outside_finding(self) -> Iterator[Finding]:
        """Sensors outside their own clouds; told only where nothing explains them."""
        if self._outside.count > len(self.positions) / 2:
            what = f"the sensor's position lies up to {self._outside.worst:,.0f} m outside of its own cloud"
            mend = "Give poses and points in the same world, and positions in metres; look at both with 'dynaviz info'"
            yield self._finding("origin outside", Confidence.LIKELY, what, mend, self._outside)

    def _finding(self, name: str, sure: Confidence, what: str, mend: str, notes: Notes) -> Finding:
        file = file_of(self.sequence, notes.frames[0])
        return Finding(name, sure, what, mend, tuple(notes.frames), notes.count, file)

    def _label_findings(self) -> Iterator[Finding]:
        known = int(self._labels[Label.STATIC] + self._labels[Label.DYNAMIC])
        if not self._labels.sum():
            return
        if not known:
            yield Finding("all unlabelled", Confidence.CERTAIN, "labels exist, but no point is static or dynamic",
                          "Give the labels that belong to these scans; without any, runs have no scores")  # fmt: skip
        elif not self._labels[Label.DYNAMIC]:
            what = f"of {known:,} labelled points not one is dynamic, so DA, AA and HA are undefined"
            yield Finding("no dynamic label", Confidence.CERTAIN, what, "Give the labels that tell moving objects, "
                          "or frames in which something moves (--frames A:B)")  # fmt: skip
        unmatched: Mapping[int, int] = getattr(getattr(self.sequence, "whole", self.sequence), "unmatched", {})
        lost = {index: unmatched[index] for index in self.indices if unmatched.get(index)}
        if lost:
            notes = Notes()
            for index in sorted(lost):
                notes.add(index)
            what = f"{sum(lost.values()):,} points have no partner in the labelled cloud, and count nowhere"
            yield self._finding("labels do not fit", Confidence.CERTAIN, what,
                                "Write gt_cloud.pcd anew: all points of all scans, in their order", notes)  # fmt: skip

    def _order(self) -> Iterator[Finding]:
        """Numbers and times of neighbours."""
        follows = np.diff(self.positions) == 1
        if not follows.any():
            return
        step = np.diff(self.indices).astype(np.float64)
        usual = float(np.median(step[follows]))
        gaps, back, pauses = Notes(), Notes(), Notes()
        regular = usual > 0 and np.mean(step[follows] == usual) > 0.5  # else the numbers count something else
        ticks = np.where(follows & (step > usual), step / usual, 1.0) if regular else np.ones(len(step))
        missing = 0
        for k in np.flatnonzero(ticks > 1.0):
            gaps.add(self.indices[k + 1])
            missing += round(ticks[k]) - 1
        if gaps.count:
            what = f"{missing:,} numbers are missing before these frames: scans were lost, or left out"
            mend = "Add the scans with their poses; where they are lost, clean the parts apart with --frames A:B"
            yield self._finding("gap in numbers", Confidence.CERTAIN, what, mend, gaps)
        if any(stamp is None for stamp in self.stamps):
            return
        seconds = np.diff(np.array(self.stamps, np.float64)) / 1e9
        usual = float(np.median((seconds / ticks)[follows]))
        for k in np.flatnonzero(follows):
            if seconds[k] <= 0:
                back.add(self.indices[k + 1], -seconds[k])
            elif seconds[k] / ticks[k] > 2.5 * usual > 0:
                pauses.add(self.indices[k + 1], seconds[k])
        if back.count:
            what = f"time stands still or goes back (by up to {back.worst:.3f} s) at these frames"
            mend = "Sort the scans by time and give each its own stamp; methods take them in the order of their numbers"
            yield self._finding("time goes back", Confidence.CERTAIN, what, mend, back)
        if pauses.count:
            what = f"up to {pauses.worst:.2f} s pass before these frames, usually {usual:.2f} s: scans were lost"
            mend = "Add the scans; where they are lost, clean the parts apart with --frames A:B"
            yield self._finding("gap in time", Confidence.CERTAIN, what, mend, pauses)


def file_of(sequence: Sequence, index: int) -> str | None:
    """The file of a frame, where the format keeps one each."""
    whole = getattr(sequence, "whole", sequence)
    scans, indices = getattr(whole, "scans", None), getattr(whole, "indices", None)
    if isinstance(scans, Mapping):
        path = scans.get(index)
    elif isinstance(scans, tuple) and isinstance(indices, tuple) and index in indices:
        path = scans[indices.index(index)]
    else:
        path = None
    return str(path) if isinstance(path, Path) else None

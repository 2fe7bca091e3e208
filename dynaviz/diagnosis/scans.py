"""Checks of single scans and of consecutive scans. Frames are streamed.

Only a few numbers of each scan are kept.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from dynaviz.arrays import F32, F64, I64, Bool
from dynaviz.contracts.extent import FAR
from dynaviz.contracts.scan import Label, Scan
from dynaviz.diagnosis.alignment import SENSOR_FRAME, WORLD_FRAME
from dynaviz.diagnosis.finding import SHOWN, Confidence, Finding, settable
from dynaviz.sources.drive import Drive
from dynaviz.spatial import geometry

HOUSING = (
    0.05  # metres; a nearer point is a ray without return, written at the sensor's own position
)
NEAR = 0.5  # metres; an object at this range blocks everything behind it
COLUMNS = 360  # azimuth bins
COMPARED = 8192  # points by which two scans are compared

_DROP = "Remove such points when writing the scans"


class ScanStatistics:
    """A scan with quantities that several checks share.

    Attributes:
        scan: the scan.
        before: the previous frame's scan, or None if that frame was not read.
    """

    def __init__(self, scan: Scan, before: Scan | None) -> None:
        self.scan = scan
        self.before = before

    def __len__(self) -> int:
        return len(self.scan)

    @cached_property
    def columns(self) -> list[F32]:
        """x, y and z, (N,) float32 each: numpy is much faster on columns."""
        return [np.ascontiguousarray(self.scan.points[:, axis]) for axis in range(3)]

    @cached_property
    def finite(self) -> Bool:
        """(N,) bool: finite points."""
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
        """(N,) float64, metres from each ray's origin; infinite for non-finite points."""
        squares = np.zeros(len(self))
        with np.errstate(invalid="ignore", over="ignore"):
            for axis, column in enumerate(self.columns):
                squares += (column - self.scan.origins[:, axis]) ** 2
        return np.where(self.finite, np.sqrt(squares), np.inf)

    @cached_property
    def box(self) -> tuple[F64, F64]:
        """Low and high corner, (3,) float64, metres, of all finite points.

        Zeros if there are none.
        """
        kept = (
            self.columns if self.finite.all() else [column[self.finite] for column in self.columns]
        )
        if not len(kept[0]):
            return np.zeros(3), np.zeros(3)
        return np.array([x.min() for x in kept], np.float64), np.array(
            [x.max() for x in kept], np.float64
        )


def empty(stats: ScanStatistics) -> float:
    """1 if no point is finite, else 0."""
    return float(not stats.finite.any())


def not_finite(stats: ScanStatistics) -> float:
    """Share of points that are NaN or infinite."""
    return _share(~stats.finite)


def far(stats: ScanStatistics) -> float:
    """Largest absolute coordinate of finite points and ray origins, kilometres."""
    return (
        max(float(np.abs(part).max(initial=0)) for part in (*stats.box, stats.scan.origins)) / 1000
    )


def no_return(stats: ScanStatistics) -> float:
    """Number of points at exactly (0, 0, 0) if more than a dozen, else of points at their ray's
    origin.
    """
    return float((stats.zero if stats.zero.sum() > 12 else stats.ranges < HOUSING).sum())


def ego(stats: ScanStatistics) -> float:
    """Share of azimuth bins with a point nearer than ``NEAR``."""
    near = (stats.ranges >= HOUSING) & (stats.ranges < NEAR)
    if not near.any():
        return 0.0
    xyz = geometry.apply(geometry.inverse(stats.scan.T_world_sensor), stats.scan.points[near])
    azimuth = np.arctan2(xyz[:, 1], xyz[:, 0]) / (2 * np.pi) + 0.5  # 0 to 1
    return len(np.unique(np.floor(azimuth * COLUMNS))) / COLUMNS


def duplicates(stats: ScanStatistics) -> float:
    """Share of points with the coordinates of another point, without counting rays
    without return.
    """
    x, y, z = (column.view(np.uint32).astype(np.uint64) for column in stats.columns)
    with np.errstate(over="ignore"):
        key = (
            x * np.uint64(0x9E3779B97F4A7C15)
            + y * np.uint64(0xC2B2AE3D27D4EB4F)
            + z * np.uint64(0x165667B19E3779F9)
        )
    key = np.sort(key[stats.finite & ~stats.zero & (stats.ranges >= HOUSING)])
    return _share(key[1:] == key[:-1])


def repeated(stats: ScanStatistics) -> float:
    """1 if the scan equals the previous one, in the world frame or in the sensor frame; else 0."""
    scan = stats.scan
    before = stats.before
    if before is None or len(scan) != len(before) or not stats.finite.any():
        return 0.0
    sample = slice(None, None, max(len(scan) // COMPARED, 1))
    if np.array_equal(scan.points[sample], before.points[sample], equal_nan=True):
        return 1.0
    with np.errstate(invalid="ignore"):
        a, b = (
            geometry.apply(geometry.inverse(s.T_world_sensor), s.points[sample])
            for s in (scan, before)
        )
    rounding = 1e-6 * max(float(np.abs(corner).max()) for corner in stats.box)
    return float(np.allclose(a, b, rtol=0, atol=1e-3 + rounding, equal_nan=True))


def outside(stats: ScanStatistics) -> float:
    """Distance from the sensor to the bounding box of its points, metres.

    0 if small for a cloud of this size.
    """
    (low, high) = stats.box
    position = stats.scan.position
    gap = float(np.linalg.norm(np.maximum(0, np.maximum(low - position, position - high))))
    return (
        gap
        if stats.finite.any() and gap > max(10.0, 0.1 * float(np.linalg.norm(high - low)))
        else 0.0
    )


def _around_zero(stats: ScanStatistics, origin: F64) -> bool:
    """Whether the points are around zero although the world's origin (3,) was moved far away."""
    low, high = stats.box
    return bool(origin.any() and (low <= -origin).all() and (-origin <= high).all())


def _around_position(stats: ScanStatistics, origin: F64) -> bool:
    """Whether the points, before they were placed by the pose, are around the sensor's position.

    They are then in the world already. The world's origin (3,) was moved there.
    """
    T = stats.scan.T_world_sensor
    points = geometry.apply(geometry.inverse(T), stats.scan.points[stats.finite])
    position = T[:3, 3] + origin
    return bool((points.min(0) <= position).all() and (position <= points.max(0)).all())


def _share(hits: Bool) -> float:
    return float(hits.mean()) if len(hits) else 0.0


@dataclass(frozen=True)
class Check:
    """A figure of a scan, and the limit above which it is a finding.

    Attributes:
        name: name of the finding.
        measure: computes the figure.
        limit: a larger figure is a finding.
        confidence: confidence in the finding.
        problem: a sentence; ``{worst}`` is replaced by the largest figure.
        fix: a sentence; ``{near}`` is replaced by the option that makes methods ignore near points.
        least: share of all frames in which it must be found: what belongs to the sensor is always
            there.
    """

    name: str
    measure: Callable[[ScanStatistics], float]
    limit: float
    confidence: Confidence
    problem: str
    fix: str
    least: float = 0.0


CHECKS = (
    Check("empty frame", empty, 0, Confidence.CERTAIN, "the scan contains no finite point",
          "Skip such frames with --frames A:B, or remove their files and poses"),
    Check("not finite", not_finite, 0, Confidence.CERTAIN, "up to {worst:.2%} of a scan's points "
    "are NaN or infinite",
          f"{_DROP}. Methods keep them all, so they only cost time and accuracy"),
    Check("far points", far, FAR / 1000, Confidence.CERTAIN,
          "a point or sensor position is {worst:,.0f} km from the world's origin, where float32 is "
          "too coarse",
          "Move the world's origin to the first pose (subtract its position from poses and "
          "points), or remove them"),
    Check("no return", no_return, 0, Confidence.CERTAIN,
          "up to {worst:,.0f} points of a scan are at the sensor itself or at exactly (0, 0, 0): "
          "rays without return, "
          "which block every other ray that starts there",
          "Nothing for runs: they leave these points unjudged. For other programs: "
          f"{_DROP[0].lower()}{_DROP[1:]}"),
    Check("ego points", ego, 0.01, Confidence.CERTAIN,
          f"in up to {{worst:.0%}} of all directions something nearer than {NEAR} m, "
          "such as the sensor's carrier, blocks the rays",
          "Let methods ignore near points: {near}. For other methods, "
          f"{_DROP[0].lower()}{_DROP[1:]}", 0.3),
    Check("duplicate points", duplicates, 0.001, Confidence.CERTAIN,
          "up to {worst:.1%} of a scan's points have the coordinates of another point and count "
          "twice in all scores",
          "Write each return once. After merging lidars or clouds, remove repeated rows"),
    Check("duplicate frame", repeated, 0, Confidence.CERTAIN, "the scan is identical to the "
    "previous one",
          "Remove one of the two and its pose. In a bag, choose the original topic, not a "
          "republished one"),
)  # fmt: skip


@dataclass
class Occurrences:
    """The frames in which a check has a finding.

    Attributes:
        frames: numbers of the first ``SHOWN`` frames.
        count: number of frames.
        worst: the largest figure.
    """

    frames: list[int] = field(default_factory=list)
    count: int = 0
    worst: float = 0.0

    def add(self, index: int, figure: float = 0.0) -> None:
        """Add a frame."""
        self.count += 1
        self.worst = max(self.worst, figure)
        if len(self.frames) < SHOWN:
            self.frames.append(index)


class ScanChecker:
    """Checks one scan after another.

    Keeps the pose, number and stamp of each, and the occurrences of each finding.

    Attributes:
        positions, indices, stamps, poses: of each checked frame: position in the sequence, number,
            time in nanoseconds (None if absent), and T_world_sensor.
        usable: whether each frame has finite points, none too far from the world's origin.
    """

    def __init__(self, sequence: Drive) -> None:
        self.sequence = sequence
        self.positions: list[int] = []
        self.indices: list[int] = []
        self.stamps: list[int | None] = []
        self.poses: list[F64] = []
        self.usable: list[bool] = []
        self._with_points: list[int] = []
        self._occurrences = [Occurrences() for _ in CHECKS]
        self._label_counts: I64 = np.zeros(256, np.int64)
        self._outside = Occurrences()
        self._around_zero = 0
        self._around_position = 0
        self._before: Scan | None = None

    def check(self, position: int, scan: Scan) -> None:
        """Check a scan."""
        before = self._before if self.positions and self.positions[-1] == position - 1 else None
        stats = ScanStatistics(scan, before)
        for check, occurrences in zip(CHECKS, self._occurrences, strict=True):
            if (figure := check.measure(stats)) > check.limit:
                occurrences.add(scan.index, figure)
        if scan.labels is not None:
            self._label_counts += np.bincount(scan.labels, minlength=256)
        if (gap := outside(stats)) > 0:
            self._outside.add(scan.index, gap)
            self._around_zero += _around_zero(stats, self.sequence.origin)
            self._around_position += _around_position(stats, self.sequence.origin)
        self.positions.append(position)
        self.indices.append(scan.index)
        self.stamps.append(scan.stamp_ns)
        self.poses.append(scan.T_world_sensor)
        if stats.finite.any():
            self._with_points.append(len(self.poses) - 1)
        self.usable.append(bool(stats.finite.any()) and far(stats) <= FAR / 1000)
        self._before = scan

    @property
    def with_points(self) -> list[int]:
        """Rows of the frames with finite points."""
        return self._with_points

    def read(self, row: int) -> Scan:
        """Read the scan of a row of ``positions`` again."""
        return self.sequence[self.positions[row]]

    def findings(self) -> Iterator[Finding]:
        """Findings on scans, labels, frame numbers and times."""
        for check, occurrences in zip(CHECKS, self._occurrences, strict=True):
            if occurrences.count > check.least * len(self.positions):
                problem = check.problem.format(worst=occurrences.worst)
                fix = check.fix
                if "{near}" in fix:
                    fix = fix.format(near=settable("min_range", f"{NEAR + 0.1}"))
                yield self._finding(check.name, check.confidence, problem, fix, occurrences)
        yield from self._label_findings()
        yield from self._order_findings()

    def outside_finding(self) -> Iterator[Finding]:
        """A finding if most sensor positions are outside their own clouds.

        For use if nothing else explains it.
        """
        if self._outside.count > len(self.positions) / 2:
            problem = (
                f"the sensor's position is up to {self._outside.worst:,.0f} m outside its own cloud"
            )
            for count, meant, where in (
                (self._around_zero, SENSOR_FRAME, "which is around zero"),
                (self._around_position, WORLD_FRAME, "and the points in its file are around it"),
            ):
                if 2 * count > self._outside.count:
                    text = f"{meant.problem}: {problem}, {where}"
                    yield Finding(meant.name, Confidence.LIKELY, text, meant.fix)
                    return
            fix = (
                "Give poses and points in the same world frame, positions in metres; 'dynaviz "
                "info' shows the extent"
            )
            yield Finding("origin outside", Confidence.LIKELY, problem, fix)

    def _finding(
        self, name: str, confidence: Confidence, problem: str, fix: str, occurrences: Occurrences
    ) -> Finding:
        file = file_of(self.sequence, occurrences.frames[0])
        return Finding(
            name, confidence, problem, fix, tuple(occurrences.frames), occurrences.count, file
        )

    def _label_findings(self) -> Iterator[Finding]:
        known = int(self._label_counts[Label.STATIC] + self._label_counts[Label.DYNAMIC])
        if not self._label_counts.sum():
            return
        if not known:
            problem = "labels exist, but no point is labelled static or dynamic"
            fix = "Give the labels of these scans; without labels, runs have no scores"
            yield Finding("all unlabelled", Confidence.CERTAIN, problem, fix)
        elif not self._label_counts[Label.DYNAMIC]:
            problem = (
                f"none of the {known:,} labelled points is dynamic, so DA, AA and HA are undefined"
            )
            fix = (
                "Give labels that mark moving objects, or choose frames in which something moves "
                "(--frames A:B)"
            )
            yield Finding("no dynamic label", Confidence.CERTAIN, problem, fix)
        unmatched = self.sequence.unmatched
        lost = {index: unmatched[index] for index in self.indices if unmatched.get(index)}
        if lost:
            occurrences = Occurrences()
            for index in sorted(lost):
                occurrences.add(index)
            problem = (
                f"{sum(lost.values()):,} points are missing from the labelled cloud and are not "
                "scored"
            )
            fix = "Write gt_cloud.pcd again, with all points of all scans in order"
            yield self._finding("labels do not fit", Confidence.CERTAIN, problem, fix, occurrences)

    def _order_findings(self) -> Iterator[Finding]:
        """Findings on the numbers and times of consecutive frames."""
        follows = np.diff(self.positions) == 1
        if not follows.any():
            return
        step = np.diff(self.indices).astype(np.float64)
        usual = float(np.median(step[follows]))
        gaps = Occurrences()
        back = Occurrences()
        pauses = Occurrences()
        # otherwise the numbers are not frame counts
        regular = usual > 0 and np.mean(step[follows] == usual) > 0.5
        ticks = (
            np.where(follows & (step > usual), step / usual, 1.0) if regular else np.ones(len(step))
        )
        missing = 0
        for k in np.flatnonzero(ticks > 1.0):
            gaps.add(self.indices[k + 1])
            missing += round(ticks[k]) - 1
        if gaps.count:
            numbers = "number is" if missing == 1 else "numbers are"
            problem = (
                f"{missing:,} {numbers} missing before these frames: scans were lost or left out"
            )
            fix = (
                "Add the scans with their poses. If they are lost, clean the parts separately with "
                "--frames A:B"
            )
            yield self._finding("gap in numbers", Confidence.CERTAIN, problem, fix, gaps)
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
            problem = f"stamps repeat or decrease (by up to {back.worst:.3f} s) at these frames"
            fix = (
                "Sort the scans by time and give each its own stamp. Methods process them in the "
                "order of their numbers"
            )
            yield self._finding("time goes back", Confidence.CERTAIN, problem, fix, back)
        if pauses.count:
            problem = (
                f"up to {pauses.worst:.2f} s pass before these frames instead of {usual:.2f} s: "
                "scans are missing"
            )
            fix = "Add the scans. If they are lost, clean the parts separately with --frames A:B"
            yield self._finding("gap in time", Confidence.CERTAIN, problem, fix, pauses)


def file_of(sequence: Drive, index: int) -> str | None:
    """The file of a frame, by its number; None if the format does not keep one file per frame."""
    file = sequence.scan_file(index)
    return None if file is None else str(file)

"""Clouds of a bag: their index, their rows, and when their points were measured."""

from __future__ import annotations

import contextlib
from collections import Counter, defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynaviz.arrays import F64, I64
from dynaviz.contracts.scan import Scan
from dynaviz.errors import DataError
from dynaviz.io.pointcloud2 import cloud_rows, cloud_xyz
from dynaviz.io.rosbag import Bag
from dynaviz.sources.hypotheses.sweep import READ, Sweeps, SweepTimes, judge_sweeps
from dynaviz.spatial import geometry
from dynaviz.spatial.trajectory import (
    FIELDS,
    PosesOverTime,
    deskew,
    impossible,
    point_times,
    unit_of,
)

SAMPLES = 5  # clouds used to determine the unit of the point times


@dataclass(frozen=True)
class CloudTopic:
    """Index of the clouds of a topic.

    Attributes:
        topic: name of the topic.
        frame: frame of the first cloud.
        keys: (N, 2) int64: recording time in ns, and position among the messages of that time.
        stamps: (N,) int64, nanoseconds: header stamp, or recording time if the header has none.
    """

    topic: str
    frame: str
    keys: I64
    stamps: I64


@dataclass(frozen=True)
class TimedSweep:
    """When the points of a cloud were measured.

    Attributes:
        field: the field with their times.
        unit: nanoseconds per unit of the field.
        table: time by azimuth, for points whose own time is impossible.
    """

    field: str
    unit: float
    table: SweepTimes

    @classmethod
    def find(cls, bag: Bag, clouds: CloudTopic, positions: I64) -> TimedSweep | None:
        """The field with the point times and its unit; None if no field spans a sweep.

        Several sweeps are examined, because a single one may be incomplete.
        """
        found: Counter[tuple[str, float]] = Counter()
        sweeps: dict[str, list[tuple[F64, F64]]] = defaultdict(list)
        for k in np.unique(np.linspace(0, len(positions) - 1, SAMPLES).astype(int)):
            rows = read_cloud(bag, clouds, int(positions[k]))
            field = next((name for name in FIELDS if name in (rows.dtype.names or ())), None)
            if field is None or rows.dtype[field].shape or not len(rows):
                continue
            values = rows[field]
            if (unit := unit_of(values)) is None:
                continue
            found[field, unit] += 1
            with valid_cloud(bag, clouds, int(positions[k])):
                points = cloud_xyz(rows)
            right = np.isfinite(points).all(1) & ~impossible(values)
            first = values[right].min() if right.any() else 0
            times = (values[right] - first).astype(np.float64)
            sweeps[field].append((points[right].astype(np.float64), times))
        if not found:
            return None
        (field, unit), _ = found.most_common(1)[0]
        return cls(field, unit, SweepTimes.of(sweeps[field]))

    def times(self, rows: NDArray[Any], points: NDArray[Any], stamp: int) -> tuple[I64, int]:
        """(N,) int64, nanoseconds: times of the points of a cloud, and how many are impossible.

        The latter get the time at which the sensor looks in their direction, if its sweeps begin
        alike; otherwise that of the cloud.
        """
        values = rows[self.field]
        times = point_times(values, self.unit, stamp)
        finite = np.isfinite(points).all(1)
        wrong = impossible(values) & finite
        number = int(wrong.sum())
        if number and self.table.steady and not wrong.all():
            offsets, known = self.table.at(points[wrong].astype(np.float64))
            start = int(times[~wrong & finite].min())
            chosen = np.flatnonzero(wrong)[known]
            times[chosen] = start + np.round(offsets[known] * self.unit).astype(np.int64)
        return times, number


def judged(
    bag: Bag,
    clouds: CloudTopic,
    positions: I64,
    poses: F64,
    path: PosesOverTime,
    sweep: TimedSweep,
) -> Sweeps:
    """Whether clouds are deskewed already, tried on some of them."""

    def read(position: int) -> tuple[Scan, Scan]:
        k = int(positions[position])
        rows = read_cloud(bag, clouds, k)
        rows = rows[np.sort(np.random.default_rng(0).permutation(len(rows))[:READ])]
        with valid_cloud(bag, clouds, k):
            points = cloud_xyz(rows)
        stamp = int(clouds.stamps[k])
        pose = poses[position]
        taken = Scan(k, geometry.transform(pose, points), pose, stamp)
        if sweep.field not in (rows.dtype.names or ()):
            return taken, taken
        times = sweep.times(rows, points, stamp)[0]
        return Scan(k, deskew(points, times, path)[0], pose, stamp), taken

    return judge_sweeps(read, poses, clouds.stamps[positions], path)


def read_cloud(bag: Bag, clouds: CloudTopic, k: int) -> NDArray[Any]:
    """The points of a cloud with all fields."""
    with valid_cloud(bag, clouds, k):
        return cloud_rows(bag.message(clouds.topic, *clouds.keys[k].tolist()))


def sensor_points(bag: Bag, clouds: CloudTopic, k: int) -> F64:
    """(N, 3) float64, metres: the points of a cloud as they are in the message."""
    rows = read_cloud(bag, clouds, k)
    with valid_cloud(bag, clouds, k):
        return cloud_xyz(rows).astype(np.float64)


@contextlib.contextmanager
def valid_cloud(bag: Bag, clouds: CloudTopic, k: int) -> Iterator[None]:
    """Name the message in the error of a cloud."""
    try:
        yield
    except ValueError as error:
        at = f"message {k} of {clouds.topic}"
        raise DataError(
            bag.path, f"invalid cloud: {error}", at=at, hint="Record it again"
        ) from None

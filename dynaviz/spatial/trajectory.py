"""Trajectories that interpolate poses, and deskewing.

Each point is transformed by the pose at its own time.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dynaviz.arrays import F32, F64, I64, Bool
from dynaviz.spatial import geometry

FIELDS = ("t", "time", "timestamp", "time_stamp", "offset_time", "time_offset", "offset_ns")
"""Names that sensor drivers use for the time of a point."""

TICK = 10_000
"""Time resolution of deskewing, nanoseconds; in half a tick, a car at 30 m/s moves 0.15 mm."""

# duration of a sweep, nanoseconds; a factor of 1000 apart, so that only one unit fits
_SHORTEST = 2e6
_LONGEST = 2e9
_SAME_CLOCK = (
    1e10  # largest difference of a sweep's stamp and its points' times on one clock, nanoseconds
)
# percentiles between which most times of a sweep lie, and how many times that span a sweep lasts
_BULK = (10.0, 90.0)
_STRAY = 2.5
_LARGEST = 2.0**62  # nanoseconds; differences of such times fit into 64 bits


class PosesOverTime(Protocol):
    """Poses over time."""

    @property
    def span(self) -> tuple[float, float]:
        """First and last time, nanoseconds."""
        ...

    def at(self, times: ArrayLike) -> F64:
        """(N, 4, 4) float64, metres: the poses at (N,) int64 nanoseconds."""
        ...


@dataclass(frozen=True, eq=False)
class Moved:
    """Poses over time, with an offset added to their positions.

    Attributes:
        poses: the poses.
        offset: (3,) float64, metres.
    """

    poses: PosesOverTime
    offset: F64

    @property
    def span(self) -> tuple[float, float]:
        """First and last time, nanoseconds."""
        return self.poses.span

    def at(self, times: ArrayLike) -> F64:
        """(N, 4, 4) float64, metres: the poses at (N,) int64 nanoseconds."""
        poses = np.array(self.poses.at(times))
        poses[:, :3, 3] += self.offset
        return poses


@dataclass(frozen=True, eq=False)
class Mounted:
    """Poses over time of something that is mounted on a vehicle.

    Attributes:
        poses: of the vehicle.
        mount: (4, 4) float64, metres: its pose on the vehicle.
    """

    poses: PosesOverTime
    mount: F64

    @property
    def span(self) -> tuple[float, float]:
        """First and last time, nanoseconds."""
        return self.poses.span

    def at(self, times: ArrayLike) -> F64:
        """(N, 4, 4) float64, metres: the poses at (N,) int64 nanoseconds."""
        return geometry.compose(self.poses.at(times), self.mount)


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Poses at some times, with interpolation.

    Constant rotation rate about one axis, positions along a line.

    Before the first and after the last pose, the first and last step are extrapolated. A single
    pose is constant.

    Attributes:
        times: (K,) int64, nanoseconds, strictly increasing, K at least 1.
        poses: (K, 4, 4) float64, metres.
    """

    times: I64
    poses: F64

    @classmethod
    def of(cls, times: ArrayLike, poses: ArrayLike) -> Trajectory:
        """Sort poses by time; of several poses at the same time, the last one is used."""
        all_times = np.asarray(times, np.int64)
        all_poses = np.asarray(poses, np.float64)
        latest_first = slice(None, None, -1)
        unique, row = np.unique(all_times[latest_first], return_index=True)
        return cls(unique, all_poses[latest_first][row])

    @property
    def span(self) -> tuple[float, float]:
        """First and last time, nanoseconds; infinite for a single pose."""
        if len(self.times) == 1:
            return -np.inf, np.inf
        return float(self.times[0]), float(self.times[-1])

    def at(self, times: ArrayLike) -> F64:
        """Poses at any times; at the time of a given pose, exactly that pose.

        Args:
            times: (N,) int64, nanoseconds.

        Returns:
            (N, 4, 4) float64, metres.
        """
        from scipy.spatial.transform import Rotation

        moments = np.asarray(times, np.int64)
        last = len(self.times) - 1
        before = np.clip(np.searchsorted(self.times, moments, "right") - 1, 0, last)
        poses: F64 = self.poses[before]  # a copy
        exact = (self.times[before] == moments) | (last == 0)
        step = np.minimum(before, last - 1)[~exact]
        if len(step):
            share = (moments[~exact] - self.times[step]) / (self.times[step + 1] - self.times[step])
            start = self.poses[step]
            turned = Rotation.from_rotvec(share[:, None] * self._turns[step]).as_matrix()
            start[:, :3, :3] = geometry.compose(start[:, :3, :3], turned)
            start[:, :3, 3] += share[:, None] * (
                self.poses[step + 1, :3, 3] - self.poses[step, :3, 3]
            )
            poses[~exact] = start
        return poses

    @cached_property
    def _turns(self) -> F64:
        """(K - 1, 3) rotation vectors from each pose to the next, in the frame of the first of the
        two.
        """
        from scipy.spatial.transform import Rotation

        R = self.poses[:, :3, :3]
        turns: F64 = Rotation.from_matrix(
            geometry.compose(np.swapaxes(R[:-1], 1, 2), R[1:])
        ).as_rotvec()
        return turns


def deskew(points: NDArray[np.floating[Any]], times: I64, path: PosesOverTime) -> tuple[F32, F64]:
    """Transform each point by the pose at its own time, rounded to ``TICK``.

    Args:
        points: (N, 3) float, metres, sensor frame at the time of each point.
        times: (N,) int64, nanoseconds.
        path: T_world_sensor over time.

    Returns:
        points: (N, 3) float32, metres, world frame.
        origins: (N, 3) float64, metres, world frame: sensor position at the time of each point.
    """
    ticks, of = np.unique((times + TICK // 2) // TICK, return_inverse=True)
    T = path.at(ticks * TICK)
    world = np.empty((len(points), 3))
    with np.errstate(over="ignore", invalid="ignore"):  # non-finite values stay non-finite
        x, y, z = (points[:, axis].astype(np.float64) for axis in range(3))
        for axis in range(3):
            a, b, c, d = (T[:, axis, column][of] for column in range(4))
            world[:, axis] = a * x + b * y + c * z + d
        return world.astype(np.float32), T[of, :3, 3]


def unit_of(values: NDArray[Any]) -> float | None:
    """Detect the unit of per-point times (s, ms, us or ns) from the duration of the sweep.

    Args:
        values: (N,) of any numeric type, as written by the driver.

    Returns:
        Nanoseconds per unit: 1e9, 1e6, 1e3 or 1. None if the times do not span a sweep (2 ms to 2
        s) in any unit.
    """
    values = values[np.isfinite(values)]
    if not len(values):
        return None
    low, high = (
        np.percentile(values.astype(np.float64), _BULK)
        if len(values) > 20
        else (values.min(), values.max())
    )
    span = float(values.max() - values.min())
    if span > _STRAY * float(high - low) > 0:
        span = float(high - low)  # a few times are impossible
    return next(
        (unit for unit in (1e9, 1e6, 1e3, 1.0) if _SHORTEST < span * unit <= _LONGEST), None
    )


def impossible(values: NDArray[Any]) -> Bool:
    """(N,) bool: times that cannot be of this sweep, far from those of most of its points.

    Args:
        values: (N,) of any numeric type, as written by the driver.
    """
    with np.errstate(invalid="ignore"):  # of values that are not numbers
        exact = values.astype(np.float64)
    known = np.isfinite(exact)
    if known.sum() <= 20:
        return ~known
    low, middle, high = np.percentile(exact[known], (_BULK[0], 50.0, _BULK[1]))
    reach = _STRAY * max(float(high - low), 0.0)
    with np.errstate(invalid="ignore"):
        stray = ~(np.abs(exact - middle) <= reach) if reach > 0 else ~known
    return np.asarray(stray, np.bool_)


def point_times(values: NDArray[Any], unit: float, stamp_ns: int) -> I64:
    """Compute the time at which each point was measured.

    Args:
        values: (N,) of any numeric type: offsets from the sweep's stamp, or absolute times. If they
            are from another clock than the stamp, the first point gets the time of the stamp.
        unit: nanoseconds per unit of the values.
        stamp_ns: stamp of the sweep, nanoseconds.

    Returns:
        (N,) int64, nanoseconds, on the stamp's clock; values that are not times of this sweep get
        the stamp.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        finite = np.abs(values.astype(np.float64) * unit) < _LARGEST
        finite &= ~impossible(values)
    if not finite.any():
        return np.full(len(values), stamp_ns, np.int64)
    first = values[finite].min()
    start = int(first) if unit == 1 else round(float(first) * unit)
    if abs(start) < _SAME_CLOCK:
        start += stamp_ns
    elif abs(start - stamp_ns) > _SAME_CLOCK:
        start = stamp_ns
    times = np.full(len(values), stamp_ns, np.int64)
    times[finite] = start + np.round((values[finite] - first).astype(np.float64) * unit).astype(
        np.int64
    )
    return times

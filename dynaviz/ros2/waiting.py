"""Clouds that wait for the pose of their sensor, which TF often knows a little later."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from dynaviz.arrays import F32, F64, I64
from dynaviz.io.pointcloud2 import cloud_rows, cloud_xyz
from dynaviz.ros2.messages import stamp_of, times_of
from dynaviz.spatial.trajectory import Trajectory

MOMENTS = 5  # of a sweep at which its pose is asked for, first and last included
Lookup = Callable[[str, int], "F64 | str"]
"""The pose of a frame in the world at a time in nanoseconds, (4, 4) float64 in metres; or why it is
not known (yet)."""


@dataclass(frozen=True, eq=False)
class ReadyCloud:
    """A cloud whose poses are known.

    Attributes:
        message: as it came.
        points: (N, 3) float32, metres, in the frame of the cloud.
        stamp: nanoseconds.
        T_world_sensor: (4, 4) float64, metres: at the stamp.
        times: (N,) int64, nanoseconds: when each point was measured; None without, or if clouds
            are not deskewed.
        path: poses during the sweep; None with ``times``.
    """

    message: Any
    points: F32
    stamp: int
    T_world_sensor: F64
    times: I64 | None
    path: Trajectory | None


@dataclass(frozen=True, eq=False)
class _Waiting:
    message: Any
    points: F32
    stamp: int
    times: I64 | None
    since: float

    def moments(self) -> list[int]:
        """When poses are needed, nanoseconds: at the stamp, then through the sweep."""
        if self.times is None:
            return [self.stamp]
        sweep = np.linspace(self.times.min(), self.times.max(), MOMENTS).astype(np.int64)
        return [self.stamp, *np.unique(sweep).tolist()]


class CloudQueue:
    """Holds clouds until their poses are known, in the order in which they came.

    A cloud is dropped if its poses are not known in time, or if too many wait.

    Args:
        lookup: asks for a pose.
        timeout: seconds that a cloud waits at most.
        room: number of clouds that may wait.
        deskew: whether to use the times of points, where there are any.

    Attributes:
        dropped: why clouds were dropped since it was emptied, one sentence each.
    """

    def __init__(self, lookup: Lookup, timeout: float, room: int, deskew: bool) -> None:
        self.dropped: list[str] = []
        self._lookup = lookup
        self._timeout = timeout
        self._room = room
        self._deskew = deskew
        self._waiting: deque[_Waiting] = deque()

    def __len__(self) -> int:
        return len(self._waiting)

    def add(self, message: Any, now: float) -> None:
        """Let a PointCloud2 wait.

        Args:
            message: the cloud.
            now: seconds, on any steady clock.
        """
        stamp = stamp_of(message.header)
        try:
            rows = cloud_rows(message)
            points = cloud_xyz(rows)
        except ValueError as error:
            self.dropped.append(f"a cloud cannot be read: {error}")
            return
        times = times_of(rows, stamp) if self._deskew and len(rows) else None
        self._waiting.append(_Waiting(message, points, stamp, times, now))
        if len(self._waiting) > self._room:
            self._waiting.popleft()
            self.dropped.append(f"more than {self._room} clouds wait for their transform")

    def take(self, now: float) -> ReadyCloud | None:
        """The oldest cloud whose poses are known; None if none is ready.

        Args:
            now: seconds, on the clock of ``add``.
        """
        while self._waiting:
            first = self._waiting[0]
            found = self._poses(first)
            if not isinstance(found, str):
                self._waiting.popleft()
                return found
            if now - first.since < self._timeout:
                return None
            self._waiting.popleft()
            self.dropped.append(f"no transform within {self._timeout:g} s: {found}")
        return None

    def _poses(self, cloud: _Waiting) -> ReadyCloud | str:
        """The cloud with its poses, or why one is not known."""
        moments = cloud.moments()
        poses: list[F64] = []
        for moment in moments:
            pose = self._lookup(cloud.message.header.frame_id, moment)
            if isinstance(pose, str):
                return pose
            poses.append(pose)
        path = None if cloud.times is None else Trajectory.of(moments[1:], poses[1:])
        return ReadyCloud(cloud.message, cloud.points, cloud.stamp, poses[0], cloud.times, path)

"""A method that runs live: one scan in, its labels out.

A static map, and revised labels of the last scans.
"""

from __future__ import annotations

import contextlib
import ctypes
import gc
import threading
from collections import deque
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from dynaviz import kernels
from dynaviz.arrays import F32, F64, Bool, single
from dynaviz.blocks.blocks import VOXELS, BlockGrid
from dynaviz.blocks.window import Window
from dynaviz.contracts.at_sensor import AtSensor, unjudged
from dynaviz.contracts.attributes import far_origin
from dynaviz.contracts.given import given_points, given_pose
from dynaviz.contracts.method import Context, Labels, Live, Method, MethodInfo, Relabels
from dynaviz.contracts.probe import SILENT, Probe
from dynaviz.contracts.scan import Scan
from dynaviz.contracts.sensors import Sensor
from dynaviz.errors import UsageError
from dynaviz.spatial import geometry
from dynaviz.spatial.trajectory import Moved, PosesOverTime, deskew


@dataclass(frozen=True)
class Settings:
    """How a method runs live.

    Attributes:
        reach: metres around the sensor within which points are judged.
        keep: number of last scans that can be revised.
        map_voxel: edge of the voxels of the static map, metres.
        seed: for all randomness in the method.
    """

    reach: float = 60.0
    keep: int = 20
    map_voxel: float = 0.2
    seed: int = 0


@dataclass(frozen=True, eq=False)
class Revised:
    """The labels of an earlier scan, by what is known now.

    Attributes:
        index: number of the scan, from 0.
        stamp: nanoseconds, as given.
        labels: of its points.
    """

    index: int
    stamp: int | None
    labels: Labels


class LiveSession:
    """A method that runs live. Make it with ``dynaviz.live``.

    Memory is bounded by the reach: what lies beyond is forgotten, and so are all scans but the last
    ``keep``.

    Attributes:
        settings: as given.
        restarts: how often the map began anew because the sensor left the range of voxel keys,
            32768 voxels.
    """

    def __init__(
        self, method: Method, sensor: Sensor, settings: Settings, probe: Probe = SILENT
    ) -> None:
        self.settings = settings
        self.restarts = 0
        self._method = method
        self._sensor = sensor
        self._probe = probe
        self._near = AtSensor(sensor)
        self._kept: deque[Scan] = deque()
        self._count = 0
        self._origin: F64 | None = None  # subtracted from all positions
        self._mapping = threading.RLock()  # held while the map changes or is read
        self._begin()

    @property
    def info(self) -> MethodInfo:
        """The method, with the legend of the reason codes."""
        return self._method.info

    def __len__(self) -> int:
        """Number of scans so far."""
        return self._count

    def update(
        self,
        points: ArrayLike,
        pose: ArrayLike,
        stamp: int | None = None,
        *,
        points_in: str = "sensor",
        times: ArrayLike | None = None,
        path: PosesOverTime | None = None,
    ) -> Labels:
        """Learn from the next scan, and label its points by the scans so far, including this one.

        Args:
            points: (N, 3 or more) float, metres; columns after the third are ignored. NaN is
                allowed.
            pose: (4, 4) float, metres: T_world_sensor; the world may be far from its origin.
            stamp: nanoseconds, or None.
            points_in: ``sensor`` or ``world``: the frame of the points.
            times: (N,) int64, nanoseconds: when each point was measured, to deskew the scan.
            path: poses of the sensor over these times, such as
                ``dynaviz.spatial.trajectory.Trajectory.of(times, poses)``; with ``times``.

        Returns:
            (N,) bool and (N,) uint8: which points are dynamic, and the reason codes
            (``info.reasons``). Points beyond the reach are kept.

        Raises:
            UsageError: for arrays of other shapes, or a pose that is not finite or not rigid.
        """
        xyz = given_points(points, self._count)
        T = given_pose(pose, self._count)
        if points_in not in ("sensor", "world"):
            raise UsageError(f"points_in = {points_in}: give sensor or world")
        if (times is None) != (path is None) or (path is not None and points_in == "world"):
            raise UsageError("times and path deskew points in the sensor frame: give both of them")
        if self._origin is None:
            self._origin = far_origin(T[:3, 3])
        T[:3, 3] -= self._origin
        xyz = xyz[:, :3]
        if path is not None:
            moments = np.asarray(times, np.int64)
            if moments.shape != (len(xyz),):
                raise UsageError(f"times: {moments.shape} for {len(xyz)} points. Give one for each")
            points_now, origins = deskew(xyz, moments, Moved(path, -self._origin))
            return self._take(Scan(self._count, points_now, T, stamp, origins=origins))
        world = single(xyz - self._origin) if points_in == "world" else geometry.transform(T, xyz)
        return self._take(Scan(self._count, world, T, stamp))

    def add(self, scan: Scan) -> Labels:
        """As ``update``, with a scan in the world frame.

        Its index must be the number of scans so far.
        """
        if self._origin is None:
            self._origin = np.zeros(3)
        return self._take(scan.moved(-self._origin) if self._origin.any() else scan)

    def _take(self, scan: Scan) -> Labels:
        """Learn from a scan in the session's own world frame, and label it."""
        if np.abs(scan.position).max() > self._window.farthest:
            with self._mapping:
                scan = self._restart(scan)
        labels = self._learn(scan)
        self._count += 1
        with self._mapping:
            self._map.add(scan, labels.dynamic)
        self._kept.append(scan)
        while len(self._kept) > self.settings.keep:
            self._forget(self._kept.popleft())
        return labels

    def map(self) -> F32 | F64:
        """The static map within reach.

        One point per voxel that was labelled static more often than dynamic. Another thread may
        call it while this one labels a scan, which waits only while the map changes.

        Returns:
            (M, 3), metres, world frame, to a 256th of a voxel; float64 if the world's origin is far
            away.
        """
        with self._mapping:
            points = self._map.points()
            origin = self._origin
        if origin is None or not origin.any():
            return points
        far: F64 = points + origin
        return far

    def revise(self) -> list[Revised]:
        """The labels of the last ``keep`` scans by what is known now, oldest first.

        Later scans show what earlier ones could not: that a car which stood drove off, or that
        space is empty.
        """
        scans = list(self._kept)
        method = self._method
        seen = [self._near.hidden(scan) for scan in scans]
        shown = [scan for scan, _ in seen]
        labels = (
            method.relabel(shown)
            if isinstance(method, Relabels)
            else [method.label(scan) for scan in shown]
        )
        labels = [
            unjudged(each, found, self.info) for each, (_, found) in zip(labels, seen, strict=True)
        ]
        return [
            Revised(scan.index, scan.stamp_ns, each)
            for scan, each in zip(scans, labels, strict=True)
        ]

    def _begin(self) -> None:
        self._window = Window(self.settings.reach)
        self._method.begin(Context(self._window, self._sensor, self._probe, self.settings.seed))
        self._map = StaticMap(self._window, self.settings.map_voxel)

    def _learn(self, scan: Scan) -> Labels:
        with self._mapping:
            self._window.follow(scan)
        seen, found = self._near.hidden(scan)
        self._method.observe(seen)
        return unjudged(self._method.label(seen), found, self.info)

    def _forget(self, scan: Scan) -> None:
        if isinstance(self._method, Live):
            self._method.forget(scan.index)

    def _restart(self, scan: Scan) -> Scan:
        """Begin anew with the world's origin at the sensor, and learn the last scans again.

        Returns the moved scan.
        """
        assert self._origin is not None
        offset = np.round(scan.position)
        self._origin = self._origin + offset
        self.restarts += 1
        self._begin()
        self._kept = deque(each.moved(-offset) for each in self._kept)
        for each in self._kept:
            self._map.add(each, self._learn(each).dynamic)
        _return_freed_memory()
        return scan.moved(-offset)


def _return_freed_memory() -> None:
    """Return the memory of the old map to the system.

    It is part of reference cycles, and glibc keeps small blocks.
    """
    gc.collect()
    with contextlib.suppress(OSError, AttributeError, TypeError):  # other C libraries
        ctypes.CDLL(None).malloc_trim(0)


def warm_up(kind: type[Method], params: Any, sensor: Sensor, settings: Settings) -> None:
    """Run a method on a small simulated world, so that its kernels are loaded before the first
    scan.

    Raises:
        UsageError: if the method needs facts of the sensor that are not known.
    """
    from dynaviz.testing.world import SENSOR, crossing

    LiveSession(kind(params), sensor, settings)  # raises if a fact is missing
    # that of these scans, so that dynamic points are found
    session = LiveSession(kind(params), SENSOR, settings)
    for scan in crossing(8):
        session.add(scan.without_truth())
    session.revise()
    session.map()


class StaticMap(BlockGrid):
    """For each voxel the first static point, and how often points in it were labelled static and
    dynamic.

    Args:
        window: goes with the sensor.
        voxel: edge of a voxel, metres.
    """

    def __init__(self, window: Window, voxel: float) -> None:
        super().__init__(window, voxel)
        n = len(self)
        self._static, self._dynamic = (
            self.per_block(np.zeros((n, VOXELS), np.uint16)) for _ in range(2)
        )
        # place of the point, 256ths of a voxel
        self._within = self.per_block(np.zeros((n, VOXELS, 3), np.uint8))

    def add(self, scan: Scan, dynamic: Bool) -> None:
        """Add the points of a scan, with their labels (N,)."""
        points = kernels.as_readonly(scan.points, np.float32)
        voxels = self.locate(scan.points)
        state = self._static, self._dynamic, self._within
        kernels.static_map.add(
            points, voxels, np.ascontiguousarray(dynamic), self._per_metre, *state
        )

    def points(self) -> F32:
        """(M, 3) float32, metres, world frame.

        The points of voxels labelled static more often than dynamic.
        """
        state = self._static, self._dynamic, self._within
        points: F32 = kernels.static_map.points(
            self.existing(), self._blocks, self.resolution, *state
        )
        return points

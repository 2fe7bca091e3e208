"""The trajectory with which a map was cleaned, in the coordinates and on the clock of the source."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np

from dynaviz.arrays import F64, I64
from dynaviz.contracts.attributes import origin_of
from dynaviz.contracts.scan import Scan, Sequence, SequenceSlice
from dynaviz.sources.datasets.lidars import Lidars
from dynaviz.sources.odometry.pose_table import write_pose_rows
from dynaviz.spatial.trajectory import Moved, PosesOverTime, Trajectory

PER_SWEEP = 5
"""Poses of a sweep whose points have times: the first and last, and between them, so that straight lines follow."""


@runtime_checkable
class HasTrajectory(Protocol):
    """A sequence that knows the pose of its sensor at any time."""

    @property
    def trajectory(self) -> PosesOverTime:
        """T_world_sensor over time, in the world frame of the scans."""
        ...


class UsedPoses:
    """Collects the poses of scans, to write them as a file that ``--poses`` reads.

    Args:
        sequence: the scans are its frames, in order. Scans of several lidars have no common trajectory.
    """

    def __init__(self, sequence: Sequence) -> None:
        self._sequence, self._scans, self._times = sequence, list[tuple[int, int | None, F64]](), list[I64]()

    def add(self, scan: Scan) -> None:
        """Add the pose of a scan."""
        self._scans.append((scan.index, scan.stamp_ns, scan.T_world_sensor))
        if scan.stamp_ns is None:
            return
        self._times.append(np.array([scan.stamp_ns]))
        if scan.times is not None and len(finite := scan.times[np.isfinite(scan.times)]):
            first, last = (round(float(t) * 1e9) for t in (finite.min(), finite.max()))
            # Times of points are rounded to float32, within 10 ns in a sweep: the table reaches as far on both sides.
            self._times.append(scan.stamp_ns + np.linspace(first - 100, last + 100, PER_SWEEP).astype(np.int64))

    def write(self, file: Path) -> bool:
        """Write the table; False if there is none to write."""
        whole: Sequence = self._sequence
        while isinstance(whole, SequenceSlice):
            whole = whole.whole
        if isinstance(whole, Lidars) or not self._scans:
            return False
        origin = origin_of(self._sequence)
        indices, stamps, poses = zip(*self._scans, strict=True)
        if None in stamps or len(set(stamps)) < len(stamps):
            moved = np.array(poses)
            moved[:, :3, 3] += origin
            write_pose_rows(file, zip(indices, moved, strict=True), by_stamp=False)
            return True
        known: PosesOverTime = whole.trajectory if isinstance(whole, HasTrajectory) else Trajectory.of(stamps, poses)
        times = np.unique(np.concatenate(self._times))
        write_pose_rows(file, zip(times.tolist(), Moved(known, origin).at(times), strict=True), by_stamp=True)
        return True

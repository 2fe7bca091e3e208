"""The trajectory with which a map was cleaned, in the coordinates and on the clock of
the source.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from dynaviz.arrays import F64, I64
from dynaviz.contracts.scan import Scan
from dynaviz.sources.datasets.lidars import Lidars
from dynaviz.sources.datasets.pose_matching import moved
from dynaviz.sources.drive import Drive
from dynaviz.sources.odometry.pose_table import write_pose_rows, write_tum
from dynaviz.spatial.trajectory import Moved, PosesOverTime, Trajectory

PER_SWEEP = 5
"""Poses of a sweep whose points have times: the first and last, and between them, so that straight
lines follow."""


class UsedPoses:
    """Collects the poses of scans, to write them as a file that ``--poses`` reads.

    Args:
        sequence: the scans are its frames, in order. The poses of several lidars have a column with
            their number.
    """

    def __init__(self, sequence: Drive) -> None:
        self._sequence = sequence
        reader = sequence.reader
        self._lidar = reader.order[:, 0] if isinstance(reader, Lidars) else None
        self._scans = defaultdict[int, list[tuple[int, int | None, F64]]](list)
        self._times = defaultdict[int, list[I64]](list)

    def add(self, scan: Scan) -> None:
        """Add the pose of a scan."""
        lidar = 0 if self._lidar is None else int(self._lidar[scan.index])
        self._scans[lidar].append((scan.index, scan.stamp_ns, scan.T_world_sensor))
        if scan.stamp_ns is None:
            return
        times = self._times[lidar]
        times.append(np.array([scan.stamp_ns]))
        if scan.times is not None and len(finite := scan.times[np.isfinite(scan.times)]):
            first, last = (round(float(t) * 1e9) for t in (finite.min(), finite.max()))
            # Times of points are rounded to float32, within 10 ns in a sweep: the table reaches as
            # far on both sides.
            times.append(
                scan.stamp_ns + np.linspace(first - 100, last + 100, PER_SWEEP).astype(np.int64)
            )

    def write(self, file: Path) -> bool:
        """Write the table; False if there is none to write.

        Those of one lidar, with times, are written as TUM, too: ``trajectory.tum``.
        """
        origin = self._sequence.origin
        known = self._known()
        rows = list[tuple[int, F64]]()
        lidars = list[int]()
        for lidar in sorted(known or self._scans):
            if known:
                times = np.unique(np.concatenate(self._times.get(lidar, self._times[0])))
                own = list(zip(times.tolist(), Moved(known[lidar], origin).at(times), strict=True))
            else:
                own = [(index, moved(T[None], origin)[0]) for index, _, T in self._scans[lidar]]
            rows += own
            lidars += [lidar] * len(own)
        if rows:
            several = len(set(lidars)) > 1
            write_pose_rows(file, rows, bool(known), lidars if several else None)
            if known and not several:
                write_tum(file.with_suffix(".tum"), rows)
        return bool(rows)

    def _known(self) -> Mapping[int, PosesOverTime]:
        """The poses over time of each lidar; empty if scans of one have no stamps, or the same."""
        at = {
            k: {stamp: T for _, stamp, T in scans if stamp is not None}
            for k, scans in self._scans.items()
        }
        if any(len(at[k]) < len(scans) for k, scans in self._scans.items()):
            return {}
        return self._sequence.trajectories or {
            k: Trajectory.of(list(poses), list(poses.values())) for k, poses in at.items()
        }

"""Tables of poses, one per sweep, which ``--poses`` reads."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from dynaviz.arrays import F64, I64
from dynaviz.contracts.scan import Scan
from dynaviz.io.atomic import write_atomic
from dynaviz.sources.datasets.lidars import LIDAR
from dynaviz.spatial import geometry
from dynaviz.spatial.motion import smoothed
from dynaviz.spatial.trajectory import Trajectory


def write_pose_table(
    file: Path, frames: Iterable[Scan], poses: F64, moments: I64 | None = None
) -> None:
    """Write poses by stamp, or by number if a frame has no stamp or two have the same.

    Args:
        file: CSV file.
        frames: the sweeps; only their numbers and stamps are used.
        poses: (frames, 4, 4) float64, metres.
        moments: (frames,) int64, nanoseconds: the times to which the poses refer, if they are not
            the stamps. These times, a few between them and the stamps have a line, so that no sweep
            lies outside, and straight lines between the lines of the table follow the motion.
    """
    frames = tuple(frames)
    stamps = [frame.stamp_ns for frame in frames]
    rows: list[tuple[int, F64]]
    by_stamp = None not in stamps and len(set(stamps)) == len(stamps)
    if not by_stamp:
        rows = list(zip((frame.index for frame in frames), poses, strict=True))
    else:
        own = np.array(stamps, np.int64)
        trajectory = Trajectory.of(own, poses) if moments is None else smoothed(moments, poses)
        times = np.union1d(own, trajectory.times)
        rows = list(zip(times.tolist(), trajectory.at(times), strict=True))
    write_pose_rows(file, rows, by_stamp)


def write_pose_rows(
    file: Path, rows: Iterable[tuple[int, F64]], by_stamp: bool, lidars: Iterable[int] | None = None
) -> None:
    """Write poses, each with its stamp in nanoseconds or the number of its frame.

    Args:
        file: CSV file.
        rows: stamp or number, and T_world_sensor, (4, 4) float64, metres.
        by_stamp: whether the numbers are stamps.
        lidars: number of the lidar of each row; None if there is only one.
    """
    names = [
        "stamp [ns]" if by_stamp else "index",
        *(f"T{row}{column}" for row in range(3) for column in range(4)),
    ]
    lines = [[str(number), *(f"{x:.17g}" for x in T[:3].ravel())] for number, T in rows]
    if lidars is not None:
        names = [*names, LIDAR]
        lines = [[*line, str(lidar)] for line, lidar in zip(lines, lidars, strict=True)]
    write_atomic(file, "\n".join([*map(",".join, [names, *lines]), ""]).encode())


def without_points(scan: Scan) -> Scan:
    """A scan without points, to keep its number, stamp and pose."""
    return Scan(scan.index, np.empty((0, 3), np.float32), scan.T_world_sensor, scan.stamp_ns)


def write_tum(file: Path, rows: Iterable[tuple[int, F64]]) -> None:
    """Write poses as TUM: time in seconds, position, quaternion x y z w.

    Args:
        file: text file.
        rows: stamp in nanoseconds, and T_world_sensor, (4, 4) float64, metres.
    """
    lines = ["# time x y z qx qy qz qw"]
    for stamp, T in rows:
        w, x, y, z = geometry.quaternion(T[:3, :3])
        numbers = " ".join(f"{value:.12g}" for value in (*T[:3, 3], x, y, z, w))
        lines.append(f"{stamp // 10**9}.{stamp % 10**9:09d} {numbers}")
    write_atomic(file, ("\n".join(lines) + "\n").encode())

"""Estimate the poses of a sequence with an odometry, and cache them in a file that ``--poses``
reads.
"""

from __future__ import annotations

import hashlib
import time
import tomllib
from dataclasses import asdict, dataclass
from importlib import metadata
from pathlib import Path
from typing import Any, ClassVar, Protocol

import numpy as np

from dynaviz.arrays import F64, I64
from dynaviz.contracts import registry
from dynaviz.contracts.scan import Scan, Sequence, stream
from dynaviz.errors import DataError
from dynaviz.io.atomic import write_atomic
from dynaviz.progress import Progress, silent
from dynaviz.sources.drive import Drive
from dynaviz.sources.odometry.pose_table import without_points, write_pose_table
from dynaviz.sources.odometry.verify import PoseCheck, check_poses, restart_frames
from dynaviz.sources.origin import EstimatedPoses
from dynaviz.spatial import geometry
from dynaviz.spatial.motion import deskewed_along, smoothed
from dynaviz.spatial.trajectory import Trajectory


class PosesDoNotHold(DataError):
    """Estimated poses that do not place the scans on each other."""


class Odometry(Protocol):
    """Estimates poses, one sweep after the other.

    Attributes:
        reference: time in the sweep to which its pose refers, for sweeps whose points have times: 0
            for the first point, 1 for the last.
        package: the distribution that implements it, whose version is part of the cache's key.

    Args:
        reach: metres: range within which most points lie.

    Raises:
        MissingDependency: if the package is not installed.
    """

    reference: ClassVar[float]
    package: ClassVar[str]

    def __init__(self, reach: float) -> None: ...

    def register(self, points: F64, times: F64 | None) -> F64:
        """Estimate the pose of the next sweep.

        Args:
            points: (N, 3) float64, metres, sensor frame, each at its own time; finite.
            times: (N,) float64, seconds; when each point was measured. None if the sweep is already
                compensated for motion, or the times are unknown.

        Returns:
            (4, 4) float64, metres: the pose in the frame of the first sweep.
        """
        ...


_DO_NOT_HOLD = (
    "Give the poses of a SLAM system with --poses FILE. Scans that are far apart, such as "
    "keyframes, need them"
)
FEWEST = 4  # sweeps whose poses are checked
FORMAT = 4  # of the cache; a change makes earlier caches invalid
_SAMPLES = 5  # frames whose ranges are looked at


def estimate(
    name: str, sequence: Sequence, folder: Path, raw: bool, progress: Progress = silent
) -> EstimatedPoses:
    """Estimate poses, or find those that an earlier call wrote into the same folder for the same
    data.

    Sweeps that are not compensated for motion are registered twice.

    Args:
        name: of the odometry (``dynaviz list odometries``).
        sequence: its points are transformed to the sensor frame with its own poses.
        folder: where to write ``poses_NAME.csv`` and ``poses_NAME.toml``.
        raw: whether ``Scan.times`` say when points were measured, and the points are not yet
            compensated for motion.
        progress: called after each sweep.

    Raises:
        UsageError: for an unknown odometry.
        MissingDependency: if it is not installed.
        DataError: for data that cannot be read, or files that cannot be written.
    """
    kind: type[Odometry] = registry.load("odometries", name)
    file = folder / f"poses_{name}.csv"
    note = folder / f"poses_{name}.toml"
    sample = [
        sequence[k] for k in np.unique(np.linspace(0, len(sequence) - 1, _SAMPLES).astype(int))
    ]
    reach = reach_of(sample)
    first = kind(reach)  # raises MissingDependency before the sequence is read
    key = _key(kind, name, sequence, sample)
    if (earlier := _cached(file, note, key)) is not None:
        return earlier
    start = time.monotonic()
    way = _register(first, sequence, raw, None, progress)
    path = None
    if way.deskewed and len(set(way.moments.tolist())) == len(sequence) > 1:
        path = smoothed(way.moments, way.poses)
        way = _register(kind(reach), sequence, raw, path, progress)
    if len(sequence) >= FEWEST:
        found_to_hold = _checked(kind, reach, sequence, raw, path, way)
        if not found_to_hold.holds:
            raise PosesDoNotHold(
                sequence.name,
                f"the poses that {name} estimated do not hold: {found_to_hold}",
                hint=_DO_NOT_HOLD,
            )
    write_pose_table(file, way.frames, way.poses, way.moments if way.deskewed else None)
    steps = np.linalg.norm(np.diff(way.poses[:, :3, 3], axis=0), axis=1)
    found = EstimatedPoses(file, name, _version(kind), len(way.poses), round(float(steps.sum()), 3),
                           round(time.monotonic() - start, 1), way.deskewed, key)  # fmt: skip
    _save(note, found)
    return found


@dataclass(frozen=True)
class _Way:
    """The poses that one pass found.

    Attributes:
        poses: (frames, 4, 4) float64, metres.
        moments: (frames,) int64, nanoseconds: the times to which they refer.
        frames: the sweeps without points.
        deskewed: whether times of points were used.
    """

    poses: F64
    moments: I64
    frames: list[Scan]
    deskewed: bool


def _register(
    odometry: Odometry, sequence: Sequence, raw: bool, path: Trajectory | None, progress: Progress
) -> _Way:
    """Register all sweeps.

    The first pass (path None) leaves deskewing to the odometry, which does not know yet how the
    sensor moves on: the first sweeps, and those where a vehicle brakes or pitches, stay distorted.
    The second deskews with the poses of the first.
    """
    poses = []
    moments = list[int]()
    frames = list[Scan]()
    deskewed = False
    for done, scan in enumerate(stream(sequence), 1):
        points, times = _sensor_frame(scan, raw)
        moment = _moment(scan, times, odometry.reference)
        deskewed |= times is not None
        if path is not None and times is not None:
            own = (scan.stamp_ns or 0) + np.round(times * 1e9).astype(np.int64)
            points = deskewed_along(points, own, path, moment)
            times = None
        poses.append(odometry.register(points, times))
        moments.append(moment)
        frames.append(without_points(scan))
        progress("poses" if path is None else "poses, second pass", done, len(sequence))
    return _Way(np.array(poses), np.array(moments, np.int64), frames, deskewed)


def _checked(
    kind: type[Odometry],
    reach: float,
    sequence: Sequence,
    raw: bool,
    path: Trajectory | None,
    way: _Way,
) -> PoseCheck:
    """What speaks for the poses, with a second start in the middle of the drive."""

    def points(position: int) -> F64:
        scan = sequence[position]
        found, times = _sensor_frame(scan, raw)
        along = path or (smoothed(way.moments, way.poses) if way.deskewed else None)
        if times is None or along is None:
            return found
        own = (scan.stamp_ns or 0) + np.round(times * 1e9).astype(np.int64)
        return deskewed_along(found, own, along, int(way.moments[position]))

    def restart() -> F64:
        rows = range(*restart_frames(len(sequence)))
        part = Drive.of(sequence).chosen(rows)
        return _register(kind(reach), part, raw, path, silent).poses

    return check_poses(way.poses, points, restart)


def _sensor_frame(scan: Scan, raw: bool) -> tuple[F64, F64 | None]:
    """Finite points in the sensor frame, and their times if they are known and matter."""
    finite = np.isfinite(scan.points).all(1)
    points = geometry.apply(geometry.inverse(scan.T_world_sensor), scan.points[finite])
    if not raw or scan.times is None:
        return points, None
    return points, scan.times[finite].astype(np.float64)


def _moment(scan: Scan, times: F64 | None, reference: float) -> int:
    """The time to which the pose of a sweep refers, nanoseconds."""
    stamp = scan.stamp_ns or 0
    if times is None or not len(times):
        return stamp
    first = float(times.min())
    last = float(times.max())
    return stamp + round((first + reference * (last - first)) * 1e9)


def reach_of(scans: list[Scan]) -> float:
    """Metres: 95 % of the points are nearer."""
    ranges = [np.sqrt(scan.squared_ranges()) for scan in scans]
    near = np.concatenate([values[np.isfinite(values)] for values in ranges])
    return float(np.percentile(near, 95)) if len(near) else 0.0


def _key(kind: type[Odometry], name: str, sequence: Sequence, sample: list[Scan]) -> str:
    """Digest of the odometry, and of some frames of the sequence."""
    digest = hashlib.sha256(f"{FORMAT} {name} {_version(kind)} {len(sequence)}".encode())
    for scan in sample:
        digest.update(f"{scan.index} {scan.stamp_ns}".encode())
        digest.update(geometry.apply(geometry.inverse(scan.T_world_sensor), scan.points).tobytes())
    return digest.hexdigest()


def _version(kind: type[Odometry]) -> str:
    try:
        return metadata.version(kind.package)
    except metadata.PackageNotFoundError:
        return "unknown"


def _save(note: Path, found: EstimatedPoses) -> None:
    import tomli_w

    facts = {name: value for name, value in asdict(found).items() if name not in ("file", "reused")}
    write_atomic(note, tomli_w.dumps(facts).encode())


def _cached(file: Path, note: Path, key: str) -> EstimatedPoses | None:
    """The poses of an earlier call with the same key; None if there are none."""
    try:
        facts: dict[str, Any] = tomllib.loads(note.read_text(encoding="utf-8"))
        found = EstimatedPoses(file, **facts, reused=True)
    except (OSError, ValueError, TypeError):
        return None
    return found if found.key == key and file.is_file() else None

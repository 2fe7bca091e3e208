"""Match scans to the poses of a file by stamp, number or order.

The pose of a lidar on a vehicle (``--extrinsic``).
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from dynaviz.arrays import F64, I64
from dynaviz.contracts.attributes import far_origin
from dynaviz.errors import DataError, UsageError
from dynaviz.io.poses import PoseFile, read_poses
from dynaviz.sources.hypotheses import clocks
from dynaviz.sources.hypotheses.judge import Points, Reading, judge, near_zero
from dynaviz.sources.hypotheses.sizes import in_smaller_units
from dynaviz.spatial import geometry
from dynaviz.spatial.trajectory import PosesOverTime, Trajectory

STAMP_TOLERANCE = (
    1_000_000  # nanoseconds a scan may lie outside the poses, because stamps are rounded
)
NO_POSES = "none"  # as the source of poses: each scan stays in its own frame, for odometries
FRAMES = ("sensor", "world")  # frames that points may be in


@dataclass(frozen=True)
class MatchedPoses:
    """The scans that have a pose.

    Attributes:
        positions: (M,) int64: positions of these scans in the sequence, increasing.
        poses: (M, 4, 4) float64, metres: T_world_sensor of each.
        stamps: (M,) int64, nanoseconds, of the scans or otherwise of their poses; None if neither
            has stamps.
        description: source of the poses in a few words, for ``dynaviz info``.
        trajectory: T_world_sensor over time; None if poses are not matched by stamp.
        origin: (3,) float64, metres: what was subtracted from all positions.
    """

    positions: I64
    poses: F64
    stamps: I64 | None
    description: str
    trajectory: Trajectory | None = None
    origin: F64 = field(default_factory=lambda: np.zeros(3))

    def mounted(self, mount: F64) -> MatchedPoses:
        """The poses of a sensor with this pose (4, 4) on the vehicle whose poses these are."""
        trajectory = self.trajectory and Trajectory(
            self.trajectory.times, geometry.compose(self.trajectory.poses, mount)
        )
        return replace(self, poses=geometry.compose(self.poses, mount), trajectory=trajectory)

    def near_zero(self) -> MatchedPoses:
        """The poses in a world whose origin is near the first of them.

        See ``contracts.attributes.far_origin``.
        """
        origin = far_origin(self.poses[0, :3, 3])
        if not origin.any():
            return self
        trajectory = self.trajectory and Trajectory(
            self.trajectory.times, moved(self.trajectory.poses, -origin)
        )
        return replace(self, poses=moved(self.poses, -origin), trajectory=trajectory, origin=origin)


def moved(poses: F64, offset: F64) -> F64:
    """(N, 4, 4) poses, with (3,) added to their positions."""
    poses = poses.copy()
    poses[:, :3, 3] += offset
    return poses


def match_poses(
    file: Path, scans: Path, stamps: I64 | None, numbers: I64, points: Points | None = None
) -> MatchedPoses:
    """Find the pose of each scan.

    Poses are interpolated by stamp if scans and poses have stamps. Otherwise they are matched by
    number if the poses have numbers, or else by order, which needs as many poses as scans. Scans
    without a pose are skipped with a warning. If the file can be read in several ways, or its clock
    is not that of the scans, each reading is tried on a few scans.

    Args:
        file: pose file.
        scans: path of the scans, for messages.
        stamps: (N,) int64, nanoseconds, of the scans; None if they have none.
        numbers: (N,) int64, of the scans.
        points: reads the points of a scan in the sensor frame; None if they are in the world frame,
            so that nothing can be tried.

    Raises:
        DataError: if the poses cannot be read or match no scan, or if nobody can tell which reading
            is right.
    """
    poses = read_poses(file)
    if (several := len(poses.lidars)) > 1:
        raise DataError(
            file,
            f"has the poses of {several} lidars",
            hint="Give those of one, or the merged map of all",
        )
    if points is None:
        name, poses = poses.most_upright()
        matched = _matched(poses, scans, stamps, numbers, None)
        read = f"; read as x y z {name}, with which the sensor is upright" if name else ""
        return replace(matched, description=f"{matched.description}{read}")
    turns: dict[str, MatchedPoses] = {}
    errors = []
    for name, each in poses.readings.items():
        try:
            turns[name] = _matched(replace(poses, poses=each), scans, stamps, numbers, points)
        except DataError as error:
            errors.append(error)
    if errors and not turns:
        raise errors[0]
    if not turns:
        return _matched(poses, scans, stamps, numbers, points)
    if len(turns) == 1:
        return next(iter(turns.values()))
    try:
        name, figures = _tried(file, turns, points, "the order of its quaternions")
    except DataError:
        if poses.kind != "TUM":
            raise
        return _matched(poses, scans, stamps, numbers, points)  # as the format states
    matched = turns[name]
    return replace(matched, description=f"{matched.description}; read as x y z {name} ({figures})")


def _matched(
    poses: PoseFile, scans: Path, stamps: I64 | None, numbers: I64, points: Points | None
) -> MatchedPoses:
    file = poses.path
    if stamps is not None and poses.stamps is not None and (len(poses) > 1 or len(stamps) == 1):
        return _on_one_clock(poses, scans, stamps, points)
    if poses.numbers is not None:
        if not np.isin(numbers, poses.numbers).any() and len(poses) == len(numbers):
            poses = replace(poses, numbers=None)  # vertices of a graph have numbers of their own
        else:
            return _by_number(poses, scans, numbers)
    if len(poses) != len(numbers):
        plural = "pose" if len(poses) == 1 else "poses"
        problem = f"has {len(poses)} {plural}, but there are {len(numbers)} scans in {scans}"
        hint = "Give one pose per scan, or stamps for both (TUM, CSV), or an index (CSV)"
        raise DataError(file, problem, hint=hint)
    stamps = poses.stamps if stamps is None else stamps
    if stamps is not None and (np.diff(stamps) < 0).any():
        stamps = None
    return MatchedPoses(
        np.arange(len(numbers)), poses.poses, stamps, f"{file.name} ({poses.kind}), by order"
    )


def _on_one_clock(poses: PoseFile, scans: Path, stamps: I64, points: Points | None) -> MatchedPoses:
    """Poses by stamp; on the clock that fits if the given one covers few scans."""
    assert poses.stamps is not None
    share = clocks.covered(stamps, poses.stamps)
    found = clocks.offsets(stamps, poses.stamps) if share < clocks.INSIDE else {}
    if not found or points is None:
        return _by_stamp(poses, scans, stamps)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        readings = {"the clock of the scans": _by_stamp(poses, scans, stamps)} if share else {}
        shifted = {name: replace(poses, stamps=poses.stamps + by) for name, by in found.items()}
        readings |= {name: _by_stamp(each, scans, stamps) for name, each in shifted.items()}
    try:
        name, figures = _tried(poses.path, readings, points, "the clock of its times")
    except DataError:
        return _by_stamp(poses, scans, stamps)  # which reports it if no scan is covered
    if name in found:
        seconds = f"{found[name] / 1e9:+.3f} s: {name}"
        described = f"{readings[name].description}, {seconds} ({figures})"
        return replace(readings[name], description=described)
    return _by_stamp(poses, scans, stamps)


def _tried(
    file: Path, readings: Mapping[str, MatchedPoses], points: Points, what: str
) -> tuple[str, str]:
    """The reading that fits the scans, and its measures in words.

    Raises:
        DataError: if none is good by itself and clearly better than the others.
    """
    common = sorted(set.intersection(*(set(each.positions.tolist()) for each in readings.values())))
    if not common:
        common = list(next(iter(readings.values())).positions)
    rows = {name: np.searchsorted(each.positions, common) for name, each in readings.items()}
    own = lambda k: points(common[k])  # noqa: E731
    tried = {
        name: near_zero(Reading(each.poses[rows[name]], own))
        for name, each in readings.items()
        if len(rows[name]) == len(common)
    }
    verdicts = [judge(tried)]
    if not verdicts[0].sure:
        verdicts += [judge(each) for each in in_smaller_units(tried)]
    verdict = next((each for each in verdicts if each.sure), verdicts[0])
    if not verdict.sure:
        hint = (
            "Say it in the file: a header line such as # time x y z qx qy qz qw, or times on the "
            "clock of the scans"
        )
        raise DataError(file, f"cannot tell {what} from the scans ({verdict.figures})", hint=hint)
    return verdict.best, str(verdict.measures[verdict.best])


def _by_stamp(poses: PoseFile, scans: Path, stamps: I64) -> MatchedPoses:
    assert poses.stamps is not None
    decreasing = np.diff(poses.stamps) < 0
    if decreasing.any():
        problem = (
            f"times are not increasing: row {int(np.argmax(decreasing)) + 2} is before the row "
            "above"
        )
        raise DataError(poses.path, problem, hint="Sort the poses by time, with one drive per file")
    trajectory = Trajectory.of(poses.stamps, poses.poses)
    kept = covered_scans(trajectory, stamps, f"{poses.path}", scans)
    description = f"{poses.path.name} ({poses.kind}), by stamp"
    return MatchedPoses(kept, trajectory.at(stamps[kept]), stamps[kept], description, trajectory)


def _by_number(poses: PoseFile, scans: Path, numbers: I64) -> MatchedPoses:
    assert poses.numbers is not None
    row_of = {int(number): row for row, number in enumerate(poses.numbers)}
    kept = np.array([k for k, number in enumerate(numbers.tolist()) if number in row_of], np.int64)
    if len(row_of) < len(poses):
        raise DataError(poses.path, "two poses have the same index", hint="Give one pose per scan")
    if not len(kept):
        problem = (
            f"poses {min(row_of)} to {max(row_of)} match none of the scans {numbers[0]} to "
            f"{numbers[-1]} in {scans}"
        )
        raise DataError(poses.path, problem, hint="Number poses and scans alike")
    warn_skipped(len(numbers) - len(kept), len(numbers), f"have no pose in {poses.path}")
    rows = np.array([row_of[number] for number in numbers[kept].tolist()])
    stamps = None if poses.stamps is None else poses.stamps[rows]
    return MatchedPoses(
        kept, poses.poses[rows], stamps, f"{poses.path.name} ({poses.kind}), by number"
    )


def covered_scans(poses: PosesOverTime, stamps: I64, source: str, scans: Path) -> I64:
    """Positions of the scans whose stamps the poses cover; the others are skipped with a warning.

    Raises:
        DataError: if no scan is covered.
    """
    first, last = poses.span
    kept = np.flatnonzero((stamps >= first - STAMP_TOLERANCE) & (stamps <= last + STAMP_TOLERANCE))
    if not len(kept):
        scan_span = f"{stamps.min() / 1e9:.3f} to {stamps.max() / 1e9:.3f} s"
        pose_span = f"{first / 1e9:.3f} to {last / 1e9:.3f} s"
        problem = (
            f"scans and poses do not overlap in time: scans from {scan_span}, poses from "
            f"{pose_span}"
        )
        raise DataError(
            scans, problem, hint=f"Give poses of the same drive and clock; these are from {source}"
        )
    warn_skipped(
        len(stamps) - len(kept),
        len(stamps),
        f"are outside the time span of the poses from {source}",
    )
    return kept


def warn_skipped(number: int, total: int, reason: str) -> None:
    """Warn if scans are skipped."""
    if number:
        warnings.warn(f"{number} of {total} scans {reason} and are skipped", stacklevel=3)


def parse_points_in(points_in: str | None) -> str:
    """The frame of the points, ``sensor`` (default) or ``world``.

    Raises:
        UsageError: for anything else.
    """
    if points_in not in (None, *FRAMES):
        raise UsageError(f"--points-in {points_in}: give {' or '.join(FRAMES)}")
    return points_in or FRAMES[0]


_HINT = (
    "Give X,Y,Z,ROLL,PITCH,YAW in metres and degrees, or a file with one pose (12 numbers, or 4x4)"
)


def parse_extrinsic(text: str | None) -> F64 | None:
    """T_vehicle_lidar from ``X,Y,Z,ROLL,PITCH,YAW``, metres and degrees, or from a file with one
    pose.

    The rotation is yaw about z, then pitch about the new y, then roll about the new x, as in URDF.

    Returns:
        (4, 4) float64, metres; None for None.

    Raises:
        UsageError: for anything else.
        DataError: for a file that is not a pose.
    """
    if text is None:
        return None
    if Path(text).is_file():
        poses = read_poses(text).poses
        if len(poses) != 1:
            raise UsageError(f"--extrinsic {text}: has {len(poses)} poses. {_HINT}")
        pose: F64 = poses[0]
        return pose
    try:
        numbers = np.array([float(word) for word in re.split(r"[,\s]+", text.strip())])
    except ValueError:
        raise UsageError(f"--extrinsic {text}: neither numbers nor a file. {_HINT}") from None
    if len(numbers) != 6 or not np.isfinite(numbers).all():
        raise UsageError(f"--extrinsic {text}: has {len(numbers)} numbers. {_HINT}")
    from scipy.spatial.transform import Rotation

    T = np.eye(4)
    T[:3, 3] = numbers[:3]
    T[:3, :3] = Rotation.from_euler("ZYX", numbers[:2:-1], degrees=True).as_matrix()
    return T

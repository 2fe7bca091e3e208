"""Sequences of arrays in memory, such as from a notebook."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dynaviz.arrays import F32, F64, single
from dynaviz.contracts.attributes import Attributes
from dynaviz.contracts.given import SCANS, given_points, given_pose, given_poses
from dynaviz.contracts.reader import Reader
from dynaviz.contracts.scan import Scan, Sequence
from dynaviz.contracts.sensors import Sensor
from dynaviz.errors import NoPoses, UsageError
from dynaviz.sources.datasets.pose_matching import (
    NO_POSES,
    MatchedPoses,
    match_poses,
    parse_extrinsic,
    parse_points_in,
)
from dynaviz.spatial import geometry

_NO_POSES = (
    "Estimate them with --poses small-gicp, or give one for each scan: (points, pose), or "
    "poses=(frames, 4, 4)"
)


@dataclass(frozen=True, eq=False)
class ArraySequence(Reader):
    """Scans given as arrays.

    Attributes:
        clouds: (N, 3 or more) float for each scan, metres; the fourth column is the intensity.
        poses: (frames, 4, 4) float64, metres: T_world_sensor.
        scan_stamps: nanoseconds for each scan, or None.
        points_in: ``sensor`` or ``world``: the frame of the points.
        name, sensor: of the sequence.
        origin: (3,) float64, metres: what was subtracted from all positions.
    """

    clouds: tuple[NDArray[Any], ...]
    poses: F64
    scan_stamps: tuple[int | None, ...]
    points_in: str = "sensor"
    name: str = "arrays"
    sensor: Sensor = field(default_factory=Sensor)
    origin: F64 = field(default_factory=lambda: np.zeros(3))
    has_labels: bool = False

    @property
    def format(self) -> str:
        """Arrays."""
        return "arrays"

    @classmethod
    def of(
        cls,
        scans: Iterable[Any],
        points_in: str | None = None,
        poses: str | None = None,
        extrinsic: str | None = None,
        deskew: bool | None = None,
    ) -> ArraySequence:
        """A sequence of ``(points, pose)``, ``(points, pose, stamp in nanoseconds)``, or points
        alone.

        Args:
            scans: the scans.
            points_in, poses, extrinsic, deskew: as for ``dynaviz.open``; a file of poses replaces
                those of the scans, and ``none`` leaves each scan in its own frame.

        Raises:
            UsageError: for anything else, or arrays of other shapes; names the scan.
            NoPoses: if a scan has no pose, and ``poses`` is None.
        """
        if deskew:
            raise UsageError("deskew: arrays have no times of points. Leave it out, or open a bag")
        clouds = list[NDArray[Any]]()
        own = list[F64 | None]()
        stamps = list[int | None]()
        for number, scan in enumerate(scans):
            points, pose, stamp = _parts(scan, number)
            clouds.append(given_points(points, number))
            own.append(
                np.eye(4)
                if poses == NO_POSES
                else None
                if pose is None
                else given_pose(pose, number)
            )
            stamps.append(None if stamp is None else int(stamp))
        if not clouds:
            raise UsageError(f"there are no scans. {SCANS}")
        given = [T for T in own if T is not None]
        if poses in (None, NO_POSES) and len(given) < len(own):
            problem = (
                f"scan {next(k for k, T in enumerate(own) if T is None)} has no pose"
                if given
                else "have no poses"
            )
            raise NoPoses("arrays", problem, hint=_NO_POSES)
        numbers = np.arange(len(clouds))
        times = None if None in stamps else np.array(stamps, np.int64)
        if poses in (None, NO_POSES):
            matched = MatchedPoses(numbers, np.array(given), times, "of the arrays")
        else:
            matched = match_poses(Path(poses), Path("the arrays"), times, numbers)
        mount = parse_extrinsic(extrinsic)
        matched = (matched if mount is None else matched.mounted(mount)).near_zero()
        kept = matched.positions.tolist()
        chosen = tuple(clouds[k] for k in kept), matched.poses, tuple(stamps[k] for k in kept)
        return cls(*chosen, parse_points_in(points_in), origin=matched.origin)

    def __len__(self) -> int:
        return len(self.clouds)

    def attributes(self, position: int) -> Attributes:
        """The columns after x, y and z."""
        cloud = self.clouds[position]
        names = ["intensity", *(f"column_{k}" for k in range(4, cloud.shape[1]))]
        return {name: cloud[:, k] for k, name in zip(range(3, cloud.shape[1]), names, strict=False)}

    def coordinates(self, position: int) -> F32 | F64 | None:
        """(N, 3), metres, in the world; None for float32 in the sensor frame."""
        xyz = self.clouds[position][:, :3]
        xyz = xyz.astype(np.result_type(np.float32, xyz.dtype), copy=False)
        if self.points_in == "world":
            return xyz
        return (
            None
            if xyz.dtype == np.float32
            else geometry.apply(self.poses[position], xyz) + self.origin
        )

    def __getitem__(self, position: int) -> Scan:
        xyz = self.clouds[position][:, :3]
        T_world_sensor = self.poses[position]
        world = self.points_in == "world"
        points = single(xyz - self.origin) if world else geometry.transform(T_world_sensor, xyz)
        return Scan(position % len(self), points, T_world_sensor, self.scan_stamps[position])


def without_poses(sequence: Sequence) -> bool:
    """Whether several scans have the identity as pose, as programs write that know no poses."""
    some = {0, len(sequence) // 2, len(sequence) - 1}
    return len(some) > 1 and all(
        np.array_equal(sequence[k].T_world_sensor, np.eye(4)) for k in some
    )


def with_given_poses(scans: Iterable[Any], poses: ArrayLike) -> list[tuple[Any, F64, Any]]:
    """Scans as ``ArraySequence.of`` takes them, with a pose for each, (frames, 4, 4), in place of
    their own.

    Raises:
        UsageError: for another number of poses, or poses that are not rigid.
    """
    parts = [_parts(scan, number) for number, scan in enumerate(scans)]
    return [
        (points, T, stamp)
        for (points, _, stamp), T in zip(parts, given_poses(poses, len(parts)), strict=True)
    ]


def _parts(scan: Any, number: int) -> tuple[Any, Any, Any]:
    """Points, pose and stamp of a scan; None for those that are not given."""
    if isinstance(scan, np.ndarray):
        return scan, None, None
    if not isinstance(scan, list | tuple) or len(scan) not in (2, 3):
        raise UsageError(f"scan {number}: {type(scan).__name__} is not (points, pose). {SCANS}")
    return scan[0], scan[1], scan[2] if len(scan) == 3 else None

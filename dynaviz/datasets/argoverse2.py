"""Argoverse 2, sensor logs (Wilson et al. 2021): two lidars in one sweep, poses of the car, boxes with track ids."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from dynaviz.arrays import F64, I64
from dynaviz.datasets.box_labels import OrientedBox, boxed_truth, moving_tracks, track_facts
from dynaviz.datasets.files import holds, numbered, only
from dynaviz.datasets.truth import Truth, fields_of
from dynaviz.errors import DataError
from dynaviz.io.feather import read_feather
from dynaviz.scan import Scan
from dynaviz.sensors import Sensor, load_sensor
from dynaviz.spatial import geometry

KINDS = (  # Scan.classes counts these, as the data set's own flow labels do
    "none", "animal", "articulated bus", "bicycle", "bicyclist", "bollard", "box truck", "bus", "construction barrel",
    "construction cone", "dog", "large vehicle", "message board trailer", "mobile pedestrian crossing sign",
    "motorcycle", "motorcyclist", "official signaler", "pedestrian", "railed vehicle", "regular vehicle", "school bus",
    "sign", "stop sign", "stroller", "traffic light trailer", "truck", "truck cab", "vehicular trailer", "wheelchair",
    "wheeled device", "wheeled rider",
)  # fmt: skip
CLASS_NAMES = dict(enumerate(KINDS))
LIDARS = ("up_lidar", "down_lidar")  # lasers 0 to 31, and 32 to 63
LASERS = 32
STEP = 10_000_000  # nanoseconds; rays of the same step start at the same place, so that methods can bundle them
GAP = 50_000_000  # nanoseconds; a pose farther from a sweep is none of it
_POSE = ("qw", "qx", "qy", "qz", "tx_m", "ty_m", "tz_m")
_SWEEP = ("x", "y", "z", "laser_number", "offset_ns")
_BOX = ("timestamp_ns", "track_uuid", "category", "length_m", "width_m", "height_m", *_POSE)


@dataclass(frozen=True)
class EgoPoses:
    """The car over time.

    Attributes:
        path: the file, for errors.
        stamps: (P,) int64, nanoseconds, increasing.
        T_world_ego: (P, 4, 4) float64, metres.
    """

    path: Path
    stamps: I64
    T_world_ego: F64

    def at(self, stamp: int) -> F64:
        """(4, 4) float64: the pose that is nearest in time; the data set has one at each sweep.

        Raises:
            DataError: where none is near.
        """
        nearest = int(np.argmin(np.abs(self.stamps - stamp)))
        if (gap := abs(int(self.stamps[nearest]) - stamp)) > GAP:
            problem = f"has no pose near {stamp} ns: the nearest is {gap / 1e9:.3f} s away"
            raise DataError(self.path, problem, hint="Poses must cover all sweeps and boxes; copy the file again")
        pose: F64 = self.T_world_ego[nearest]
        return pose

    def places(self, mounts: F64, stamps: I64) -> F64:
        """Where (M, 3) places on the car were at (S,) times: (M, S, 3) float64, metres, world frame."""
        times, known = (stamps - self.stamps[0]).astype(np.float64), (self.stamps - self.stamps[0]).astype(np.float64)
        out = np.empty((len(mounts), len(stamps), 3))
        for place, mount in zip(out, mounts, strict=True):
            path = (self.T_world_ego[:, :3, :3] * mount).sum(-1) + self.T_world_ego[:, :3, 3]
            for axis in range(3):
                place[:, axis] = np.interp(times, known, path[:, axis])
        return out


@dataclass(frozen=True)
class Argoverse2Sequence:
    """A log of the Argoverse 2 sensor data set, or of its lidar data set, which has no boxes.

    The world has the city's axes, z up, and its origin where the sensor was at the first sweep. The sensor frame is the
    upper lidar's place with the axes of the car. Sweeps come compensated for the car's motion; each ray starts where
    its own lidar was when it fired. A sweep without boxes in a log with boxes is unlabelled as a whole.
    """

    layout: ClassVar[str] = "LOG/{sensors/lidar/*.feather, city_SE3_egovehicle.feather, annotations.feather}"

    log: str
    sensor: Sensor
    scans: dict[int, Path]
    poses: EgoPoses
    mounts: F64
    boxes: dict[int, list[OrientedBox]] | None
    moving: frozenset[int]

    @classmethod
    def matches(cls, path: Path) -> bool:
        """Whether a path is a log, its folder of sweeps, or a split or the whole data set."""
        return bool(_logs(path))

    @classmethod
    def open(cls, path: Path) -> Self:
        """Open a log.

        Raises:
            DataError: where sweeps, poses or calibration are missing or damaged, or there are several logs.
        """
        found = _logs(path)
        log = only(found[0].parent if found else path, "logs", {log.name: log for log in found})
        scans = numbered(log / "sensors/lidar", ".feather")
        mounts = _mounts(log / "calibration/egovehicle_SE3_sensor.feather")
        poses = _poses(log / "city_SE3_egovehicle.feather")
        poses.T_world_ego[:, :3, 3] -= geometry.apply(poses.at(min(scans)), mounts[:1])[0]
        file = log / "annotations.feather"
        boxes = _boxes(file) if file.is_file() else None
        moving = moving_tracks(
            (box.track, stamp * 1e-9, geometry.compose(poses.at(stamp), box.T_frame_box)[:3, 3])
            for stamp, drawn in (boxes or {}).items()
            for box in drawn
        )
        return cls(log.name, load_sensor("vlp32c_pair"), scans, poses, mounts, boxes, moving)

    @property
    def name(self) -> str:
        """As in ``argoverse2_7fab2350``, the beginning of the log's name."""
        return f"argoverse2_{self.log[:8]}"

    @property
    def has_labels(self) -> bool:
        """Whether there are boxes."""
        return self.boxes is not None

    @property
    def facts(self) -> dict[str, str]:
        """How many objects have boxes."""
        return track_facts({box.track for drawn in (self.boxes or {}).values() for box in drawn}, self.moving)

    def __len__(self) -> int:
        return len(self.scans)

    def __getitem__(self, position: int) -> Scan:
        stamp = list(self.scans)[position]
        sweep = read_feather(self.scans[stamp], _SWEEP)
        xyz = np.column_stack([sweep[axis].astype(np.float64) for axis in "xyz"])
        T_world_ego = self.poses.at(stamp)
        T_ego_sensor = geometry.pose(self.mounts[0], (1, 0, 0, 0))
        truth = self._truth(xyz, stamp) if self.boxes is not None else None
        return Scan(
            index=position % len(self),
            points=geometry.transform(T_world_ego, xyz),
            T_world_sensor=geometry.compose(T_world_ego, T_ego_sensor),
            stamp_ns=stamp,
            origins=self._origins(sweep, stamp),
            **fields_of(truth, CLASS_NAMES),
        )

    def _truth(self, xyz: F64, stamp: int) -> Truth:
        """Truth of (N, 3) points in the car's frame."""
        drawn = (self.boxes or {}).get(stamp)
        known = None if drawn is not None else np.zeros(len(xyz), np.bool_)
        return boxed_truth(xyz, drawn or [], self.moving, known)

    def _origins(self, sweep: dict[str, NDArray[Any]], stamp: int) -> F64:
        """(N, 3) float64, metres, world frame: where the lidar of each point was when it fired."""
        step = sweep["offset_ns"].astype(np.int64) // STEP
        if not len(step):
            return np.empty((0, 3))
        steps = np.arange(step.min(), step.max() + 1)
        places = self.poses.places(self.mounts, stamp + steps * STEP + STEP // 2)
        lidar = (sweep["laser_number"] >= LASERS).astype(np.intp)
        origins: F64 = places[lidar, step - steps[0]]
        return origins


def _logs(path: Path) -> list[Path]:
    """The logs that a path may mean."""
    for log in (path, path.parent.parent):
        if holds(log / "sensors/lidar", "*.feather") and path in (log, log / "sensors/lidar"):
            return [log]
    found = [*path.glob("*/sensors/lidar"), *path.glob("sensor/*/*/sensors/lidar")]
    return sorted(lidar.parent.parent for lidar in found if holds(lidar, "*.feather"))


def _transforms(path: Path, table: dict[str, NDArray[Any]]) -> F64:
    """(rows, 4, 4) float64, metres: the transform in each row.

    Raises:
        DataError: for a row that is none.
    """
    rows = np.column_stack([table[name].astype(np.float64) for name in _POSE])
    out = np.tile(np.eye(4), (len(rows), 1, 1))
    out[:, :3, 3] = rows[:, 4:]
    for row, quaternion in enumerate(rows[:, :4]):
        try:
            out[row, :3, :3] = geometry.matrix(quaternion)
        except ValueError:
            raise DataError(path, "has no rotation", at=f"row {row}", hint="Copy the file again") from None
    if not np.isfinite(out).all():
        row = int(np.flatnonzero(~np.isfinite(out).all((1, 2)))[0])
        raise DataError(path, "has a position that is not finite", at=f"row {row}", hint="Copy the file again")
    return out


def _poses(path: Path) -> EgoPoses:
    table = read_feather(path, ("timestamp_ns", *_POSE))
    if not len(table["timestamp_ns"]):
        raise DataError(path, "has no poses", hint="Copy the file again")
    order = np.argsort(table["timestamp_ns"], kind="stable")
    return EgoPoses(path, table["timestamp_ns"][order].astype(np.int64), _transforms(path, table)[order])


def _mounts(path: Path) -> F64:
    """(2, 3) float64, metres, the car's frame: where the lidars are."""
    table = read_feather(path, ("sensor_name", *_POSE))
    names = table["sensor_name"].tolist()
    for lidar in LIDARS:
        if lidar not in names:
            raise DataError(path, f"has no {lidar}", hint="Copy the file again")
    return _transforms(path, table)[[names.index(lidar) for lidar in LIDARS], :3, 3]


def _boxes(path: Path) -> dict[int, list[OrientedBox]]:
    """The boxes at each time stamp, in the order of time."""
    table = read_feather(path, _BOX)
    numbers = {track: number for number, track in enumerate(sorted(set(table["track_uuid"])), 1)}
    kinds = {kind.replace(" ", "_").upper(): number for number, kind in enumerate(KINDS)}
    sizes = np.column_stack([table[name].astype(np.float64) for name in ("length_m", "width_m", "height_m")])
    T_ego_box = _transforms(path, table)
    T_ego_box[:, :3, 3] -= T_ego_box[:, :3, 2] * sizes[:, 2:] / 2  # from the middle to the bottom
    boxes: dict[int, list[OrientedBox]] = {int(stamp): [] for stamp in np.unique(table["timestamp_ns"])}
    rows = zip(table["timestamp_ns"].tolist(), table["track_uuid"], table["category"], T_ego_box, sizes, strict=True)
    for stamp, track, category, T, size in rows:
        boxes[stamp].append(OrientedBox(numbers[track], kinds.get(category, 0), T, tuple(size.tolist())))
    return boxes

"""Argoverse 2 sensor logs (Wilson et al. 2021).

Sweeps of two lidars, ego poses, boxes with track ids.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from dynaviz.arrays import F64, I64
from dynaviz.contracts.attributes import Attributes
from dynaviz.contracts.reader import Reader
from dynaviz.contracts.scan import Scan
from dynaviz.contracts.sensors import Sensor, load_sensor
from dynaviz.errors import DataError
from dynaviz.io.feather import read_feather
from dynaviz.sources.datasets.box_labels import (
    OrientedBox,
    moving_tracks,
    track_facts,
    truth_from_boxes,
)
from dynaviz.sources.datasets.files import has_files, numbered_files, only
from dynaviz.sources.datasets.truth import Truth, scan_fields
from dynaviz.spatial import geometry

CATEGORIES = (  # Scan.classes are positions in this tuple, as in the data set's flow labels
    "none", "animal", "articulated "
    "bus", "bicycle", "bicyclist", "bollard", "box truck", "bus", "construction barrel",
    "construction cone", "dog", "large vehicle", "message board trailer", "mobile pedestrian "
    "crossing sign",
    "motorcycle", "motorcyclist", "official "
    "signaler", "pedestrian", "railed vehicle", "regular vehicle", "school bus",
    "sign", "stop sign", "stroller", "traffic light "
    "trailer", "truck", "truck cab", "vehicular trailer", "wheelchair",
    "wheeled device", "wheeled rider",
)  # fmt: skip
CLASS_NAMES = dict(enumerate(CATEGORIES))
LIDARS = ("up_lidar", "down_lidar")  # lasers 0 to 31, and 32 to 63
LASERS = 32
ORIGIN_STEP = (
    10_000_000  # nanoseconds; rays within a step share an origin, so that methods can group them
)
MAX_POSE_GAP = 50_000_000  # nanoseconds between a sweep and its pose
_POSE_COLUMNS = ("qw", "qx", "qy", "qz", "tx_m", "ty_m", "tz_m")
_SWEEP_COLUMNS = ("x", "y", "z", "laser_number", "offset_ns")
_TEXT = ("track_uuid", "category", "sensor_name")
_INTEGERS = ("timestamp_ns", "offset_ns", "laser_number")
_LONGEST_SWEEP = 10**10  # nanoseconds
_LARGEST = 1e9  # metres, of positions and sizes
_BOX_COLUMNS = (
    "timestamp_ns",
    "track_uuid",
    "category",
    "length_m",
    "width_m",
    "height_m",
    *_POSE_COLUMNS,
)


@dataclass(frozen=True)
class EgoPoses:
    """The ego poses of a log.

    Attributes:
        path: the file, for errors.
        stamps: (P,) int64, nanoseconds, increasing.
        T_world_ego: (P, 4, 4) float64, metres.
    """

    path: Path
    stamps: I64
    T_world_ego: F64

    def at(self, stamp: int) -> F64:
        """(4, 4) float64: the pose nearest in time; the data set has one for each sweep.

        Raises:
            DataError: if no pose is within ``MAX_POSE_GAP``.
        """
        nearest = int(np.argmin(np.abs(self.stamps - stamp)))
        if (gap := abs(int(self.stamps[nearest]) - stamp)) > MAX_POSE_GAP:
            problem = f"no pose near {stamp} ns: the nearest is {gap / 1e9:.3f} s away"
            raise DataError(
                self.path,
                problem,
                hint="The poses must cover all sweeps and boxes. Copy the file again",
            )
        pose: F64 = self.T_world_ego[nearest]
        return pose

    def positions(self, mounts: F64, stamps: I64) -> F64:
        """Positions of (M, 3) mounts on the car at (S,) times.

        (M, S, 3) float64, metres, world frame.
        """
        times = (stamps - self.stamps[0]).astype(np.float64)
        pose_times = (self.stamps - self.stamps[0]).astype(np.float64)
        out = np.empty((len(mounts), len(stamps), 3))
        for position, mount in zip(out, mounts, strict=True):
            path = (self.T_world_ego[:, :3, :3] * mount).sum(-1) + self.T_world_ego[:, :3, 3]
            for axis in range(3):
                position[:, axis] = np.interp(times, pose_times, path[:, axis])
        return out


@dataclass(frozen=True)
class Argoverse2Sequence(Reader):
    """A log of the Argoverse 2 sensor data set, or of its lidar data set, which has no boxes.

    The world frame has the axes of the city frame, z up, and its origin at the sensor position of
    the first sweep. The sensor frame has the position of the upper lidar and the axes of the car.
    Sweeps are already motion-compensated; each ray starts at the position of its lidar when it
    fired. In a log with boxes, a sweep without any is unlabelled.
    """

    layout: ClassVar[str] = (
        "LOG/{sensors/lidar/*.feather, city_SE3_egovehicle.feather, annotations.feather}"
    )

    log: str
    sensor: Sensor
    scans: dict[int, Path]
    poses: EgoPoses
    mounts: F64
    boxes: dict[int, list[OrientedBox]] | None
    moving: frozenset[int]

    @classmethod
    def matches(cls, path: Path) -> bool:
        """Whether a path is a log, its folder of sweeps, a split, or the whole data set."""
        return bool(_logs(path))

    @classmethod
    def open(cls, path: Path) -> Self:
        """Open a log.

        Raises:
            DataError: if sweeps, poses or calibration are missing or corrupt, or there are several
                logs.
        """
        found = _logs(path)
        log = only(found[0].parent if found else path, "logs", {log.name: log for log in found})
        scans = numbered_files(log / "sensors/lidar", ".feather")
        mounts = _mounts(log / "calibration/egovehicle_SE3_sensor.feather")
        poses = _poses(log / "city_SE3_egovehicle.feather")
        poses.T_world_ego[:, :3, 3] -= geometry.apply(poses.at(min(scans)), mounts[:1])[0]
        annotations = log / "annotations.feather"
        boxes = _boxes(annotations) if annotations.is_file() else None
        moving = moving_tracks(
            (box.track, stamp * 1e-9, geometry.compose(poses.at(stamp), box.T_frame_box)[:3, 3])
            for stamp, sweep_boxes in (boxes or {}).items()
            for box in sweep_boxes
        )
        return cls(log.name, load_sensor("vlp32c_pair"), scans, poses, mounts, boxes, moving)

    @property
    def name(self) -> str:
        """``argoverse2_`` and the first 8 characters of the log id, such as
        ``argoverse2_7fab2350``.
        """
        return f"argoverse2_{self.log[:8]}"

    @property
    def has_labels(self) -> bool:
        """Whether there are boxes."""
        return self.boxes is not None

    @property
    def facts(self) -> dict[str, str]:
        """Number of objects with boxes."""
        return track_facts(
            {box.track for boxes in (self.boxes or {}).values() for box in boxes}, self.moving
        )

    def __len__(self) -> int:
        return len(self.scans)

    def scan_file(self, index: int) -> Path | None:
        """The file of the frame with this number."""
        return list(self.scans.values())[index] if 0 <= index < len(self) else None

    def attributes(self, position: int) -> Attributes:
        """Intensity, number of the laser, and offset of the time from that of the sweep,
        nanoseconds.
        """
        sweep = _read(
            list(self.scans.values())[position], ("intensity", "laser_number", "offset_ns")
        )
        return dict(sweep)

    def __getitem__(self, position: int) -> Scan:
        stamp = list(self.scans)[position]
        sweep = _read(self.scans[stamp], _SWEEP_COLUMNS)
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
            times=(1e-9 * sweep["offset_ns"]).astype(np.float32),
            **scan_fields(truth, CLASS_NAMES),
        )

    def _truth(self, xyz: F64, stamp: int) -> Truth:
        """Ground truth of (N, 3) points in the ego frame."""
        boxes = (self.boxes or {}).get(stamp)
        annotated = None if boxes is not None else np.zeros(len(xyz), np.bool_)
        return truth_from_boxes(xyz, boxes or [], self.moving, annotated)

    def _origins(self, sweep: dict[str, NDArray[Any]], stamp: int) -> F64:
        """(N, 3) float64, metres, world frame: position of each point's lidar when it fired."""
        step = sweep["offset_ns"].astype(np.int64) // ORIGIN_STEP
        if not len(step):
            return np.empty((0, 3))
        steps = np.arange(step.min(), step.max() + 1)
        positions = self.poses.positions(
            self.mounts, stamp + steps * ORIGIN_STEP + ORIGIN_STEP // 2
        )
        lidar = (sweep["laser_number"] >= LASERS).astype(np.intp)
        origins: F64 = positions[lidar, step - steps[0]]
        return origins


def _read(path: Path, columns: tuple[str, ...]) -> dict[str, NDArray[Any]]:
    """Columns of a table; DataError as ``read_feather``, and for times that do not fit into a
    sweep.
    """
    table = read_feather(path, columns, _TEXT, _INTEGERS)
    offsets = table.get("offset_ns")
    if (
        offsets is not None
        and len(offsets)
        and not -_LONGEST_SWEEP < offsets.min() <= offsets.max() < _LONGEST_SWEEP
    ):
        problem = (
            f"column offset_ns spans {offsets.min()} to {offsets.max()} ns, longer than a sweep"
        )
        raise DataError(path, problem, hint="Copy the file again")
    return table


def _logs(path: Path) -> list[Path]:
    """The logs that a path may refer to."""
    for log in (path, path.parent.parent):
        if has_files(log / "sensors/lidar", "*.feather") and path in (log, log / "sensors/lidar"):
            return [log]
    found = [*path.glob("*/sensors/lidar"), *path.glob("sensor/*/*/sensors/lidar")]
    return sorted(lidar.parent.parent for lidar in found if has_files(lidar, "*.feather"))


def _transforms(path: Path, table: dict[str, NDArray[Any]]) -> F64:
    """(rows, 4, 4) float64, metres: the transform in each row.

    Raises:
        DataError: for a row without a valid transform.
    """
    rows = np.column_stack([table[name].astype(np.float64) for name in _POSE_COLUMNS])
    out = np.tile(np.eye(4), (len(rows), 1, 1))
    out[:, :3, 3] = rows[:, 4:]
    for row, quaternion in enumerate(rows[:, :4]):
        try:
            out[row, :3, :3] = geometry.matrix(quaternion)
        except ValueError:
            raise DataError(
                path,
                "the quaternion is not a rotation",
                at=f"row {row}",
                hint="Copy the file again",
            ) from None
    if not (valid := np.abs(rows[:, 4:]) < _LARGEST).all():
        row = int(np.flatnonzero(~valid.all(1))[0])
        raise DataError(
            path,
            "the position is not finite, or too far",
            at=f"row {row}",
            hint="Copy the file again",
        )
    return out


def _poses(path: Path) -> EgoPoses:
    table = _read(path, ("timestamp_ns", *_POSE_COLUMNS))
    if not len(table["timestamp_ns"]):
        raise DataError(path, "contains no poses", hint="Copy the file again")
    order = np.argsort(table["timestamp_ns"], kind="stable")
    return EgoPoses(
        path, table["timestamp_ns"][order].astype(np.int64), _transforms(path, table)[order]
    )


def _mounts(path: Path) -> F64:
    """(2, 3) float64, metres, ego frame: positions of the two lidars."""
    table = _read(path, ("sensor_name", *_POSE_COLUMNS))
    names = table["sensor_name"].tolist()
    for lidar in LIDARS:
        if lidar not in names:
            raise DataError(path, f"sensor {lidar} is missing", hint="Copy the file again")
    return _transforms(path, table)[[names.index(lidar) for lidar in LIDARS], :3, 3]


def _boxes(path: Path) -> dict[int, list[OrientedBox]]:
    """The boxes of each sweep by its stamp, in order of time."""
    table = _read(path, _BOX_COLUMNS)
    numbers = {track: number for number, track in enumerate(sorted(set(table["track_uuid"])), 1)}
    class_ids = {
        category.replace(" ", "_").upper(): number for number, category in enumerate(CATEGORIES)
    }
    sizes = np.column_stack(
        [table[name].astype(np.float64) for name in ("length_m", "width_m", "height_m")]
    )
    if not (valid := np.abs(sizes) < _LARGEST).all():
        row = int(np.flatnonzero(~valid.all(1))[0])
        raise DataError(
            path,
            "the size is not finite, or too large",
            at=f"row {row}",
            hint="Copy the file again",
        )
    T_ego_box = _transforms(path, table)
    # from the centre of the box to its bottom face
    T_ego_box[:, :3, 3] -= T_ego_box[:, :3, 2] * sizes[:, 2:] / 2
    boxes: dict[int, list[OrientedBox]] = {
        int(stamp): [] for stamp in np.unique(table["timestamp_ns"])
    }
    rows = zip(
        table["timestamp_ns"].tolist(),
        table["track_uuid"],
        table["category"],
        T_ego_box,
        sizes,
        strict=True,
    )
    for stamp, track, category, T, size in rows:
        boxes[stamp].append(
            OrientedBox(numbers[track], class_ids.get(category, 0), T, tuple(size.tolist()))
        )
    return boxes

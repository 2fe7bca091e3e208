"""SemanticKITTI (Behley et al. 2019): KITTI odometry sweeps, poses from SLAM, a class and instance for each point."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import ClassVar, Self

import numpy as np

from dynaviz import geometry
from dynaviz.datasets.files import holds, numbered, only_folder
from dynaviz.errors import DataError
from dynaviz.io.calib import read_calib, rigid_of
from dynaviz.io.poses import read_kitti_poses
from dynaviz.io.semantic_label import read_semantic_labels
from dynaviz.io.text import read_table
from dynaviz.io.velodyne import read_velodyne
from dynaviz.scan import F32, F64, U8, Label, Scan
from dynaviz.sensors import Sensor, load_sensor

MOVING = range(252, 260)  # car, bicyclist, person, motorcyclist, on rails, bus, truck, other vehicle
UNSURE = (0, 1)  # unlabelled, outlier: static as in the public benchmark
CLASS_NAMES = {
    0: "unlabelled", 1: "outlier", 10: "car", 11: "bicycle", 13: "bus", 15: "motorcycle", 16: "on rails", 18: "truck",
    20: "other vehicle", 30: "person", 31: "bicyclist", 32: "motorcyclist", 40: "road", 44: "parking", 48: "sidewalk",
    49: "other ground", 50: "building", 51: "fence", 52: "other structure", 60: "lane marking", 70: "vegetation",
    71: "trunk", 72: "terrain", 80: "pole", 81: "traffic sign", 99: "other object", 252: "moving car",
    253: "moving bicyclist", 254: "moving person", 255: "moving motorcyclist", 256: "moving on rails",
    257: "moving bus", 258: "moving truck", 259: "moving other vehicle",
}  # fmt: skip
EGO = 3.0  # metres; what is nearer and unsure is the recording car itself, dynamic as in the public benchmark


@dataclass(frozen=True)
class SemanticKittiSequence:
    """A sequence of SemanticKITTI. The world is the sensor's frame at the start: x forward, y left, z up.

    Frames without a label file are unlabelled as a whole.
    """

    layout: ClassVar[str] = "velodyne/*.bin, calib.txt, poses.txt, labels/*.label"

    folder: Path
    sensor: Sensor
    scans: dict[int, Path]
    poses: F64
    times: F64 | None

    @classmethod
    def matches(cls, path: Path) -> bool:
        """Whether a path is a sequence, its ``velodyne`` folder, or what holds ``sequences/``."""
        return _sequence(path, choose=False) is not None

    @classmethod
    def open(cls, path: Path) -> Self:
        """Open a sequence.

        Raises:
            DataError: where sweeps, poses or calibration are missing or do not fit together.
        """
        folder = _sequence(path, choose=True) or path
        scans = numbered(folder / "velodyne", ".bin")
        calib = folder / "calib.txt"
        T_camera_sensor = rigid_of(calib, read_calib(calib), "Tr", "Tr_velo_to_cam")
        T_world_camera = geometry.compose(geometry.inverse(T_camera_sensor), read_kitti_poses(folder / "poses.txt"))
        poses = geometry.compose(T_world_camera, T_camera_sensor)
        clock = folder / "times.txt"
        times = read_table(clock, 1, "A line is a time in seconds")[:, 0] if clock.is_file() else None
        for name, rows in (("poses.txt", poses), ("times.txt", times)):
            if rows is not None and len(rows) <= max(scans):
                problem = f"has {len(rows)} lines, but there is a sweep {max(scans):06d}.bin"
                raise DataError(folder / name, problem, hint="Each sweep needs a line; copy the file again")
        return cls(folder, load_sensor("hdl64e"), scans, poses, times)

    @property
    def name(self) -> str:
        """As in ``semantickitti_08``."""
        return f"semantickitti_{self.folder.name}"

    @cached_property
    def has_labels(self) -> bool:
        """Whether any frame has a label file."""
        return holds(self.folder / "labels", "*.label")

    def __len__(self) -> int:
        return len(self.scans)

    def __getitem__(self, position: int) -> Scan:
        index = list(self.scans)[position]
        xyz = read_velodyne(self.scans[index])[:, :3]
        T_world_sensor = self.poses[index]
        labels = classes = instances = None
        file = self.folder / "labels" / f"{self.scans[index].stem}.label"
        if file.is_file():
            classes, instances = read_semantic_labels(file, len(xyz))
            labels = _labels(classes, xyz)
        elif self.has_labels:
            labels = np.full(len(xyz), Label.UNLABELLED, np.uint8)
        return Scan(
            index=index,
            points=geometry.transform(T_world_sensor, xyz),
            T_world_sensor=T_world_sensor,
            stamp_ns=None if self.times is None else round(self.times[index] * 1e9),
            labels=labels,
            classes=classes,
            instances=None if instances is None else instances.astype(np.int32),
            class_names=CLASS_NAMES,
        )


def _labels(classes: np.ndarray[tuple[int], np.dtype[np.uint16]], xyz: F32) -> U8:
    """Labels of classes and points in the sensor frame."""
    squares = xyz.astype(np.float64) ** 2
    near = squares[:, 0] + squares[:, 1] + squares[:, 2] < EGO**2
    moving = (classes >= MOVING.start) & (classes < MOVING.stop)
    ego = near & np.isin(classes, UNSURE)
    return np.where(moving | ego, Label.DYNAMIC, Label.STATIC).astype(np.uint8)


def _sequence(path: Path, choose: bool) -> Path | None:
    """The folder of a sequence; with ``choose``, one must be found where there are sequences."""
    for folder in (path, path.parent if path.name == "velodyne" else path):
        if (folder / "poses.txt").is_file() and holds(folder / "velodyne", "*.bin"):
            return folder
    root = path if path.name == "sequences" else path / "sequences"
    if not root.is_dir():
        return None
    return only_folder(root, "sequences") if choose else root

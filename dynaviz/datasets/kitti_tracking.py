"""KITTI tracking (Geiger et al. 2012): HDL-64E sweeps, GPS poses, and boxes of what camera 2 sees."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from dynaviz import geometry
from dynaviz.datasets.files import holds, numbered, only_folder
from dynaviz.errors import DataError
from dynaviz.io.boxes import REGION, Box, read_boxes
from dynaviz.io.calib import matrix_of, read_calib, rigid_of
from dynaviz.io.oxts import read_oxts
from dynaviz.io.velodyne import read_velodyne
from dynaviz.scan import F64, U8, Bool, Label, Scan
from dynaviz.sensors import Sensor, load_sensor

KINDS = ("none", "Car", "Van", "Truck", "Pedestrian", "Person", "Cyclist", "Tram", "Misc")  # Scan.classes counts these
CLASS_NAMES = {number: kind.lower() for number, kind in enumerate(KINDS)}
IMAGE = (1242, 375)  # pixels of camera 2; nothing outside its image has boxes
SWEEP = 0.1036  # seconds between two sweeps
MOVING = 0.5  # metres a second over its life, from which a track is dynamic
SLACK = 0.05  # metres by which a box is grown, for its sides are drawn tight
RIM = 0.25  # metres around a moving box in which nobody knows
FEET = 0.12  # metres at the bottom of the grown box that are ground


@dataclass(frozen=True)
class Camera:
    """Camera 2: where points lie in its frame and its image."""

    T_camera_sensor: F64
    projection: F64

    def sees(self, points: F64) -> tuple[Bool, F64, F64]:
        """Whether (N, 3) points in the camera frame lie in the image, and the columns and rows where, in pixels."""
        image = geometry.apply(self.projection, points)
        with np.errstate(divide="ignore", invalid="ignore"):
            column, row = image[:, 0] / image[:, 2], image[:, 1] / image[:, 2]
        seen: Bool = (points[:, 2] > 0.5) & (column >= 0) & (column < IMAGE[0]) & (row >= 0) & (row < IMAGE[1])
        return seen, column, row


@dataclass(frozen=True)
class KittiTrackingSequence:
    """A sequence of KITTI tracking. The world is the sensor's frame at frame 0: x forward, y left, z up.

    Ground truth comes from the boxes: points in the box of a track that moves are dynamic, other points in the image of
    camera 2 are static, and all else is unlabelled. The released data lack a few sweeps; frames keep their numbers.
    """

    layout: ClassVar[str] = "training/{velodyne/0012/*.bin, calib/0012.txt, oxts/0012.txt, label_02/0012.txt}"

    number: str
    sensor: Sensor
    scans: dict[int, Path]
    poses: F64
    camera: Camera
    boxes: dict[int, list[Box]] | None
    moving: frozenset[int]

    @classmethod
    def matches(cls, path: Path) -> bool:
        """Whether a path is a sequence's ``velodyne/0012``, or the split's folder, or ``training/0012``."""
        return _split(path) is not None

    @classmethod
    def open(cls, path: Path) -> Self:
        """Open a sequence.

        Raises:
            DataError: where sweeps, poses or calibration are missing, or there are several sequences to choose from.
        """
        split, number = _split(path) or (path, None)
        number = number or only_folder(split / "velodyne", "sequences").name
        scans = numbered(split / "velodyne" / number, ".bin")
        calib, oxts, labels = (split / kind / f"{number}.txt" for kind in ("calib", "oxts", "label_02"))
        rows = read_calib(calib)
        T_camera_sensor = rigid_of(calib, rows, "Tr_velo_to_cam", "Tr_velo_cam")
        T_rectified = rigid_of(calib, rows, "R0_rect", "R_rect")
        T_sensor_imu = rigid_of(calib, rows, "Tr_imu_to_velo", "Tr_imu_velo")
        poses = geometry.compose(read_oxts(oxts), geometry.inverse(T_sensor_imu))
        if len(poses) <= max(scans):
            problem = f"has {len(poses)} lines, but there is a sweep {max(scans):06d}.bin"
            raise DataError(oxts, problem, hint="Each sweep needs a line; copy the file again")
        poses = geometry.compose(geometry.inverse(poses[0]), poses)
        camera = Camera(geometry.compose(T_rectified, T_camera_sensor), matrix_of(calib, rows, "P2"))
        boxes = read_boxes(labels) if labels.is_file() else None
        moving = _moving(boxes or [], geometry.compose(poses, geometry.inverse(camera.T_camera_sensor)))
        by_frame = None if boxes is None else _by(boxes, "frame")
        return cls(number, load_sensor("hdl64e"), scans, poses, camera, by_frame, moving)

    @property
    def name(self) -> str:
        """As in ``kitti_tracking_0012``."""
        return f"kitti_tracking_{self.number}"

    @property
    def has_labels(self) -> bool:
        """Whether there are boxes."""
        return self.boxes is not None

    def __len__(self) -> int:
        return len(self.scans)

    def __getitem__(self, position: int) -> Scan:
        index = list(self.scans)[position]
        xyz = read_velodyne(self.scans[index])[:, :3]
        T_world_sensor = self.poses[index]
        points = geometry.transform(T_world_sensor, xyz)
        if self.boxes is None:
            return Scan(index, points, T_world_sensor)
        boxes = self.boxes.get(index, [])
        seen_from = geometry.apply(self.camera.T_camera_sensor, xyz)
        classes, instances = _objects(seen_from, boxes)
        labels = self._labels(seen_from, boxes)
        return Scan(
            index, points, T_world_sensor, labels=labels, classes=classes, instances=instances, class_names=CLASS_NAMES
        )

    def _labels(self, points: F64, boxes: Iterable[Box]) -> U8:
        """Labels of (N, 3) points in the camera frame."""
        seen, column, row = self.camera.sees(points)
        labels = np.where(seen, Label.STATIC, Label.UNLABELLED).astype(np.uint8)
        moving = [box for box in boxes if box.track in self.moving]
        for left, top, right, bottom in (box.rectangle for box in boxes if box.kind == REGION):
            labels[seen & (column >= left) & (column <= right) & (row >= top) & (row <= bottom)] = Label.UNLABELLED
        for box in moving:
            labels[_inside(points, box, RIM)] = Label.UNLABELLED
        for box in moving:
            labels[_inside(points, box, SLACK, FEET)] = Label.DYNAMIC
        return labels


def _split(path: Path) -> tuple[Path, str | None] | None:
    """The folder ``training`` that a path means, and the sequence where it says which."""
    candidates: list[tuple[Path, str | None]]
    if holds(path, "*.bin"):
        candidates = [(path.parent.parent, path.name)]
    else:
        number = None if path.name == "velodyne" else path.name
        candidates = [(path, None), (path / "training", None), (path.parent, number)]
    for split, number in candidates:
        if (split / "oxts").is_dir() and (split / "velodyne" / (number or "")).is_dir():
            return split, number
    return None


def _by(boxes: Iterable[Box], key: str) -> dict[int, list[Box]]:
    groups = defaultdict(list)
    for box in boxes:
        groups[getattr(box, key)].append(box)
    return dict(groups)


def _moving(boxes: Iterable[Box], T_world_camera: F64) -> frozenset[int]:
    """Tracks that end elsewhere than they begin: faster than ``MOVING`` over their life."""
    moving = set()
    for track, life in _by((box for box in boxes if box.kind != REGION), "track").items():
        first, last = life[0], life[-1]
        start, end = (geometry.apply(T_world_camera[box.frame], np.array([box.bottom]))[0] for box in (first, last))
        seconds = max(1, last.frame - first.frame) * SWEEP
        if np.sqrt(((end - start) ** 2).sum()) > MOVING * seconds:
            moving.add(track)
    return frozenset(moving)


def _inside(points: F64, box: Box, margin: float, feet: float = 0.0) -> Bool:
    """Which (N, 3) points in the camera frame lie in a box that is grown by a margin, but for its feet."""
    height, width, length = box.size
    x, y, z = (points[:, axis] - box.bottom[axis] for axis in range(3))
    along = np.cos(box.yaw) * x - np.sin(box.yaw) * z
    across = np.sin(box.yaw) * x + np.cos(box.yaw) * z
    inside: Bool = (np.abs(along) < length / 2 + margin) & (np.abs(across) < width / 2 + margin)
    return inside & (y < margin - feet) & (y > -height - margin)


def _objects(points: F64, boxes: Iterable[Box]) -> tuple[NDArray[np.uint16], NDArray[np.int32]]:
    """Class (a position in ``KINDS``) and instance (track + 1) of (N, 3) points in the camera frame; 0 outside."""
    classes, instances = np.zeros(len(points), np.uint16), np.zeros(len(points), np.int32)
    for box in boxes:
        if box.kind in KINDS:
            inside = _inside(points, box, SLACK, FEET)
            classes[inside], instances[inside] = KINDS.index(box.kind), box.track + 1
    return classes, instances

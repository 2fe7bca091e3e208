"""KITTI tracking (Geiger et al. 2012).

HDL-64E sweeps, GPS poses, and boxes in the view of camera 2.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, Self

import numpy as np

from dynaviz.arrays import F64, Bool
from dynaviz.contracts.scan import Scan
from dynaviz.contracts.sensors import Sensor, load_sensor
from dynaviz.errors import DataError
from dynaviz.io.kitti import (
    REGION,
    TrackBox,
    calib_matrix,
    calib_transform,
    read_boxes,
    read_calib,
    read_oxts,
)
from dynaviz.io.velodyne import read_velodyne
from dynaviz.sources.datasets.box_labels import (
    OrientedBox,
    moving_tracks,
    track_facts,
    truth_from_boxes,
)
from dynaviz.sources.datasets.files import VelodyneSweeps, has_files, numbered_files, only_folder
from dynaviz.sources.datasets.truth import Truth, scan_fields
from dynaviz.spatial import geometry


@dataclass(frozen=True)
class Camera:
    """A camera calibrated to the lidar.

    Attributes:
        T_camera_sensor: (4, 4) float64, metres; camera frame: x right, y down, z forward.
        projection: (3, 4) float64, from the camera frame to pixels.
        size: (width, height) of the image, pixels.
    """

    T_camera_sensor: F64
    projection: F64
    size: tuple[float, float] = (1242, 375)

    def project(self, points: F64) -> tuple[Bool, F64, F64]:
        """Project (N, 3) points in the camera frame.

        Mask of points in the image, columns and rows in pixels.
        """
        projected = geometry.apply(self.projection, points)
        with np.errstate(divide="ignore", invalid="ignore"):
            column = projected[:, 0] / projected[:, 2]
            row = projected[:, 1] / projected[:, 2]
        width, height = self.size
        in_image: Bool = (
            (points[:, 2] > 0.5) & (column >= 0) & (column < width) & (row >= 0) & (row < height)
        )
        return in_image, column, row


# Scan.classes are positions in this tuple.
CATEGORIES = ("none", "Car", "Van", "Truck", "Pedestrian", "Person", "Cyclist", "Tram", "Misc")
CLASS_NAMES = {number: category.lower() for number, category in enumerate(CATEGORIES)}
SWEEP_PERIOD = 0.1036  # seconds between two sweeps


@dataclass(frozen=True)
class KittiTrackingSequence(VelodyneSweeps):
    """A sequence of KITTI tracking. The world frame is the sensor frame at frame 0.

    X forward, y left, z up.

    Ground truth comes from boxes: points in the box of a moving track are dynamic, other points in
    the image of camera 2 are static, and all others are unlabelled. The released data lack a few
    sweeps; frames keep their numbers.
    """

    layout: ClassVar[str] = (
        "training/{velodyne/0012/*.bin, calib/0012.txt, oxts/0012.txt, label_02/0012.txt}"
    )

    number: str
    sensor: Sensor
    scans: dict[int, Path]
    poses: F64
    camera: Camera
    boxes: dict[int, list[TrackBox]] | None
    moving: frozenset[int]

    @classmethod
    def matches(cls, path: Path) -> bool:
        """Whether a path is ``velodyne/0012`` of a sequence, the folder of the split, or
        ``training/0012``.
        """
        return _split(path) is not None

    @classmethod
    def open(cls, path: Path) -> Self:
        """Open a sequence.

        Raises:
            DataError: if sweeps, poses or calibration are missing, or there are several sequences.
        """
        split, number = _split(path) or (path, None)
        number = number or only_folder(split / "velodyne", "sequences").name
        scans = numbered_files(split / "velodyne" / number, ".bin")
        calib, oxts, labels = (
            split / kind / f"{number}.txt" for kind in ("calib", "oxts", "label_02")
        )
        rows = read_calib(calib)
        T_camera_sensor = calib_transform(calib, rows, "Tr_velo_to_cam", "Tr_velo_cam")
        T_rectified = calib_transform(calib, rows, "R0_rect", "R_rect")
        T_sensor_imu = calib_transform(calib, rows, "Tr_imu_to_velo", "Tr_imu_velo")
        poses = geometry.compose(read_oxts(oxts), geometry.inverse(T_sensor_imu))
        if len(poses) <= max(scans):
            problem = f"has only {len(poses)} lines, but there is a sweep {max(scans):06d}.bin"
            raise DataError(oxts, problem, hint="Each sweep needs a line. Copy the file again")
        poses = geometry.compose(geometry.inverse(poses[0]), poses)
        camera = Camera(
            geometry.compose(T_rectified, T_camera_sensor), calib_matrix(calib, rows, "P2")
        )
        boxes = read_boxes(labels) if labels.is_file() else None
        moving = _moving(
            boxes or [], geometry.compose(poses, geometry.inverse(camera.T_camera_sensor))
        )
        by_frame = None if boxes is None else _by_frame(boxes)
        return cls(number, load_sensor("hdl64e"), scans, poses, camera, by_frame, moving)

    @property
    def name(self) -> str:
        """Format and sequence number, such as ``kitti_tracking_0012``."""
        return f"kitti_tracking_{self.number}"

    @property
    def has_labels(self) -> bool:
        """Whether there are boxes."""
        return self.boxes is not None

    @property
    def facts(self) -> dict[str, str]:
        """Number of objects with boxes."""
        return track_facts(
            {box.track for boxes in (self.boxes or {}).values() for box in boxes} - {-1},
            self.moving,
        )

    def __getitem__(self, position: int) -> Scan:
        index = self.index_of(position)
        xyz = read_velodyne(self.scans[index])[:, :3]
        T_world_sensor = self.poses[index]
        points = geometry.transform(T_world_sensor, xyz)
        truth = None
        if self.boxes is not None:
            truth = self._truth(
                geometry.apply(self.camera.T_camera_sensor, xyz), self.boxes.get(index, [])
            )
        return Scan(index, points, T_world_sensor, **scan_fields(truth, CLASS_NAMES))

    def _truth(self, points: F64, boxes: Iterable[TrackBox]) -> Truth:
        """Ground truth of (N, 3) points in the camera frame."""
        annotated, column, row = self.camera.project(points)
        for left, top, right, bottom in (box.rectangle for box in boxes if box.kind == REGION):
            annotated &= ~((column >= left) & (column <= right) & (row >= top) & (row <= bottom))
        return truth_from_boxes(
            points,
            [_oriented_box(box) for box in boxes if box.kind != REGION],
            self.moving,
            annotated,
        )


def _split(path: Path) -> tuple[Path, str | None] | None:
    """The folder ``training`` that a path refers to, and the sequence number if the
    path names one.
    """
    candidates: list[tuple[Path, str | None]]
    if has_files(path, "*.bin"):
        candidates = [(path.parent.parent, path.name)]
    else:
        number = None if path.name == "velodyne" else path.name
        candidates = [(path, None), (path / "training", None), (path.parent, number)]
    for split, number in candidates:
        if (split / "oxts").is_dir() and (split / "velodyne" / (number or "")).is_dir():
            return split, number
    return None


def _by_frame(boxes: Iterable[TrackBox]) -> dict[int, list[TrackBox]]:
    groups = defaultdict(list)
    for box in boxes:
        groups[box.frame].append(box)
    return dict(groups)


def _moving(boxes: Iterable[TrackBox], T_world_camera: F64) -> frozenset[int]:
    """Moving tracks, with the numbers of ``Scan.instances``."""
    return moving_tracks(
        (
            box.track + 1,
            box.frame * SWEEP_PERIOD,
            geometry.apply(T_world_camera[box.frame], np.array([box.bottom]))[0],
        )
        for box in boxes
        if box.kind != REGION and 0 <= box.frame < len(T_world_camera)
    )


def _oriented_box(box: TrackBox) -> OrientedBox:
    """A box in the camera frame, whose y axis points down."""
    height, width, length = box.size
    c = np.cos(box.yaw)
    s = np.sin(box.yaw)
    T_camera_box = np.eye(4)
    T_camera_box[:3] = np.column_stack([(c, 0, -s), (s, 0, c), (0, -1, 0), box.bottom])
    class_id = CATEGORIES.index(box.kind) if box.kind in CATEGORIES else 0
    return OrientedBox(box.track + 1, class_id, T_camera_box, (length, width, height))

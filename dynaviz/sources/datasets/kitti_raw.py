"""KITTI raw (Geiger et al. 2013).

HDL-64E sweeps, GPS poses, and for some drives boxes in the view of camera 2.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, Self

import numpy as np

from dynaviz.arrays import F64
from dynaviz.contracts.scan import Scan
from dynaviz.contracts.sensors import Sensor, load_sensor
from dynaviz.errors import DataError
from dynaviz.io.atomic import open_file
from dynaviz.io.kitti import (
    Tracklet,
    calib_matrix,
    calib_transform,
    read_calib,
    read_oxts,
    read_tracklets,
)
from dynaviz.io.velodyne import read_velodyne
from dynaviz.sources.datasets.box_labels import (
    OrientedBox,
    moving_tracks,
    track_facts,
    truth_from_boxes,
)
from dynaviz.sources.datasets.files import VelodyneSweeps, has_files, numbered_files, only
from dynaviz.sources.datasets.kitti_tracking import CATEGORIES, CLASS_NAMES, SWEEP_PERIOD, Camera
from dynaviz.sources.datasets.truth import scan_fields
from dynaviz.spatial import geometry

_CALIB_HINT = "Download the calibration of that day into DATE/calib_*.txt, next to its drives"
_TIME_HINT = "Each line is a time such as 2011-09-26 13:02:25.594360375"


@dataclass(frozen=True)
class KittiRawSequence(VelodyneSweeps):
    """A drive of KITTI raw. The world frame is the sensor frame at the first record.

    X forward, y left, z up.

    Poses come from the GPS and inertial unit. If there is a ``tracklet_labels.xml``, points in the
    box of a moving track are dynamic, other points in the image of camera 2 are static, and all
    others are unlabelled.
    """

    layout: ClassVar[str] = (
        "DATE/{calib_imu_to_velo.txt, DATE_drive_0001_sync/{velodyne_points/data/*.bin, oxts/data}}"
    )

    drive: Path
    sensor: Sensor
    scans: dict[int, Path]
    poses: dict[int, F64]
    scan_stamps: dict[int, int]
    camera: Camera | None
    boxes: dict[int, list[OrientedBox]]
    moving: frozenset[int]

    @classmethod
    def matches(cls, path: Path) -> bool:
        """Whether a path is a drive, its folder of sweeps, or a folder of drives or days."""
        return bool(_drives(path))

    @classmethod
    def open(cls, path: Path) -> Self:
        """Open a drive.

        Raises:
            DataError: if sweeps, poses or calibration are missing, or there are several drives.
        """
        found = _drives(path)
        drive = only(
            found[0].parent if found else path, "drives", {drive.name: drive for drive in found}
        )
        scans = numbered_files(drive / "velodyne_points/data", ".bin")
        records = numbered_files(drive / "oxts/data", ".txt")
        if missing := sorted(scans.keys() - records.keys()):
            problem = f"no record for the sweep of frame {missing[0]}"
            raise DataError(drive / "oxts/data", problem, hint="Copy the folder again")
        T_sensor_imu = _transform(drive.parent / "calib_imu_to_velo.txt")
        poses = geometry.compose(read_oxts(*records.values()), geometry.inverse(T_sensor_imu))
        poses = geometry.compose(geometry.inverse(poses[0]), poses)
        by_frame = dict(zip(records, poses, strict=True))
        stamps = _stamps(drive / "velodyne_points/timestamps.txt", scans)
        tracklets = drive / "tracklet_labels.xml"
        if not tracklets.is_file():
            return cls(drive, load_sensor("hdl64e"), scans, by_frame, stamps, None, {}, frozenset())
        boxes = _boxes(read_tracklets(tracklets))
        moving = moving_tracks(
            (
                box.track,
                frame * SWEEP_PERIOD,
                geometry.compose(by_frame[frame], box.T_frame_box)[:3, 3],
            )
            for frame in sorted(boxes.keys() & by_frame.keys())
            for box in boxes[frame]
        )
        return cls(
            drive,
            load_sensor("hdl64e"),
            scans,
            by_frame,
            stamps,
            _camera(drive.parent),
            boxes,
            moving,
        )

    @property
    def name(self) -> str:
        """Format, date and drive, such as ``kitti_raw_2011_09_26_drive_0001``."""
        return f"kitti_raw_{self.drive.name.removesuffix('_sync')}"

    @property
    def has_labels(self) -> bool:
        """Whether there are tracklets."""
        return self.camera is not None

    @property
    def facts(self) -> dict[str, str]:
        """Number of objects with boxes."""
        return track_facts(
            {box.track for boxes in self.boxes.values() for box in boxes}, self.moving
        )

    def __getitem__(self, position: int) -> Scan:
        index = self.index_of(position)
        xyz = read_velodyne(self.scans[index])[:, :3].astype(np.float64)
        T_world_sensor = self.poses[index]
        truth = None
        if self.camera is not None:
            in_image, _, _ = self.camera.project(geometry.apply(self.camera.T_camera_sensor, xyz))
            truth = truth_from_boxes(xyz, self.boxes.get(index, []), self.moving, in_image)
        return Scan(
            index=index,
            points=geometry.transform(T_world_sensor, xyz),
            T_world_sensor=T_world_sensor,
            stamp_ns=self.scan_stamps.get(index),
            **scan_fields(truth, CLASS_NAMES),
        )


def _drives(path: Path) -> list[Path]:
    """The drives that a path may refer to."""
    for drive in (path, path.parent, path.parent.parent):
        sweeps = drive / "velodyne_points/data"
        if path in (drive, sweeps.parent, sweeps) and has_files(sweeps, "*.bin"):
            return [drive]
    found = [
        *path.glob("*_drive_*/velodyne_points/data"),
        *path.glob("*/*_drive_*/velodyne_points/data"),
    ]
    return sorted(sweeps.parent.parent for sweeps in found if has_files(sweeps, "*.bin"))


def _transform(path: Path) -> F64:
    """(4, 4) float64, metres: the transform in a calibration file with the lines R and T."""
    try:
        rows = read_calib(path)
    except DataError as error:
        raise DataError(path, error.problem, at=error.at, hint=_CALIB_HINT) from None
    T = calib_transform(path, rows, "R")
    if "T" not in rows or rows["T"].shape != (3,) or not np.isfinite(rows["T"]).all():
        raise DataError(path, "line T with 3 numbers is missing", hint=_CALIB_HINT)
    T[:3, 3] = rows["T"]
    return T


def _camera(day: Path) -> Camera:
    """Camera 2 from the calibration of a day."""
    path = day / "calib_cam_to_cam.txt"
    rows = read_calib(path)
    T_camera_sensor = geometry.compose(
        calib_transform(path, rows, "R_rect_00"), _transform(day / "calib_velo_to_cam.txt")
    )
    if "S_rect_02" not in rows or rows["S_rect_02"].shape != (2,):
        raise DataError(path, "line S_rect_02 with 2 numbers is missing", hint=_CALIB_HINT)
    width, height = rows["S_rect_02"].tolist()
    return Camera(T_camera_sensor, calib_matrix(path, rows, "P_rect_02"), (width, height))


def _stamps(path: Path, scans: dict[int, Path]) -> dict[int, int]:
    """Stamps by frame in nanoseconds; empty without the file.

    The file has a line per frame, or a line per sweep if sweeps are missing.
    """
    if not path.is_file():
        return {}
    with open_file(path, _TIME_HINT) as file:
        lines = file.read().decode("latin-1").split("\n")
    lines = lines[: len(lines) - 1 if not lines[-1].strip() else None]
    if len(lines) <= max(scans) and len(lines) != len(scans):
        problem = f"has only {len(lines)} lines, but there is a sweep {max(scans)}"
        raise DataError(path, problem, hint="Each sweep needs a line. Copy the file again")
    frames = range(len(lines)) if len(lines) > max(scans) else scans
    return {
        frame: _time(path, n, line)
        for n, (frame, line) in enumerate(zip(frames, lines, strict=True), 1)
        if line.strip()
    }


def _time(path: Path, number: int, line: str) -> int:
    try:
        return int(np.datetime64(line.strip(), "ns").astype(np.int64))
    except ValueError:
        raise DataError(path, "not a valid time", at=f"line {number}", hint=_TIME_HINT) from None


def _boxes(tracklets: list[Tracklet]) -> dict[int, list[OrientedBox]]:
    """Boxes by frame, in the sensor frame."""
    boxes: dict[int, list[OrientedBox]] = {}
    for track, tracklet in enumerate(tracklets, 1):
        kind = tracklet.kind.partition(" ")[0]  # "Person (sitting)" is Person
        class_id = CATEGORIES.index(kind) if kind in CATEGORIES else 0
        height, width, length = tracklet.size
        for frame, (x, y, z, yaw) in enumerate(tracklet.poses, tracklet.first):
            T_sensor_box = geometry.pose((x, y, z), (np.cos(yaw / 2), 0, 0, np.sin(yaw / 2)))
            boxes.setdefault(frame, []).append(
                OrientedBox(track, class_id, T_sensor_box, (length, width, height))
            )
    return boxes

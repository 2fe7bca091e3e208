"""KITTI odometry (Geiger et al. 2012): HDL-64E sweeps and poses of camera 0."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Self

from dynaviz.arrays import F32, F64
from dynaviz.contracts.scan import Scan
from dynaviz.contracts.sensors import Sensor, load_sensor
from dynaviz.errors import DataError
from dynaviz.io.kitti import calib_transform, read_calib
from dynaviz.io.poses import read_kitti_poses
from dynaviz.io.text import read_table
from dynaviz.io.velodyne import read_velodyne
from dynaviz.sources.datasets.files import VelodyneSweeps, has_files, numbered_files, only
from dynaviz.spatial import geometry


@dataclass(frozen=True)
class KittiOdometrySequence(VelodyneSweeps):
    """A sequence of KITTI odometry, which has no ground truth.

    The world frame is the sensor frame at the first pose: x forward, y left, z up. Camera poses are
    converted to sensor poses with the calibration ``Tr``. They are read from ``poses/NN.txt`` next
    to ``sequences``, or from ``poses.txt`` in the sequence.
    """

    layout: ClassVar[str] = "sequences/NN/{velodyne/*.bin, calib.txt}, poses/NN.txt"
    title: ClassVar[str] = "kitti_odometry"

    folder: Path
    sensor: Sensor
    scans: dict[int, Path]
    poses: F64
    times: F64 | None

    @staticmethod
    def pose_file(folder: Path) -> Path:
        """The pose file of the sequence in a folder."""
        shared = folder.parent.parent / "poses" / f"{folder.name}.txt"
        return shared if shared.is_file() else folder / "poses.txt"

    @classmethod
    def matches(cls, path: Path) -> bool:
        """Whether a path is a sequence with ``poses/NN.txt``, its ``velodyne`` folder, or the
        parent of ``sequences/``.

        Sequences with their own ``poses.txt`` are SemanticKITTI and do not match.
        """
        return any(
            cls.pose_file(folder).is_file() and not (folder / "poses.txt").is_file()
            for folder in find_sequences(path)
        )

    @classmethod
    def open(cls, path: Path) -> Self:
        """Open a sequence.

        Raises:
            DataError: if sweeps, poses or calibration are missing or inconsistent.
        """
        found = find_sequences(path)
        folder = (
            only(found[0].parent, "sequences", {folder.name: folder for folder in found})
            if found
            else path
        )
        scans = numbered_files(folder / "velodyne", ".bin")
        calib = folder / "calib.txt"
        pose_file = cls.pose_file(folder)
        T_camera_sensor = calib_transform(calib, read_calib(calib), "Tr", "Tr_velo_to_cam")
        T_world_camera = geometry.compose(
            geometry.inverse(T_camera_sensor), read_kitti_poses(pose_file)
        )
        poses = geometry.compose(T_world_camera, T_camera_sensor)
        time_file = folder / "times.txt"
        times = (
            read_table(time_file, 1, "Each line is a time in seconds")[:, 0]
            if time_file.is_file()
            else None
        )
        for source, rows in ((pose_file, poses), (time_file, times)):
            if rows is not None and len(rows) <= max(scans):
                problem = f"has only {len(rows)} lines, but there is a sweep {max(scans):06d}.bin"
                raise DataError(
                    source, problem, hint="Each sweep needs a line. Copy the file again"
                )
        return cls(folder, load_sensor("hdl64e"), scans, poses, times)

    @property
    def name(self) -> str:
        """Format and sequence number, such as ``kitti_odometry_08``."""
        return f"{self.title}_{self.folder.name}"

    @property
    def has_labels(self) -> bool:
        """False: the data set has no labels."""
        return False

    def __getitem__(self, position: int) -> Scan:
        index = self.index_of(position)
        xyz = self.sweep(index)
        T_world_sensor = self.poses[index]
        return Scan(
            index=index,
            points=geometry.transform(T_world_sensor, xyz),
            T_world_sensor=T_world_sensor,
            stamp_ns=None if self.times is None else round(self.times[index] * 1e9),
            **self.truth(index, xyz),
        )

    def sweep(self, index: int) -> F32:
        """Points of a frame: (N, 3) float32, metres, sensor frame."""
        return read_velodyne(self.scans[index])[:, :3]

    def truth(self, index: int, xyz: F32) -> dict[str, Any]:
        """Ground truth of a frame as keyword arguments of ``Scan``; here, none."""
        return {}


def find_sequences(path: Path) -> list[Path]:
    """The sequence folders that a path may refer to."""
    for folder in (path, path.parent if path.name == "velodyne" else path):
        if has_files(folder / "velodyne", "*.bin"):
            return [folder]
    root = path if path.name == "sequences" else path / "sequences"
    return sorted(folder for folder in root.glob("*") if has_files(folder / "velodyne", "*.bin"))

"""KITTI odometry (Geiger et al. 2012): HDL-64E sweeps and poses of camera 0."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Self

from dynaviz.arrays import F32, F64
from dynaviz.datasets.files import holds, numbered, only
from dynaviz.errors import DataError
from dynaviz.io.calib import calib_transform, read_calib
from dynaviz.io.poses import read_kitti_poses
from dynaviz.io.text import read_table
from dynaviz.io.velodyne import read_velodyne
from dynaviz.scan import Scan
from dynaviz.sensors import Sensor, load_sensor
from dynaviz.spatial import geometry


@dataclass(frozen=True)
class KittiOdometrySequence:
    """A sequence of KITTI odometry, which has no ground truth.

    The world is the sensor's frame at the start: x forward, y left, z up. Poses of the camera become poses of the
    sensor by the calibration ``Tr``. They are read from ``poses/NN.txt`` beside ``sequences``, or from ``poses.txt`` in
    the sequence.
    """

    layout: ClassVar[str] = "sequences/NN/{velodyne/*.bin, calib.txt}, poses/NN.txt"
    title: ClassVar[str] = "kitti_odometry"

    folder: Path
    sensor: Sensor
    scans: dict[int, Path]
    poses: F64
    times: F64 | None

    @staticmethod
    def trajectory(folder: Path) -> Path:
        """The file of poses of the sequence in a folder."""
        beside = folder.parent.parent / "poses" / f"{folder.name}.txt"
        return beside if beside.is_file() else folder / "poses.txt"

    @classmethod
    def matches(cls, path: Path) -> bool:
        """Whether a path is a sequence with ``poses/NN.txt``, its ``velodyne`` folder, or what holds ``sequences/``.

        Not where a sequence has a ``poses.txt`` of its own, as in SemanticKITTI.
        """
        return any(
            cls.trajectory(folder).is_file() and not (folder / "poses.txt").is_file() for folder in sequences_of(path)
        )

    @classmethod
    def open(cls, path: Path) -> Self:
        """Open a sequence.

        Raises:
            DataError: where sweeps, poses or calibration are missing or do not fit together.
        """
        found = sequences_of(path)
        folder = only(found[0].parent, "sequences", {folder.name: folder for folder in found}) if found else path
        scans = cls.chosen(folder, numbered(folder / "velodyne", ".bin"))
        calib, file = folder / "calib.txt", cls.trajectory(folder)
        T_camera_sensor = calib_transform(calib, read_calib(calib), "Tr", "Tr_velo_to_cam")
        T_world_camera = geometry.compose(geometry.inverse(T_camera_sensor), read_kitti_poses(file))
        poses = geometry.compose(T_world_camera, T_camera_sensor)
        clock = folder / "times.txt"
        times = read_table(clock, 1, "A line is a time in seconds")[:, 0] if clock.is_file() else None
        for source, rows in ((file, poses), (clock, times)):
            if rows is not None and len(rows) <= max(scans):
                problem = f"has {len(rows)} lines, but there is a sweep {max(scans):06d}.bin"
                raise DataError(source, problem, hint="Each sweep needs a line; copy the file again")
        return cls(folder, load_sensor("hdl64e"), scans, poses, times)

    @classmethod
    def chosen(cls, folder: Path, scans: dict[int, Path]) -> dict[int, Path]:
        """The sweeps that make the sequence: all."""
        return scans

    @property
    def name(self) -> str:
        """As in ``kitti_odometry_08``."""
        return f"{self.title}_{self.folder.name}"

    @property
    def has_labels(self) -> bool:
        """There are none."""
        return False

    def __len__(self) -> int:
        return len(self.scans)

    def __getitem__(self, position: int) -> Scan:
        index = list(self.scans)[position]
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
        """(N, 3) float32, metres, sensor frame: the points of a frame."""
        return read_velodyne(self.scans[index])[:, :3]

    def truth(self, index: int, xyz: F32) -> dict[str, Any]:
        """What is known of the points of a frame, as fields of a ``Scan``: nothing."""
        return {}


def sequences_of(path: Path) -> list[Path]:
    """The folders of sequences that a path may mean."""
    for folder in (path, path.parent if path.name == "velodyne" else path):
        if holds(folder / "velodyne", "*.bin"):
            return [folder]
    root = path if path.name == "sequences" else path / "sequences"
    return sorted(folder for folder in root.glob("*") if holds(folder / "velodyne", "*.bin"))

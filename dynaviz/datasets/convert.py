"""Any readable sequence in the public benchmark's layout, frame by frame."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dynaviz.arrays import F64, U8
from dynaviz.errors import UsageError
from dynaviz.io.benchmark import BenchmarkWriter
from dynaviz.scan import Label, Scan, Sequence, stream
from dynaviz.sensors import Sensor, sensor_names
from dynaviz.spatial import geometry

SAME = 1e-4  # metres within which a ray starts at a lidar's mount


@dataclass
class Conversion:
    """What came of a conversion.

    Attributes:
        folder: where it is.
        frames, points: how many.
        unlabelled: points without a label in a sequence that has labels.
        moved_rays: points whose ray started elsewhere than the layout can tell.
        pose_error: the largest difference between an entry of a pose and of the pose that is read back; metres for
            positions.
        exact: all poses, and the places where rays start, are read back bit for bit, and with them the digest of the
            sequence.
    """

    folder: Path
    frames: int = 0
    points: int = 0
    unlabelled: int = 0
    moved_rays: int = 0
    pose_error: float = 0.0
    exact: bool = True

    def remarks(self) -> list[str]:
        """What a user should know before using it; a line each."""
        said = []
        if self.unlabelled:
            said.append(
                f"{self.unlabelled:,} of {self.points:,} points are unlabelled: 255 in gt_cloud.pcd. dynaviz "
                "leaves them out of every count; public tools take all but 0 for dynamic"
            )
        if self.moved_rays:
            said.append(
                f"the rays of {self.moved_rays:,} points started elsewhere than at the sensor's position, which the "
                "layout cannot tell; methods that trace rays answer a little differently"
            )
        if self.pose_error > 1e-6:
            said.append(
                f"poses are no pure rotations and shifts: those read back differ by up to {self.pose_error:.1g}"
            )
        return said


def convert(
    sequence: Sequence,
    out: str | os.PathLike[str],
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Conversion:
    """Write a sequence in the public benchmark's layout (``dynaviz.io.benchmark``), one frame in memory at a time.

    Args:
        sequence: any; its frames keep their numbers.
        out: the folder to make; it must not exist yet, and appears whole or not at all.
        progress: told how many of how many frames are done.

    Raises:
        DataError: where ``out`` exists or cannot be written, or the sequence cannot be read.
        UsageError: for frames whose numbers do not grow, for the layout orders them by their numbers.
    """
    done = Conversion(Path(out))
    names: dict[int, str] = {}
    indices: list[int] = []
    stamps: list[int | None] = []
    with BenchmarkWriter(out) as writer:
        for scan in stream(sequence):
            if indices and scan.index <= indices[-1]:
                raise UsageError(
                    f"{sequence.name}: frame {scan.index} comes after {indices[-1]}. Give --frames in order"
                )
            lidar = _lidar(scan, sequence.sensor)
            writer.append(scan.index, scan.points, scan.T_world_sensor, lidar=lidar)
            if sequence.has_labels:
                labels = scan.labels
                if labels is None:
                    labels = np.full(len(scan), Label.UNLABELLED, np.uint8)
                writer.append_truth(scan.points, labels, scan.classes, scan.instances)
                done.unlabelled += int((labels == Label.UNLABELLED).sum())
            _note(done, scan, lidar)
            names.update(scan.class_names)
            indices.append(scan.index)
            stamps.append(scan.stamp_ns)
            progress(len(indices), len(sequence))
        sensor = sequence.sensor.name if sequence.sensor.name in sensor_names() else None
        facts = {"name": sequence.name, "sensor": sensor, "frames": len(indices), "rate": _rate(indices, stamps)}
        writer.describe(facts, dict(sorted(names.items())))
    return done


def _note(done: Conversion, scan: Scan, lidar: U8 | None) -> None:
    """Count a scan, and compare what is read back with what was."""
    done.frames += 1
    done.points += len(scan)
    T = scan.T_world_sensor
    back = geometry.pose(T[:3, 3], geometry.quaternion(T[:3, :3]))
    done.pose_error = max(done.pose_error, float(np.abs(back - T).max()))
    done.exact &= back.tobytes() == T.tobytes()
    if lidar is None:
        away = np.abs(scan.origins - scan.position).max(1) > SAME
        done.moved_rays += len(scan) if len(scan.origins) == 1 and away[0] else int(away.sum())
    done.exact &= lidar is None and scan.origins.tobytes() == scan.position.tobytes()


def _lidar(scan: Scan, sensor: Sensor) -> U8 | None:
    """(N,) uint8, from which of the sensor's mounts each ray starts; None where they do not."""
    if len(scan.origins) == 1 or not sensor.mounts:
        return None
    mounts = geometry.apply(scan.T_world_sensor, np.array([mount[:3] for mount in sensor.mounts], np.float64))
    far: F64 = np.stack([np.abs(scan.origins - mount).max(1) for mount in mounts], axis=1)
    return far.argmin(1).astype(np.uint8) if (far.min(1) < SAME).all() else None


def _rate(indices: list[int], stamps: list[int | None]) -> float | None:
    """Sweeps a second by the first and the last stamp; None without."""
    if len(indices) < 2 or stamps[0] is None or stamps[-1] is None or stamps[-1] <= stamps[0]:
        return None
    return float(f"{(indices[-1] - indices[0]) / (stamps[-1] - stamps[0]) * 1e9:.9g}")

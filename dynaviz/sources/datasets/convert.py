"""Convert any sequence to the layout of the public benchmark."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dynaviz.arrays import F64, U8
from dynaviz.contracts.scan import Label, Scan, Sequence, stream
from dynaviz.contracts.sensors import Sensor, sensor_names
from dynaviz.errors import UsageError
from dynaviz.io.benchmark import BenchmarkWriter
from dynaviz.spatial import geometry

MOUNT_TOLERANCE = 1e-4  # metres between the origin of a ray and the mount of its lidar


@dataclass
class Conversion:
    """Summary of a conversion.

    Attributes:
        folder: the written folder.
        frames, points: number of frames and points.
        unlabelled: points without a label in a sequence that has labels.
        moved_rays: points whose ray origin the layout cannot store.
        pose_error: largest absolute difference between an entry of a pose and of the pose read
            back; metres for positions.
        exact: all poses and ray origins, and hence the digest of the sequence, are read back bit
            for bit.
    """

    folder: Path
    frames: int = 0
    points: int = 0
    unlabelled: int = 0
    moved_rays: int = 0
    pose_error: float = 0.0
    exact: bool = True

    def remarks(self) -> list[str]:
        """Warnings about information that the copy lacks, one line each."""
        remarks = []
        if self.unlabelled:
            remarks.append(
                f"{self.unlabelled:,} of {self.points:,} points are unlabelled (255 in "
                "gt_cloud.pcd). dynaviz "
                "does not count them; the benchmark's own tools treat every value except 0 as "
                "dynamic"
            )
        if self.moved_rays:
            remarks.append(
                f"the rays of {self.moved_rays:,} points do not start at the sensor position, "
                "which the layout cannot "
                "store; results of methods that cast rays differ slightly"
            )
        if self.pose_error > 1e-6:
            remarks.append(
                "the poses are not exactly rigid: the poses read back differ by up to "
                f"{self.pose_error:.1g}"
            )
        return remarks


def convert(
    sequence: Sequence,
    out: str | os.PathLike[str],
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Conversion:
    """Write a sequence in the layout of the public benchmark (``dynaviz.io.benchmark``), one frame
    in memory at a time.

    Args:
        sequence: any sequence; frames keep their numbers.
        out: folder to create; it must not exist yet, and is written atomically.
        progress: called with the number of frames done and the total.

    Raises:
        DataError: if ``out`` exists or cannot be written, or the sequence cannot be read.
        UsageError: if frame numbers do not increase, because the layout orders frames by number.
    """
    done = Conversion(Path(out))
    names: dict[int, str] = {}
    indices: list[int] = []
    stamps: list[int | None] = []
    with BenchmarkWriter(out) as writer:
        for scan in stream(sequence):
            if indices and scan.index <= indices[-1]:
                raise UsageError(
                    f"{sequence.name}: frame {scan.index} comes after {indices[-1]}. Give --frames "
                    "in increasing order"
                )
            lidar = _lidar(scan, sequence.sensor)
            writer.append(scan.index, scan.points, scan.T_world_sensor, lidar=lidar)
            if sequence.has_labels:
                labels = scan.labels
                if labels is None:
                    labels = np.full(len(scan), Label.UNLABELLED, np.uint8)
                writer.append_truth(scan.points, labels, scan.classes, scan.instances)
                done.unlabelled += int((labels == Label.UNLABELLED).sum())
            _update(done, scan, lidar)
            names.update(scan.class_names)
            indices.append(scan.index)
            stamps.append(scan.stamp_ns)
            progress(len(indices), len(sequence))
        sensor = sequence.sensor.name if sequence.sensor.name in sensor_names() else None
        facts = {
            "name": sequence.name,
            "sensor": sensor,
            "frames": len(indices),
            "rate": _rate(indices, stamps),
        }
        writer.describe(facts, dict(sorted(names.items())))
    return done


def _update(done: Conversion, scan: Scan, lidar: U8 | None) -> None:
    """Add a scan to the summary, and compare its pose and origins with what will be read back."""
    done.frames += 1
    done.points += len(scan)
    T = scan.T_world_sensor
    read_back = geometry.pose(T[:3, 3], geometry.quaternion(T[:3, :3]))
    done.pose_error = max(done.pose_error, float(np.abs(read_back - T).max()))
    done.exact &= read_back.tobytes() == T.tobytes()
    if lidar is None:
        moved = np.abs(scan.origins - scan.position).max(1) > MOUNT_TOLERANCE
        done.moved_rays += len(scan) if len(scan.origins) == 1 and moved[0] else int(moved.sum())
    done.exact &= lidar is None and scan.origins.tobytes() == scan.position.tobytes()


def _lidar(scan: Scan, sensor: Sensor) -> U8 | None:
    """(N,) uint8, the sensor mount at which each ray starts; None if any ray starts elsewhere."""
    if len(scan.origins) == 1 or not sensor.mounts:
        return None
    mounts = geometry.apply(
        scan.T_world_sensor, np.array([mount[:3] for mount in sensor.mounts], np.float64)
    )
    distances: F64 = np.stack([np.abs(scan.origins - mount).max(1) for mount in mounts], axis=1)
    return (
        distances.argmin(1).astype(np.uint8) if (distances.min(1) < MOUNT_TOLERANCE).all() else None
    )


def _rate(indices: list[int], stamps: list[int | None]) -> float | None:
    """Sweeps per second from the first and last stamp; None without stamps."""
    if len(indices) < 2 or stamps[0] is None or stamps[-1] is None or stamps[-1] <= stamps[0]:
        return None
    return float(f"{(indices[-1] - indices[0]) / (stamps[-1] - stamps[0]) * 1e9:.9g}")

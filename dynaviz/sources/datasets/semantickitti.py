"""SemanticKITTI (Behley et al. 2019).

KITTI odometry sweeps, poses from SLAM, a class and instance for each point.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from dynaviz.arrays import F32, U8
from dynaviz.contracts.scan import Label
from dynaviz.io.semantic_label import read_semantic_labels
from dynaviz.sources.datasets.files import has_files
from dynaviz.sources.datasets.kitti_odometry import KittiOdometrySequence, find_sequences

# any, car, bicyclist, person, motorcyclist, on rails, bus, truck, other vehicle
MOVING_CLASSES = range(251, 260)
UNLABELLED_CLASSES = (0, 1)  # unlabelled, outlier; static, as in the public benchmark
CLASS_NAMES = {
    0: "unlabelled", 1: "outlier", 9: "static", 10: "car", 11: "bicycle", 13: "bus",
    15: "motorcycle", 16: "on rails",
    18: "truck", 20: "other "
    "vehicle", 30: "person", 31: "bicyclist", 32: "motorcyclist", 40: "road", 44: "parking",
    48: "sidewalk", 49: "other ground", 50: "building", 51: "fence", 52: "other "
    "structure", 60: "lane marking",
    70: "vegetation", 71: "trunk", 72: "terrain", 80: "pole", 81: "traffic "
    "sign", 99: "other object", 251: "moving",
    252: "moving car", 253: "moving bicyclist", 254: "moving person", 255: "moving motorcyclist",
    256: "moving on rails", 257: "moving bus", 258: "moving truck", 259: "moving other vehicle",
}  # fmt: skip
# metres; unlabelled points within it are the recording car: dynamic, as in the public benchmark
EGO_RADIUS = 3.0


@dataclass(frozen=True)
class SemanticKittiSequence(KittiOdometrySequence):
    """A sequence of SemanticKITTI. The world frame is the sensor frame at the first pose.

    X forward, y left, z up.

    Frames without a label file are unlabelled. Unlabelled and outlier points within 3 m belong to
    the recording car and count as dynamic, as in the public benchmark.
    """

    layout: ClassVar[str] = "velodyne/*.bin, calib.txt, poses.txt, labels/*.label"
    title: ClassVar[str] = "semantickitti"

    @staticmethod
    def pose_file(folder: Path) -> Path:
        """The pose file of the sequence in a folder."""
        return folder / "poses.txt"

    @classmethod
    def matches(cls, path: Path) -> bool:
        """Whether a path is a sequence, its ``velodyne`` folder, or the parent of
        ``sequences/``.
        """
        return any(cls.pose_file(folder).is_file() for folder in find_sequences(path))

    @cached_property
    def has_labels(self) -> bool:
        """Whether any frame has a label file."""
        return has_files(self.folder / "labels", "*.label")

    def truth(self, index: int, xyz: F32) -> dict[str, Any]:
        """Labels, classes and instances of a frame as keyword arguments of ``Scan``."""
        file = self.folder / "labels" / f"{self.scans[index].stem}.label"
        if file.is_file():
            classes, instances = read_semantic_labels(file, len(xyz))
            labels = _labels(classes, xyz)
            fields = {"labels": labels, "classes": classes, "instances": instances.astype(np.int32)}
        else:
            fields = (
                {"labels": np.full(len(xyz), Label.UNLABELLED, np.uint8)} if self.has_labels else {}
            )
        return {**fields, "class_names": CLASS_NAMES}


def _labels(classes: np.ndarray[tuple[int], np.dtype[np.uint16]], xyz: F32) -> U8:
    """Labels of points in the sensor frame, from their classes."""
    x, y, z = xyz.astype(np.float64).T
    near = x**2 + y**2 + z**2 < EGO_RADIUS**2
    moving = (classes >= MOVING_CLASSES.start) & (classes < MOVING_CLASSES.stop)
    ego = near & np.isin(classes, UNLABELLED_CLASSES)
    return np.where(moving | ego, Label.DYNAMIC, Label.STATIC).astype(np.uint8)

"""SemanticKITTI (Behley et al. 2019): KITTI odometry sweeps, poses from SLAM, a class and instance for each point."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from dynaviz.arrays import F32, F64, U8, Bool
from dynaviz.contracts.attributes import Attributes
from dynaviz.contracts.scan import Label, Scan
from dynaviz.errors import DataError
from dynaviz.io.semantic_label import read_semantic_labels
from dynaviz.sources.datasets.files import has_files
from dynaviz.sources.datasets.kitti_odometry import KittiOdometrySequence, find_sequences
from dynaviz.spatial import geometry

MOVING_CLASSES = range(251, 260)  # any, car, bicyclist, person, motorcyclist, on rails, bus, truck, other vehicle
UNLABELLED_CLASSES = (0, 1)  # unlabelled, outlier; static, as in the public benchmark
CLASS_NAMES = {
    0: "unlabelled", 1: "outlier", 9: "static", 10: "car", 11: "bicycle", 13: "bus", 15: "motorcycle", 16: "on rails",
    18: "truck", 20: "other vehicle", 30: "person", 31: "bicyclist", 32: "motorcyclist", 40: "road", 44: "parking",
    48: "sidewalk", 49: "other ground", 50: "building", 51: "fence", 52: "other structure", 60: "lane marking",
    70: "vegetation", 71: "trunk", 72: "terrain", 80: "pole", 81: "traffic sign", 99: "other object", 251: "moving",
    252: "moving car", 253: "moving bicyclist", 254: "moving person", 255: "moving motorcyclist",
    256: "moving on rails", 257: "moving bus", 258: "moving truck", 259: "moving other vehicle",
}  # fmt: skip
EGO_RADIUS = 3.0  # metres; unlabelled points within it are the recording car: dynamic, as in the public benchmark

PAPER_FRAMES = {  # first and last frame of each sequence in the papers on the public benchmark
    "00": (4390, 4530), "01": (150, 250), "02": (860, 950), "05": (2350, 2670), "07": (630, 820), "19": (150, 512),
}  # fmt: skip
CROP_RADIUS = 50.0  # metres; labels are sparse beyond, and the benchmark's current extractor drops the points


@dataclass(frozen=True)
class SemanticKittiSequence(KittiOdometrySequence):
    """A sequence of SemanticKITTI. The world frame is the sensor frame at the first pose: x forward, y left, z up.

    Frames without a label file are unlabelled. Unlabelled and outlier points within 3 m belong to the recording car and
    count as dynamic, as in the public benchmark. ``semantickitti_paper:PATH/00`` selects the frames of the papers,
    ``semantickitti_50m:PATH/00`` drops points beyond 50 m.
    """

    layout: ClassVar[str] = "velodyne/*.bin, calib.txt, poses.txt, labels/*.label"
    title: ClassVar[str] = "semantickitti"

    @staticmethod
    def pose_file(folder: Path) -> Path:
        """The pose file of the sequence in a folder."""
        return folder / "poses.txt"

    @classmethod
    def matches(cls, path: Path) -> bool:
        """Whether a path is a sequence, its ``velodyne`` folder, or the parent of ``sequences/``."""
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
            fields = {"labels": np.full(len(xyz), Label.UNLABELLED, np.uint8)} if self.has_labels else {}
        return {**fields, "class_names": CLASS_NAMES}


@dataclass(frozen=True)
class SemanticKittiPaperSequence(SemanticKittiSequence):
    """The frames of SemanticKITTI 00, 01, 02, 05, 07 and 19 that the papers on the benchmark use.

    Sweeps are not cropped, as for the published scores. Opened by name only: ``semantickitti_paper:PATH/00``.
    """

    layout: ClassVar[str] = "selected by name only: the frames of semantickitti used in the papers"

    @classmethod
    def matches(cls, path: Path) -> bool:
        """False: this format is selected by name only."""
        return False

    @classmethod
    def select_sweeps(cls, folder: Path, scans: dict[int, Path]) -> dict[int, Path]:
        """The sweeps used in the papers.

        Raises:
            DataError: if no paper uses the sequence, or a sweep is missing.
        """
        if folder.name not in PAPER_FRAMES:
            problem = f"not used in the papers, which use the sequences {', '.join(PAPER_FRAMES)}"
            raise DataError(folder, problem, hint="Give one of these, or use all frames with semantickitti:PATH")
        first, last = PAPER_FRAMES[folder.name]
        for frame in range(first, last + 1):
            if frame not in scans:
                problem = f"sweep {frame:06d}.bin is missing; the papers use frames {first} to {last}"
                raise DataError(folder / "velodyne", problem, hint="Copy it there, or open semantickitti:PATH")
        return {frame: scans[frame] for frame in range(first, last + 1)}


@dataclass(frozen=True)
class SemanticKitti50mSequence(SemanticKittiSequence):
    """SemanticKITTI without points farther than 50 m from the sensor, as the benchmark's extractor writes since 2024.

    Scores are not comparable to the published ones, which use full sweeps. Opened by name only:
    ``semantickitti_50m:PATH/00``.
    """

    layout: ClassVar[str] = "selected by name only: semantickitti within 50 m"

    @classmethod
    def matches(cls, path: Path) -> bool:
        """False: this format is selected by name only."""
        return False

    @property
    def name(self) -> str:
        """Format, sequence number and range, such as ``semantickitti_08_50m``."""
        return f"{super().name}_50m"

    def __getitem__(self, position: int) -> Scan:
        scan = super().__getitem__(position)
        near = _near(scan)
        fields = {field: getattr(scan, field) for field in ("points", "labels", "classes", "instances")}
        return replace(scan, **{field: array[near] for field, array in fields.items() if array is not None})

    def attributes(self, position: int) -> Attributes:
        """The intensity of the points within the range."""
        near = _near(super().__getitem__(position))
        return {name: array[near] for name, array in super().attributes(position).items()}


def _near(scan: Scan) -> Bool:
    """(N,) bool: which points are within the range."""
    near: Bool = _squared_norms(geometry.apply(geometry.inverse(scan.T_world_sensor), scan.points)) < CROP_RADIUS**2
    return near


def _labels(classes: np.ndarray[tuple[int], np.dtype[np.uint16]], xyz: F32) -> U8:
    """Labels of points in the sensor frame, from their classes."""
    near = _squared_norms(xyz.astype(np.float64)) < EGO_RADIUS**2
    moving = (classes >= MOVING_CLASSES.start) & (classes < MOVING_CLASSES.stop)
    ego = near & np.isin(classes, UNLABELLED_CLASSES)
    return np.where(moving | ego, Label.DYNAMIC, Label.STATIC).astype(np.uint8)


def _squared_norms(xyz: F64) -> F64:
    """(N,) squared lengths of the vectors."""
    squares: F64 = xyz[:, 0] ** 2 + xyz[:, 1] ** 2 + xyz[:, 2] ** 2
    return squares

"""SemanticKITTI (Behley et al. 2019): KITTI odometry sweeps, poses from SLAM, a class and instance for each point."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from dynaviz.arrays import F32, F64, U8
from dynaviz.datasets.files import holds
from dynaviz.datasets.kitti_odometry import KittiOdometrySequence, sequences_of
from dynaviz.errors import DataError
from dynaviz.io.semantic_label import read_semantic_labels
from dynaviz.scan import Label, Scan
from dynaviz.spatial import geometry

MOVING = range(251, 260)  # anything, car, bicyclist, person, motorcyclist, on rails, bus, truck, other vehicle
UNSURE = (0, 1)  # unlabelled, outlier: static as in the public benchmark
CLASS_NAMES = {
    0: "unlabelled", 1: "outlier", 9: "static", 10: "car", 11: "bicycle", 13: "bus", 15: "motorcycle", 16: "on rails",
    18: "truck", 20: "other vehicle", 30: "person", 31: "bicyclist", 32: "motorcyclist", 40: "road", 44: "parking",
    48: "sidewalk", 49: "other ground", 50: "building", 51: "fence", 52: "other structure", 60: "lane marking",
    70: "vegetation", 71: "trunk", 72: "terrain", 80: "pole", 81: "traffic sign", 99: "other object", 251: "moving",
    252: "moving car", 253: "moving bicyclist", 254: "moving person", 255: "moving motorcyclist",
    256: "moving on rails", 257: "moving bus", 258: "moving truck", 259: "moving other vehicle",
}  # fmt: skip
EGO = 3.0  # metres; what is nearer and unsure is the recording car itself, dynamic as in the public benchmark


PAPER = {  # first and last frame of the sequences in the papers on the public benchmark
    "00": (4390, 4530), "01": (150, 250), "02": (860, 950), "05": (2350, 2670), "07": (630, 820), "19": (150, 512),
}  # fmt: skip
CROP = 50.0  # metres; beyond, labels are thin, and the benchmark's present extractor drops points


@dataclass(frozen=True)
class SemanticKittiSequence(KittiOdometrySequence):
    """A sequence of SemanticKITTI. The world is the sensor's frame at the start: x forward, y left, z up.

    Frames without a label file are unlabelled as a whole. Unsure points nearer than 3 m are the recording car itself
    and count as dynamic, as in the public benchmark. ``semantickitti_paper:PATH/00`` takes the frames of the papers,
    ``semantickitti_50m:PATH/00`` drops points beyond 50 m.
    """

    layout: ClassVar[str] = "velodyne/*.bin, calib.txt, poses.txt, labels/*.label"
    title: ClassVar[str] = "semantickitti"

    @staticmethod
    def trajectory(folder: Path) -> Path:
        """The file of poses of the sequence in a folder."""
        return folder / "poses.txt"

    @classmethod
    def matches(cls, path: Path) -> bool:
        """Whether a path is a sequence, its ``velodyne`` folder, or what holds ``sequences/``."""
        return any(cls.trajectory(folder).is_file() for folder in sequences_of(path))

    @cached_property
    def has_labels(self) -> bool:
        """Whether any frame has a label file."""
        return holds(self.folder / "labels", "*.label")

    def truth(self, index: int, xyz: F32) -> dict[str, Any]:
        """Labels, classes and instances of the points of a frame, as fields of a ``Scan``."""
        file = self.folder / "labels" / f"{self.scans[index].stem}.label"
        if file.is_file():
            classes, instances = read_semantic_labels(file, len(xyz))
            labels = _labels(classes, xyz)
            known = {"labels": labels, "classes": classes, "instances": instances.astype(np.int32)}
        else:
            known = {"labels": np.full(len(xyz), Label.UNLABELLED, np.uint8)} if self.has_labels else {}
        return {**known, "class_names": CLASS_NAMES}


@dataclass(frozen=True)
class SemanticKittiPaperSequence(SemanticKittiSequence):
    """The frames of SemanticKITTI 00, 01, 02, 05, 07 and 19 that the benchmark's papers use.

    Sweeps are whole, as where the published scores were computed. Opened by name only: ``semantickitti_paper:PATH/00``.
    """

    layout: ClassVar[str] = "by that name only: the papers' frames of semantickitti"

    @classmethod
    def matches(cls, path: Path) -> bool:
        """Never: a sequence is whole where nobody asks for a part."""
        return False

    @classmethod
    def chosen(cls, folder: Path, scans: dict[int, Path]) -> dict[int, Path]:
        """The sweeps of the papers, which must all be there.

        Raises:
            DataError: for a sequence that is in no paper, or a sweep that is missing.
        """
        if folder.name not in PAPER:
            problem = f"has no frames in the papers, only sequences {', '.join(PAPER)}"
            raise DataError(folder, problem, hint="Give one of those, or all frames with semantickitti:PATH")
        first, last = PAPER[folder.name]
        for frame in range(first, last + 1):
            if frame not in scans:
                problem = f"has no sweep {frame:06d}.bin, but the papers use {first} to {last}"
                raise DataError(folder / "velodyne", problem, hint="Copy it there, or drop _paper")
        return {frame: scans[frame] for frame in range(first, last + 1)}


@dataclass(frozen=True)
class SemanticKitti50mSequence(SemanticKittiSequence):
    """SemanticKITTI without points farther than 50 m from the sensor, as the benchmark's extractor writes since 2024.

    Scores do not compare with those published, which are of whole sweeps. Opened by name only:
    ``semantickitti_50m:PATH/00``.
    """

    layout: ClassVar[str] = "by that name only: semantickitti within 50 m"

    @classmethod
    def matches(cls, path: Path) -> bool:
        """Never: sweeps are whole where nobody asks for less."""
        return False

    @property
    def name(self) -> str:
        """As in ``semantickitti_08_50m``."""
        return f"{super().name}_50m"

    def __getitem__(self, position: int) -> Scan:
        scan = super().__getitem__(position)
        near = _squares(geometry.apply(geometry.inverse(scan.T_world_sensor), scan.points)) < CROP**2
        fields = {field: getattr(scan, field) for field in ("points", "labels", "classes", "instances")}
        return replace(scan, **{field: array[near] for field, array in fields.items() if array is not None})


def _labels(classes: np.ndarray[tuple[int], np.dtype[np.uint16]], xyz: F32) -> U8:
    """Labels of classes and points in the sensor frame."""
    near = _squares(xyz.astype(np.float64)) < EGO**2
    moving = (classes >= MOVING.start) & (classes < MOVING.stop)
    ego = near & np.isin(classes, UNSURE)
    return np.where(moving | ego, Label.DYNAMIC, Label.STATIC).astype(np.uint8)


def _squares(xyz: F64) -> F64:
    """(N,) squared lengths."""
    squares: F64 = xyz[:, 0] ** 2 + xyz[:, 1] ** 2 + xyz[:, 2] ** 2
    return squares

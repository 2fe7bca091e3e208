"""HeLiMOS (Lim et al. 2024).

Moving object segmentation with four different lidars on one car, in KITTI's layout.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np

from dynaviz.arrays import F32
from dynaviz.contracts.scan import Label
from dynaviz.contracts.sensors import load_sensor
from dynaviz.errors import DataError
from dynaviz.io.atomic import open_file
from dynaviz.io.semantic_label import read_semantic_labels
from dynaviz.sources.datasets.files import has_files, only
from dynaviz.sources.datasets.semantickitti import (
    MOVING_CLASSES,
    UNLABELLED_CLASSES,
    SemanticKittiSequence,
)

SENSORS = {"Aeva": "aeries2", "Avia": "avia", "Ouster": "os2_128", "Velodyne": "vlp16"}
"""Folders of a recording, and the sensor of each."""
SPLITS = ("train", "val", "test")
CLASS_NAMES = {0: "unlabelled", 9: "static", 251: "moving"}


@dataclass(frozen=True)
class HelimosSequence(SemanticKittiSequence):
    """One lidar of HeLiMOS: ``Deskewed_LiDAR/Aeva``, ``Avia``, ``Ouster`` or ``Velodyne``.

    Classes 0 and 1 are unlabelled, 251 and above dynamic, all others static. Frames without a label
    file are unlabelled. The world frame is the sensor frame at the first pose.
    """

    layout: ClassVar[str] = (
        "Deskewed_LiDAR/{Aeva, Avia, Ouster, Velodyne}/{velodyne/*.bin, calib.txt, poses.txt}"
    )
    title: ClassVar[str] = "helimos"
    split: ClassVar[str] = ""

    @classmethod
    def matches(cls, path: Path) -> bool:
        """Whether a path is the folder of a lidar next to a list of frames, or the parent of such
        folders.
        """
        return not cls.split and any(
            (folder.parent / f"{split}.txt").is_file()
            for folder in _lidars(path)
            for split in SPLITS
        )

    @classmethod
    def open(cls, path: Path) -> Self:
        """Open the folder of a lidar.

        Raises:
            DataError: if sweeps, poses, calibration or the list of the split are missing or
                inconsistent.
        """
        folder = only(path, "lidars", {folder.name: folder for folder in _lidars(path)})
        if not (folder / "poses.txt").is_file():
            hint = "HeLiMOS's toolbox writes it (helimos_saver): KITTI format, one line per sweep"
            raise DataError(folder / "poses.txt", "does not exist", hint=hint)
        return replace(super().open(folder), sensor=load_sensor(SENSORS[folder.name]))

    @property
    def name(self) -> str:
        """Format, lidar and split, such as ``helimos_ouster_val``."""
        return "_".join(filter(None, (self.title, self.folder.name.lower(), self.split)))

    @cached_property
    def labelled_frames(self) -> frozenset[int] | None:
        """Numbers of the frames in the split; None for all frames.

        Raises:
            DataError: if the list cannot be read or is not a list of frame numbers.
        """
        return _frame_numbers(self.folder.parent / f"{self.split}.txt") if self.split else None

    def truth(self, index: int, xyz: F32) -> dict[str, Any]:
        """Labels and classes of a frame as keyword arguments of ``Scan``.

        All unlabelled outside the split.
        """
        file = self.folder / "labels" / f"{self.scans[index].stem}.label"
        if not file.is_file() or (
            self.labelled_frames is not None and index not in self.labelled_frames
        ):
            return {
                "labels": np.full(len(xyz), Label.UNLABELLED, np.uint8),
                "class_names": CLASS_NAMES,
            }
        classes, _ = read_semantic_labels(file, len(xyz))
        labels = np.where(classes >= MOVING_CLASSES.start, Label.DYNAMIC, Label.STATIC).astype(
            np.uint8
        )
        labels[np.isin(classes, UNLABELLED_CLASSES)] = Label.UNLABELLED
        return {"labels": labels, "classes": classes, "class_names": CLASS_NAMES}


@dataclass(frozen=True)
class HelimosTrainSequence(HelimosSequence):
    """HeLiMOS with the labels of the training frames only; all frames are read.

    Opened by name only.
    """

    layout: ClassVar[str] = "selected by name only: helimos with the labels of train.txt"
    split: ClassVar[str] = "train"


@dataclass(frozen=True)
class HelimosValSequence(HelimosSequence):
    """HeLiMOS with the labels of the validation frames only; all frames are read.

    Opened by name only.
    """

    layout: ClassVar[str] = "selected by name only: helimos with the labels of val.txt"
    split: ClassVar[str] = "val"


@dataclass(frozen=True)
class HelimosTestSequence(HelimosSequence):
    """HeLiMOS with the labels of the test frames only; all frames are read. Opened by name only."""

    layout: ClassVar[str] = "selected by name only: helimos with the labels of test.txt"
    split: ClassVar[str] = "test"


def _lidars(path: Path) -> list[Path]:
    """The lidar folders that a path may refer to.

    Itself, its parent if it is ``velodyne``, or its subfolders.
    """
    for folder in (path, path.parent if path.name == "velodyne" else path):
        if folder.name in SENSORS and has_files(folder / "velodyne", "*.bin"):
            return [folder]
    roots = (path, path / "Deskewed_LiDAR")
    return [
        root / name
        for root in roots
        for name in SENSORS
        if has_files(root / name / "velodyne", "*.bin")
    ]


def _frame_numbers(path: Path) -> frozenset[int]:
    """The numbers in a file, one per line."""
    hint = "Each line is the number of a frame, such as 000123"
    with open_file(path, hint) as file:
        lines = file.read().split()
    try:
        return frozenset(int(line) for line in lines)
    except ValueError:
        raise DataError(path, "contains something other than frame numbers", hint=hint) from None

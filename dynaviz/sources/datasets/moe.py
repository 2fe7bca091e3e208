"""MOE (moving events): ten sequences with a motion label per point, three of them simulated.

Layout and meaning of the labels: README of the data set, DeepDuke/MOE-Dataset.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np

from dynaviz.arrays import F64
from dynaviz.contracts.attributes import Attributes, far_origin
from dynaviz.contracts.reader import Reader
from dynaviz.contracts.scan import Label, Scan
from dynaviz.contracts.sensors import Sensor
from dynaviz.errors import DataError
from dynaviz.io.fields import columns_of, without_axes
from dynaviz.io.pcd import read_pcd
from dynaviz.io.poses import read_kitti_poses
from dynaviz.io.text import read_table
from dynaviz.sources.datasets.files import has_files, numbered_files, only
from dynaviz.spatial import geometry

POSES = "gt_poses.txt"
SIMULATED = ("00", "01", "02")
"""Sequences of simulators, whose labels are exact."""
STANDING = 1  # Scan.classes: 0 not moveable; moving points have 2 and the data set's class
CLASS_NAMES = {0: "not moveable", STANDING: "moveable, standing"} | {
    STANDING + 1 + number: f"moving, class {number}" for number in range(64)
}
_HINT = "Each line is a point: moveable (0 or 1), moving (0 or 1), class (-1 if it does not move)"


@dataclass(frozen=True)
class MoeSequence(Reader):
    """A sequence of MOE: ``pcd/NNNNNN.pcd`` in the sensor frame, ``gt_poses.txt``, ``label``.

    The world frame is that of the poses. Moving points are dynamic, all others static. Sequences 05
    to 09 are published without labels.
    """

    layout: ClassVar[str] = "NN/{pcd/*.pcd, gt_poses.txt, label/*.txt}"

    folder: Path
    sensor: Sensor
    scans: dict[int, Path]
    poses: F64

    @classmethod
    def matches(cls, path: Path) -> bool:
        """Whether a path is a sequence, its folder ``pcd``, or the parent of sequences."""
        return bool(_sequences(path))

    @classmethod
    def open(cls, path: Path) -> Self:
        """Open a sequence.

        Raises:
            DataError: if scans or poses are missing or inconsistent, or there are several
                sequences.
        """
        found = _sequences(path)
        folder = only(path, "sequences", {folder.name: folder for folder in found})
        scans = numbered_files(folder / "pcd", ".pcd")
        poses = read_kitti_poses(folder / POSES)
        if len(poses) <= max(scans):
            problem = f"has only {len(poses)} lines, but there is a scan {max(scans):06d}.pcd"
            raise DataError(
                folder / POSES, problem, hint="Each scan needs a line. Copy the file again"
            )
        return cls(folder, Sensor(), scans, poses)

    @property
    def name(self) -> str:
        """Format and sequence number, such as ``moe_00``."""
        return f"moe_{self.folder.name}"

    @cached_property
    def has_labels(self) -> bool:
        """Whether any frame has a label file."""
        return has_files(self.folder / "label", "*.txt")

    @property
    def facts(self) -> dict[str, str]:
        """Where the labels are from."""
        if not self.has_labels:
            return {"labels": "none; 05 to 09 are published without"}
        simulated = self.folder.name in SIMULATED
        return {"labels": "of a simulator, exact" if simulated else "made by people"}

    @cached_property
    def origin(self) -> F64:
        """(3,) float64, metres: what is subtracted from all positions."""
        return far_origin(self.poses[next(iter(self.scans)), :3, 3])

    def attributes(self, position: int) -> Attributes:
        """All fields of the file besides the coordinates."""
        path = list(self.scans.values())[position]
        return without_axes(columns_of(read_pcd(path).rows))

    def __len__(self) -> int:
        return len(self.scans)

    def scan_file(self, index: int) -> Path | None:
        """The file of the frame with this number."""
        return self.scans.get(index)

    def __getitem__(self, position: int) -> Scan:
        index = list(self.scans)[position]
        xyz = read_pcd(self.scans[index]).xyz
        T_world_sensor = self.poses[index].copy()
        T_world_sensor[:3, 3] -= self.origin
        return Scan(
            index=index,
            points=geometry.transform(T_world_sensor, xyz),
            T_world_sensor=T_world_sensor,
            **(self._truth(index, len(xyz)) if self.has_labels else {}),
        )

    def _truth(self, index: int, points: int) -> dict[str, Any]:
        """Labels and classes of a frame; all unlabelled without a file."""
        file = self.folder / "label" / f"{self.scans[index].stem}.txt"
        if not file.is_file():
            return {
                "labels": np.full(points, Label.UNLABELLED, np.uint8),
                "class_names": CLASS_NAMES,
            }
        rows = read_table(file, 3, _HINT)
        if len(rows) != points:
            problem = f"has {len(rows)} lines for {points} points"
            raise DataError(file, problem, hint="Use labels and scans of one sequence")
        moveable, moving, number = rows.T
        valid = np.isin(moveable, (0, 1)) & np.isin(moving, (0, 1))
        valid &= (number >= -1) & (number < 1 << 15) & (number == np.floor(number))
        if not valid.all():
            row = int(np.flatnonzero(~valid)[0])
            problem = f"{' '.join(f'{value:g}' for value in rows[row])} is not a label"
            raise DataError(file, problem, at=f"line {row + 1}", hint=_HINT)
        classes = np.where(moving == 1, STANDING + 1 + np.maximum(number, 0), moveable)
        return {
            "labels": np.where(moving == 1, Label.DYNAMIC, Label.STATIC).astype(np.uint8),
            "classes": classes.astype(np.uint16),
            "class_names": CLASS_NAMES,
        }


def _sequences(path: Path) -> list[Path]:
    """The sequences that a path may refer to."""
    for folder in (path, path.parent if path.name == "pcd" else path):
        if _is_sequence(folder):
            return [folder]
    return sorted(folder for folder in path.glob("*") if _is_sequence(folder))


def _is_sequence(folder: Path) -> bool:
    return (folder / POSES).is_file() and has_files(folder / "pcd", "*.pcd")

"""Where a result gets labels and maps from.

The run in this process, or the files of a saved run.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Protocol

import numpy as np

from dynaviz.arrays import F64, all_finite
from dynaviz.errors import UsageError
from dynaviz.io.pcd import read_pcd
from dynaviz.scores.labels import RunLabels
from dynaviz.sources.drive import Drive


class Answers(Protocol):
    """The labels of a run, and the map without the points that it removed."""

    @property
    def labels(self) -> RunLabels:
        """Labels by position of the frame."""
        ...

    def static_map(self) -> F64:
        """(M, 3) float64, metres: the kept points in the coordinates of the source."""
        ...


@dataclass(frozen=True)
class RunAnswers:
    """Of a run in this process, whose scans are read again for the map.

    Attributes:
        sequence: what it ran on.
        labels: of the run.
        folder: with its files, if it wrote any.
        recording: its file, if there is one.
    """

    sequence: Drive
    labels: RunLabels
    folder: Path | None = None
    recording: Path | None = None

    def static_map(self) -> F64:
        """As ``Answers``; only finite points."""
        parts = [np.empty((0, 3))]
        for position in range(len(self.sequence)):
            scan = self.sequence[position]
            kept = ~self.labels[position] & all_finite(scan.points)
            parts.append(self.sequence.exact_points(position, scan)[kept])
        return np.concatenate(parts)


@dataclass(frozen=True)
class SavedAnswers:
    """Of a run whose files are in a folder."""

    folder: Path

    @cached_property
    def labels(self) -> RunLabels:
        """As ``Answers``.

        Raises:
            UsageError: if the folder has no ``labels.npz``.
        """
        return RunLabels.load(self._file("labels.npz"))

    def static_map(self) -> F64:
        """As ``Answers``; only finite points.

        Raises:
            UsageError: if the folder has no ``static_map.pcd``.
        """
        pcd = read_pcd(self._file("static_map.pcd"))
        xyz = np.column_stack([pcd[axis].astype(np.float64) for axis in "xyz"])
        return xyz[all_finite(xyz)]

    def _file(self, name: str) -> Path:
        if not (path := self.folder / name).is_file():
            raise UsageError(
                f"{path} does not exist. Load the result.json in the folder of its run"
            )
        return path

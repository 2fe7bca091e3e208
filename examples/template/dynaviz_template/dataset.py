"""An example data set: a folder with one text file per scan, ``000000.xyzl``, and the file
``origins.txt``.

A scan has one row ``x y z label`` per point, in metres, in the world frame. Labels: 0 static, 1
dynamic, 255 unlabelled. ``origins.txt`` has one row ``x y z`` per scan: the position of the sensor.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from dynaviz.arrays import F64
from dynaviz.contracts.scan import Scan
from dynaviz.contracts.sensors import Sensor
from dynaviz.errors import DataError
from dynaviz.sources.datasets.files import has_files, numbered_files


@dataclass(frozen=True)
class TextScans:
    """Text files with labels, and a file with the positions of the sensor."""

    name: str
    scans: dict[int, Path]
    origins: F64
    sensor: Sensor = field(default_factory=Sensor)  # unknown; --sensor NAME selects one
    has_labels: bool = True
    layout: ClassVar[str] = "*.xyzl and origins.txt"

    @classmethod
    def matches(cls, path: Path) -> bool:
        """Look at file names only: dynaviz calls this for every data set and every path."""
        return (path / "origins.txt").is_file() and has_files(path, "*.xyzl")

    @classmethod
    def open(cls, path: Path) -> Self:
        """Read the small files. Scans are read on access.

        Raises:
            DataError: a file is invalid; the message states the file, the position in it and what
                to do.
        """
        scans = numbered_files(path, ".xyzl")
        origins = _rows(path / "origins.txt", np.float64, 3)
        if len(origins) != len(scans):
            raise DataError(
                path / "origins.txt",
                f"has {len(origins)} rows for {len(scans)} scans",
                hint="Give one row per scan",
            )
        return cls(path.name, scans, origins)

    def __len__(self) -> int:
        return len(self.scans)

    def __getitem__(self, position: int) -> Scan:
        index = list(self.scans)[position]
        T_world_sensor = np.eye(4)
        T_world_sensor[:3, 3] = self.origins[position]
        rows = _rows(self.scans[index], np.float32, 4)
        return Scan(index, rows[:, :3], T_world_sensor, labels=rows[:, 3].astype(np.uint8))


def _rows(path: Path, dtype: Any, columns: int) -> NDArray[Any]:
    """Read the numbers in a text file, (rows, columns)."""
    try:
        return np.loadtxt(path, dtype, ndmin=2, usecols=range(columns))
    except (OSError, ValueError) as error:  # the message of numpy states the row
        raise DataError(
            path, f"cannot be read: {error}", hint=f"Write {columns} numbers into each row"
        ) from None

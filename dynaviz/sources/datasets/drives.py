"""Several drives in one world frame, as one sequence."""

from __future__ import annotations

import bisect
import dataclasses
from collections.abc import Iterator
from collections.abc import Sequence as Several
from dataclasses import dataclass
from itertools import accumulate
from pathlib import Path

import numpy as np

from dynaviz.arrays import F32, F64
from dynaviz.contracts.attributes import Attributes, Unposed
from dynaviz.contracts.reader import Reader
from dynaviz.contracts.scan import Scan, Sequence
from dynaviz.contracts.sensors import Sensor
from dynaviz.errors import DataError, UsageError
from dynaviz.sources.drive import Drive

OBJECTS = 1_000_000  # instance numbers of a drive follow those of the one before


@dataclass(frozen=True)
class Joined(Reader):
    """Frames of several drives, in the world frame of the first.

    Attributes:
        parts: the drives; sequences become drives, and all get the origin of the first.
    """

    parts: tuple[Drive, ...]

    def __post_init__(self) -> None:
        drives = tuple(map(Drive.of, self.parts))
        object.__setattr__(self, "parts", tuple(each.at(drives[0].origin) for each in drives))

    def place(self, position: int) -> tuple[int, int]:
        """The part that a frame is from, and its position there."""
        raise NotImplementedError

    @property
    def format(self) -> str:
        """Those of the parts."""
        return " and ".join(dict.fromkeys(part.reader.format for part in self.parts))

    @property
    def sensor(self) -> Sensor:
        """The sensor of the first part."""
        return self.parts[0].sensor

    @property
    def has_labels(self) -> bool:
        """Whether any part has ground truth."""
        return any(part.has_labels for part in self.parts)

    @property
    def origin(self) -> F64:
        """(3,) float64, metres: that of the first part."""
        return self.parts[0].origin

    @property
    def exact(self) -> bool:
        """Whether all parts have exact poses and sensors."""
        return all(part.exact for part in self.parts)

    @property
    def las_file(self) -> Path | None:
        """That of the first part, in whose world frame all parts are."""
        return self.parts[0].las_file

    def scan_file(self, index: int) -> Path | None:
        """The file of the part's frame."""
        part, row = self.place(index)
        try:
            scan = self.parts[part][row]
        except DataError as error:  # the frame has a number of its own
            return error.path if isinstance(error.path, Path) else None
        return self.parts[part].scan_file(scan.index)

    def __len__(self) -> int:
        return sum(map(len, self.parts))

    def attributes(self, position: int) -> Attributes:
        """Those of the part's frame."""
        part, row = self.place(position)
        return self.parts[part].attributes(row)

    def coordinates(self, position: int) -> F32 | F64 | None:
        """Those of the part's frame."""
        part, row = self.place(position)
        return self.parts[part].coordinates(row)

    def unposed(self) -> Iterator[Unposed]:
        """Those of all parts."""
        for part in self.parts:
            yield from part.unposed()

    def __getitem__(self, position: int) -> Scan:
        part, row = self.place(position)
        return dataclasses.replace(self.parts[part][row], index=range(len(self))[position])


@dataclass(frozen=True)
class Drives(Joined):
    """Drives one after the other, in one world frame.

    A car that stood in one and is gone in another is found.

    Frames are numbered through, and so are objects. All drives have the sensor of the first.
    """

    @classmethod
    def of(cls, drives: Several[Sequence]) -> Drives:
        """Join drives.

        Raises:
            UsageError: for drives with different sensors.
        """
        names = {drive.sensor.name for drive in drives}
        if len(names) > 1:
            raise UsageError(
                f"drives with different sensors cannot be joined: {', '.join(sorted(names))}"
            )
        return cls(tuple(map(Drive.of, drives)))

    @property
    def name(self) -> str:
        """The names of the drives."""
        return "+".join(drive.name for drive in self.parts)

    def __getitem__(self, position: int) -> Scan:
        scan = super().__getitem__(position)
        (drive, _) = self.place(position)
        if scan.instances is None or not drive:
            return scan
        instances = np.where(
            scan.instances > 0, scan.instances + drive * OBJECTS, scan.instances
        ).astype(np.int32)
        return dataclasses.replace(scan, instances=instances)

    def place(self, position: int) -> tuple[int, int]:
        """The drive of a frame, and its position in it."""
        ends = list(accumulate(map(len, self.parts)))
        if not 0 <= position < ends[-1]:
            raise IndexError(position)
        drive = bisect.bisect_right(ends, position)
        return drive, position - (ends[drive] - len(self.parts[drive]))

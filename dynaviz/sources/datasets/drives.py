"""Several drives in one world frame, as one sequence."""

from __future__ import annotations

import bisect
import dataclasses
from collections.abc import Iterator
from collections.abc import Sequence as Several
from dataclasses import dataclass
from itertools import accumulate

import numpy as np

from dynaviz.arrays import F32, F64
from dynaviz.contracts.attributes import Attributes, Unposed, attributes_of, coordinates_of, origin_of, unposed_of
from dynaviz.contracts.scan import Scan, Sequence
from dynaviz.contracts.sensors import Sensor
from dynaviz.errors import UsageError

OBJECTS = 1_000_000  # instance numbers of a drive follow those of the one before


@dataclass(frozen=True)
class Drives:
    """Drives one after the other, in one world frame: a car that stood in one and is gone in another is found.

    Frames are numbered through, and so are objects. All drives have the sensor of the first.
    """

    drives: tuple[Sequence, ...]

    @classmethod
    def of(cls, drives: Several[Sequence]) -> Drives:
        """Join drives.

        Raises:
            UsageError: for drives with different sensors.
        """
        names = {drive.sensor.name for drive in drives}
        if len(names) > 1:
            raise UsageError(f"drives with different sensors cannot be joined: {', '.join(sorted(names))}")
        return cls(tuple(drives))

    @property
    def name(self) -> str:
        """The names of the drives."""
        return "+".join(drive.name for drive in self.drives)

    @property
    def sensor(self) -> Sensor:
        """The sensor of the drives."""
        return self.drives[0].sensor

    @property
    def has_labels(self) -> bool:
        """Whether any drive has ground truth."""
        return any(drive.has_labels for drive in self.drives)

    def __len__(self) -> int:
        return sum(map(len, self.drives))

    @property
    def origin(self) -> F64:
        """(3,) float64, metres: that of the first drive, to which the others are moved."""
        return origin_of(self.drives[0])

    def attributes(self, position: int) -> Attributes:
        """Those of the drive's frame."""
        drive, row = self._place(position)
        return attributes_of(self.drives[drive], row)

    def coordinates(self, position: int) -> F32 | F64 | None:
        """Those of the drive's frame."""
        drive, row = self._place(position)
        return coordinates_of(self.drives[drive], row)

    def unposed(self) -> Iterator[Unposed]:
        """Those of all drives."""
        for each in self.drives:
            yield from unposed_of(each)

    def __getitem__(self, position: int) -> Scan:
        drive, row = self._place(position)
        scan = self.drives[drive][row]
        if (offset := origin_of(self.drives[drive]) - self.origin).any():
            scan = scan.moved(offset)
        instances = scan.instances
        if instances is not None and drive:
            instances = np.where(instances > 0, instances + drive * OBJECTS, instances).astype(np.int32)
        return dataclasses.replace(scan, index=position, instances=instances)

    def _place(self, position: int) -> tuple[int, int]:
        """The drive of a frame, and its position in it."""
        ends = list(accumulate(map(len, self.drives)))
        if not 0 <= position < ends[-1]:
            raise IndexError(position)
        drive = bisect.bisect_right(ends, position)
        return drive, position - (ends[drive] - len(self.drives[drive]))

"""What reads the frames of a data set, and states what the data set says beyond its scans.

A format derives from ``Reader`` and overrides what it knows. Scans carry none of it, so that
methods run at the same speed with and without; a second pass over the source reads it when a map is
written.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from dynaviz.arrays import F32, F64, I64
from dynaviz.contracts import registry
from dynaviz.contracts.attributes import Attributes, Unposed
from dynaviz.contracts.scan import Scan, Sequence
from dynaviz.contracts.sensors import Sensor
from dynaviz.spatial.trajectory import PosesOverTime

if TYPE_CHECKING:
    default = property
else:

    class default:  # used like property
        """A property that a subclass may replace by a field, also by one of a dataclass."""

        def __init__(self, get: Any) -> None:
            self._get = get
            self.__doc__ = get.__doc__

        def __set_name__(self, owner: type, name: str) -> None:
            self._name = name

        def __get__(self, reader: Any, owner: type) -> Any:
            if reader is None:  # the default of a field would be taken from here
                raise AttributeError(self._name)
            return self._get(reader)


class Reader:
    """Reads the frames of a data set, one at a time; a ``Sequence`` that states more.

    Subclasses have a name, a sensor, and whether any frame has ground truth; they read frames and
    know how many there are. Everything else has a default.

    Attributes:
        name: short, for folders and table rows.
        sensor: that recorded the data.
        has_labels: whether any frame has ground truth.
    """

    if TYPE_CHECKING:

        @property
        def name(self) -> str:  # noqa: D102
            ...

        @property
        def sensor(self) -> Sensor:  # noqa: D102
            ...

        @property
        def has_labels(self) -> bool:  # noqa: D102
            ...

    def __len__(self) -> int:
        raise NotImplementedError

    def __getitem__(self, position: int) -> Scan:
        """Read the frame at a position from 0 to len - 1; raises IndexError otherwise."""
        raise NotImplementedError

    @default
    def format(self) -> str:
        """Name of the format, as results state it: that on the command line, or of the class."""
        return _format_of(type(self))

    @default
    def origin(self) -> F64:
        """(3,) float64, metres: add it to points and poses to get the coordinates of the source.

        The world frame is moved if the coordinates of the source are far from zero.
        """
        return np.zeros(3)

    @default
    def exact(self) -> bool:
        """Whether poses and sensor are exact, as in a simulated scene; nobody estimates or checks
        them.
        """
        return False

    @default
    def facts(self) -> Mapping[str, str]:
        """Further facts by name, such as the topic of a bag or the number of tracks."""
        return {}

    @default
    def stamps(self) -> I64 | None:
        """(frames,) int64, nanoseconds: when each frame was measured; None if a scan must be read
        to know.
        """
        return None

    @default
    def trajectories(self) -> Mapping[int, PosesOverTime]:
        """T_world_sensor over time of each lidar; empty if poses of scans are known only."""
        return {}

    @default
    def pose_path(self) -> PosesOverTime | None:
        """T_world_sensor over time, by which frames were placed by their stamps; None if their
        poses have no times.
        """
        return None

    @default
    def las_file(self) -> Path | None:
        """A LAS file in whose world frame the scans are; None without one.

        A LAS map takes over its header: coordinate system, scales and offsets.
        """
        return None

    @default
    def unmatched(self) -> Mapping[int, int]:
        """Number of points without ground truth, by frame number, of the frames read so far."""
        return {}

    def attributes(self, position: int) -> Attributes:
        """Attributes of the frame at a position, in the order of its points.

        Empty if it has none.
        """
        return {}

    def coordinates(self, position: int) -> F32 | F64 | None:
        """(N, 3), metres: coordinates of a frame as the source states them, in its type.

        None if the points of the scan tell as much.
        """
        return None

    def unposed(self) -> Iterator[Unposed]:
        """Points that no pose covers, piece by piece."""
        yield from ()

    def scan_file(self, index: int) -> Path | None:
        """The file of the frame with this number; None if frames have no files of their own."""
        return None


class _PlainReader(Reader):
    """The reader of a sequence that does not derive from ``Reader``, such as one of a plug-in.

    What the sequence states counts; the rest has its default.
    """

    def __init__(self, sequence: Sequence) -> None:
        self._sequence = sequence

    def __getattribute__(self, name: str) -> Any:
        if not name.startswith("_") and hasattr(self._sequence, name):
            return getattr(self._sequence, name)
        return super().__getattribute__(name)

    @property
    def format(self) -> str:
        """That of the sequence."""
        return _format_of(type(self._sequence))

    def __len__(self) -> int:
        return len(self._sequence)

    def __getitem__(self, position: int) -> Scan:
        return self._sequence[position]


def _format_of(kind: type) -> str:
    return registry.name_of("datasets", kind) or kind.__name__


def reader_of(sequence: Sequence) -> Reader:
    """A sequence as a reader, which has defaults for all that it does not state."""
    return sequence if isinstance(sequence, Reader) else _PlainReader(sequence)

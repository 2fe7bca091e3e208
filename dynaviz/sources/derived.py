"""The base of readers whose frames are those of a drive, changed."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

from dynaviz.arrays import F32, F64, I64
from dynaviz.contracts.attributes import Attributes, Unposed
from dynaviz.contracts.reader import Reader
from dynaviz.contracts.sensors import Sensor
from dynaviz.sources.drive import Drive
from dynaviz.spatial.trajectory import PosesOverTime


class Derived(Reader):
    """Reads the frames of a drive, changed, and states what the drive states unless overridden.

    Attributes:
        whole: the drive.
    """

    whole: Drive

    @property
    def name(self) -> str:
        """That of the drive."""
        return self.whole.name

    @property
    def sensor(self) -> Sensor:
        """That of the drive."""
        return self.whole.sensor

    @property
    def has_labels(self) -> bool:
        """Whether the drive has ground truth."""
        return self.whole.has_labels

    def __len__(self) -> int:
        return len(self.whole)

    @property
    def origin(self) -> F64:
        """(3,) float64, metres: that of the drive."""
        return self.whole.origin

    @property
    def exact(self) -> bool:
        """Whether poses and sensor of the drive are exact."""
        return self.whole.exact

    @property
    def facts(self) -> Mapping[str, str]:
        """Those of the drive."""
        return self.whole.facts

    @property
    def stamps(self) -> I64 | None:
        """Those of the drive."""
        return self.whole.stamps

    @property
    def trajectories(self) -> Mapping[int, PosesOverTime]:
        """Those of the drive."""
        return self.whole.trajectories

    @property
    def pose_path(self) -> PosesOverTime | None:
        """That of the drive."""
        return self.whole.pose_path

    @property
    def las_file(self) -> Path | None:
        """That of the drive."""
        return self.whole.las_file

    @property
    def unmatched(self) -> Mapping[int, int]:
        """Those of the drive."""
        return self.whole.unmatched

    def attributes(self, position: int) -> Attributes:
        """Those of the drive."""
        return self.whole.attributes(position)

    def coordinates(self, position: int) -> F32 | F64 | None:
        """Those of the drive."""
        return self.whole.coordinates(position)

    def unposed(self) -> Iterator[Unposed]:
        """Those of the drive."""
        return self.whole.unposed()

    def scan_file(self, index: int) -> Path | None:
        """That of the drive."""
        return self.whole.scan_file(index)

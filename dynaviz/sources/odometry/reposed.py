"""A sequence with other poses than its own."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dynaviz.arrays import F64
from dynaviz.contracts.attributes import Unposed, facts_of, unposed_of
from dynaviz.contracts.scan import Scan, Sequence, SequenceView
from dynaviz.errors import DataError
from dynaviz.io.poses import read_poses
from dynaviz.spatial import geometry
from dynaviz.spatial.trajectory import PosesOverTime


@dataclass(frozen=True)
class ReposedSequence(SequenceView):
    """A sequence whose scans are moved from their own poses to others.

    Ground truth and attributes stay.

    Attributes:
        whole: the sequence.
        poses: (frames, 4, 4) float64, metres: T_world_sensor of each frame by position.
    """

    whole: Sequence
    poses: F64
    exact = False

    @classmethod
    def read(cls, sequence: Sequence, file: Path) -> ReposedSequence:
        """Read the poses of a file by number, or by stamp if the scans have stamps.

        Raises:
            DataError: if a scan has no pose.
        """
        found = read_poses(file)
        rows = found.numbers if found.numbers is not None else found.stamps
        poses = dict(zip([] if rows is None else rows.tolist(), found.poses, strict=True))
        chosen = []
        for position in range(len(sequence)):
            scan = sequence[position]
            T = poses.get(scan.index if found.numbers is not None else scan.stamp_ns)
            if T is None:
                raise DataError(
                    file, f"has no pose for frame {scan.index}", hint="Estimate the poses again"
                )
            chosen.append(T)
        return cls(sequence, np.array(chosen))

    @property
    def facts(self) -> Mapping[str, str]:
        """Further facts of the sequence."""
        return {**facts_of(self.whole), "poses": "estimated"}

    @property
    def origin(self) -> F64:
        """(3,) float64, metres: zero, because the poses have a world frame of their own."""
        return np.zeros(3)

    @property
    def las_file(self) -> Path | None:
        """None: the scans are not in the world frame of a LAS file."""
        return None

    def unposed(self) -> Iterator[Unposed]:
        """Those of the sequence, without their place: it is in another world frame."""
        for each in unposed_of(self.whole):
            yield dataclasses.replace(each, xyz=None)

    def coordinates(self, position: int) -> None:
        """None: the points of the scan tell as much."""

    @property
    def trajectories(self) -> Mapping[int, PosesOverTime]:
        """None: those of the sequence are not the poses of these scans."""
        return {}

    def __getitem__(self, position: int) -> Scan:
        scan = self.whole[position]
        T_world_sensor = self.poses[position]
        move = geometry.compose(T_world_sensor, geometry.inverse(scan.T_world_sensor))
        return dataclasses.replace(
            scan,
            points=geometry.transform(move, scan.points),
            T_world_sensor=T_world_sensor,
            origins=geometry.apply(move, scan.origins),
        )

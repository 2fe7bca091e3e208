"""The few frames of a sequence that are compared with each other.

The same for the doctor and for the quick check.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dynaviz.arrays import F32, F64
from dynaviz.contracts.attributes import Attributes
from dynaviz.contracts.scan import Scan
from dynaviz.diagnosis.scans import ScanChecker
from dynaviz.errors import DataError
from dynaviz.progress import Progress
from dynaviz.sources.datasets.pose_matching import NO_POSES
from dynaviz.sources.derived import Derived
from dynaviz.sources.drive import Drive
from dynaviz.sources.hypotheses.sizes import LONG_STEPS
from dynaviz.sources.hypotheses.views import MAX_APART, ScanView, apart, around, comparable

GROUPS = 6  # of frames, spread over the sequence; a pair of each is compared
STEPS = (1, 2, 5, 10, 20, MAX_APART)  # frames after the first of a group, until the sensor is apart
UNIT_STEPS = 10  # the same, at least, if the unit is unknown
POINTS = 30_000  # of a frame, at most

Rows = list[tuple[int, int]]


@dataclass(frozen=True, eq=False)
class FewPoints(Derived):
    """A drive of which each frame is read once, with at most ``POINTS`` points."""

    whole: Drive
    kept: dict[int, Scan]

    has_labels = False

    def attributes(self, position: int) -> Attributes:
        """Those of the points."""
        found = self.whole.attributes(position)
        return {name: array[:: _step(len(array))] for name, array in found.items()}

    def coordinates(self, position: int) -> F32 | F64 | None:
        """Those of the points."""
        found = self.whole.coordinates(position)
        return None if found is None else found[:: _step(len(found))]

    def __getitem__(self, position: int) -> Scan:
        if position not in self.kept:
            scan = self.whole[position].without_truth()
            step = _step(len(scan))
            origins = scan.origins if len(scan.origins) == 1 else scan.origins[::step]
            times = None if scan.times is None else scan.times[::step]
            self.kept[position] = replace(
                scan, points=scan.points[::step], origins=origins, times=times
            )
        return self.kept[position]


def _step(points: int) -> int:
    """Every how many points of a scan one is kept."""
    return -(-points // POINTS) or 1


class FrameGroups:
    """Groups of frames of a sequence.

    In each, the sensor moves 1 m or turns 5 degrees, if it does within 40 frames.

    Args:
        sequence: at most 42 of its frames are read; those that cannot be read are left out.

    Attributes:
        few: the sequence, with few points.
        checker: of the frames that were read.
        posed: whether the sequence has poses; otherwise each scan is in its own frame.
    """

    def __init__(self, sequence: Drive) -> None:
        self.posed = sequence.provenance.options.poses != NO_POSES
        self.few = Drive.of(FewPoints(sequence, {}))
        self.checker = ScanChecker(self.few)
        self._groups: list[list[int]] = []  # positions
        starts = np.unique(np.linspace(0, max(len(sequence) - 2, 0), GROUPS).astype(int))
        read = {position for start in starts.tolist() for position in self._group(start)}
        for position in sorted(read):
            self.checker.check(position, self.few[position])
        self._row = {position: row for row, position in enumerate(self.checker.positions)}

    def _group(self, start: int) -> list[int]:
        """The frames of a group."""
        group = list[int]()
        for step in (0, *STEPS):
            scan = self.scan(start + step)
            if scan is None:
                continue
            group.append(start + step)
            way = np.linalg.norm((scan.T_world_sensor - self.few[group[0]].T_world_sensor)[:3, 3])
            long = way > LONG_STEPS * (group[-1] - group[0])
            if apart(self.few[group[0]].T_world_sensor, scan.T_world_sensor) and (
                not long or step >= UNIT_STEPS
            ):
                break
        self._groups.append(group)
        return group

    def scan(self, position: int) -> Scan | None:
        """The frame at a position, with few points; None if there is none, or it cannot be read."""
        try:
            return self.few[position] if position < len(self.few) else None
        except DataError:
            return None

    def pairs(self, skipped: int = 0) -> Rows:
        """The first and the last frame of each group, or instead of the first the one after it.

        Rows of ``checker``.
        """
        rows = [
            [row for p in group if self.checker.usable[row := self._row[p]]][skipped:]
            for group in self._groups
        ]
        return sorted({(each[0], each[-1]) for each in rows if len(each) > 1})

    def pairs_apart(self, most: int) -> Rows:
        """The first frame of each group, and its last one at most so many frames later.

        Rows of ``checker``.
        """
        near = [[p for p in group if p <= group[0] + most] for group in self._groups if group]
        return sorted({(self._row[each[0]], self._row[each[-1]]) for each in near if len(each) > 1})

    def views(self, rows: Rows, progress: Progress) -> list[tuple[ScanView, ScanView]]:
        """Pairs of scans for comparison; those with too few points are left out."""
        views = []
        checker = self.checker
        track = checker.positions, checker.poses, checker.stamps
        for done, pair in enumerate(rows, 1):
            a, b = (ScanView(checker.read(row), around(row, *track)) for row in pair)
            if comparable((a, b)):
                views.append((a, b))
            progress("comparing", done, len(rows))
        return views

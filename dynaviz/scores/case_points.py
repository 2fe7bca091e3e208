"""To which case of a run a wrong point belongs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from dynaviz.arrays import F32, F64, I64, Intp
from dynaviz.contracts.metric import CaseSample
from dynaviz.contracts.scan import ErrorKind
from dynaviz.scores.failure_case import ROUNDED, FailureCase, JoinedPoints

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

FRAME = 0.25  # metres: how far apart points of successive frames count, in addition


@dataclass(frozen=True)
class CasePoints:
    """The cases of a run, and some points of each.

    A point belongs to the case whose frames and box contain it. Where several do, it belongs to the
    one with the nearest point in space and time; if no points are known, to the costliest.

    Attributes:
        cases: costliest first.
        sample: some points of each; None if unknown, as in earlier recordings.
    """

    cases: Sequence[FailureCase]
    sample: CaseSample | None = None

    def owners(self, kind: ErrorKind, frames: I64, points: F32 | F64) -> I64:
        """(N,) numbers of the cases of wrong points, 1 for the first; 0 for no listed case.

        Args:
            kind: of their error.
            frames: (N,) positions in the run.
            points: (N, 3) metres, world frame.
        """
        owners = np.zeros(len(points), np.int64)
        rows_in = self._inside(kind, frames, points)
        boxes = np.zeros(len(points), np.int64)
        for number, rows in rows_in.items():
            boxes[rows] += 1
            owners[rows[owners[rows] == 0]] = number
        nearest = np.full(len(points), np.inf)
        for number, rows in rows_in.items():
            if number not in self._trees:
                continue
            shared = rows[boxes[rows] > 1]
            places = _in_time(frames[shared], points[shared])
            metres = np.asarray(self._trees[number].query(places)[0])
            nearer = metres < nearest[shared]
            owners[shared[nearer]] = number
            nearest[shared[nearer]] = metres[nearer]
        return owners

    def owner(self, kind: ErrorKind, frame: int, place: Sequence[float]) -> int | None:
        """The number of the case of a wrong point; None for no listed case."""
        found = self.owners(kind, np.array([frame]), np.array([place], np.float64))
        return int(found[0]) or None

    def around(self, kind: ErrorKind, frame: int, place: Sequence[float]) -> int:
        """How many cases have frames and boxes that contain a wrong point."""
        rows_in = self._inside(kind, np.array([frame]), np.array([place], np.float64))
        return sum(len(rows) for rows in rows_in.values())

    def _inside(self, kind: ErrorKind, frames: I64, points: F32 | F64) -> dict[int, Intp]:
        """By number of the cases of a kind, the rows of the points in their frames and boxes."""
        numbered = enumerate(self.cases, 1)
        of_kind = {number: case for number, case in numbered if case.kind == kind}
        return inside(of_kind, frames, points)

    @cached_property
    def _trees(self) -> dict[int, cKDTree]:
        from scipy.spatial import cKDTree

        if self.sample is None:
            return {}
        places = _in_time(self.sample.frames, self.sample.points)
        return {
            number + 1: cKDTree(places[self.sample.case == number])
            for number in np.unique(self.sample.case).tolist()
        }


def inside(cases: Mapping[int, JoinedPoints], frames: I64, points: F32 | F64) -> dict[int, Intp]:
    """By number of the cases, the rows of the points in their frames and boxes.

    Args:
        cases: by number.
        frames: (N,) positions in the run.
        points: (N, 3) metres, world frame.
    """
    by_x = np.argsort(points[:, 0], kind="stable")
    x = points[by_x, 0].astype(np.float64)
    found = {}
    for number, case in cases.items():
        low = np.array(case.low) - ROUNDED
        high = np.array(case.high) + ROUNDED
        rows = by_x[np.searchsorted(x, low[0]) : np.searchsorted(x, high[0], "right")]
        rows = rows[(frames[rows] >= case.first_frame) & (frames[rows] <= case.last_frame)]
        for axis in (1, 2):
            at = points[rows, axis]
            rows = rows[(at >= low[axis]) & (at <= high[axis])]
        found[number] = np.sort(rows)
    return found


def _in_time(frames: I64, points: F32 | F64) -> F64:
    """(N, 4) metres: points, and their frames as a fourth coordinate."""
    return np.column_stack([points.astype(np.float64), FRAME * frames])

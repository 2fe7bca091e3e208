"""The points of a run as its review shows them: around a place, with what was decided."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from dynaviz.arrays import F32, F64, I32, U8, Bool, Intp
from dynaviz.contracts.scan import Scan
from dynaviz.reviews.applying import NONE, Applied, ByHand
from dynaviz.reviews.candidates import Candidate, found_in, without_points
from dynaviz.reviews.decisions import ReviewDecision
from dynaviz.reviews.regions import ObjectRegion, Region
from dynaviz.reviews.visibility import RangeImages

MOST = 40_000_000  # points in memory; of longer drives, every second, third, ... point is kept


@dataclass(frozen=True, eq=False)
class Around:
    """Points around a place, of all frames.

    Attributes:
        xyz: (N, 3) float32, metres, world of the sequence.
        frame: (N,) int32, position of the frame.
        removed: (N,) bool, what the run did.
        chosen: (N,) bool, whether they are in the region asked about.
        verdicts: (N,) uint8, as ``Applied.verdicts``.
    """

    xyz: F32
    frame: I32
    removed: Bool
    chosen: Bool
    verdicts: U8


class ReviewSurvey:
    """All points of a run, its candidates, and what its scans saw.

    Args:
        scans: of the sequence, in order.
        labels: (N,) bool for each scan, True for removed points.
        origin: (3,) float64, metres: offset of the sequence's world.
        expected: about how many points there are.

    Attributes:
        candidates: the one that is expected to change most first.
        step: every so many-th point is in memory.
        looks: what the scans saw.
    """

    def __init__(
        self,
        scans: Iterable[Scan],
        labels: Iterable[Bool],
        origin: F64,
        expected: int = 0,
    ) -> None:
        self.step = max(1, -(-expected // MOST))
        self._origin = origin
        self._times: list[Scan] = []
        self._parts: list[tuple[F32, Bool]] = []
        found = found_in(self._gathered(zip(scans, labels, strict=True)), origin)
        self.candidates: tuple[Candidate, ...] = found.candidates
        self.looks: RangeImages = found.looks
        self._sort()

    def _gathered(self, scans: Iterable[tuple[Scan, Bool]]) -> Iterator[tuple[Scan, Bool]]:
        """Scans with their labels, whose points are kept on the way."""
        for scan, dynamic in scans:
            self._parts.append((scan.points[:: self.step], dynamic[:: self.step]))
            self._times.append(without_points(scan))
            yield scan, dynamic

    def _sort(self) -> None:
        """Order all points along x, so that those in a box are found soon."""
        lengths = [len(points) for points, _ in self._parts]
        xyz = np.concatenate([points for points, _ in self._parts] or [np.empty((0, 3), "f4")])
        removed = np.concatenate([dynamic for _, dynamic in self._parts] or [np.empty(0, "?")])
        self._parts.clear()
        order = np.argsort(xyz[:, 0], kind="stable")
        self._xyz: F32 = xyz[order]
        self._removed: Bool = removed[order].astype(np.bool_)
        frames = np.repeat(np.arange(len(lengths), dtype=np.int32), lengths)
        self._frame: I32 = frames[order]

    @property
    def frames(self) -> int:
        """Number of frames."""
        return len(self._times)

    def time(self, frame: int) -> Scan:
        """The scan at a position, without its points."""
        return self._times[frame]

    def rows(self, low: F64, high: F64) -> Intp:
        """(K,) rows of the points in a box; metres, world of the sequence."""
        x = self._xyz[:, 0]
        rows = np.arange(
            np.searchsorted(x, np.float32(low[0])), np.searchsorted(x, np.float32(high[0]), "right")
        )
        for axis in (1, 2):
            values = self._xyz[rows, axis]
            rows = rows[(values >= low[axis]) & (values <= high[axis])]
        return rows

    def around(
        self, low: F64, high: F64, region: Region | None, decisions: Iterable[ReviewDecision]
    ) -> Around:
        """The points in a box.

        Args:
            low, high: (3,) metres, world of the sequence.
            region: what ``chosen`` tells.
            decisions: those that hold.
        """
        rows = self.rows(low, high)
        chosen = np.zeros(len(rows), np.bool_)
        verdicts = np.full(len(rows), NONE, np.uint8)
        applied = Applied(decisions, self._origin)
        asked = Applied([] if region is None else [ReviewDecision("static", region)], self._origin)
        for part, scan in self._by_frame(rows):
            verdicts[part] = applied.verdicts(scan)
            chosen[part] = asked.verdicts(scan) != NONE
        return Around(self._xyz[rows], self._frame[rows], self._removed[rows], chosen, verdicts)

    def by_hand(self, decisions: Iterable[ReviewDecision]) -> ByHand:
        """What decisions change; of the points in memory."""
        decisions = tuple(decisions)
        applied = Applied(decisions, self._origin)
        found = [self.rows(*self._box(each)) for each in decisions]
        rows = np.unique(np.concatenate([np.empty(0, np.intp), *found]))
        removed = self._removed[rows]
        for part, scan in self._by_frame(rows):
            applied.answers(scan, removed[part])
        return applied.by_hand

    def _box(self, decision: ReviewDecision) -> tuple[F64, F64]:
        """A box that contains the region of a decision at all times."""
        region = decision.region
        offset = 0.0 if decision.local else self._origin
        if isinstance(region, ObjectRegion):
            margin = max(region.edge, region.margin)
            low = np.min([piece.low for piece in region.pieces], axis=0) - margin
            high = np.max([piece.high for piece in region.pieces], axis=0) + margin
            return low - offset, high + region.edge - offset
        bounds = region.bounds(self._times[0])
        assert bounds is not None
        return bounds[0] - offset, bounds[1] - offset

    def _by_frame(self, rows: Intp) -> Iterator[tuple[Intp, Scan]]:
        """Positions in ``rows`` of each frame, and its points there as a scan."""
        frames = self._frame[rows]
        order = np.argsort(frames, kind="stable")
        ends = np.flatnonzero(np.diff(frames[order])) + 1
        for part in np.split(order, ends):
            if len(part):
                scan = self._times[int(frames[part[0]])]
                yield part, dataclasses.replace(scan, points=self._xyz[rows[part]])

"""Join wrong points into cases, frame by frame.

Memory grows neither with points nor with small cases.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynaviz import kernels
from dynaviz.arrays import F32, F64, I64, U8, Bool, Intp
from dynaviz.contracts.metric import CaseSample, FrameBoxes
from dynaviz.contracts.scan import Outcome
from dynaviz.scores.failure_case import FailureCase, JoinedPoints, RangeSpan
from dynaviz.scores.sections import RemovedCluster
from dynaviz.spatial.grid import pack
from dynaviz.spatial.surface import GRAZING
from dynaviz_eval import samples

Angles = Callable[[Intp], F64]

EDGE = 0.5  # metres: points in touching cells belong to one case
GAP = 10  # frames for which a cell is remembered: points that return later start a new case
KEEP = 100  # cases listed individually
NUMBER = 0xFFFFFFFF  # the bits of a group that are the number of an object
MEASURED_EVERY = 20  # points of a case in a frame for one whose surface is measured
MOST_MEASURED = 32  # of these
EVERY = 16  # frames between two clean-ups, which drop small cases that are over
# columns of remembered cells
CASE = 1
LAST = 2


@dataclass(frozen=True, eq=False)
class FramePoints:
    """The points of one kind of error in a frame.

    Attributes:
        frame: position in the run.
        points: (N, 3) float32, metres, world frame; finite.
        groups: (N,) int64.
        reasons: (N,) uint8 codes.
        ranges: (N,) float32, metres from the sensor.
        touching: (N,) bool, True next to points of another kind, such as dynamic ones.
        ground: (N,) bool, True on the ground; None if unknown.
        angles: given rows of ``points``, the angles at which their rays meet the surface; None if
            unknown.
        rows: (N,) rows in the scan; None for no sample.
        heights: (N,) float32, metres above the ground; None if unknown.
    """

    frame: int
    points: F32
    groups: I64
    reasons: U8
    ranges: F32
    touching: Bool
    ground: Bool | None = None
    angles: Angles | None = None
    rows: Intp | None = None
    heights: F32 | None = None


class Cases:
    """Joins the points of one kind of error into cases.

    A case grows by cells that touch it, in the same frame or up to ``GAP`` frames later, so it
    follows moving objects. Points of different groups never join. ``rows`` contains one row per
    case and frame, for the cases that are kept.

    Args:
        reasons: number of reason codes.
        span: maximum extent of a case along an axis, metres; larger ones are split.
        dropped: receives the small cases that are over and no longer kept, one row each
            (``summed``).
        keep: number of cases that are kept when they are over, largest first.
        sampled: number of points of each case that are kept, in ``sample``, of which ``group`` is
            the case.
        objects: whether the points of a group with an object's number are one case, which is kept.
    """

    def __init__(
        self,
        reasons: int,
        span: float,
        dropped: Callable[[NDArray[np.void]], None] = lambda cases: None,
        keep: int = KEEP,
        sampled: int = 0,
        objects: bool = False,
    ) -> None:
        self._limit = int(min(span / EDGE, 1 << 30))
        self.kind = np.dtype(
            [
                ("case", np.int64), ("frame", np.int64), ("group", np.int64), ("points", np.int64),
                ("cells", np.int64),
                ("touching", np.int64), ("ground", np.int64), ("surface", np.int64),
                ("grazed", np.int64),
                ("low", np.float32, 3), ("high", np.float32, 3),
                ("near", np.float32), ("far", np.float32), ("ranges", np.float64),
                ("reasons", np.int64, reasons),
            ]
        )  # fmt: skip
        self.rows = np.empty(0, self.kind)
        self._dropped = dropped
        self._keep = keep
        self._sampled = sampled
        self._objects = objects
        self.sample = np.empty(0, samples.POINT)
        self._new_sample: list[NDArray[np.void]] = []
        self._new: list[NDArray[np.void]] = []
        self._table = np.full(1024, -1, np.int64)
        self._cells = np.empty((1024, 3), np.int64)
        self._remembered = 0
        self._parent = np.empty(0, np.int32)
        self._low = self._high = np.empty((0, 3), np.int32)
        self._used = 0

    def add(self, wrong: FramePoints) -> None:
        """Add the points of a frame. Call it in the order of frames."""
        if len(wrong.points):
            self._new.append(self._rows(wrong))
        if wrong.frame % EVERY == EVERY - 1:
            self.settle(wrong.frame)

    def _rows(self, wrong: FramePoints) -> NDArray[np.void]:
        """Link the points of a frame to cases; one row for each of its cases."""
        frame = wrong.frame
        points = wrong.points
        groups = wrong.groups
        reasons = wrong.reasons
        self._make_room(len(points))
        of_point, first, fresh, self._used = kernels.cases.link(
            pack(points, EDGE), groups, frame, GAP, self._limit,
            self._table, self._cells, self._parent, self._low, self._high, self._used,
        )  # fmt: skip
        self._remembered += fresh
        # cases may have joined since
        of_point = kernels.cases.roots(self._parent, self._used)[of_point]
        case, counts, low, high, sums, crossed = kernels.cases.fold(
            of_point, self._used, points, wrong.ranges, first, wrong.touching,
            first & False if wrong.ground is None else wrong.ground, reasons,
            self.kind["reasons"].shape[0],
        )  # fmt: skip
        rows = np.zeros(len(case), self.kind)
        rows["case"] = case
        rows["frame"] = frame
        rows["group"] = groups[counts[:, 0]]
        rows["ranges"] = sums
        for column, name in enumerate(("points", "cells", "touching", "ground"), 1):
            rows[name] = counts[:, column]
        rows["low"] = low[:, :3]
        rows["high"] = high[:, :3]
        rows["near"] = low[:, 3]
        rows["far"] = high[:, 3]
        rows["reasons"] = crossed
        row = np.searchsorted(case, of_point)
        if self._sampled and wrong.rows is not None:
            self._choose(wrong, of_point, rows["points"][row])
        if wrong.angles is not None:
            measured = _spread_over(row, rows["points"])
            found = wrong.angles(measured)
            of = row[measured]
            weights = (rows["points"] / np.bincount(of))[of]
            for name, chosen in (("surface", found >= 0), ("grazed", found < GRAZING)):
                rows[name] = np.bincount(of, weights * chosen)
        return rows

    def _choose(self, wrong: FramePoints, case: NDArray[np.int32], sizes: I64) -> None:
        """Keep those points of a frame that may be in the samples of their cases."""
        assert wrong.rows is not None
        priority = samples.priorities(wrong.frame, wrong.rows)
        some = np.flatnonzero(samples.likely(priority, sizes, self._sampled))
        heights = None if wrong.heights is None else wrong.heights[some]
        self._new_sample.append(
            samples.records(
                wrong.frame, wrong.rows[some], case[some].astype(np.int64), priority[some],
                wrong.points[some], heights, wrong.reasons[some], False,
            )
        )  # fmt: skip

    def _make_room(self, more: int) -> None:
        room = 2 * (self._remembered + more)
        if room > len(self._table):
            self._table, self._cells = kernels.cases.remember(
                self._table, self._cells, 1 << room.bit_length()
            )
        need = self._used + more + 1
        if need > len(self._parent):
            grown = max(2 * len(self._parent), need)
            parent = np.empty(grown, np.int32)
            low = np.empty((grown, 3), np.int32)
            high = np.empty((grown, 3), np.int32)
            used = self._used
            parent[:used] = self._parent[:used]
            low[:used] = self._low[:used]
            high[:used] = self._high[:used]
            self._parent = parent
            self._low = low
            self._high = high

    def settle(self, frame: int) -> None:
        """Renumber the cases, and drop those that are over by this frame and not
        among the largest.
        """
        rows = np.concatenate([self.rows, *self._new])
        self._new = []
        if self._objects:
            self._join_objects(rows)
        rows["case"] = kernels.cases.roots(self._parent, self._used)[rows["case"]]
        rows, _ = pooled(rows, ("case", "frame"))  # several cases of a frame may have joined
        sample = np.concatenate([self.sample, *self._new_sample])
        self._new_sample = []
        sample["group"] = kernels.cases.roots(self._parent, self._used)[sample["group"]]
        old, which = np.unique(rows["case"], return_inverse=True)
        points = np.bincount(which, rows["points"], len(old))
        last = np.zeros(len(old), np.int64)
        np.maximum.at(last, which, rows["frame"])
        done = last < frame - GAP
        largest = np.zeros(len(old), np.bool_)
        largest[np.argsort(-points, kind="stable")[: self._keep]] = True
        keep = ~done | largest
        if self._objects:  # or what an object has in later frames would be a case of its own
            keep[which[(rows["group"] & NUMBER) != 0]] = True
        self._dropped(summed(rows[~keep[which]]))
        self.rows = rows[keep[which]]
        new = np.cumsum(keep) - 1
        self.rows["case"] = new[which][keep[which]]
        of = np.searchsorted(old, sample["group"])
        sample["group"] = new[of]
        self.sample = samples.smallest(sample[keep[of]], self._sampled)
        self._forget(frame, old, keep, new)

    def _join_objects(self, rows: NDArray[np.void]) -> None:
        """Make one case of the cases of each object with a number."""
        numbered = rows[(rows["group"] & NUMBER) != 0]
        cases = kernels.cases.roots(self._parent, self._used)[numbered["case"]]
        groups, of = np.unique(numbered["group"], return_inverse=True)
        first = np.full(len(groups), self._used, np.int64)
        np.minimum.at(first, of, cases)
        self._parent[cases] = first[of]

    def _forget(self, frame: int, old: I64, keep: Bool, new: Intp) -> None:
        alive = np.flatnonzero((self._table >= 0) & (frame - self._cells[:, LAST] <= GAP))
        keys = self._table[alive]
        cells = self._cells[alive]
        root = kernels.cases.roots(self._parent, self._used)[cells[:, CASE]]
        cells[:, CASE] = new[np.searchsorted(old, root)]
        kept = old[keep]
        self._low = self._low[kept]
        self._high = self._high[kept]
        self._used = len(kept)
        self._parent = np.arange(self._used, dtype=np.int32)
        self._remembered = len(alive)
        size = 1 << max(10, (2 * len(alive)).bit_length())
        self._table, self._cells = kernels.cases.remember(keys, cells, size)


def _spread_over(row: Intp, points: I64) -> Intp:
    """The points of each case whose surface is measured, evenly spread over its ``points``.

    Given each point's case.
    """
    order = np.argsort(row, kind="stable")
    rank = np.arange(len(row)) - np.repeat(np.cumsum(points) - points, points)
    shares = np.clip(points // MEASURED_EVERY, 1, MOST_MEASURED)[row[order]]
    of = points[row[order]]
    chosen: Intp = order[rank * shares % of < shares]
    return chosen


def pooled(rows: NDArray[np.void], by: tuple[str, ...]) -> tuple[NDArray[np.void], Intp]:
    """Pool rows with equal values in some fields.

    The pooled rows sorted by these, and the number of rows of each.
    """
    rows = rows[np.lexsort([rows[name] for name in by[::-1]])]
    changes = np.any([np.diff(rows[name]) != 0 for name in by], axis=0)
    starts = np.flatnonzero(np.append(len(rows) > 0, changes))[: len(rows)]
    found = rows[starts]
    if len(starts):
        for name in (
            "points",
            "cells",
            "touching",
            "ground",
            "surface",
            "grazed",
            "ranges",
            "reasons",
        ):
            found[name] = np.add.reduceat(rows[name], starts)
        for name in ("low", "near"):
            found[name] = np.minimum.reduceat(rows[name], starts)
        for name in ("high", "far"):
            found[name] = np.maximum.reduceat(rows[name], starts)
    return found, np.diff(np.append(starts, len(rows)))


def summed(rows: NDArray[np.void]) -> NDArray[np.void]:
    """One row per case, over all of its frames.

    ``frame`` is the one with the most points. Additional fields: ``first`` and ``last`` frame, the
    number of ``frames``, and ``moved``: metres between the mean centre of its first three frames
    and that of its last three.
    """
    rows = rows[np.lexsort((rows["frame"], rows["case"]))]
    found, frames = pooled(rows, ("case",))
    more = [("first", np.int64), ("last", np.int64), ("frames", np.int64), ("moved", np.float32)]
    total = np.zeros(len(found), np.dtype(rows.dtype.descr + more))
    for name in rows.dtype.names or ():
        total[name] = found[name]
    ends = np.cumsum(frames)
    starts = ends - frames
    total["frames"] = frames
    total["first"] = rows["frame"][starts]
    total["last"] = rows["frame"][ends - 1]
    most = np.lexsort((rows["frame"], -rows["points"], rows["case"]))
    worst = rows[most[starts]]
    total["frame"] = worst["frame"]
    for name in ("surface", "grazed"):  # of the frame whose points the ledger explains
        total[name] = worst[name] * total["points"] // worst["points"]
    centres = (rows["low"] + rows["high"]) / 2
    three = np.minimum(np.arange(3), frames[:, None] - 1)
    way = centres[ends[:, None] - 1 - three].mean(1) - centres[starts[:, None] + three].mean(1)
    total["moved"] = np.sqrt((way**2).sum(1))
    return total


def gathered(
    rows: NDArray[np.void], span: float
) -> tuple[NDArray[np.void], dict[int, float], dict[int, int]]:
    """Make one case of patches of ground of one group that are near each other, such as the arcs of
    one scan pattern.

    From the largest one on, each case of ground takes in the others that fit into the same ``span``
    metres along each axis and were seen at most ``GAP`` frames before or after it.

    Returns:
        The rows; by case that took in others the share of its points in its largest patch; and by
        case that was taken in, which one took it.
    """
    total = summed(rows)
    ground = total[2 * total["ground"] > total["points"]]
    ground = ground[np.argsort(-ground["points"], kind="stable")]
    into = {}
    largest = {}
    while len(ground):
        first = ground[0]
        rest = np.ones(len(ground), np.bool_)
        rest[0] = False
        low = first["low"]
        high = first["high"]
        points = int(first["points"])
        near = (ground["group"] == first["group"]) & (ground["first"] <= first["last"] + GAP)
        near &= (ground["last"] >= first["first"] - GAP) & rest
        for i in np.flatnonzero(near).tolist():
            both = np.minimum(low, ground["low"][i]), np.maximum(high, ground["high"][i])
            if (both[1] - both[0] <= span).all():
                (low, high) = both
                rest[i] = False
                points += int(ground["points"][i])
                into[int(ground["case"][i])] = int(first["case"])
        if points > first["points"]:
            largest[int(first["case"])] = float(first["points"]) / points
        ground = ground[rest]
    rows = rows.copy()
    rows["case"] = [into.get(case, case) for case in rows["case"].tolist()]
    return pooled(rows, ("case", "frame"))[0], largest, into


def facts(case: np.void, names: Sequence[str], grounded: bool) -> JoinedPoints:
    """What is known about a case without ground truth.

    Args:
        case: a row of ``summed``.
        names: of the reason codes.
        grounded: whether its points on the ground were counted.
    """
    points = int(case["points"])
    return JoinedPoints(
        points=points,
        first_frame=int(case["first"]),
        last_frame=int(case["last"]),
        worst_frame=int(case["frame"]),
        frames=int(case["frames"]),
        low=tuple(round(float(value), 2) for value in case["low"]),
        high=tuple(round(float(value), 2) for value in case["high"]),
        range=RangeSpan(
            round(float(case["near"]), 1),
            round(float(case["ranges"]) / points, 1),
            round(float(case["far"]), 1),
        ),
        moved=round(float(case["moved"]), 1),
        reasons={
            names[code]: int(case["reasons"][code])
            for code in np.argsort(-case["reasons"], kind="stable")
            if case["reasons"][code]
        },
        ground=round(float(case["ground"]) / points, 3) if grounded else None,
    )


def boxes(
    listed: Sequence[tuple[FailureCase | RemovedCluster, NDArray[np.void]]],
    outcomes: Sequence[Outcome],
    sample: CaseSample | None = None,
) -> FrameBoxes:
    """A box around each listed case, overall and in each of its frames.

    Args:
        listed: cases, at least one, each with its rows.
        outcomes: of the points of each case.
        sample: some of their points.
    """
    cases = [case for case, _ in listed]
    rows = np.concatenate([rows for _, rows in listed])
    low = np.array([case.low for case in cases], np.float32)
    high = np.array([case.high for case in cases], np.float32)
    number = np.repeat(np.arange(len(cases)), [len(rows) for _, rows in listed])
    labels = tuple(f"{number} {case.what}" for number, case in enumerate(cases, 1))
    return FrameBoxes(
        labels,
        np.array(outcomes, np.uint8),
        low,
        high,
        rows["frame"],
        number,
        rows["low"],
        rows["high"],
        rows["points"].astype(np.int64),
        sample,
    )

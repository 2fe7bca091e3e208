"""What a run removed; without ground truth also clusters of removed points, the most suspicious
first.
"""

from __future__ import annotations

from array import array
from collections.abc import Mapping
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from dynaviz import kernels
from dynaviz.arrays import F32, I64, Bool
from dynaviz.contracts.method import MethodInfo
from dynaviz.contracts.metric import Figure, Labelled
from dynaviz.contracts.scan import Label, Outcome
from dynaviz.scores.scores import RANGE_EDGES
from dynaviz.scores.sections import (
    CaseTotals,
    Removals,
    RemovedCluster,
    RemovedFrame,
    RemovedInterval,
)
from dynaviz.spatial.grid import in_key_range
from dynaviz_eval.attribution import is_ground, sized
from dynaviz_eval.behaviour import VisitedPlaces
from dynaviz_eval.cases import EDGE, GAP, KEEP, Cases, FramePoints, boxes, facts, summed
from dynaviz_eval.ground import on_ground, scan_heights, scan_squared_ranges
from dynaviz_eval.suspicion import MOVING, cluster_sentence, moved, suspicion

_FRAME = RemovedFrame.__struct_fields__
SPAN = 20.0  # metres: larger clusters are split, as are the holes of a run with ground truth


class RemovalsMetric:
    """Section ``removals``: removed points by reason, range and frame, for every run.

    A run without ground truth also has ``clusters``: at most 100, removed points that belong
    together as those of a failure case do, ranked by ``suspicion`` times number of points; of a
    comparison of drives, by number of points.
    """

    def __init__(self, info: MethodInfo) -> None:
        self._names = [*(reason.name for reason in info.reasons), "unknown code"]
        self._reasons = np.zeros(len(self._names), np.int64)
        self._range = np.zeros((2, len(RANGE_EDGES) + 1), np.int64)
        self._frames = array("q")  # of each: the columns of ``_FRAME``
        self._clusters: _Clusters | None = _Clusters(self._names, info.compares)

    def update(self, labelled: Labelled) -> Mapping[str, float]:
        """Add the points of one scan."""
        scan = labelled.scan
        removed = np.flatnonzero(labelled.dynamic)
        codes = np.minimum(labelled.reasons[removed], len(self._names) - 1)
        self._reasons += np.bincount(codes, minlength=len(self._names))
        squared = scan_squared_ranges(scan)
        self._range += _by_range(squared), _by_range(squared[removed])
        self._frames.extend([labelled.frame, scan.index, len(scan), len(removed)])
        if self._clusters and scan.labels is not None and (scan.labels != Label.UNLABELLED).any():
            self._clusters = None
        if self._clusters:
            self._clusters.add(labelled)
        return {}

    def finish(self) -> Mapping[str, Removals]:
        """The section."""
        ends = [0.0, *RANGE_EDGES, None]
        order = np.argsort(-self._reasons, kind="stable")
        frames = np.array(self._frames).reshape(-1, len(_FRAME))
        others = self._clusters.finish() if self._clusters else CaseTotals()
        section = Removals(
            points=int(frames[:, 2].sum()),
            removed=int(frames[:, 3].sum()),
            reasons={
                self._names[code]: int(self._reasons[code]) for code in order if self._reasons[code]
            },
            range=tuple(
                RemovedInterval(low=low, high=high, points=points, removed=removed)
                for low, high, points, removed in zip(
                    ends[:-1], ends[1:], *self._range.tolist(), strict=True
                )
            ),
            frame=tuple(RemovedFrame(*row) for row in frames.tolist()),
            clusters=tuple(cluster for cluster, _ in self._clusters.listed)
            if self._clusters
            else (),
            others=others,
        )
        return {"removals": section}

    def figures(self) -> Mapping[str, Figure]:
        """A box around each cluster, overall and in each of its frames.

        Empty for runs with ground truth.
        """
        if not self._clusters or not self._clusters.listed:
            return {}
        listed = self._clusters.listed
        return {"clusters": boxes(listed, [Outcome.UNLABELLED_REMOVED] * len(listed))}


class _Clusters:
    """Joins removed points of unknown truth into clusters."""

    def __init__(self, names: list[str], compares: bool) -> None:
        self.listed: list[tuple[RemovedCluster, NDArray[np.void]]] = []
        self._names = names
        self._compares = compares
        self._places = VisitedPlaces()
        self._frame = 0
        self._dropped = CaseTotals()
        self._cases = Cases(len(names), SPAN, self._drop)

    def add(self, labelled: Labelled) -> None:
        scan = labelled.scan
        self._frame = labelled.frame
        self._places.add(labelled.frame, scan.points)
        chosen = np.flatnonzero(labelled.dynamic)
        chosen = chosen[in_key_range(scan.points[chosen], EDGE)]
        ground = on_ground(scan_heights(scan))
        near = _next_to_kept(labelled, ground)[chosen]
        ground = ground[chosen]
        groups = ground.astype(np.int64)  # so that ground does not join the objects on it
        points = scan.points[chosen]
        ranges = np.sqrt(scan_squared_ranges(scan)[chosen])
        reasons = labelled.reasons[chosen]
        self._cases.add(FramePoints(labelled.frame, points, groups, reasons, ranges, near, ground))

    def finish(self) -> CaseTotals:
        """List the clusters; returns the totals of the others."""
        self._cases.settle(self._frame + GAP + 1)  # all clusters are over by then
        rows = self._cases.rows
        found = [self._described(case, rows[rows["case"] == case["case"]]) for case in summed(rows)]
        found.sort(key=self._order)
        self.listed = found[:KEEP]
        rest = found[KEEP:]
        points = sum(cluster.points for cluster, _ in rest)
        return self._dropped.plus(len(rest), points)

    def _order(self, found: tuple[RemovedCluster, Any]) -> tuple[Any, ...]:
        cluster, _ = found
        weight = 1.0 if self._compares else cluster.suspicion
        return -weight * cluster.points, cluster.first_frame, cluster.low

    def _described(
        self, case: np.void, rows: NDArray[np.void]
    ) -> tuple[RemovedCluster, NDArray[np.void]]:
        """A cluster, with its rows."""
        known = facts(case, self._names, True)
        if self._compares:  # what changed stood still: nothing tells whether that is right
            score = 0.0
            why = tuple[str, ...]()
            did = next(iter(known.reasons))
            what = "ground" if is_ground(case) else "object"
        else:
            score, why = suspicion(case, rows, self._places.visits(case["low"], case["high"]))
            did = "removed"
            what = sized(case, np.median(rows["high"] - rows["low"], axis=0))
            what = f"{MOVING} {what}" if moved(rows) else what
        cluster = RemovedCluster(
            **msgspec.structs.asdict(known),
            kept_near=round(float(case["touching"] / case["points"]), 3),
            suspicion=score,
            why=why,
            did=did,
            what=what,
        )
        return msgspec.structs.replace(cluster, sentence=cluster_sentence(cluster)), rows

    def _drop(self, over: NDArray[np.void]) -> None:
        self._dropped = self._dropped.plus(len(over), int(over["points"].sum()))


def _next_to_kept(labelled: Labelled, ground: Bool) -> Bool:
    """(N,) bool: removed points next to kept ones of the same kind.

    That a mover touches the ground means nothing.
    """
    removed = labelled.dynamic
    points = labelled.scan.points
    found: Bool = np.zeros(len(points), np.bool_)
    for kind in (ground, ~ground):
        found |= kernels.touching.cells(points, removed & kind, ~removed & kind, EDGE)
    return found


def _by_range(squared: F32) -> I64:
    """(5,) int64: number of points in each interval between ``RANGE_EDGES``, given
    squared ranges.
    """
    below = [np.count_nonzero(squared < edge * edge) for edge in RANGE_EDGES]
    return np.diff([0, *below, len(squared)])  # NaN counts in the last interval

"""The four counts by range, by height above the ground, by frame and by object."""

from __future__ import annotations

from array import array
from collections import defaultdict
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from dynaviz.arrays import F32, I64, U8
from dynaviz.contracts.method import MethodInfo
from dynaviz.contracts.metric import Figure, Labelled
from dynaviz.contracts.scan import Label, Outcome
from dynaviz.scores.scores import RANGE_EDGES, Counts
from dynaviz.scores.sections import Breakdown, FrameRow, IntervalRow, ObjectRow
from dynaviz_eval.ground import scan_heights, scan_squared_ranges

RANGES = (0.0, *RANGE_EDGES, np.inf)
HEIGHTS = (-np.inf, 0.2, 0.5, 1.0, 2.0, 4.0, np.inf)


class BreakdownMetric:
    """Section ``breakdown``.

    Lists ``range``, ``height``, ``frame`` and ``object`` with counts and percentages.

    Range and height bins include their lower edge, ``from``; None is an open end. Points without
    finite coordinates count in the last bin. An object's ``reasons`` are the reasons of its wrongly
    kept points, most frequent first.
    """

    def __init__(self, info: MethodInfo) -> None:
        self._range = np.zeros((len(RANGES) - 1, len(Outcome)), np.int64)
        self._height = np.zeros((len(HEIGHTS) - 1, len(Outcome)), np.int64)
        self._frames = array("q")  # of each: position, number, and points by outcome
        self._objects = _Objects([reason.name for reason in info.reasons])

    def update(self, labelled: Labelled) -> Mapping[str, float]:
        """Add the points of one scan."""
        scan = labelled.scan
        outcome = labelled.outcome
        self._range += _count_by_bin(np.sqrt(scan_squared_ranges(scan)), RANGES, outcome)
        self._height += _count_by_bin(scan_heights(scan), HEIGHTS, outcome)
        self._frames.extend(
            [labelled.frame, scan.index, *np.bincount(outcome, minlength=len(Outcome)).tolist()]
        )
        self._objects.add(labelled)
        return {}

    def finish(self) -> Mapping[str, Breakdown]:
        """The section."""
        frames = np.array(self._frames).reshape(-1, 2 + len(Outcome)).tolist()
        section = Breakdown(
            range=_rows(RANGES, self._range),
            height=_rows(HEIGHTS, self._height),
            frame=tuple(
                FrameRow(frame=frame, index=index, **Counts.of_histogram(counts).row())
                for frame, index, *counts in frames
            ),
            object=self._objects.rows(),
        )
        return {"breakdown": section}

    def figures(self) -> Mapping[str, Figure]:
        """None."""
        return {}


class _Objects:
    """Counts by class and instance.

    An object that stops, and changes its class because of that, starts a new row.
    """

    def __init__(self, reasons: Sequence[str]) -> None:
        self._names = [*reasons, "unknown code"]
        self._by_outcome: defaultdict[tuple[int, int], I64] = defaultdict(
            lambda: np.zeros(len(Outcome), np.int64)
        )
        self._by_reason: defaultdict[tuple[int, int], I64] = defaultdict(
            lambda: np.zeros(len(self._names), np.int64)
        )
        self._frames: dict[tuple[int, int], tuple[int, int]] = {}

    def add(self, labelled: Labelled) -> None:
        scan = labelled.scan
        if scan.labels is None or (scan.instances is None and scan.classes is None):
            return
        part_of_object = scan.labels == Label.DYNAMIC
        if scan.instances is not None:
            part_of_object |= scan.instances != 0
        chosen = np.flatnonzero(part_of_object)
        classes, instances = (
            np.int64(0) if ids is None else ids[chosen].astype(np.int64)
            for ids in (scan.classes, scan.instances)
        )
        keys, which = np.unique(classes << 32 | instances, return_inverse=True)
        outcome = labelled.outcome[chosen]
        reasons = np.minimum(labelled.reasons[chosen], len(self._names) - 1)
        kept = outcome == Outcome.FALSE_NEGATIVE
        by_outcome = _cross(which, len(keys), outcome, len(Outcome))
        by_reason = _cross(which[kept], len(keys), reasons[kept], len(self._names))
        for packed, counts, wrong in zip(keys.tolist(), by_outcome, by_reason, strict=True):
            key = divmod(packed, 1 << 32)
            self._by_outcome[key] += counts
            self._by_reason[key] += wrong
            self._frames[key] = self._frames.get(key, (labelled.frame, 0))[0], labelled.frame

    def rows(self) -> tuple[ObjectRow, ...]:
        """Objects with at least one dynamic point, most kept dynamic points first."""
        rows = []
        for (of_class, instance), by_outcome in self._by_outcome.items():
            counts = Counts.of_histogram(by_outcome)
            (first, last) = self._frames[of_class, instance]
            if counts.dynamic_removed + counts.dynamic_kept:
                wrong = self._by_reason[of_class, instance]
                by_name = {
                    self._names[k]: int(wrong[k])
                    for k in np.argsort(-wrong, kind="stable")
                    if wrong[k]
                }
                rows.append(
                    ObjectRow(
                        class_=of_class,
                        instance=instance,
                        first_frame=first,
                        last_frame=last,
                        points=int(by_outcome.sum()),
                        reasons=by_name,
                        **counts.row(),
                    )
                )
        return tuple(sorted(rows, key=lambda row: (-row.dynamic_kept, row.class_, row.instance)))


def _count_by_bin(values: F32, edges: tuple[float, ...], outcome: U8) -> I64:
    """(bins, outcomes) numbers of points."""
    bins = np.zeros(len(values), np.uint8)
    for edge in edges[1:-1]:
        bins += ~(values < edge)  # True for NaN, which counts in the last bin
    return _cross(bins, len(edges) - 1, outcome, len(Outcome))


def _cross(rows: Any, n_rows: int, columns: Any, n_columns: int) -> I64:
    """(n_rows, n_columns) numbers of points, from the row and the column of each point."""
    crossed = np.bincount(rows.astype(np.int64) * n_columns + columns, minlength=n_rows * n_columns)
    return crossed.reshape(n_rows, n_columns)


def _rows(edges: tuple[float, ...], by_outcome: I64) -> tuple[IntervalRow, ...]:
    ends = [None if np.isinf(edge) else edge for edge in edges]
    return tuple(
        IntervalRow(low=low, high=high, **Counts.of_histogram(counts).row())
        for low, high, counts in zip(ends[:-1], ends[1:], by_outcome, strict=True)
    )

"""What a drive showed of its moving objects, and what a method made of it.

A sample of points, chosen by a number that follows from frame and row, stands for all points.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from dynaviz.arrays import I64, Bool, Intp
from dynaviz.contracts.looks import AskedPlaces, CountedLooks
from dynaviz.contracts.method import Reason
from dynaviz.contracts.metric import Labelled
from dynaviz.contracts.scan import Label, Outcome
from dynaviz.scores.looks import Ceiling, Estimate, ObjectCeiling
from dynaviz_eval.causes import cause_of, looks_of_parts
from dynaviz_eval.samples import POINT, Sample, likely, priorities, records

POINTS = 2500  # dynamic points that stand for all
WRONG = 1000  # wrong points of each kind that stand for all of them
LISTED = 100  # objects
CONFIDENT = 1.96  # standard deviations: 95 %

KEPT = 1  # the groups of the samples
REMOVED = 2
DYNAMIC = 0


class Evident:
    """Samples of the dynamic, the kept dynamic and the removed static points of a run."""

    def __init__(self, reasons: Sequence[Reason]) -> None:
        self._reasons = reasons
        self._dynamic = Sample(POINTS)
        self._wrong = Sample(WRONG)
        self._counts = np.zeros(6, np.int64)
        self._sample = np.empty(0, POINT)

    def add(self, labelled: Labelled) -> None:
        """Add a scan with ground truth."""
        scan = labelled.scan
        if scan.labels is None:
            return
        self._counts += np.bincount(labelled.outcome, minlength=6)
        outcome = labelled.outcome
        kept = outcome == Outcome.FALSE_NEGATIVE
        strata: tuple[tuple[int, Bool, int], ...] = (
            (DYNAMIC, scan.labels == Label.DYNAMIC, POINTS),
            (KEPT, kept, WRONG),
            (REMOVED, outcome == Outcome.FALSE_POSITIVE, WRONG),
        )
        for group, chosen, wanted in strata:
            rows: Intp = np.flatnonzero(chosen)
            priority = priorities(labelled.frame, rows)
            sizes: I64 = np.full(len(rows), len(rows), np.int64)
            some = np.flatnonzero(likely(priority, sizes, wanted))
            some = some[np.isfinite(scan.points[rows[some]]).all(1)]
            own = rows[some]
            sample = self._dynamic if group == DYNAMIC else self._wrong
            sample.add(
                records(
                    labelled.frame, own, np.full(len(own), group), priority[some],
                    scan.points[own], None, labelled.reasons[own], labelled.dynamic[own],
                )
            )  # fmt: skip

    def places(self) -> AskedPlaces:
        """The sampled points."""
        self._sample = np.concatenate([self._dynamic.settle(), self._wrong.settle()])
        return asked_places(self._sample)

    def found(self, seen: CountedLooks, objects: Sequence[ObjectCeiling]) -> Ceiling:
        """The section, given the looks at the sampled points."""
        removed = int(self._counts[Outcome.DYNAMIC_REMOVED])
        kept = int(self._counts[Outcome.FALSE_NEGATIVE])
        dynamic = removed + kept
        holes = int(self._counts[Outcome.FALSE_POSITIVE])
        static = holes + int(self._counts[Outcome.STATIC_KEPT])
        evident = seen.through > 0
        group = self._sample["group"]
        answer = self._sample["removed"]
        of_all = group == DYNAMIC
        ceiling = Ceiling()
        if dynamic:
            ceiling = Ceiling(
                possible=estimate(evident[of_all], dynamic, dynamic),
                possible_by_object=_by_object(objects),
                removed_seen=estimate(evident[of_all & answer], removed, dynamic),
                removed_unseen=estimate(~evident[of_all & answer], removed, dynamic),
                kept_seen=estimate(evident[group == KEPT], kept, dynamic),
                kept_unseen=estimate(~evident[group == KEPT], kept, dynamic),
                objects=tuple(objects[:LISTED]),
            )
        ghosts = np.flatnonzero(group == KEPT)
        removed_static = np.flatnonzero(group == REMOVED)
        return msgspec.structs.replace(
            ceiling,
            lost_DA=self._lost("false_negative", ghosts, seen, kept, dynamic),
            lost_SA=self._lost("false_positive", removed_static, seen, holes, static),
        )

    def _lost(
        self, kind: str, rows: Intp, seen: CountedLooks, part: int, whole: int
    ) -> Mapping[str, Estimate]:
        """Wrong points by cause, in percentage points of the score that they cost."""
        counts = Counter[str]()
        words = [reason.cause for reason in self._reasons]
        codes = self._sample["reason"][rows].tolist()
        for code, looks in zip(codes, looks_of_parts(seen, rows[:, None]), strict=True):
            word = words[code] if code < len(words) else None
            counts[str(cause_of(kind, looks, word))] += 1
        return {
            cause: share(count, len(rows), part, whole) for cause, count in counts.most_common()
        }


def asked_places(sample: NDArray[Any], groups: I64 | None = None) -> AskedPlaces:
    """The places of sampled points; without groups unless given."""
    frames = sample["frame"].astype(np.int64)
    none = np.full(len(sample), -1, np.int64)
    return AskedPlaces(
        np.ascontiguousarray(sample["xyz"]), frames, none if groups is None else groups
    )


def estimate(found: Bool, part: int, whole: int) -> Estimate:
    """A part of all points that has a property, in percent of the whole.

    Args:
        found: (K,) bool: whether sampled points of the part have it.
        part, whole: numbers of points.
    """
    return share(int(np.count_nonzero(found)), len(found), part, whole)


def share(count: int, sampled: int, part: int, whole: int) -> Estimate:
    """``estimate`` of a count among sampled points."""
    if not sampled or not whole:
        return Estimate(0.0)
    p = count / sampled
    scale = 100.0 * part / whole
    rest = max(1.0 - sampled / part, 0.0)  # nothing is unsure if all were sampled
    error = CONFIDENT * np.sqrt(p * (1.0 - p) / sampled * rest)
    return Estimate(round(scale * p, 2), round(float(scale * error), 2))


def _by_object(objects: Sequence[ObjectCeiling]) -> Estimate | None:
    """The share of the points of objects with evidence at any of their sampled places."""
    points = sum(each.points for each in objects)
    known = sum(each.points for each in objects if each.seen_through > 0)
    return Estimate(round(100.0 * known / points, 2)) if points else None

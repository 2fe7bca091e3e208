"""Decisions, applied to the scans of a sequence."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from dynaviz.arrays import F64, I64, U8, Bool, Intp
from dynaviz.contracts.scan import Label, Scan
from dynaviz.errors import DataError
from dynaviz.reviews.decisions import LABELS, VERDICTS, Decisions, ReviewDecision, Seen
from dynaviz.reviews.regions import ObjectRegion, clock_of, time_of
from dynaviz.sources.drive import Drive

NONE = 255
"""Verdict of a point that no decision is about."""

STATIC, DYNAMIC, UNDECIDED = range(len(VERDICTS))
"""Verdicts of points, in the order of ``VERDICTS``."""

MANY = 8  # decisions in a scan, from which its points are sorted along x
ELSEWHERE = 1.0  # metres between positions of the sensor at one time: it is another world frame


@dataclass
class Effect:
    """What a decision did.

    Attributes:
        decision: the decision.
        points: points in its region.
        kept, removed: of them, those whose answer it changed.
    """

    decision: ReviewDecision
    points: int = 0
    kept: int = 0
    removed: int = 0


@dataclass
class ByHand:
    """What decisions did to the answers of a run.

    Attributes:
        effects: one for each decision that holds.
        kept, removed: points whose answer a decision changed.
    """

    effects: list[Effect] = field(default_factory=list)
    kept: int = 0
    removed: int = 0

    @property
    def unmatched(self) -> list[ReviewDecision]:
        """Decisions that no point was in the region of."""
        return [each.decision for each in self.effects if not each.points]

    def warning(self, path: str | os.PathLike[str]) -> str:
        """One line about decisions that match nothing; empty if each matches a point."""
        lost = self.unmatched
        if not lost:
            return ""
        named = "; ".join(each.sentence for each in lost[:3]) + ("; ..." if len(lost) > 3 else "")
        return (
            f"{os.fspath(path)}: {len(lost)} of {len(self.effects)} decisions match no point of "
            f"this sequence, and are left as they are: {named}"
        )


class Applied:
    """Decisions on the scans of a sequence.

    Args:
        decisions: those that hold, in order.
        origin: (3,) float64, metres: offset of the sequence's world.
        makes_truth: whether they are the ground truth of scans that have none.

    Attributes:
        by_hand: what ``answers`` did so far.
    """

    def __init__(
        self,
        decisions: Iterable[ReviewDecision],
        origin: F64 | None = None,
        makes_truth: bool = False,
    ) -> None:
        self._decisions = tuple(decisions)
        self._makes_truth = makes_truth
        self._other: frozenset[int] = frozenset()
        self._origin = np.zeros(3) if origin is None else origin
        self.by_hand = ByHand([Effect(each) for each in self._decisions])

    @classmethod
    def to(cls, sequence: Drive, decisions: Decisions, makes_truth: bool = False) -> Applied:
        """The decisions of a file on a sequence.

        Raises:
            DataError: if they were made in another world frame.
        """
        held = decisions.standing
        found = cls(held, sequence.origin, makes_truth)
        found._other = times_elsewhere(sequence, held, decisions.path)
        return found

    def __len__(self) -> int:
        return len(self._decisions)

    def verdicts(self, scan: Scan) -> U8:
        """(N,) uint8: what decisions say of each point, ``NONE`` where there is none."""
        return self._verdicts(scan)[0]

    def answers(self, scan: Scan, dynamic: Bool) -> tuple[Bool, U8]:
        """The answers of a run with the decisions, which are counted.

        Args:
            scan: a scan of the sequence.
            dynamic: (N,) bool, the answers of a method.

        Returns:
            (N,) bool, and the verdicts.
        """
        verdicts, which = self._verdicts(scan)
        decided = np.flatnonzero(which >= 0)
        if not len(decided):
            return dynamic, verdicts
        found = dynamic.copy()
        found[verdicts == STATIC] = False
        found[verdicts == DYNAMIC] = True
        kept = dynamic & ~found
        removed = found & ~dynamic
        self.by_hand.kept += int(kept.sum())
        self.by_hand.removed += int(removed.sum())
        total = len(self._decisions)
        of = which[decided]
        counts = (
            np.bincount(of, minlength=total),
            np.bincount(of, kept[decided], total).astype(np.int64),
            np.bincount(of, removed[decided], total).astype(np.int64),
        )
        for k in np.unique(of).tolist():
            effect = self.by_hand.effects[k]
            effect.points += int(counts[0][k])
            effect.kept += int(counts[1][k])
            effect.removed += int(counts[2][k])
        return found, verdicts

    def truth(self, scan: Scan) -> Scan:
        """The scan with the ground truth that decisions state.

        Points that its ground truth leaves unlabelled stay so. A scan without ground truth gets
        that of the decisions with ``makes_truth``, and is unlabelled elsewhere.
        """
        if scan.labels is None and not self._makes_truth:
            return scan
        verdicts = self.verdicts(scan)
        if scan.labels is not None and (verdicts == NONE).all():
            return scan
        if scan.labels is None:
            labels = np.full(len(scan), Label.UNLABELLED, np.uint8)
            known = np.ones(len(scan), np.bool_)
        else:
            labels = scan.labels.copy()
            known = labels != Label.UNLABELLED
        for name, label in LABELS.items():
            labels[known & (verdicts == VERDICTS.index(name))] = label
        labels[known & (verdicts == UNDECIDED)] = Label.UNLABELLED
        return dataclasses.replace(scan, labels=labels)

    def _verdicts(self, scan: Scan) -> tuple[U8, I64]:
        """(N,) uint8 verdicts, and (N,) int64 which decision holds, -1 for none."""
        verdicts = np.full(len(scan), NONE, np.uint8)
        which = np.full(len(scan), -1, np.int64)
        active: list[tuple[int, F64, F64]] = []
        for k, each in enumerate(self._decisions):
            if k in self._other or (each.span is not None and not each.span.contains(scan)):
                continue
            bounds = each.region.bounds(scan)
            if bounds is not None:
                offset = 0.0 if each.local else self._origin
                active.append((k, bounds[0] - offset, bounds[1] - offset))
        if not active:
            return verdicts, which
        chosen = _Chooser(scan.points, len(active) >= MANY)
        for k, low, high in active:
            rows = chosen(low, high)
            if not len(rows):
                continue
            each = self._decisions[k]
            offset = 0.0 if each.local else self._origin
            xyz = scan.points[rows].astype(np.float64) + offset
            rows = rows[each.region.contains(scan, xyz)]
            verdicts[rows] = VERDICTS.index(each.verdict)
            which[rows] = k
        return verdicts, which


class _Chooser:
    """Rows of points in boxes, of which there may be many."""

    def __init__(self, points: Any, many: bool) -> None:
        self._points = points
        self._order = np.argsort(points[:, 0], kind="stable") if many else None
        self._x = None if self._order is None else points[self._order, 0].astype(np.float64)

    def __call__(self, low: F64, high: F64) -> Intp:
        """(K,) rows of the points in a box, in order."""
        if self._order is None or self._x is None:
            x = self._points[:, 0]
            rows = np.flatnonzero((x >= low[0]) & (x <= high[0]))
        else:
            first = np.searchsorted(self._x, low[0])
            rows = np.sort(self._order[first : np.searchsorted(self._x, high[0], "right")])
        for axis in (1, 2):
            values = self._points[rows, axis]
            rows = rows[(values >= low[axis]) & (values <= high[axis])]
        return rows


def times_elsewhere(
    sequence: Drive, decisions: Sequence[ReviewDecision], path: str | os.PathLike[str]
) -> frozenset[int]:
    """Which decisions are about times of another drive than a sequence, by position in the list.

    They state where the sensor was when it saw what they are about. A stamp with a date, or the
    name of the sequence, tells that it is the same drive.

    Raises:
        DataError: if it is the same drive, but in another world frame.
    """
    origin = sequence.origin
    away: dict[str, float | None] = {}
    for each in decisions:
        if each.seen is not None and each.by not in away:
            scan = _scan_at(sequence, each)
            here = None if scan is None else scan.position + (0.0 if each.local else origin)
            away[each.by] = (
                None if here is None else float(np.linalg.norm(here - np.array(each.seen.position)))
            )
            metres = away[each.by]
            if metres is not None and metres > ELSEWHERE and _same_drive(each, sequence):
                problem = (
                    f"was made in another world frame than that of {sequence.name}: the sensor is "
                    f"{metres:,.1f} m away from where it was at that time"
                )
                hint = "Give the poses with which the decisions were made (--poses)"
                raise DataError(path, problem, hint=hint)
    return frozenset(
        k
        for k, each in enumerate(decisions)
        if (isinstance(each.region, ObjectRegion) or each.span is not None)
        and each.seen is not None
        and not _same_drive(each, sequence)
        and ((metres := away[each.by]) is None or metres > ELSEWHERE)
    )


def seen_in(sequence: Drive, position: int) -> Seen:
    """Where the sensor is in a frame, for a decision."""
    scan = sequence[position]
    clock = clock_of(scan)
    time = time_of(scan, clock)
    assert time is not None
    place = scan.position + sequence.origin
    return Seen(clock, time, tuple(place.tolist()), sequence.name)


def _same_drive(decision: ReviewDecision, sequence: Drive) -> bool:
    """Whether times of a decision are certainly those of a sequence, if it has them."""
    seen = decision.seen
    return seen is not None and (seen.dated or seen.sequence in ("", sequence.name))


def _scan_at(sequence: Drive, decision: ReviewDecision) -> Scan | None:
    """The scan from which a decision's part was seen; None if there is none of that time.

    Scans are taken to be in the order of time.
    """
    seen = decision.seen
    assert seen is not None
    low = 0
    high = len(sequence)
    slack = 1_000_000 if seen.clock == "stamp" else 0
    while low < high:
        middle = (low + high) // 2
        scan = sequence[middle]
        time = time_of(scan, seen.clock)
        if time is None:
            return None
        if abs(time - seen.time) <= slack:
            return scan
        if time < seen.time:
            low = middle + 1
        else:
            high = middle
    return None

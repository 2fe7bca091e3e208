"""Failure cases that are new or cost more than in an earlier run on the same data."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from dynaviz.scores.failure_case import FailureCase
from dynaviz.scores.result import Result

STORED_CASES = 10  # of a run in a baseline, the costliest
WORTH = 0.05  # percentage points: a smaller change of a case's cost is not listed
LISTED = 10  # of a run, at most
PAD = 0.1  # metres: boxes of flat cases have a volume


@dataclass(frozen=True, slots=True)
class ChangedCase:
    """A failure case that is new or grew.

    Attributes:
        number: of the case in its run, 1 for the first.
        case: as it is now.
        before: percentage points that its object or place cost before; 0 if it is new.
        recording: of the run; None if it has none.
    """

    number: int
    case: FailureCase
    before: float
    recording: Path | None

    @property
    def grown(self) -> float:
        """Percentage points that it costs more than before."""
        return self.case.cost - self.before

    @property
    def text(self) -> str:
        """What it is, what it costs, and where, in a line."""
        case = self.case
        was = f"was {self.before:.2f} %" if self.before else "new"
        one = case.first_frame == case.last_frame
        frames = (
            f"frame {case.first_frame}" if one else f"frames {case.first_frame}-{case.last_frame}"
        )
        cause = f", {case.cause}" if case.cause else ""
        return (
            f"case {self.number}: {case.what}, {case.cost:.2f} % of {case.metric} ({was}), "
            f"{case.range.mean:.0f} m away, {frames}{cause}"
        )

    @property
    def command(self) -> str | None:
        """What opens the recording at the case; None without a recording."""
        if self.recording is None:
            return None
        path = shlex.quote(str(self.recording))
        return f"dynaviz view {path} --case {self.number} -o case_{self.number}.png"


def changed_cases(now: Result, before: Result, recording: Path | None) -> list[ChangedCase]:
    """The cases that are new or grew, those that grew most first.

    Of a baseline, only the costliest cases are known: a case that costs no more than any of them
    may have been there before, and is not listed.

    Args:
        now: the later run.
        before: the earlier run on the same data, or its entry in a baseline.
        recording: of the later run.
    """
    if before.sections.failures is None:
        return []
    known = before.failures
    unknown = known[-1].cost if len(known) == STORED_CASES else 0.0
    left = [case.cost for case in known]
    places = [_places(case, known) for case in now.failures]
    # each case first takes what the most similar one cost, or one that grew would take from others
    cost = [
        _take(left, same[:1], case.cost) for case, same in zip(now.failures, places, strict=True)
    ]
    found = []
    for k, (case, same) in enumerate(zip(now.failures, places, strict=True)):
        cost[k] += _take(left, same[1:], case.cost - cost[k])
        change = ChangedCase(k + 1, case, cost[k], recording)
        if change.grown >= WORTH and case.cost > unknown:
            found.append(change)
    found.sort(key=lambda each: -each.grown)
    return found[:LISTED]


def _places(case: FailureCase, known: Sequence[FailureCase]) -> list[int]:
    """Positions of the earlier cases of the same object or place, the most similar one first."""
    same = [k for k, other in enumerate(known) if same_place(case, other)]
    return sorted(same, key=lambda k: -_likeness(case, known[k]))


def _likeness(case: FailureCase, other: FailureCase) -> float:
    """How much of their boxes two cases share: 1 for the same box."""
    shared = 1.0
    joined = 1.0
    for low, high, first, last in zip(case.low, case.high, other.low, other.high, strict=True):
        shared *= max(min(high, last) - max(low, first), 0.0) + PAD
        joined *= max(high, last) - min(low, first) + PAD
    return shared / joined


def _take(left: list[float], same: Sequence[int], cost: float) -> float:
    """Take what a case costs from what the earlier ones of its object or place cost."""
    taken = 0.0
    for k in same:
        part = min(left[k], cost - taken)
        left[k] -= part
        taken += part
    return taken


def same_place(case: FailureCase, other: FailureCase) -> bool:
    """Whether two cases are of one object, or of one place and time where objects are unknown."""
    if case.kind != other.kind:
        return False
    if case.instance and other.instance:
        return (case.class_, case.instance) == (other.class_, other.instance)
    at_once = case.first_frame <= other.last_frame and other.first_frame <= case.last_frame
    return at_once and _overlap(case, other)


def _overlap(case: FailureCase, other: FailureCase) -> bool:
    sides: Sequence[tuple[float, float, float, float]] = list(
        zip(case.low, case.high, other.low, other.high, strict=True)
    )
    return all(low <= last and first <= high for low, high, first, last in sides)

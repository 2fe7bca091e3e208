"""The cases that a recording shows.

The costliest failures, or what looks suspicious without ground truth.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np

from dynaviz.arrays import F32, F64, I64, Bool
from dynaviz.contracts.metric import Figure, FrameBoxes
from dynaviz.contracts.scan import Outcome, Scan
from dynaviz.scores.failure_case import FailureCase
from dynaviz.scores.result import Result
from dynaviz.scores.sections import RemovedCluster
from dynaviz.scores.spans import Spans, in_words

LISTED = 20  # cases in the list and in the map, at most ...
WORTH = 0.01  # ... that cost at least this share of the first one
# figures with the boxes of cases
FAILURES = "failures"
CLUSTERS = "clusters"
POINTS = "points"
DID = {"false_positive": "removed", "false_negative": "kept"}
REASONS = 3  # named in the text of a case
# outcomes of the points of cases
WRONG = (
    Outcome.FALSE_POSITIVE,
    Outcome.FALSE_NEGATIVE,
    Outcome.UNLABELLED_REMOVED,
)


@dataclass(frozen=True, slots=True, eq=False)
class ShownCase:
    """A case of the timeline ``case``.

    Attributes:
        number: its index, 1 for the first.
        title: what it is, in a few words.
        outcome: of its points.
        frame: position in the run of its worst frame.
        low, high: (3,) float64, metres, world frame: its box in that frame.
        lost: what it costs: percentage points of SA or of DA; without ground truth, the number of
            removed ``points``.
        text: Markdown, without evidence.
        spans: of frames by state, as in ``FailureCase``.
        failure: the case, with ground truth.
    """

    number: int
    title: str
    outcome: Outcome
    frame: int
    low: F64
    high: F64
    lost: Mapping[str, float]
    text: str
    spans: Spans
    failure: FailureCase | None = None

    @property
    def cost_of_point(self) -> float:
        """What one of its points costs; without ground truth 1."""
        return self.failure.cost / max(self.failure.points, 1) if self.failure else 1.0

    @property
    def label(self) -> str:
        """Number and title."""
        return f"{self.number} {self.title}"


def listed(result: Result) -> list[FailureCase]:
    """The costliest failure cases."""
    return [
        case for case in result.failures[:LISTED] if case.cost >= WORTH * result.failures[0].cost
    ]


def suspicious(result: Result) -> list[RemovedCluster]:
    """The most suspicious clusters of removed points; none if the run had ground truth."""
    removals = result.sections.removals
    return list(removals.clusters[:LISTED]) if removals else []


def belong(failure: FailureCase, scan: Scan, rows: I64) -> Bool:
    """(K,) bool: which points of a scan are of the class and object of a case, as far as these are
    known.
    """
    of_case = np.ones(len(rows), np.bool_)
    for number, numbers in (
        (failure.class_, scan.classes),
        (failure.instance, scan.instances),
    ):
        if number is not None and numbers is not None:
            of_case &= numbers[rows] == number
    return of_case


def middle_of(xyz: F32 | F64) -> int:
    """Row of the point in the middle of (N, 3) points, N >= 1.

    The explorer explains it when it opens the case.
    """
    return int(np.argmin(((xyz - np.median(xyz.astype(np.float64), axis=0)) ** 2).sum(1)))


def boxes_of(result: Result, figures: Mapping[str, Figure]) -> FrameBoxes | None:
    """The boxes of the shown cases by frame; None if no case is shown or no metric located them."""
    boxes = figures.get(FAILURES if listed(result) else CLUSTERS)
    return boxes if isinstance(boxes, FrameBoxes) else None


def shown(result: Result, boxes: FrameBoxes) -> list[ShownCase]:
    """The cases to show, in the order of their boxes."""
    failures = listed(result)
    clusters = suspicious(result)
    if failures:
        texts = [(title_of(case), {case.metric: case.cost}, _failure_text(case, i, len(failures)))
                 for i, case in enumerate(failures, 1)]  # fmt: skip
    else:
        texts = [
            (title_of(case), {POINTS: float(case.points)}, _cluster_text(case, i, len(clusters)))
            for i, case in enumerate(clusters, 1)
        ]
    cases = []
    found = cast("list[FailureCase | RemovedCluster]", [*failures, *clusters])
    for i, (case, (title, lost, text)) in enumerate(zip(found, texts, strict=False)):
        row = np.flatnonzero((boxes.case == i) & (boxes.frames == case.worst_frame))
        low, high = (
            (boxes.box_low[row[0]], boxes.box_high[row[0]]) if len(row) else (case.low, case.high)
        )
        corners = np.asarray(low, np.float64), np.asarray(high, np.float64)
        failure = case if isinstance(case, FailureCase) else None
        spans = failure.spans if failure else {}
        outcome = Outcome(boxes.outcomes[i])
        cases.append(
            ShownCase(i + 1, title, outcome, case.worst_frame, *corners, lost, text, spans, failure)
        )
    return cases


def title_of(case: FailureCase | RemovedCluster) -> str:
    """What happened to what, in a few words."""
    return f"{DID[case.kind] if isinstance(case, FailureCase) else case.did} {case.what}".strip()


def _failure_text(case: FailureCase, number: int, count: int) -> str:
    title = f"#### {number} of {count}: {title_of(case)}, {case.cost:.2f} % of {case.metric}"
    given = shares(case.reasons)
    cause = f"{case.cause}: {given}" if case.cause else given
    lines = [("Cause", cause), ("Worst frame", _frame(case)), ("Over time", in_words(case.spans))]
    return f"{title}\n\n{case.sentence}\n\n{_bullets(lines)}"


def _cluster_text(case: RemovedCluster, number: int, count: int) -> str:
    """Its sentence already states what is suspicious."""
    title = f"#### {number} of {count}: {title_of(case)}, {case.points:,} points"
    lines = [("Reasons", shares(case.reasons)), ("Worst frame", _frame(case))]
    return f"{title}\n\n{case.sentence} No ground truth: judge for yourself.\n\n{_bullets(lines)}"


def _frame(case: FailureCase | RemovedCluster) -> str:
    span = (
        ""
        if case.first_frame == case.last_frame
        else f" of {case.first_frame} to {case.last_frame}"
    )
    return f"{case.worst_frame}{span}"


def shares(reasons: Mapping[str, int]) -> str:
    """The most frequent reasons with their shares."""
    total = sum(reasons.values())
    return ", ".join(
        f"{name.replace('_', ' ')} {100 * n / total:.0f} %"
        for name, n in list(reasons.items())[:REASONS]
    )


def _bullets(lines: Sequence[tuple[str, str]]) -> str:
    return "\n".join(f"- **{name}**: {text}" for name, text in lines if text)

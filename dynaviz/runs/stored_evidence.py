"""Evidence that the recording of a run stores: found by case, point or place."""

from __future__ import annotations

import contextlib
import dataclasses
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from dynaviz.arrays import F32
from dynaviz.contracts.scan import ErrorKind, Label
from dynaviz.contracts.scan import Sequence as Scans
from dynaviz.errors import DataError, UsageError
from dynaviz.explain.case_evidence import evidence_text
from dynaviz.explain.document import Why, cause_at
from dynaviz.explain.point_ledger import PointLedger
from dynaviz.runs.run import Run
from dynaviz.scores.case_points import CasePoints
from dynaviz.scores.failure_case import FailureCase
from dynaviz.scores.sections import RemovedCluster
from dynaviz.views.cases import WRONG, middle_of, title_of
from dynaviz.views.read.reader import RunRecording

NEAR = 0.5  # metres: a place farther from every point asks about none
EARLIER = (
    "The recording is of an earlier version and lacks the numbers of single scans: add --again to "
    "repeat the run."
)


@dataclass(frozen=True, slots=True)
class Question:
    """What a user asks about: a point, a case, or the point nearest to a place.

    Attributes:
        frame, point, case, near: as for ``why``.

    Raises:
        UsageError: unless it is exactly one of them.
    """

    frame: int | None
    point: int | None
    case: int | None
    near: tuple[float, float, float] | None

    def __post_init__(self) -> None:
        ways = (self.point is not None, self.case is not None, self.near is not None)
        if sum(ways) != 1:
            raise UsageError(
                "ask about one thing: --frame F --point P, --case N, or --near X,Y,Z with or "
                "without --frame F"
            )
        if self.point is not None and self.frame is None:
            raise UsageError(f"point {self.point}: give its frame, too: --frame F")
        if self.case is not None and self.frame is not None:
            raise UsageError("--case N is explained in its worst frame: leave out --frame")


@dataclass(frozen=True, slots=True)
class Found:
    """What a recording has for a question.

    Attributes:
        ledger: that answers it; None if none does.
        case: number of the case that was asked about, or that contains the point; None if none.
        ledgers: all of that case.
        place: frame and row of the point; None if only the sequence knows it.
    """

    ledger: PointLedger | None
    case: int | None = None
    ledgers: tuple[PointLedger, ...] = ()
    place: tuple[int, int] | None = None


class Stored:
    """The evidence in the recording of a run, if it has one."""

    def __init__(self, run: Run) -> None:
        self._run = run
        self._recording: RunRecording | None = None
        with contextlib.suppress(DataError, UsageError):  # not recorded
            self._recording = run.recording

    @property
    def recorded(self) -> bool:
        """Whether the run has a recording."""
        return self._recording is not None

    @property
    def cases(self) -> Sequence[FailureCase | RemovedCluster]:
        """The cases of the run; without ground truth the clusters of removed points."""
        result = self._run.result
        return result.failures or result.clusters

    def ledgers(self, case: int) -> tuple[PointLedger, ...]:
        """Those of a case, 1 for the first; none if none are stored."""
        return () if self._recording is None else self._recording.ledgers(case)

    def find(self, asked: Question) -> Found:
        """The answer to a question, or the point that it is about.

        Raises:
            UsageError: for a case that does not exist.
        """
        if asked.case is not None:
            return self._case(asked.case)
        if asked.near is not None:
            return self._near(asked.near, asked.frame)
        assert asked.frame is not None
        assert asked.point is not None
        place = asked.frame, asked.point
        for case, ledgers in self._of_frame(asked.frame):
            for ledger in ledgers:
                if ledger.point == asked.point:
                    return Found(ledger, case, ledgers, place)
        return Found(None, place=place)

    def place_in_sequence(self, asked: Question, sequence: Scans) -> tuple[int, int]:
        """Frame and row of a point that the recording does not know.

        Raises:
            UsageError: if there is none.
        """
        if asked.case is not None:
            case = self.cases[asked.case - 1]
            scan = sequence[case.worst_frame]
            removed = self._run.labels[case.worst_frame]
            inside = (scan.points >= np.array(case.low) - 0.01).all(1)
            inside &= (scan.points <= np.array(case.high) + 0.01).all(1)
            if isinstance(case, FailureCase) and scan.labels is not None:
                ghost = case.kind == "false_negative"
                inside &= scan.labels == (Label.DYNAMIC if ghost else Label.STATIC)
                inside &= removed != ghost
            else:
                inside &= removed
            rows = np.flatnonzero(inside)
            if len(rows):
                return case.worst_frame, int(rows[middle_of(scan.points[rows])])
            raise UsageError(f"case {asked.case}: its worst frame has no such point")
        assert asked.near is not None
        if asked.frame is None or not 0 <= asked.frame < len(sequence):
            raise UsageError(
                f"{_place(asked.near)}: no recorded point is within {NEAR:g} m. Give the frame, "
                f"too: --frame F, from 0 to {len(sequence) - 1}"
            )
        row, metres = _nearest(sequence[asked.frame].points, asked.near)
        if metres > NEAR:
            raise UsageError(
                f"{_place(asked.near)}: frame {asked.frame} has no point within {NEAR:g} m; the "
                f"nearest is {metres:.1f} m away"
            )
        return asked.frame, row

    def document(
        self,
        ledger: PointLedger,
        case: int | None = None,
        ledgers: Sequence[PointLedger] = (),
    ) -> Why:
        """The document on a stored point, and on the case that was asked about."""
        result = self._run.result
        recording = self._recording
        assert recording is not None
        ledger = self.with_case(ledger)
        notes = EARLIER if _is_earlier(ledger) else "", self.doubt(ledger)
        return Why(
            result.method,
            str(recording.properties["title"]),
            result.sequence.name,
            result.online,
            ledger,
            cause_at(result, ledger),
            " ".join(note for note in notes if note),
            "" if case is None else self.about(case, ledgers),
        )

    def about(self, number: int, ledgers: Sequence[PointLedger]) -> str:
        """What a case is, and the evidence on all of its points, in sentences."""
        case = self.cases[number - 1]
        failure = case if isinstance(case, FailureCase) else None
        cost = f"{failure.cost:.2f} % of {failure.metric}" if failure else f"{case.points:,} points"
        return (
            f"Case {number} of {len(self.cases)}: {title_of(case)}, {cost}. {case.sentence} "
            f"{evidence_text(ledgers, failure)}"
        )

    def with_case(self, ledger: PointLedger) -> PointLedger:
        """The ledger of a wrong point with the number of its case, if that is listed."""
        if not ledger.wrong or ledger.case is not None:
            return ledger
        for case, ledgers in self._of_frame(ledger.frame):
            if any(each.point == ledger.point for each in ledgers):
                return dataclasses.replace(ledger, case=case)
        owner = self._points.owner(kind_of(ledger), ledger.frame, ledger.position)
        return dataclasses.replace(ledger, case=owner)

    def doubt(self, ledger: PointLedger) -> str:
        """That the case of a point is not certain, in a sentence; empty if it is."""
        if not ledger.wrong or self._points.sample is not None:
            return ""
        cases = self._points.around(kind_of(ledger), ledger.frame, ledger.position)
        if cases < 2:
            return ""
        return (
            f"It may be of another case: it lies in the boxes of {cases} cases, and no recording "
            "of this run stores the points of cases."
        )

    @cached_property
    def _points(self) -> CasePoints:
        if self._recording is None:
            return CasePoints(self._run.result.failures)
        return self._recording.case_points

    def _case(self, number: int) -> Found:
        if not 1 <= number <= len(self.cases):
            raise UsageError(f"case {number}: the run has the cases 1 to {len(self.cases)}")
        ledgers = self.ledgers(number)
        if not ledgers:
            return Found(None, number)
        case = self.cases[number - 1]
        reason = case.reason if isinstance(case, FailureCase) else None
        chosen = [each for each in ledgers if each.reason.name == reason] or list(ledgers)
        middle = chosen[middle_of(np.array([each.position for each in chosen]))]
        return Found(middle, number, ledgers, (middle.frame, middle.point))

    def _near(self, place: tuple[float, float, float], frame: int | None) -> Found:
        best = (NEAR, Found(None))
        for case in range(1, len(self.cases) + 1):
            if frame is not None and self.cases[case - 1].worst_frame != frame:
                continue
            ledgers = self.ledgers(case)
            for ledger in ledgers:
                metres = math.dist(ledger.position, place)
                if metres < best[0]:
                    found = Found(ledger, case, ledgers, (ledger.frame, ledger.point))
                    best = metres, found
        if best[1].ledger is not None or self._recording is None:
            return best[1]
        for drawn in self._recording.drawn():
            if frame is not None and drawn.frame != frame:
                continue
            rows = np.arange(len(drawn.xyz))
            if frame is None:
                rows = np.flatnonzero(np.isin(drawn.outcome, WRONG))
            if len(rows):
                row, metres = _nearest(drawn.xyz[rows], place)
                if metres < best[0]:
                    point = int(drawn.point[rows[row]])
                    best = metres, Found(None, place=(drawn.frame, point))
        return best[1]

    def _of_frame(self, frame: int) -> Iterator[tuple[int, tuple[PointLedger, ...]]]:
        """The cases with this worst frame, and their ledgers."""
        for number, case in enumerate(self.cases, 1):
            if case.worst_frame == frame:
                yield number, self.ledgers(number)


def kind_of(ledger: PointLedger) -> ErrorKind:
    """The kind of error of a wrong point."""
    return "false_positive" if ledger.removed else "false_negative"


def _nearest(points: F32, place: tuple[float, float, float]) -> tuple[int, float]:
    """Row of the nearest point, and its distance, metres; infinite without any."""
    squared = ((points.astype(np.float64) - np.array(place)) ** 2).sum(1)
    if not np.isfinite(squared).any():
        return -1, math.inf
    row = int(np.nanargmin(squared))
    return row, math.sqrt(squared[row])


def _place(place: tuple[float, float, float]) -> str:
    return ",".join(f"{x:g}" for x in place)


def _is_earlier(ledger: PointLedger) -> bool:
    """Whether a ledger lacks the numbers of single scans, as in earlier recordings."""
    lasting = [
        rule
        for rule in ledger.rules
        if rule.frame is not None and any(term.value is not None for term in rule.terms)
    ]
    return bool(lasting) and not any(entry.terms for entry in ledger.entries)

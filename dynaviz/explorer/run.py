"""A recorded run as the explorer sees it.

Its cases, and the truth, answer and reason of any point.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from functools import cached_property
from typing import Any

import numpy as np

from dynaviz.arrays import F32, F64, I64, U8, Bool
from dynaviz.contracts import registry
from dynaviz.contracts.scan import ERRORS, TRUTH, ErrorKind, Outcome
from dynaviz.errors import DataError, UsageError
from dynaviz.explain.dial import Dial
from dynaviz.explain.document import sentence
from dynaviz.explain.judging import Parameter
from dynaviz.explain.point_ledger import PointLedger
from dynaviz.runs.run import open_run
from dynaviz.scores.comparison.frame_answers import FrameAnswers
from dynaviz.scores.result import Result
from dynaviz.views import paths
from dynaviz.views.cases import WRONG
from dynaviz.views.read.focus import Focus
from dynaviz.views.read.reader import DrawnPoints, viewable

NEAR = 0.5  # metres: a click farther from every point of a frame asks about none
# of all frames; none is right and kept
GATHERED = (
    paths.MAP_WRONG,
    paths.REMOVED,
    paths.REMOVED_WRONG,
)
OUTCOMES = {  # of a point by whether it was removed, and whether that is right
    (True, True): Outcome.DYNAMIC_REMOVED,
    (True, False): Outcome.FALSE_POSITIVE,
    (False, True): Outcome.STATIC_KEPT,
    (False, False): Outcome.FALSE_NEGATIVE,
}

START = 1.0  # seconds: a replay opens the sequence, and loads the kernels of the method


class ExploredRun:
    """A recorded run, in memory.

    Args:
        run: its folder, ``result.json`` or ``run.rrd``; or a result with a recording.

    Attributes:
        run: the run.
        path: of the recording.
        recording, result: of the run.
        frames: number of frames.

    Raises:
        DataError: for a recording that cannot be read, is of a run that did not finish, or contains
            no points.
    """

    def __init__(self, run: str | os.PathLike[str] | Result):
        self.run = open_run(run)
        self.path = self.run.recording_file
        viewable(self.path)
        self.recording = self.run.recording
        if self.recording.properties["mode"] == "scores":
            hint = "Run the method again with --record errors"
            raise DataError(
                self.path, "contains scores alone, without points to explore", hint=hint
            )
        self.result: Result = self.run.result
        self.frames = self.recording.frames
        self._drawn: dict[int, DrawnPoints] = {
            drawn.frame: drawn for drawn in self.recording.drawn() if len(drawn.xyz)
        }
        self._answers: dict[int, FrameAnswers] = {
            answers.frame: answers for answers in self.recording.answers()
        }
        self._reasons = self.recording.reasons
        self._ledgers: dict[int, tuple[PointLedger, ...]] = {}
        for frame, drawn in self._drawn.items():
            answered = len(self._answers[frame]) if frame in self._answers else 0
            if ((drawn.point < 0) | (drawn.point >= answered)).any():
                hint = f"Save all other parts with: dynaviz info {self.path}"
                raise DataError(
                    self.path, "contains points without an answer", at=f"frame {frame}", hint=hint
                )

    @property
    def compares(self) -> bool:
        """Whether "removed" means that a point changed between two drives.

        Its reason then names its answer.
        """
        return self.recording.compares

    @property
    def passes(self) -> tuple[str, ...]:
        """Phases in which a replay passes over all scans."""
        one = self.result.online or self.result.sections.source is not None
        return ("survey", "label") if one else ("survey", "observe", "label")

    @property
    def replay_s(self) -> float | None:
        """Seconds that a replay takes, by what its passes took when the run was recorded.

        None if unknown.
        """
        measured = self.recording.properties.get("repeat_s")
        return None if measured is None else float(measured) + START

    @cached_property
    def dial(self) -> Dial | None:
        """Turns the parameters of the run; None if its recording has no sample of points."""
        sample = self.recording.sample
        if sample is None:
            return None
        cases = self.result.failures
        return Dial(sample, cases, [self.ledgers(case) for case in range(1, len(cases) + 1)])

    @property
    def sliders(self) -> tuple[Parameter, ...]:
        """Those of the whole run, none without a sample."""
        return () if self.recording.sample is None else self.recording.sample.parameters

    @property
    def title(self) -> str:
        """Of the method."""
        return str(self.recording.properties["title"])

    @cached_property
    def focus(self) -> Focus:
        """Writes layouts and marks for the viewer."""
        known = self.result.method in registry.loadable("methods")
        return Focus(
            self.recording, registry.load("methods", self.result.method).info if known else None
        )

    @cached_property
    def map(self) -> F32:
        """(N, 3) float32, metres, world frame: the kept points of the whole run, thinned."""
        found: F32 = self.recording.static(paths.MAP).get(
            "Points3D:positions", np.zeros((0, 3), np.float32)
        )
        return found

    @cached_property
    def wrong(self) -> WrongPoints:
        """The drawn points that are wrong; without ground truth, those that were removed."""
        return WrongPoints(list(self._drawn.values()))

    def index_of(self, frame: int) -> int:
        """The number in the data set of a frame of the run."""
        return self._answers[frame].index

    def drawn(self, frame: int) -> DrawnPoints | None:
        """The drawn points of a frame."""
        return self._drawn.get(frame)

    def clicked(
        self, entity: str, instance: int | None, frame: int, position: F64
    ) -> tuple[int, int]:
        """Frame and row of a clicked point.

        Args:
            entity: its path in the recording.
            instance: its number there.
            frame: position in the run at which it was clicked.
            position: (3,) metres, world frame.

        Raises:
            UsageError: if no recorded point is there.
        """
        drawn = self._drawn.get(frame)
        if (
            entity == paths.SCAN
            and drawn is not None
            and instance is not None
            and instance < len(drawn.point)
        ):
            return frame, int(drawn.point[instance])
        if drawn is not None and (row := _nearest(drawn.xyz, position)) is not None:
            return frame, int(drawn.point[row])
        if entity in GATHERED and (found := _nearest(self.wrong.xyz, position)) is not None:
            return int(self.wrong.frame[found]), int(self.wrong.point[found])
        raise UsageError(
            "correct points are not stored individually. Record the run with --record full"
        )

    def point(
        self, frame: int, point: int, corrections: Mapping[int, str] | None = None
    ) -> dict[str, Any]:
        """Truth, answer and reason of a point, in plain types.

        Args:
            frame: position in the run.
            point: row in its scan.
            corrections: of the truth, by number of the case.

        Raises:
            UsageError: for a frame or point that does not exist.
        """
        answers = self._answers.get(frame)
        if answers is None:
            raise UsageError(f"frame {frame}: the run has the frames 0 to {self.frames - 1}")
        if not 0 <= point < len(answers):
            raise UsageError(f"point {point}: frame {frame} has the points 0 to {len(answers) - 1}")
        reason = self._reasons[answers.reasons[point]]
        truth = TRUTH.get(int(answers.truth[point]))
        removed = bool(answers.dynamic[point])
        outcome = Outcome(answers.outcome[point])
        position = self._position(frame, point)
        number = 0
        if position is not None and outcome in ERRORS.values():
            kind: ErrorKind = "false_positive" if removed else "false_negative"
            number = self.recording.case_points.owner(kind, frame, position) or 0
        cause = self.result.failures[number - 1].cause if number else None
        corrected = (corrections or {}).get(number)
        if corrected is not None:
            right = removed == (corrected == "dynamic")
            truth = corrected
            outcome = OUTCOMES[removed, right]
        answer = (
            reason.name.replace("_", " ") if self.compares else "removed" if removed else "kept"
        )
        return {
            "frame": frame,
            "index": answers.index,
            "point": point,
            "position": position,
            "truth": truth,
            "corrected": corrected is not None,
            "removed": removed,
            "answer": answer,
            "outcome": outcome.name.lower(),
            "reason": reason.name,
            "meaning": reason.meaning,
            "cause": cause,
            "sentence": sentence(truth, answer, reason, cause),
        }

    def stored(self, frame: int, point: int) -> tuple[PointLedger, float] | None:
        """The stored ledger of a point, or of one near it that has the same label for the same
        reason.

        Returns:
            The ledger and its distance from the point, metres; None if none is within ``NEAR``.
        """
        asked = self.point(frame, point)
        return self._near(frame, point, asked["position"], asked["removed"], asked["reason"])

    def _near(
        self, frame: int, point: int, position: list[float] | None, removed: bool, reason: str
    ) -> tuple[PointLedger, float] | None:
        worst = [case.worst_frame for case in self.result.failures or ()]
        worst = worst or [cluster.worst_frame for cluster in self.result.clusters]
        numbers = [number for number, of_case in enumerate(worst, 1) if of_case == frame]
        candidates = [ledger for number in numbers for ledger in self.ledgers(number)]
        for ledger in candidates:
            if ledger.point == point:
                return ledger, 0.0
        if position is None:
            return None
        alike = [
            (math.dist(ledger.position, position), k)
            for k, ledger in enumerate(candidates)
            if (ledger.removed, ledger.reason.name) == (removed, reason)
        ]
        distance, k = min(alike, default=(math.inf, -1))
        return (candidates[k], distance) if distance <= NEAR else None

    def ledgers(self, case: int) -> tuple[PointLedger, ...]:
        """The stored ledgers of a case, 1 for the first; none if the recording has none."""
        if case not in self._ledgers:
            self._ledgers[case] = self.recording.ledgers(case)
        return self._ledgers[case]

    def wrong_too(self, other: ExploredRun) -> Bool:
        """(N,) for each of the points in ``wrong``, whether another run on the same frames is wrong
        there, too.
        """
        wrong = np.zeros(len(self.wrong.frame), np.bool_)
        for frame in np.unique(self.wrong.frame).tolist():
            here = self.wrong.frame == frame
            if frame not in other._answers or len(other._answers[frame]) != len(
                self._answers[frame]
            ):
                hint = "Compare runs of the same frames"
                raise DataError(
                    other.path, f"has other points than {self.path}", at=f"frame {frame}", hint=hint
                )
            wrong[here] = np.isin(other._answers[frame].outcome[self.wrong.point[here]], WRONG)
        return wrong

    def _position(self, frame: int, point: int) -> list[float] | None:
        """Metres, world frame; None if the point was not drawn."""
        drawn = self._drawn.get(frame)
        if drawn is None or not (drawn.point == point).any():
            return None
        place: list[float] = drawn.xyz[np.argmax(drawn.point == point)].astype(float).tolist()
        return place


class WrongPoints:
    """Points of all frames whose outcome is one of ``WRONG``.

    Attributes:
        xyz: (N, 3) float32, metres, world frame.
        frame, point, stands_for: (N,) int64.
        outcome: (N,) uint8.
    """

    def __init__(self, drawn: list[DrawnPoints]) -> None:
        rows = [np.flatnonzero(np.isin(each.outcome, WRONG)) for each in drawn]
        frames = [
            np.full(len(row), each.frame, np.int64) for each, row in zip(drawn, rows, strict=True)
        ]

        def joined(name: str, empty: Any) -> Any:
            parts = [getattr(each, name)[row] for each, row in zip(drawn, rows, strict=True)]
            return np.concatenate(parts) if parts else empty

        self.xyz = joined("xyz", np.zeros((0, 3), np.float32))
        self.frame: I64 = np.concatenate(frames) if frames else np.zeros(0, np.int64)
        self.point: I64 = joined("point", np.zeros(0, np.int64))
        self.stands_for: I64 = joined("stands_for", np.zeros(0, np.int64))
        self.outcome: U8 = joined("outcome", np.zeros(0, np.uint8))


def _nearest(xyz: np.ndarray, position: F64) -> int | None:
    """Row of the nearest point within ``NEAR``."""
    if not len(xyz):
        return None
    squared = ((xyz - position) ** 2).sum(1)
    row = int(np.nanargmin(squared)) if np.isfinite(squared).any() else 0
    return row if squared[row] <= NEAR * NEAR else None

"""Points of a comparison.

Coloured by which run is right, and labelled with both answers and their reasons.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from dynaviz.arrays import F32, U8, U16, Bool
from dynaviz.colours import Colour
from dynaviz.contracts.method import Reason
from dynaviz.contracts.scan import Label, Outcome
from dynaviz.scores.comparison.counts import BOTH, FIRST, NEITHER, SECOND, agreement
from dynaviz.scores.comparison.frame_answers import FrameAnswers
from dynaviz.views import classes
from dynaviz.views.read.reader import DrawnPoints, RunRecording

NOBODY: Colour = (235, 235, 235)
EVERYBODY: Colour = (110, 110, 118)
PLAIN = 4  # smaller class ids are agreement alone, an index into ``AGREEMENT``
_REASONS = 256
_OUTCOMES = len(Outcome)


@dataclass(frozen=True, slots=True, eq=False)
class AgreedPoints:
    """The labelled points of a frame that are drawn in either recording.

    Attributes:
        frame: position in the run.
        xyz: (M, 3) float32, metres, world frame.
        right: (M,) uint8, which run is right, an index into ``AGREEMENT``.
        ids: (M,) uint16, class ids of ``AgreementLegend``.
        dynamic: (M,) bool, ground truth.
    """

    frame: int
    xyz: F32
    right: U8
    ids: U16
    dynamic: Bool


class AgreementLegend:
    """Assigns class ids to the answers of two runs.

    Args:
        names: of the runs.
        colours: of the runs.
        reasons: the legends of their reason codes.
    """

    def __init__(
        self,
        names: tuple[str, str],
        colours: tuple[Colour, Colour],
        reasons: tuple[Sequence[Reason], Sequence[Reason]],
    ) -> None:
        self._reasons = reasons
        self._colours = {NEITHER: NOBODY, FIRST: colours[0], SECOND: colours[1], BOTH: EVERYBODY}
        self._plain = {
            NEITHER: "both wrong",
            FIRST: f"only {names[0]} correct",
            SECOND: f"only {names[1]} correct",
            BOTH: "both correct",
        }
        self._ids: dict[int, int] = {}  # by right, outcomes and reasons of both runs in one number
        self._labels: list[classes.Entry] = []

    def entries(self) -> list[classes.Entry]:
        """The entries of all ids assigned so far."""
        return [
            (right, text, self._colours[right]) for right, text in self._plain.items()
        ] + self._labels

    def ids(self, right: U8, outcomes: tuple[U8, U8], reasons: tuple[U8, U8]) -> U16:
        """(N,) uint16 class ids of (N,) points.

        Which run is right, and the outcome and reason code in each run.
        """
        code = right.astype(np.int64)
        for outcome, reason in zip(outcomes, reasons, strict=True):
            code = (code * _OUTCOMES + outcome) * _REASONS + reason
        found, inverse = np.unique(code, return_inverse=True)
        return np.array([self._id(int(one)) for one in found], np.uint16)[inverse]

    def _id(self, code: int) -> int:
        if code not in self._ids:
            rest, second = divmod(code, _OUTCOMES * _REASONS)
            right, first = divmod(rest, _OUTCOMES * _REASONS)
            text = "\n".join(
                f"{letter} {_answer(*divmod(part, _REASONS), legend)}"
                for letter, part, legend in zip("AB", (first, second), self._reasons, strict=True)
            )
            self._ids[code] = PLAIN + len(self._labels)
            self._labels.append((self._ids[code], text, self._colours[right]))
        return self._ids[code]


def _answer(outcome: int, code: int, legend: Sequence[Reason]) -> str:
    word = classes.WORDS[Outcome(outcome)]
    return f"{word}: {classes.plain(legend[code])}" if code < len(legend) else word


def agreed_points(
    first: RunRecording, second: RunRecording, legend: AgreementLegend
) -> Iterator[AgreedPoints]:
    """The drawn points of each frame, with their class ids."""
    rows = zip(first.answers(), second.answers(), first.drawn(), second.drawn(), strict=True)
    for a, b, drawn_a, drawn_b in rows:
        points, at = _drawn_in_either(a, drawn_a, drawn_b)
        truth = a.truth[points]
        right = agreement(truth, a.dynamic[points], b.dynamic[points])
        ids = legend.ids(
            right, (a.outcome[points], b.outcome[points]), (a.reasons[points], b.reasons[points])
        )
        xyz = np.concatenate([drawn_a.xyz, drawn_b.xyz])[at]
        yield AgreedPoints(a.frame, xyz, right, ids, truth == Label.DYNAMIC)


def _drawn_in_either(
    a: FrameAnswers, drawn_a: DrawnPoints, drawn_b: DrawnPoints
) -> tuple[np.ndarray, np.ndarray]:
    """Labelled points drawn in either recording.

    Positions in the scan, and in both drawings put together.
    """
    points, at = np.unique(np.concatenate([drawn_a.point, drawn_b.point]), return_index=True)
    labelled = a.truth[points] != Label.UNLABELLED
    return points[labelled], at[labelled]

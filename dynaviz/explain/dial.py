"""What other parameters would change in a whole run, estimated from a sample of its points."""

from __future__ import annotations

import io
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import msgspec
import numpy as np

from dynaviz.arrays import F64, U8, Bool
from dynaviz.contracts.scan import Outcome
from dynaviz.explain.judging import Candidates, Judgeable, Parameter, Summed, VariedTerm, of_ledgers
from dynaviz.explain.point_ledger import PointLedger
from dynaviz.explain.sample import OF_TRUTH, Drawn
from dynaviz.explain.words import number
from dynaviz.scores.failure_case import FailureCase

WHISKER = 2.0  # standard deviations: 95 % of whiskers contain the score of the run
SQUARE = 5.0  # metres: new wrong points without an object in one square are one place
SCORES = ("SA", "DA")
ARRAYS = ("frame", "row", "position", "instance", "stratum", "outcomes", "counts")
REMOVED_RIGHT = (False, True)  # whether it is right to remove points of each truth


@dataclass(frozen=True, slots=True)
class EstimatedScore:
    """An estimated score, percent, and its whisker: the distance that it is within in 95 %."""

    value: float
    whisker: float

    def __str__(self) -> str:
        return f"{self.value:.1f} ±{self.whisker:.1f}"


@dataclass(frozen=True, slots=True, eq=False)
class PointSample:
    """A sample of the points of a run that can be judged again.

    Attributes:
        drawn: the points, and the strata from which they were drawn.
        judged: the same points.
        parameters: that enter the decision and can be turned.
        given: the values of all parameters of the run that are numbers.
    """

    drawn: Drawn
    judged: Judgeable
    parameters: tuple[Parameter, ...]
    given: Mapping[str, float]

    def scores(self, values: Mapping[str, float]) -> dict[str, EstimatedScore]:
        """SA and DA with other values; a score that has no points is left out."""
        removed = self.judged.judge(values, self.given)
        return {
            name: found
            for name, outcomes, right in zip(SCORES, OF_TRUTH, REMOVED_RIGHT, strict=True)
            if (found := self._score(outcomes, removed == right, removed)) is not None
        }

    def new_places(self, values: Mapping[str, float]) -> int:
        """Objects and squares in which drawn points would be wrong, and none is now.

        A lower bound: other points of the run are not judged.
        """
        before = self._places(~self._right())
        return len(self._places(~self._right(self.judged.judge(values, self.given))) - before)

    def _places(self, which: Bool) -> set[int | tuple[int, int]]:
        """Instances of objects, and squares of points without one."""
        drawn = self.drawn
        squares = np.floor(drawn.position[which, :2] / SQUARE).astype(int).tolist()
        objects = drawn.instance[which].tolist()
        return {of or (square[0], square[1]) for of, square in zip(objects, squares, strict=True)}

    def _right(self, removed: Bool | None = None) -> Bool:
        """(K,) bool: which points are right; without labels, with those of the run."""
        dynamic = np.isin(self.drawn.outcomes, OF_TRUTH[1])[self.drawn.stratum]
        right: Bool = dynamic == (self.judged.removed if removed is None else removed)
        return right

    def _score(
        self, outcomes: tuple[Outcome, Outcome], right: Bool, removed: Bool
    ) -> EstimatedScore | None:
        drawn = self.drawn
        strata = np.flatnonzero(np.isin(drawn.outcomes, outcomes))
        total = int(drawn.counts[strata].sum())
        if not total:
            return None
        residual = np.zeros(len(right))
        value = 0.0
        variance = 0.0
        same = not (removed != self.judged.removed).any()
        for stratum in strata.tolist():
            which = np.flatnonzero(drawn.stratum == stratum)
            share = drawn.counts[stratum] / total
            size = len(which)
            wins = int(right[which].sum())
            if not size:  # of frames from which no point was drawn
                is_right = drawn.outcomes[stratum] == outcomes[0]
                value += share * is_right
                variance += share**2 / 4
                continue
            value += share * wins / size
            # One more of either kind: that all drawn points agree does not mean that all points do.
            smoothed = (wins + 1) / (size + 2)
            rest = 1 - min(size / drawn.counts[stratum], 1.0)
            variance += share**2 * smoothed * (1 - smoothed) / size * rest
            residual[which] = share / size * (right[which] - wins / size)
        if same:
            variance = 0.0  # the labels of all points are known
        elif drawn.of_frames < drawn.frames:
            variance += self._between_frames(residual)
        return EstimatedScore(100 * value, WHISKER * 100 * math.sqrt(variance))

    def _between_frames(self, residual: F64) -> float:
        """The variance because points were drawn from some frames only, by successive ones."""
        frames, of = np.unique(self.drawn.frame, return_inverse=True)
        steps = np.diff(np.bincount(of, weights=residual))
        if not len(steps):
            return 0.0
        rest = 1 - self.drawn.of_frames / self.drawn.frames
        return float(rest * len(frames) / (2 * len(steps)) * (steps**2).sum())


@dataclass(frozen=True, slots=True)
class CaseTurn:
    """A case with other parameters.

    Attributes:
        number: of the case, 1 for the first.
        wrong: number of its stored points that would be wrong, of so many that are.
        were: that are wrong in the run.
        cost: percentage points that it would cost, if its other points do the same.
    """

    number: int
    wrong: int
    were: int
    cost: float


@dataclass(frozen=True, slots=True)
class Turned:
    """A run with other parameters, as far as its recording tells.

    Attributes:
        values: of the parameters that differ.
        scores: estimated, by name.
        cases: those with evidence.
        new: number of places that would be wrong, at least.
    """

    values: Mapping[str, float]
    scores: Mapping[str, EstimatedScore]
    cases: tuple[CaseTurn, ...]
    new: int

    @property
    def repaired(self) -> int:
        """Cases of which at least half of the points would be right."""
        return sum(2 * case.wrong <= case.were for case in self.cases)

    @property
    def text(self) -> str:
        """In one line."""
        values = ", ".join(f"{name} {number(value)}" for name, value in self.values.items())
        scores = ", ".join(f"{name} {score}" for name, score in self.scores.items())
        repaired = f"{self.repaired} of {len(self.cases)} listed cases repaired"
        places = f"{self.new} new place{'s' * (self.new != 1)} with errors"
        return f"{values or 'As it ran'}: {scores}: {repaired}, {places}"


class Dial:
    """Turns the parameters of a recorded run.

    Args:
        sample: of its points.
        cases: of the run, costliest first.
        ledgers: of the first cases, in the same order; empty for one without evidence.
    """

    def __init__(
        self,
        sample: PointSample,
        cases: Sequence[FailureCase],
        ledgers: Sequence[Sequence[PointLedger]],
    ) -> None:
        self.sample = sample
        self._cases = cases
        self._judged = {
            number: of_ledgers(found, sample.given)
            for number, found in enumerate(ledgers, 1)
            if found
        }

    def turn(self, values: Mapping[str, float]) -> Turned:
        """The run with other values of parameters."""
        given = self.sample.given
        values = {name: value for name, value in values.items() if value != given[name]}
        cases = []
        for number_, judged in self._judged.items():
            case = self._cases[number_ - 1]
            ghost = case.kind == "false_negative"
            were = int((judged.removed != ghost).sum())
            wrong = int((judged.judge(values, given) != ghost).sum())
            cases.append(CaseTurn(number_, wrong, were, case.cost * wrong / max(were, 1)))
        scores = self.sample.scores(values)
        return Turned(values, scores, tuple(cases), self.sample.new_places(values))


def pack(sample: PointSample) -> bytes:
    """A sample as a compressed ``npz`` file."""
    drawn = sample.drawn
    judged = sample.judged
    arrays = {name: getattr(drawn, name) for name in ARRAYS}
    arrays["removed"] = judged.removed
    for k, (scans, bits) in enumerate(zip(judged.scans, judged.bits, strict=True)):
        arrays[f"scans {k}"] = scans
        arrays[f"bits {k}"] = bits
    for k, rule in enumerate(judged.rules):
        arrays[f"owner {k}"] = rule.owner
        arrays[f"numbers {k}"] = rule.numbers
    described = {
        "frames": drawn.frames,
        "of_frames": drawn.of_frames,
        "sums": judged.sums,
        "rules": [rule.terms for rule in judged.rules],
        "parameters": sample.parameters,
        "given": sample.given,
    }
    arrays["described"] = np.frombuffer(msgspec.json.encode(described), np.uint8)
    file = io.BytesIO()
    np.savez_compressed(file, **arrays)
    return file.getvalue()


def unpack(packed: U8) -> PointSample:
    """The inverse of ``pack``; raises ValueError, KeyError or OSError for damaged content."""
    with np.load(io.BytesIO(packed.tobytes()), allow_pickle=False) as file:
        arrays = dict(file.items())
    described = json.loads(arrays["described"].tobytes())
    sums = msgspec.convert(described["sums"], tuple[Summed, ...])
    terms = msgspec.convert(described["rules"], tuple[tuple[VariedTerm, ...], ...])
    drawn = Drawn(
        **{name: arrays[name] for name in ARRAYS},
        frames=described["frames"],
        of_frames=described["of_frames"],
    )
    judged = Judgeable(
        arrays["removed"],
        sums,
        tuple(arrays[f"scans {k}"] for k in range(len(sums))),
        tuple(arrays[f"bits {k}"] for k in range(len(sums))),
        tuple(
            Candidates(of_rule, arrays[f"owner {k}"], arrays[f"numbers {k}"])
            for k, of_rule in enumerate(terms)
        ),
    )
    parameters = msgspec.convert(described["parameters"], tuple[Parameter, ...])
    return PointSample(drawn, judged, parameters, described["given"])

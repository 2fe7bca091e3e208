"""Points judged again with other parameters, from the numbers that their scans left.

A sum of log-odds is added up again, step by step; a number is compared with another threshold. The
method does not run, so what else a parameter changes is not part of the answer.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from msgspec import Struct

from dynaviz.arrays import F32, F64, I32, I64, U8, Bool
from dynaviz.contracts.evidence import TESTS
from dynaviz.explain.deciding import scan_terms
from dynaviz.explain.point_ledger import PointLedger, TermValue

HALF = 0.5  # probability whose log-odds are 0: beyond it, a hit would count as free
STEPS = 40  # of a slider
LEAST = 4  # a slider begins at a quarter of the value ...
MOST = 3  # ... and ends at three times


class Parameter(Struct, frozen=True):
    """A parameter that enters the decision directly.

    Attributes:
        name: of the parameter.
        value: of the run.
        low, high: of its slider; in between, no value reverses the meaning of the parameter.
        step: between values of the slider.
    """

    name: str
    value: float
    low: float
    high: float
    step: float

    def values(self, count: int) -> list[float]:
        """At most so many values of the slider, spread evenly; the value of the run is one."""
        steps = np.linspace(0, round((self.high - self.low) / self.step), count).round()
        found = {float(f"{self.low + self.step * step:.6g}") for step in steps}
        return sorted(found | {self.value})


class VariedTerm(Struct, frozen=True):
    """A term of a rule whose threshold is a parameter, or whose number is a sum.

    Attributes:
        name: of the term; of a sum its name.
        test: one of ``TESTS``.
        threshold: 0 if a parameter sets it.
        parameter: that sets the threshold; empty if none does.
        follows: as in ``contracts.evidence.Term``.
    """

    name: str
    test: str
    threshold: float
    parameter: str
    follows: str


class Summed(Struct, frozen=True):
    """A sum of log-odds: as ``contracts.evidence.Quantity``, name and parameter of each step."""

    name: str
    steps: tuple[tuple[str, str], ...]
    limits: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Candidates:
    """Numbers with which a rule would hold if they passed its terms; of one point any is enough.

    Attributes:
        terms: T of them; the others hold for all candidates.
        owner: (M,) int32, the point of each, in ascending order.
        numbers: (M, T) float64; NaN for a sum, which is added up again.
    """

    terms: tuple[VariedTerm, ...]
    owner: I32
    numbers: F64


@dataclass(frozen=True, slots=True, eq=False)
class Judgeable:
    """K points that can be judged again.

    Attributes:
        removed: (K,) bool, with the parameters of the run.
        sums: that are added up again.
        scans: (K,) int64 by sum, number of scans that added to it.
        bits: by sum, the steps of these scans, point by point: bit i for its i-th step.
        rules: by which points are removed.
    """

    removed: Bool
    sums: tuple[Summed, ...]
    scans: tuple[I64, ...]
    bits: tuple[U8, ...]
    rules: tuple[Candidates, ...]

    @property
    def names(self) -> list[str]:
        """Names of the parameters that enter."""
        of_sums = (
            name
            for each in self.sums
            for name in (*(parameter for _, parameter in each.steps), *each.limits)
        )
        of_terms = (term.parameter for rule in self.rules for term in rule.terms if term.parameter)
        return list(dict.fromkeys([*of_sums, *of_terms]))

    def judge(self, values: Mapping[str, float], given: Mapping[str, float]) -> Bool:
        """(K,) bool: whether each point is removed with other values.

        Args:
            values: of the parameters that differ.
            given: the values of the run.
        """
        if all(given[name] == value for name, value in values.items()):
            return self.removed
        return self.replay({**given, **values}, given)

    def replay(self, values: Mapping[str, float], given: Mapping[str, float]) -> Bool:
        """As ``judge``, also if no value differs: from the numbers alone."""
        totals = {
            each.name: _added(each, counts, bits, values)
            for each, counts, bits in zip(self.sums, self.scans, self.bits, strict=True)
        }
        removed = np.zeros(len(self.removed), np.bool_)
        for rule in self.rules:
            holds: Bool = np.ones(len(rule.owner), np.bool_)
            for k, term in enumerate(rule.terms):
                total = totals.get(term.name)
                numbers = rule.numbers[:, k]
                if total is not None:
                    numbers = total[rule.owner].astype(np.float64)
                holds &= TESTS[term.test](numbers, _threshold(term, values))
            removed[rule.owner[holds]] = True
        return removed


def of_ledgers(ledgers: Sequence[PointLedger], parameters: Mapping[str, Any]) -> Judgeable:
    """The points of ledgers, at least one."""
    given = numbers_of(parameters)
    sums = tuple(
        Summed(q.name, q.steps, q.limits)
        for q in ledgers[0].quantities
        if q.steps and all(name in given for name in (*(n for _, n in q.steps), *q.limits))
    )
    named = {each.name for each in sums}
    scans = []
    bits = []
    for each in sums:
        order = {name: 1 << i for i, (name, _) in enumerate(each.steps)}
        applied = [
            [sum(order.get(step, 0) for step in entry.steps) for entry in ledger.entries]
            for ledger in ledgers
        ]
        some = [[bit for bit in of_point if bit] for of_point in applied]
        scans.append(np.array([len(of_point) for of_point in some], np.int64))
        bits.append(np.array([bit for of_point in some for bit in of_point], np.uint8))
    found: dict[str, tuple[tuple[VariedTerm, ...], list[int], list[list[float]]]] = {}
    for k, ledger in enumerate(ledgers):
        for name, terms, rows in _rows_of(ledger):
            varied = [i for i, term in enumerate(terms) if _varies(term, named, given)]
            kept = tuple(_compared(terms[i], given) for i in varied)
            # Rules of one name have the same terms, unless a recording lacks their numbers.
            of_rule = found.setdefault(f"{name} {len(kept)}", (kept, [], []))
            for row in rows:
                if all(row[i].holds for i in range(len(row)) if i not in varied):
                    of_rule[1].append(k)
                    of_rule[2].append([_number(row[i], named, given) for i in varied])
    rules = []
    for compared, owner, numbers in found.values():
        table = np.array(numbers, np.float64).reshape(len(owner), len(compared))
        rules.append(Candidates(compared, np.array(owner, np.int32), table))
    removed = np.array([ledger.removed for ledger in ledgers])
    return Judgeable(removed, sums, tuple(scans), tuple(bits), tuple(rules))


def _rows_of(
    ledger: PointLedger,
) -> Iterator[tuple[str, tuple[TermValue, ...], list[tuple[TermValue, ...]]]]:
    """The rules of a point: name, terms, and the numbers with which each might hold."""
    for rule in ledger.rules:
        of_scans = [terms for entry in ledger.entries if (terms := scan_terms(entry, rule))]
        if of_scans:
            yield rule.name, rule.terms, of_scans
        elif rule.frame is None:
            yield rule.name, rule.terms, [rule.terms] if rule.terms else []
        else:  # an earlier recording has no numbers of single scans
            yield rule.name, (), [()] if rule.holds else []


def parameters_of(
    names: Sequence[str],
    sums: Sequence[Summed],
    given: Mapping[str, Any],
    fits: Callable[[str, float], bool] = lambda name, value: True,
) -> list[Parameter]:
    """The sliders of some parameters; none for one that is off, which is another method.

    Args:
        names: of the parameters.
        sums: in which parameters are probabilities.
        given: their values in the run.
        fits: whether the method takes a value of a parameter.
    """
    probabilities = {
        name for each in sums for name in (*(step for _, step in each.steps), *each.limits)
    }
    found = []
    for name in names:
        value = given[name]
        if value <= 0 or (name in probabilities and value == HALF):
            continue
        if name in probabilities:
            steps = np.arange(1, 50) / 100 + (HALF if value > HALF else 0.0)
        elif isinstance(value, int):
            lowest = max(1, value // LEAST)
            steps = np.arange(lowest, max(MOST * value, 10) + 1, dtype=np.float64)
        else:
            steps = np.linspace(value / LEAST, MOST * value, STEPS + 1)
        step = float(steps[1] - steps[0])
        allowed = [each for each in steps.tolist() if fits(name, each)]
        below = [each for each in allowed if each <= value]
        above = [each for each in allowed if each >= value]
        if below and above:
            found.append(Parameter(name, value, below[0], above[-1], step))
    return found


def accepts(params: Any) -> Callable[[str, float], bool]:
    """Whether the parameters of a method may have another value."""

    def fits(name: str, value: float) -> bool:
        try:
            dataclasses.replace(params, **{name: type(getattr(params, name))(value)})
        except ValueError:
            return False
        return True

    return fits


def numbers_of(parameters: Mapping[str, Any]) -> dict[str, float]:
    """The parameters that are numbers."""
    return {
        name: value
        for name, value in parameters.items()
        if isinstance(value, int | float) and not isinstance(value, bool)
    }


def front(numbers: F64, tests: Sequence[str]) -> Bool:
    """(M,) bool: those candidates of one point of which no other is at least as good in all terms.

    Args:
        numbers: (M, T) of the candidates.
        tests: of the T terms.
    """
    if not len(tests):
        return np.equal(np.arange(len(numbers)), 0)
    better = numbers * np.where([test in (">", ">=") for test in tests], 1.0, -1.0)
    good = (better[:, None] >= better[None]).all(2)  # the first index at least as good as the other
    earlier = np.tri(len(better), k=-1, dtype=np.bool_).T
    superfluous = (good & (~good.T | earlier)).any(0)
    return np.logical_not(superfluous)


def log_odds_of(probability: float) -> np.float32:
    """Log-odds of a probability, in single precision, as methods add them up."""
    return np.float32(math.log(probability / (1 - probability)))


def _added(each: Summed, counts: I64, bits: U8, values: Mapping[str, float]) -> F32:
    """A sum of log-odds of each point, in the order of scans."""
    total = np.zeros(len(counts), np.float32)
    changes = [log_odds_of(values[parameter]) for _, parameter in each.steps]
    limits = [float(log_odds_of(values[name])) for name in each.limits] or [-np.inf, np.inf]
    first = np.cumsum(counts) - counts
    order = np.argsort(-counts, kind="stable")  # those with most scans first
    left = counts[order]
    for scan in range(int(counts.max(initial=0))):
        some = order[: np.searchsorted(-left, -scan, "left")]
        applied = bits[first[some] + scan]
        for i, change in enumerate(changes):
            stepped = some[applied >> i & 1 == 1]
            total[stepped] = np.clip(total[stepped] + change, limits[0], limits[1])
    return total


def _threshold(term: VariedTerm, values: Mapping[str, float]) -> float:
    if not term.parameter:
        return term.threshold
    value = float(values[term.parameter])
    return 1.0 - value if term.follows == "complement" else value


def _varies(term: TermValue, sums: set[str], given: Mapping[str, float]) -> bool:
    """Whether parameters enter a term in a known way."""
    return term.name in sums or (term.follows != "otherwise" and term.parameter in given)


def _compared(term: TermValue, given: Mapping[str, float]) -> VariedTerm:
    known = term.parameter in given and term.follows != "otherwise"
    follows = term.follows if known else "equal"
    threshold = 0.0 if known else term.threshold
    return VariedTerm(term.name, term.test, threshold, term.parameter if known else "", follows)


def _number(term: TermValue, sums: set[str], given: Mapping[str, float]) -> float:
    """What is compared with the threshold: for a complement, as a share of the whole."""
    if term.name in sums or term.value is None:
        return math.nan
    if term.follows != "complement" or term.parameter not in given:
        return term.value
    return float(share(term.value, term.threshold, given[term.parameter]))


def share(value: Any, threshold: Any, parameter: float) -> Any:
    """A number as a share of that of which its threshold is 1 - parameter."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.divide(value, threshold) * (1 - parameter)

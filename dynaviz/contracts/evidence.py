"""Evidence: the numbers behind a label, an optional part of the contract of methods.

A method that implements ``Explains`` can be asked, after each ``observe`` and after ``label``, what
it knows about some points. ``dynaviz.explain.repeat`` runs a method again and asks after each scan;
the differences between scans are what each scan contributed. A method does no work for this in a
normal run.
"""

from __future__ import annotations

import operator
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike

from dynaviz.arrays import F32, F64, I64, Bool
from dynaviz.contracts.scan import Scan

TESTS: dict[str, Callable[[F64, F64 | float], Bool]] = {
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
}
"""The comparisons of a ``Term``."""


@dataclass(frozen=True, slots=True, eq=False)
class Asked:
    """Points of one scan.

    Attributes:
        scan: the scan with the points. It may not have been observed yet.
        rows: (K,) int64, the points.
        first: number of points in all scans before this one: the scan's first row in
            ``Context.raw_map``.
    """

    scan: Scan
    rows: I64
    first: int

    @property
    def points(self) -> F32:
        """(K, 3) float32, metres, world frame; C-contiguous."""
        return self.scan.points[self.rows]


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """What a scan adds to a sum of log-odds at the points where it applies.

    The logit of a parameter.

    Attributes:
        name: what the scan saw, such as ``crossed``.
        parameter: name of the parameter, a probability.
        applies: (K,) bool, whether the last scan added it.
    """

    name: str
    parameter: str
    applies: Bool


@dataclass(frozen=True, slots=True, eq=False)
class Quantity:
    """A number at each asked point, after the scan that was observed last.

    Attributes:
        name: a few characters, as in the head of a table.
        values: (K,) float64; NaN where the method has none.
        unit: such as ``m``; empty for counts.
        total: whether the method accumulates it: its change is what the last scan contributed.
            Otherwise it is a reading of the last scan alone, and NaN if that scan measured nothing
            at the point.
        threshold: value at which the label changes; None if no single value does.
        legend: names of the values 0, 1, ... of a quantity that is a class.
        steps: of a sum of log-odds that starts at 0, what the last scan added, in this order. Each
            sum is clamped.
        limits: names of the parameters, probabilities, between whose logits it is clamped; empty
            for none.
    """

    name: str
    values: F64
    unit: str = ""
    total: bool = False
    threshold: float | None = None
    legend: tuple[str, ...] = ()
    steps: tuple[Step, ...] = ()
    limits: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Term:
    """A comparison of a number with a threshold at each asked point, such as ``log-odds < 0``.

    Attributes:
        name: of the number.
        values: (K,) float; NaN fails every comparison.
        test: one of ``TESTS``.
        threshold: one value, or (K,) one for each point.
        unit: such as ``m``.
        parameter: name of the parameter that sets the threshold; empty if none does.
        follows: how the threshold follows the parameter p: ``equal`` to it, in proportion to 1 - p
            (``complement``), or ``otherwise``, also if p changes more than this threshold. Unless
            otherwise, the numbers tell the label with another p.
    """

    name: str
    values: ArrayLike
    test: str
    threshold: ArrayLike
    unit: str = ""
    parameter: str = ""
    follows: Literal["equal", "complement", "otherwise"] = "equal"

    def holds(self) -> Bool:
        """(K,) bool."""
        values, threshold = (np.asarray(side, np.float64) for side in (self.values, self.threshold))
        return TESTS[self.test](values, threshold)


@dataclass(frozen=True, slots=True, eq=False)
class Rule:
    """A reason to remove points: they are dynamic where all terms hold.

    Attributes:
        name: a few words; each rule has its own.
        terms: at least one.
        lasting: one scan after which all terms hold is enough, whatever later scans show; otherwise
            the rule counts when the label is decided.
    """

    name: str
    terms: tuple[Term, ...]
    lasting: bool = False

    def holds(self) -> Bool:
        """(K,) bool."""
        held: Bool = np.logical_and.reduce([term.holds() for term in self.terms])
        return held


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """What a method knows about the asked points after the scan that was observed last.

    A point is dynamic if any rule holds. The last rules that are not empty decide, or the first
    that are ``final``.

    Attributes:
        cells: (K, 2, 3) float64, metres, world frame: lowest and highest corner of the box around
            each point whose rays are evidence, such as its voxel.
        quantities: what changes from scan to scan.
        rules: in these terms the method decides; empty while it cannot, as for points that it
            judges later.
        final: no later scan changes the labels of these points.
        alone: rays that touch none of the cells never change any of these numbers, whatever else a
            scan contains.
    """

    cells: F64
    quantities: tuple[Quantity, ...]
    rules: tuple[Rule, ...]
    final: bool = False
    alone: bool = False


@runtime_checkable
class Explains(Protocol):
    """A method that states its evidence.

    The conformance kit compares the verdict of its rules with its labels.
    """

    def evidence(self, asked: Asked) -> Evidence:
        """State the evidence on points of one scan. Changes no label.

        Called after any ``observe``, and right after the ``label`` of the points' own scan.
        """
        ...


@dataclass(slots=True)
class Verdict:
    """Collects the rules of one set of points, call by call, and decides from their numbers alone.

    Attributes:
        rules: those that decide so far.
        lasting: (K,) bool by name: lasting rules that held after some scan.
        final: whether no later call changes the verdict.
    """

    rules: tuple[Rule, ...] = ()
    lasting: dict[str, Bool] = field(default_factory=dict)
    final: bool = False

    def add(self, evidence: Evidence) -> None:
        """Take the evidence after one more scan, or after the label."""
        if self.final or not evidence.rules:
            return
        self.rules = evidence.rules
        self.final = evidence.final
        for rule in evidence.rules:
            if rule.lasting:
                held = rule.holds()
                self.lasting[rule.name] = (
                    held | self.lasting[rule.name] if rule.name in self.lasting else held
                )

    def held(self) -> dict[str, Bool]:
        """(K,) bool by name of the rule: whether it removes each point."""
        return {
            rule.name: self.lasting[rule.name] if rule.lasting else rule.holds()
            for rule in self.rules
        }

    def dynamic(self) -> Bool | None:
        """(K,) bool; None before any rule was stated."""
        held = list(self.held().values())
        return np.logical_or.reduce(held) if held else None


def voxels_around(points: F32, size: float) -> F64:
    """(K, 2, 3) float64, metres: lowest and highest corner of the voxel of each point (K, 3).

    NaN where not finite.
    """
    low = np.floor(points.astype(np.float64) / size) * size
    low[~np.isfinite(low).all(1)] = np.nan
    return np.stack([low, low + size], 1)

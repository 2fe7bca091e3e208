"""The ledger of a point as data: what each scan contributed, and the rules that decided."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from dynaviz.contracts.evidence import Quantity
from dynaviz.contracts.method import Reason


@dataclass(frozen=True, slots=True)
class TermValue:
    """A comparison with its numbers, such as ``log-odds -0.4 < 0``.

    Fields as in ``contracts.evidence.Term``.
    """

    name: str
    value: float | None
    test: str
    threshold: float
    unit: str
    holds: bool
    parameter: str = ""
    follows: str = "equal"


@dataclass(frozen=True, slots=True)
class RuleValue:
    """A rule with its numbers.

    Attributes:
        name: as in ``dynaviz.contracts.evidence.Rule``.
        terms: with the numbers that decided. For a rule that one scan may fulfil: those of the
            first scan that did, or of the scan that came closest.
        holds: whether it removes the point.
        frame: position in the run of that scan; None for a rule that the last numbers decide.
    """

    name: str
    terms: tuple[TermValue, ...]
    holds: bool
    frame: int | None


@dataclass(frozen=True, slots=True)
class LedgerEntry:
    """One scan that touched the point, or changed what the method knows about it.

    Attributes:
        frame, index: its position in the run, and its number in the data set.
        sensor: (x, y, z) metres, world frame: origin of its rays.
        range_m: from there to the point.
        angle_deg: between these rays and the surface through the point; None if the point lies on
            no surface.
        hits, crossed: number of its rays that end in the cell around the point, and that pass
            through it.
        behind_m: how far beyond the point the crossing rays end, median; None without any.
        values: quantities of the method after this scan; None where it has none.
        changes: what the scan added to those quantities that accumulate.
        holds: names of the rules that hold by the numbers of this scan.
        removed: the verdict by the scans so far; None if the method cannot tell.
        steps: names of the steps of sums that apply to the scan.
        terms: by name of the rules that one scan may fulfil, number and threshold of each term in
            this scan; without rules whose numbers are all unknown, and empty in earlier recordings.
    """

    frame: int
    index: int
    sensor: tuple[float, float, float]
    range_m: float
    angle_deg: float | None
    hits: int
    crossed: int
    behind_m: float | None
    values: Mapping[str, float | None]
    changes: Mapping[str, float]
    holds: tuple[str, ...]
    removed: bool | None
    steps: tuple[str, ...] = ()
    terms: Mapping[str, tuple[tuple[float | None, float | None], ...]] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class QuantityInfo:
    """A quantity of the ledger; fields as in ``dynaviz.contracts.evidence.Quantity``.

    Attributes:
        steps: name and parameter of each step.
    """

    name: str
    unit: str
    total: bool
    threshold: float | None
    legend: tuple[str, ...]
    steps: tuple[tuple[str, str], ...] = ()
    limits: tuple[str, ...] = ()

    @classmethod
    def of(cls, quantity: Quantity) -> QuantityInfo:
        """Without values."""
        steps = tuple((step.name, step.parameter) for step in quantity.steps)
        q = quantity
        return cls(q.name, q.unit, q.total, q.threshold, q.legend, steps, q.limits)


@dataclass(frozen=True, slots=True)
class PointLedger:
    """Why a point got its label.

    Attributes:
        frame, index, point: position in the run, number of the frame in the data set, row in the
            scan.
        position: (x, y, z) metres, world frame.
        truth: ``static``, ``dynamic``, or None without ground truth.
        removed: the label.
        reason: why, in the method's words.
        verdict: what follows from ``rules``; None for a labeller without evidence.
        rules: the point is dynamic if any holds.
        quantities: what ``entries`` list.
        entries: by frame.
        searched: number of scans searched.
        case: number of the case of which a recording stores it; None if it is not stored, and in
            earlier recordings.
    """

    frame: int
    index: int
    point: int
    position: tuple[float, float, float]
    truth: str | None
    removed: bool
    reason: Reason
    verdict: bool | None
    rules: tuple[RuleValue, ...]
    quantities: tuple[QuantityInfo, ...]
    entries: tuple[LedgerEntry, ...]
    searched: int
    case: int | None = None

    @property
    def wrong(self) -> bool | None:
        """Whether the label is wrong; None without ground truth."""
        return None if self.truth is None else self.removed != (self.truth == "dynamic")

"""The ledger of points: every scan whose rays touched them, what each contributed to their labels, and the verdict."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from dynaviz import kernels
from dynaviz.arrays import Bool
from dynaviz.contracts.evidence import Asked, Evidence, Explains, Quantity, Rule, Verdict, voxels_around
from dynaviz.contracts.method import Reason
from dynaviz.contracts.metric import Labelled
from dynaviz.contracts.scan import Label, Scan
from dynaviz.engine.loop import Listener, RunSpec, execute
from dynaviz.engine.ray_geometry import geometry, normals, touching
from dynaviz.errors import PluginError, UsageError
from dynaviz.progress import Progress, silent
from dynaviz.sources.summary import SequenceSummary

EDGE = 0.1  # metres: of the box around a point whose rays are searched, for a method without evidence
GRAZING = 10.0  # degrees: a ray that meets the surface at a smaller angle only grazes it


@dataclass(frozen=True, slots=True)
class TermValue:
    """A comparison with its numbers, such as ``log-odds -0.4 < 0``; fields as in ``contracts.evidence.Term``."""

    name: str
    value: float | None
    test: str
    threshold: float
    unit: str
    holds: bool
    parameter: str = ""


@dataclass(frozen=True, slots=True)
class RuleValue:
    """A rule with its numbers.

    Attributes:
        name: as in ``dynaviz.contracts.evidence.Rule``.
        terms: with the numbers that decided. For a rule that one scan may fulfil: those of the first scan that did, or
            of the scan that came closest.
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
        angle_deg: between these rays and the surface through the point; None if the point lies on no surface.
        hits, crossed: number of its rays that end in the cell around the point, and that pass through it.
        behind_m: how far beyond the point the crossing rays end, median; None without any.
        values: quantities of the method after this scan; None where it has none.
        changes: what the scan added to those quantities that accumulate.
        holds: names of the rules that hold by the numbers of this scan.
        removed: the verdict by the scans so far; None if the method cannot tell.
        steps: names of the steps of sums that apply to the scan.
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
        frame, index, point: position in the run, number of the frame in the data set, row in the scan.
        position: (x, y, z) metres, world frame.
        truth: ``static``, ``dynamic``, or None without ground truth.
        removed: the label.
        reason: why, in the method's words.
        verdict: what follows from ``rules``; None for a labeller without evidence.
        rules: the point is dynamic if any holds.
        quantities: what ``entries`` list.
        entries: by frame.
        searched: number of scans searched.
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

    @property
    def wrong(self) -> bool | None:
        """Whether the label is wrong; None without ground truth."""
        return None if self.truth is None else self.removed != (self.truth == "dynamic")


class Ledger(Listener):
    """Keeps the ledgers of some points of one frame while a run is executed.

    Args:
        frame: position in the run.
        points: rows in its scan.

    Attributes:
        ledgers: one for each point, after the frame was labelled and all scans were searched.
    """

    def __init__(self, frame: int, points: Sequence[int]) -> None:
        self._frame, self._rows = frame, np.array(points, np.int64)

    def begin(self, run: RunSpec, summary: SequenceSummary) -> None:
        """Read the points.

        Raises:
            UsageError: for a frame or a point that does not exist.
        """
        sequence, labeller = run.sequence, run.labeller
        if not 0 <= self._frame < len(sequence):
            raise UsageError(f"frame {self._frame}: the run has the frames 0 to {len(sequence) - 1}")
        scan = sequence[self._frame]
        if (wrong := self._rows[(self._rows < 0) | (self._rows >= len(scan))]).size:
            raise UsageError(f"point {wrong[0]}: frame {self._frame} has the points 0 to {len(scan) - 1}")
        # Only the raw map has rows, and counting them means reading the earlier scans again.
        first = sum(len(sequence[k]) for k in range(self._frame)) if labeller.info.needs_map else 0
        self._asked, self._truth = Asked(scan.without_truth(), self._rows, first), scan.labels
        self._run, self._explains = run, labeller if isinstance(labeller, Explains) else None
        self._cells = voxels_around(self._asked.points, EDGE)
        self._normals = normals(scan.points, self._asked.points)
        self._books = [_Book() for _ in self._rows]
        self._verdict, self._searched, self._over = Verdict(), 0, False
        self._quantities: tuple[Quantity, ...] = ()
        self.ledgers: tuple[PointLedger, ...] = ()

    def observing(self, frame: int, scan: Scan) -> None:
        """Keep the scan."""
        self._scan = scan

    def observed(self, frame: int) -> None:
        """Enter the scan, unless an earlier one settled the labels."""
        if not self._over:
            self._enter(frame, self._scan)

    def labelled(self, labelled: Labelled, curves: Mapping[str, float]) -> None:
        """Enter the scan of a labeller that observes none; take the label and the rules that decided it."""
        if self._run.method is None:
            self._enter(labelled.frame, labelled.scan)
        if labelled.frame == self._frame:
            if (evidence := self._evidence()) is not None:
                self._verdict.add(evidence)
            self._over = self._over or self._run.online
            self._labels = labelled.dynamic[self._rows], labelled.reasons[self._rows]

    def finish(self, *_: Any) -> None:
        """Close the ledgers.

        Raises:
            PluginError: if the method's evidence contradicts its label.
        """
        self.ledgers = tuple(self._close(k) for k in range(len(self._rows)))

    def _enter(self, frame: int, scan: Scan) -> None:
        """Add an entry to each ledger that the scan concerns."""
        self._searched += 1
        evidence = self._evidence()
        values: tuple[Quantity, ...] = ()
        held: dict[str, Bool] = {}
        removed: Bool | None = None
        if evidence is not None:
            self._cells, values, self._quantities = evidence.cells, evidence.quantities, evidence.quantities
            self._verdict.add(evidence)
            self._over = self._verdict.final
            held = {rule.name: rule.holds() for rule in evidence.rules}
            removed = self._verdict.dynamic() if evidence.rules else None
        for k, (book, rays) in enumerate(zip(self._books, touching(scan, self._cells), strict=True)):
            changes = book.update(values, k)
            if evidence is not None:
                book.compare(evidence, k, frame)
            read = any(not q.total and not np.isnan(q.values[k]) for q in values)
            read = read or any(step.applies[k] for q in values for step in q.steps)
            if len(rays[0]) or len(rays[1]) or changes or read or frame == self._frame:
                seen = geometry(scan, *rays, self._asked.points[k], self._normals[k])
                numbers = {q.name: _plain(q.values[k]) for q in values}
                holds = tuple(name for name, of in held.items() if of[k])
                so_far = None if removed is None else bool(removed[k])
                steps = tuple(step.name for q in values for step in q.steps if step.applies[k])
                book.entries.append(LedgerEntry(frame, scan.index, *seen, numbers, changes, holds, so_far, steps))

    def _evidence(self) -> Evidence | None:
        """What the method states on the points; for so few, starting threads would take most of the time."""
        if self._explains is None:
            return None
        threads = kernels.threads_in_use()
        kernels.set_threads(1)
        try:
            return self._explains.evidence(self._asked)
        finally:
            kernels.set_threads(threads)

    def _close(self, k: int) -> PointLedger:
        dynamic, codes = self._labels
        held, verdict = self._verdict.held(), self._verdict.dynamic()
        info, row = self._run.labeller.info, int(self._rows[k])
        if verdict is not None and verdict[k] != dynamic[k]:
            raise PluginError(
                f"{info.name}: its evidence contradicts the label of point {row} of frame {self._frame}. "
                "Check the method with dynaviz.testing.check_method"
            )
        rules = tuple(self._books[k].closed(rule, k, bool(held[rule.name][k])) for rule in self._verdict.rules)
        truth = {Label.STATIC: "static", Label.DYNAMIC: "dynamic"}
        x, y, z = self._asked.points[k].astype(float).tolist()
        return PointLedger(
            frame=self._frame,
            index=self._asked.scan.index,
            point=row,
            position=(x, y, z),
            truth=None if self._truth is None else truth.get(Label(self._truth[row])),
            removed=bool(dynamic[k]),
            reason=info.reasons[codes[k]],
            verdict=None if verdict is None else bool(verdict[k]),
            rules=rules,
            quantities=tuple(map(QuantityInfo.of, self._quantities)),
            entries=tuple(self._books[k].entries),
            searched=self._searched,
        )


def replay(
    run: RunSpec, summary: SequenceSummary, asked: Sequence[tuple[int, Sequence[int]]], progress: Progress = silent
) -> list[tuple[PointLedger, ...]]:
    """The ledgers of points, from repeating a run with the same labeller.

    Args:
        run: its labeller forgets what it knows, and then knows it again.
        summary: of its sequence.
        asked: frames with rows of their scans; a frame may occur several times.
        progress: as for ``execute``.

    Returns:
        For each of ``asked`` the ledgers of its points.

    Raises:
        PluginError: if the evidence of the method contradicts its labels.
        DataError: for data that cannot be read.
    """
    rows: dict[int, list[int]] = {}
    for frame, points in asked:
        rows.setdefault(frame, []).extend(points)
    ledgers = {frame: Ledger(frame, points) for frame, points in rows.items() if points}
    execute(dataclasses.replace(run, metrics=(), summary=summary), list(ledgers.values()), progress=progress)
    left = {frame: iter(ledger.ledgers) for frame, ledger in ledgers.items()}
    return [tuple(next(left[frame]) for _ in points) for frame, points in asked]


@dataclass(slots=True)
class _Book:
    """One point's entries so far.

    Attributes:
        entries: by frame.
        totals: the last values of quantities that accumulate.
        best: for each lasting rule: how close the closest scan came, as from ``_closeness``, its frame, the terms.
    """

    entries: list[LedgerEntry] = field(default_factory=list)
    totals: dict[str, float] = field(default_factory=dict)
    best: dict[str, tuple[tuple[int, float], int, tuple[TermValue, ...]]] = field(default_factory=dict)

    def update(self, values: Sequence[Quantity], k: int) -> dict[str, float]:
        """Take the values of point k after a scan; returns the changes."""
        changes = {}
        for quantity in values:
            value = float(quantity.values[k])
            if quantity.total and not math.isnan(value):
                if change := value - self.totals.get(quantity.name, 0.0):
                    changes[quantity.name] = change
                self.totals[quantity.name] = value
        return changes

    def compare(self, evidence: Evidence, k: int, frame: int) -> None:
        """Keep the terms of lasting rules if this scan came closer than all before it."""
        for rule in evidence.rules:
            if rule.lasting:
                terms = _terms(rule, k)
                if rule.name not in self.best or _closeness(terms) > self.best[rule.name][0]:
                    self.best[rule.name] = _closeness(terms), frame, terms

    def closed(self, rule: Rule, k: int, holds: bool) -> RuleValue:
        """The rule with the numbers that decided."""
        if rule.name in self.best:
            _, frame, terms = self.best[rule.name]
            return RuleValue(rule.name, terms, holds, frame)
        return RuleValue(rule.name, _terms(rule, k), holds, None)


def _terms(rule: Rule, k: int) -> tuple[TermValue, ...]:
    found = []
    for term in rule.terms:
        values = np.asarray(term.values, np.float64)
        threshold = float(np.broadcast_to(np.asarray(term.threshold, np.float64), values.shape)[k])
        value, holds = _plain(values[k]), bool(term.holds()[k])
        found.append(TermValue(term.name, value, term.test, threshold, term.unit, holds, term.parameter))
    return tuple(found)


def _closeness(terms: Sequence[TermValue]) -> tuple[int, float]:
    """Number of terms that hold, and minus the distance of the others from their thresholds; larger is closer."""
    failing = [term for term in terms if not term.holds]
    gaps = (math.inf if term.value is None else abs(term.value - term.threshold) for term in failing)
    return len(terms) - len(failing), -sum(gaps)


def _plain(value: Any) -> float | None:
    number = float(value)
    return None if math.isnan(number) else number

"""The ledger of points: every scan whose rays touched them, what each contributed to their labels,
and the verdict.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from dynaviz import kernels
from dynaviz.arrays import F64, I64, Bool, Intp
from dynaviz.contracts.evidence import (
    Asked,
    Evidence,
    Explains,
    Quantity,
    Rule,
    Term,
    Verdict,
    voxels_around,
)
from dynaviz.contracts.method import MethodInfo
from dynaviz.contracts.metric import Labelled
from dynaviz.contracts.scan import TRUTH, Scan
from dynaviz.engine.loop import Listener, RunSpec
from dynaviz.errors import PluginError, UsageError
from dynaviz.explain.point_ledger import (
    LedgerEntry,
    PointLedger,
    QuantityInfo,
    RuleValue,
    TermValue,
)
from dynaviz.explain.ray_geometry import Touching, plain
from dynaviz.sources.summary import SequenceSummary
from dynaviz.spatial.surface import surface_normals

EDGE = (
    0.1  # metres: of the box around a point whose rays are searched, for a method without evidence
)


Pairs = tuple[tuple[float | None, float | None], ...]


class Ledger(Listener):
    """Keeps the ledgers of some points while a run is executed.

    Args:
        points: by frame, rows in its scan.

    Attributes:
        ledgers: by frame, one for each of its points; after the run.
    """

    def __init__(self, points: Mapping[int, Sequence[int]]) -> None:
        self._rows = {frame: np.array(rows, np.int64) for frame, rows in points.items()}
        self.ledgers: dict[int, tuple[PointLedger, ...]] = {}

    def begin(self, run: RunSpec, summary: SequenceSummary) -> None:
        """Read the points.

        Raises:
            UsageError: for a frame or a point that does not exist.
        """
        sequence = run.sequence
        labeller = run.labeller
        self._run = run
        self._explains = labeller if isinstance(labeller, Explains) else None
        self._books: dict[int, _Book] = {}
        for frame, rows in self._rows.items():
            if not 0 <= frame < len(sequence):
                raise UsageError(f"frame {frame}: the run has the frames 0 to {len(sequence) - 1}")
            scan = sequence[frame]
            if (wrong := rows[(rows < 0) | (rows >= len(scan))]).size:
                raise UsageError(
                    f"point {wrong[0]}: frame {frame} has the points 0 to {len(scan) - 1}"
                )
            self._books[frame] = _Book(frame, scan, rows)
        if (
            labeller.info.needs_map
        ):  # only the raw map has rows, and counting them means reading the scans again
            first = 0
            for frame in range(max(self._rows, default=-1) + 1):
                if (book := self._books.get(frame)) is not None:
                    book.asked = dataclasses.replace(book.asked, first=first)
                first += len(sequence[frame])

    def asking(self) -> list[tuple[bool, F64]]:
        """``alone`` and ``cells``, as in ``Evidence``, of points that later scans may change."""
        return [
            (book.alone, book.cells)
            for book in self._books.values()
            if not book.over and len(book.points)
        ]

    def observing(self, frame: int, scan: Scan) -> None:
        """Keep the scan."""
        self._scan = scan

    def observed(self, frame: int) -> None:
        """Enter the scan, except where an earlier one settled the labels."""
        self._enter(frame, self._scan)

    def labelled(self, labelled: Labelled, curves: Mapping[str, float]) -> None:
        """Enter the scan of a labeller that observes none.

        Take the labels and the rules that decided them.
        """
        if self._run.method is None:
            self._enter(labelled.frame, labelled.scan)
        if (book := self._books.get(labelled.frame)) is not None:
            book.judge(labelled, self._evidence(book), self._run.online)

    def finish(self, *_: Any) -> None:
        """Close the ledgers.

        Raises:
            PluginError: if the method's evidence contradicts its labels.
        """
        info = self._run.labeller.info
        self.ledgers = {frame: book.closed(info) for frame, book in self._books.items()}

    def _enter(self, frame: int, scan: Scan) -> None:
        """Add an entry to each ledger that the scan concerns."""
        books = [
            (book, self._evidence(book))
            for book in self._books.values()
            if not book.over and len(book.points)
        ]
        if not books:
            return
        cells = [book.cells if evidence is None else evidence.cells for book, evidence in books]
        rays = Touching.of(scan, np.concatenate(cells))
        first = 0
        for book, evidence in books:
            book.enter(frame, scan.index, evidence, rays, first)
            first += len(book.points)

    def _evidence(self, book: _Book) -> Evidence | None:
        """What the method states on points."""
        if self._explains is None:
            return None
        with kernels.one_thread():
            return self._explains.evidence(book.asked)


class _Book:
    """The ledgers of the points of one frame, while they are kept.

    Args:
        frame: its position in the run.
        scan: its scan.
        rows: (K,) the points.

    Attributes:
        asked: the points.
        points: (K, 3) float32, metres, world frame.
        cells: (K, 2, 3) float64, metres, world frame, as in ``Evidence``.
        alone: as in ``Evidence``.
        over: whether later scans change nothing.
    """

    def __init__(self, frame: int, scan: Scan, rows: I64) -> None:
        self.asked = Asked(scan.without_truth(), rows, 0)
        self._frame = frame
        self._truth = scan.labels
        self.points = self.asked.points
        self.cells = voxels_around(self.points, EDGE)
        self.alone = self.over = False
        self._normals = surface_normals(scan.points, self.points, scan.chosen(rows).origins)
        self._entries: list[list[LedgerEntry]] = [[] for _ in rows]
        self._totals: dict[str, F64] = {}  # the last values of quantities that accumulate
        self._best: dict[str, _Best] = {}
        self._verdict = Verdict()
        self._searched = 0
        self._quantities: tuple[Quantity, ...] = ()

    def enter(
        self, frame: int, index: int, evidence: Evidence | None, rays: Touching, first: int
    ) -> None:
        """Add a scan to the ledgers that it concerns.

        The points' cells are those from ``first`` on.
        """
        self._searched += 1
        values: tuple[Quantity, ...] = ()
        held: dict[str, Bool] = {}
        removed: Bool | None = None
        compared: dict[str, _Numbers] = {}
        concerned = (rays.hits + rays.crossed)[first : first + len(self.points)] > 0
        if evidence is not None:
            self.alone = evidence.alone
            self.cells = evidence.cells
            values = evidence.quantities
            self._quantities = evidence.quantities
            self._verdict.add(evidence)
            self.over = self._verdict.final
            held = {rule.name: rule.holds() for rule in evidence.rules}
            removed = self._verdict.dynamic() if evidence.rules else None
            compared = {rule.name: _Numbers(rule) for rule in evidence.rules if rule.lasting}
            self._compare(compared, frame)
        changes = self._changes(values)
        for quantity in values:
            if quantity.total:
                concerned |= changes[quantity.name] != 0
            else:
                concerned |= ~np.isnan(quantity.values)
            for step in quantity.steps:
                concerned |= step.applies
        if frame == self._frame:
            concerned[:] = True
        rows = np.flatnonzero(concerned)
        geometry = rays.seen(first + rows, self.points[rows], self._normals[rows])
        numbers = {quantity.name: plain(quantity.values[rows]) for quantity in values}
        added = {name: of[rows].tolist() for name, of in changes.items()}
        holding = {name: of[rows].tolist() for name, of in held.items()}
        verdict = None if removed is None else removed[rows].tolist()
        applying = [(step.name, step.applies[rows].tolist()) for q in values for step in q.steps]
        pairs = {name: each.pairs(rows) for name, each in compared.items()}
        for i, k in enumerate(rows.tolist()):
            self._entries[k].append(
                LedgerEntry(
                    frame,
                    index,
                    *geometry[i],
                    values={name: of[i] for name, of in numbers.items()},
                    changes={name: of[i] for name, of in added.items() if of[i]},
                    holds=tuple(name for name, of in holding.items() if of[i]),
                    removed=None if verdict is None else verdict[i],
                    steps=tuple(name for name, applies in applying if applies[i]),
                    terms={name: of[i] for name, of in pairs.items() if _any_known(of[i])},
                )
            )

    def judge(self, labelled: Labelled, evidence: Evidence | None, online: bool) -> None:
        """Take the labels, and the rules that decided them."""
        if evidence is not None:
            self._verdict.add(evidence)
        self.over = self.over or online
        self._dynamic = labelled.dynamic[self.asked.rows]
        self._codes = labelled.reasons[self.asked.rows]

    def closed(self, info: MethodInfo) -> tuple[PointLedger, ...]:
        """The ledgers; raises PluginError if the method's evidence contradicts its labels."""
        held = self._verdict.held()
        verdict = self._verdict.dynamic()
        if verdict is not None and (wrong := np.flatnonzero(verdict != self._dynamic)).size:
            raise PluginError(
                f"{info.name}: its evidence contradicts the label of point "
                f"{self.asked.rows[wrong[0]]} of frame "
                f"{self._frame}. Check the method with dynaviz.testing.check_method"
            )
        rules = [(rule, *self._deciding(rule)) for rule in self._verdict.rules]
        quantities = tuple(map(QuantityInfo.of, self._quantities))
        return tuple(
            PointLedger(
                frame=self._frame,
                index=self.asked.scan.index,
                point=int(self.asked.rows[k]),
                position=(
                    float(self.points[k, 0]),
                    float(self.points[k, 1]),
                    float(self.points[k, 2]),
                ),
                truth=None
                if self._truth is None
                else TRUTH.get(int(self._truth[self.asked.rows[k]])),
                removed=bool(self._dynamic[k]),
                reason=info.reasons[self._codes[k]],
                verdict=None if verdict is None else bool(verdict[k]),
                rules=tuple(
                    RuleValue(rule.name, terms(k), bool(held[rule.name][k]), frames[k])
                    for rule, terms, frames in rules
                ),
                quantities=quantities,
                entries=tuple(self._entries[k]),
                searched=self._searched,
            )
            for k in range(len(self.points))
        )

    def _changes(self, values: Sequence[Quantity]) -> dict[str, F64]:
        """What a scan added to the quantities that accumulate, (K,) each.

        0 where it left them or they are unknown.
        """
        changes = {}
        for quantity in values:
            if quantity.total:
                now = quantity.values
                before = self._totals.setdefault(quantity.name, np.zeros(len(self.points)))
                known = ~np.isnan(now)
                changes[quantity.name] = np.where(known, now - before, 0.0)
                before[known] = now[known]
        return changes

    def _compare(self, compared: Mapping[str, _Numbers], frame: int) -> None:
        """Keep the terms of lasting rules at the points to which this scan came closer than all
        before it.
        """
        for name, numbers in compared.items():
            best = self._best.setdefault(name, _Best(len(self.points)))
            count, gap = numbers.closeness()
            closer = (count > best.count) | ((count == best.count) & (gap > best.gap))
            best.count[closer] = count[closer]
            best.gap[closer] = gap[closer]
            for k in np.flatnonzero(closer).tolist():
                best.frames[k] = frame
                best.terms[k] = numbers.terms(k)

    def _deciding(
        self, rule: Rule
    ) -> tuple[Callable[[int], tuple[TermValue, ...]], Sequence[int | None]]:
        """By point, the terms of a rule with the numbers that decided, and the frame of the scan
        that set them.
        """
        if (best := self._best.get(rule.name)) is not None:
            return best.terms.__getitem__, best.frames
        return _Numbers(rule).terms, [None] * len(self.points)


class _Best:
    """For each point the scan that came closest to fulfilling a lasting rule.

    Attributes:
        count, gap: (K,) as from ``_Numbers.closeness``.
        frames, terms: of that scan.
    """

    def __init__(self, points: int) -> None:
        self.count = np.full(points, -1)
        self.gap = np.zeros(points)
        self.frames: list[int | None] = [None] * points
        self.terms: list[tuple[TermValue, ...]] = [()] * points


class _Numbers:
    """The numbers of a rule at all points."""

    def __init__(self, rule: Rule) -> None:
        self._terms: list[tuple[Term, F64, F64, Bool]] = []
        for term in rule.terms:
            values = np.asarray(term.values, np.float64)
            thresholds = np.broadcast_to(np.asarray(term.threshold, np.float64), values.shape)
            self._terms.append((term, values, thresholds, term.holds()))

    def terms(self, k: int) -> tuple[TermValue, ...]:
        """The terms of a point."""
        return tuple(
            TermValue(
                term.name,
                None if math.isnan(values[k]) else float(values[k]),
                term.test,
                float(limits[k]),
                term.unit,
                bool(holds[k]),
                term.parameter,
                term.follows,
            )
            for term, values, limits, holds in self._terms
        )

    def pairs(self, rows: Intp) -> list[Pairs]:
        """Number and threshold of each term, at each of (K,) points."""
        terms = [
            zip(plain(values[rows]), plain(limits[rows]), strict=True)
            for _, values, limits, _ in self._terms
        ]
        return list(zip(*terms, strict=True))

    def closeness(self) -> tuple[I64, F64]:
        """Number of terms that hold, and minus the distance of the others from their thresholds.

        A distance is a share of the larger number, so that metres and counts compare. Larger is
        closer.
        """
        holds = np.array([holds for *_, holds in self._terms])
        gaps = [
            np.nan_to_num(
                np.abs(values - limits) / np.maximum(np.maximum(abs(values), abs(limits)), 1e-9),
                nan=np.inf,
            )
            for _, values, limits, _ in self._terms
        ]
        return holds.sum(0), -np.where(holds, 0.0, gaps).sum(0)


def _any_known(pairs: Pairs) -> bool:
    return any(value is not None for value, _ in pairs)

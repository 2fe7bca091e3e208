"""A weighted sample of the points of a run, drawn while it labels them, and its numbers.

Points are drawn at random within strata: those with one outcome for one reason. The sample is the
same with any number of threads, because the order in which points are drawn follows from their
frame and row alone.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynaviz import kernels
from dynaviz.arrays import F32, F64, I64, U8, U64, Bool
from dynaviz.contracts.evidence import Asked, Evidence, Explains, Rule, Verdict
from dynaviz.contracts.method import Labeller
from dynaviz.contracts.metric import Labelled
from dynaviz.contracts.scan import Outcome
from dynaviz.contracts.scan import Sequence as Scans
from dynaviz.errors import PluginError
from dynaviz.explain.judging import Candidates, Judgeable, Summed, VariedTerm, front, share

FRAMES = 64  # of which points are drawn, at most: each is asked about after each scan
POINTS = 1500  # drawn of the static points, and of the dynamic ones
FEWEST = 25  # of a stratum, if it has as many
CODES = 256  # of reasons
ROOM = 20_000  # candidates of a rule, before superfluous ones are left out
OF_TRUTH = (
    (Outcome.STATIC_KEPT, Outcome.FALSE_POSITIVE),
    (Outcome.DYNAMIC_REMOVED, Outcome.FALSE_NEGATIVE),
)
REMOVED = (Outcome.DYNAMIC_REMOVED, Outcome.FALSE_POSITIVE)


@dataclass(frozen=True, slots=True, eq=False)
class Drawn:
    """Points of a run, K of them, drawn from H strata; in the order of frames.

    Attributes:
        frame, row: (K,) int64, position in the run, and row in the scan.
        position: (K, 3) float32, metres, world frame.
        instance: (K,) int64, of the object; 0 for none.
        stratum: (K,) int64, of each.
        outcomes: (H,) uint8, of each stratum.
        counts: (H,) int64, number of points in each stratum of the whole run.
        frames: number of frames of the run.
        of_frames: from how many of them points were drawn.
    """

    frame: I64
    row: I64
    position: F32
    instance: I64
    stratum: I64
    outcomes: U8
    counts: I64
    frames: int
    of_frames: int


class Draw:
    """Draws points while a run labels them.

    Args:
        frames: number of frames of the run.

    Attributes:
        first: number of points in all frames before each, and at the end in all.
    """

    def __init__(self, frames: int) -> None:
        self._frames = frames
        every = -(-frames // FRAMES)
        self._chosen = range(every // 2, frames, every)
        self._counts = np.zeros(len(Outcome) * CODES, np.int64)
        self._kept: dict[int, _Stratum] = defaultdict(_Stratum)
        self.first = [0]

    def add(self, labelled: Labelled) -> None:
        """Count the points of the next frame, and draw some."""
        self.first.append(self.first[-1] + len(labelled.scan))
        strata = labelled.outcome.astype(np.int64) * CODES + labelled.reasons
        self._counts += np.bincount(strata, minlength=len(self._counts))
        if labelled.frame not in self._chosen:
            return
        order = _order(labelled.frame, len(strata))
        for stratum in np.unique(strata).tolist():
            if stratum // CODES <= max(map(max, OF_TRUTH)):
                self._kept[stratum].add(labelled, order, np.flatnonzero(strata == stratum))

    def drawn(self) -> Drawn | None:
        """The sample; None if no point of the run has ground truth."""
        if not self._kept:
            return None
        sizes = self._sizes()
        parts = [self._kept[stratum].keep(size) for stratum, size in sizes.items()]
        joined = {
            name: np.concatenate([part[name] for part in parts])
            for name in ("frame", "row", "position", "instance")
        }
        sampled = [len(part["row"]) for part in parts]
        joined["stratum"] = np.repeat(np.arange(len(sizes)), sampled)
        order = np.lexsort((joined["row"], joined["frame"]))
        strata = np.array(list(sizes), np.int64)
        return Drawn(
            **{name: part[order] for name, part in joined.items()},
            outcomes=(strata // CODES).astype(np.uint8),
            counts=self._counts[strata],
            frames=self._frames,
            of_frames=len(self._chosen),
        )

    def _sizes(self) -> dict[int, int]:
        """How many points of each stratum are drawn.

        In proportion to the root of its size: a stratum that may change is not always large.
        """
        sizes = {}
        for outcomes in OF_TRUTH:
            strata = [each for each in sorted(self._kept) if each // CODES in outcomes]
            roots = {each: math.sqrt(self._counts[each]) for each in strata}
            for stratum in strata:
                size = round(POINTS * roots[stratum] / sum(roots.values()))
                sizes[stratum] = max(size, FEWEST)
        return sizes


class _Stratum:
    """The points of a stratum that come first in the order of drawing."""

    def __init__(self) -> None:
        self._bound = np.uint64(np.iinfo(np.uint64).max)
        self._order = np.zeros(0, np.uint64)
        self._parts: dict[str, NDArray[Any]] = {
            "frame": np.zeros(0, np.int64),
            "row": np.zeros(0, np.int64),
            "position": np.zeros((0, 3), np.float32),
            "instance": np.zeros(0, np.int64),
        }

    def add(self, labelled: Labelled, order: U64, rows: I64) -> None:
        """Take those of some rows of a scan that come before the last one so far."""
        rows = rows[order[rows] <= self._bound]
        if len(rows) > POINTS:
            rows = rows[np.argpartition(order[rows], POINTS)[:POINTS]]
        instances = labelled.scan.instances
        added = {
            "frame": np.full(len(rows), labelled.frame, np.int64),
            "row": rows,
            "position": labelled.scan.points[rows],
            "instance": np.zeros(len(rows), np.int64) if instances is None else instances[rows],
        }
        self._order = np.concatenate([self._order, order[rows]])
        self._parts = {
            name: np.concatenate([part, added[name]]) for name, part in self._parts.items()
        }
        if len(self._order) > POINTS:
            self.keep(POINTS)
            self._bound = self._order[-1]

    def keep(self, size: int) -> dict[str, NDArray[Any]]:
        """Keep those that come first: their frames, rows, positions and instances."""
        chosen = np.argsort(self._order, kind="stable")[:size]
        self._order = self._order[chosen]
        self._parts = {name: part[chosen] for name, part in self._parts.items()}
        return self._parts


class Witnesses:
    """Asks a method about drawn points after each scan, and keeps what can be judged again.

    Args:
        drawn: the points.
        first: as of ``Draw``.
        given: the parameters of the run that are numbers.
    """

    def __init__(self, drawn: Drawn, first: list[int], given: Mapping[str, float]) -> None:
        self._drawn = drawn
        self._first = first
        self._given = given
        self._asked: dict[int, _Asked] = {}

    @property
    def frames(self) -> list[int]:
        """Frames with points."""
        found: list[int] = np.unique(self._drawn.frame).tolist()
        return found

    def begin(self, labeller: Labeller, sequence: Scans) -> None:
        """Read the points."""
        assert isinstance(labeller, Explains)
        self._explains: Explains = labeller
        self._name = labeller.info.name
        for frame in self.frames:
            which = np.flatnonzero(self._drawn.frame == frame)
            scan = sequence[frame].without_truth()
            asked = Asked(scan, self._drawn.row[which], self._first[frame])
            removed = np.isin(self._drawn.outcomes[self._drawn.stratum[which]], REMOVED)
            self._asked[frame] = _Asked(asked, removed, self._given)

    def asking(self) -> list[tuple[bool, F64]]:
        """As of ``Ledger``."""
        return [(each.alone, each.cells) for each in self._asked.values() if not each.over]

    def observed(self) -> None:
        """After a scan."""
        with kernels.one_thread():
            for each in self._asked.values():
                if not each.over:
                    each.add(self._explains.evidence(each.asked))

    def labelled(self, frame: int, online: bool) -> None:
        """After the labels of a frame; online, later scans change them no more.

        Raises:
            PluginError: if the evidence contradicts those of the run.
        """
        each = self._asked.get(frame)
        if each is not None:
            self._judge(each)
            each.over = each.over or online

    def finish(self) -> None:
        """After the last scan, for frames that were not labelled again; raises as ``labelled``."""
        for each in self._asked.values():
            if not each.complete:
                self._judge(each)

    def _judge(self, each: _Asked) -> None:
        with kernels.one_thread():
            each.add(self._explains.evidence(each.asked), judged=True)
        verdict = each.verdict.dynamic()
        if verdict is not None and (verdict != each.removed).any():
            raise PluginError(f"{self._name}: its evidence contradicts its labels")

    def judged(self) -> Judgeable | None:
        """The points, in the order of frames, to be judged again.

        None if the method does not state the same rules on all of them.
        """
        parts = [part for each in self._asked.values() if (part := each.judged()) is not None]
        alike = {tuple(rule.terms for rule in part.rules) for part in parts}
        if len(parts) < len(self._asked) or len(alike) != 1:
            return None
        return _joined(parts)


class _Asked:
    """The points of one frame, while a method is asked about them.

    Args:
        asked: the points.
        removed: (K,) their labels in the run.
        given: as of ``Witnesses``.

    Attributes:
        cells, alone: as in ``Evidence``, after the last scan.
        verdict: of the rules.
        over: whether later scans change nothing.
        complete: whether the evidence was asked for after the labels.
    """

    def __init__(self, asked: Asked, removed: Bool, given: Mapping[str, float]) -> None:
        self.asked = asked
        self.removed = removed
        self.cells = np.empty((0, 2, 3))
        self.alone = False
        self.verdict = Verdict()
        self.over = False
        self.complete = False
        self._given = given
        self._sums: tuple[Summed, ...] = ()
        self._bits: dict[str, list[U8]] = defaultdict(list)
        self._rows: dict[str, _Rows] = {}

    def add(self, evidence: Evidence, judged: bool = False) -> None:
        """Keep the numbers after one more scan, or after the label."""
        self.complete = judged
        if self.verdict.final:
            return
        self.over = evidence.final
        self.alone = evidence.alone
        self.cells = evidence.cells
        if not judged:
            self._sums = sums_of(evidence, self._given)
            for quantity in evidence.quantities:
                if any(quantity.name == each.name for each in self._sums):
                    steps = [step.applies.astype(np.uint8) << i
                             for i, step in enumerate(quantity.steps)]  # fmt: skip
                    self._bits[quantity.name].append(np.bitwise_or.reduce(steps))
        for rule in evidence.rules:
            if rule.lasting:
                self._of(rule).add(rule)
        self.verdict.add(evidence)

    def judged(self) -> Judgeable | None:
        """The points; None if the method stated no rules."""
        if not self.verdict.rules:
            return None
        for rule in self.verdict.rules:
            if not rule.lasting:
                self._of(rule).add(rule)
        scans = []
        bits = []
        for each in self._sums:
            applied = np.stack(self._bits[each.name], 1)
            scans.append((applied > 0).sum(1))
            bits.append(applied[applied > 0])
        rules = [self._rows[rule.name].candidates() for rule in self.verdict.rules]
        return Judgeable(self.removed, self._sums, tuple(scans), tuple(bits), tuple(rules))

    def _of(self, rule: Rule) -> _Rows:
        names = {each.name for each in self._sums}
        return self._rows.setdefault(rule.name, _Rows(rule, names, self._given))


class _Rows:
    """The numbers with which a rule might hold for some points."""

    def __init__(self, rule: Rule, sums: set[str], given: Mapping[str, float]) -> None:
        self._given = given
        self._varied = [
            i
            for i, term in enumerate(rule.terms)
            if term.name in sums or (term.parameter in given and term.follows != "otherwise")
        ]
        self._sums = sums
        self.terms = tuple(
            VariedTerm(
                term.name,
                term.test,
                0.0 if term.parameter in given else float(np.ravel(term.threshold)[0]),
                term.parameter if term.parameter in given else "",
                term.follows,
            )
            for term in (rule.terms[i] for i in self._varied)
        )
        self._owner = np.zeros(0, np.int64)
        self._numbers = np.zeros((0, len(self._varied)))
        self._room = ROOM

    def add(self, rule: Rule) -> None:
        """Add the numbers after a scan at the points where the other terms hold."""
        fixed = [term.holds() for i, term in enumerate(rule.terms) if i not in self._varied]
        size = len(np.ravel(rule.terms[0].values))
        holds = np.logical_and.reduce(fixed) if fixed else np.ones(size, np.bool_)
        columns = []
        for i in self._varied:
            term = rule.terms[i]
            values = np.asarray(term.values, np.float64)
            if term.name in self._sums:
                values = np.full(size, np.nan)
            else:
                if term.follows == "complement":
                    values = share(values, term.threshold, self._given[term.parameter])
                holds = holds & ~np.isnan(values)
            columns.append(values)
        rows = np.flatnonzero(holds)
        numbers = np.stack(columns, 1)[rows] if columns else np.zeros((len(rows), 0))
        self._owner = np.concatenate([self._owner, rows])
        self._numbers = np.concatenate([self._numbers, numbers])
        self._thin()

    def candidates(self) -> Candidates:
        """Those that no other candidate of the same point makes superfluous, by point."""
        self._thin(always=True)
        return Candidates(self.terms, self._owner.astype(np.int32), self._numbers)

    def _thin(self, always: bool = False) -> None:
        """Leave out candidates that others make superfluous."""
        if not always and len(self._owner) < self._room:
            return
        order = np.argsort(self._owner, kind="stable")
        owner = self._owner[order]
        numbers = self._numbers[order]
        edges = np.flatnonzero(np.diff(owner, prepend=-1, append=-1))
        tests = [term.test for term in self.terms]
        sums = [i for i, term in enumerate(self.terms) if term.name in self._sums]
        kept = np.zeros(len(owner), np.bool_)
        for low, high in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
            kept[low:high] = front(np.delete(numbers[low:high], sums, 1),
                                   np.delete(tests, sums).tolist())  # fmt: skip
        self._owner = owner[kept]
        self._numbers = numbers[kept]
        self._room = max(ROOM, 2 * len(self._owner))


def sums_of(evidence: Evidence, given: Mapping[str, float]) -> tuple[Summed, ...]:
    """The sums of log-odds of a method whose parameters are known."""
    found = []
    for q in evidence.quantities:
        steps = tuple((step.name, step.parameter) for step in q.steps)
        if steps and all(name in given for name in (*(name for _, name in steps), *q.limits)):
            found.append(Summed(q.name, steps, q.limits))
    return tuple(found)


def enters(labeller: Labeller, scan: Asked, given: Mapping[str, float]) -> bool:
    """Whether parameters enter the decision of a method in a known way.

    Args:
        labeller: right after it labelled the scan.
        scan: a point of the scan.
        given: the parameters that are numbers.
    """
    if not isinstance(labeller, Explains):
        return False
    evidence = labeller.evidence(scan)
    terms = [term for rule in evidence.rules for term in rule.terms]
    known = any(term.parameter in given and term.follows != "otherwise" for term in terms)
    return known or bool(evidence.rules and sums_of(evidence, given))


def _joined(parts: list[Judgeable]) -> Judgeable:
    """The points of several frames, which are in the order of frames."""
    sums = parts[0].sums
    rules = []
    starts = np.cumsum([0, *(len(part.removed) for part in parts)])
    for k, rule in enumerate(parts[0].rules):
        of_rule = [part.rules[k] for part in parts]
        owner = [each.owner + start for each, start in zip(of_rule, starts[:-1], strict=True)]
        rules.append(
            Candidates(
                rule.terms,
                np.concatenate(owner).astype(np.int32),
                np.concatenate([each.numbers for each in of_rule]),
            )
        )
    return Judgeable(
        np.concatenate([part.removed for part in parts]),
        sums,
        tuple(np.concatenate([part.scans[k] for part in parts]) for k in range(len(sums))),
        tuple(np.concatenate([part.bits[k] for part in parts]) for k in range(len(sums))),
        tuple(rules),
    )


def _order(frame: int, points: int) -> U64:
    """(N,) a number for each point of a frame that looks random (the mixer of SplitMix64)."""
    with np.errstate(over="ignore"):
        mixed = np.arange(points, dtype=np.uint64) + (np.uint64(frame + 1) << np.uint64(32))
        mixed *= np.uint64(0x9E3779B97F4A7C15)
        for shift, factor in ((30, 0xBF58476D1CE4E5B9), (27, 0x94D049BB133111EB)):
            mixed = (mixed ^ (mixed >> np.uint64(shift))) * np.uint64(factor)
        return mixed ^ (mixed >> np.uint64(31))

"""The evidence of a failure case.

What the ledgers of its points have in common, in the terms of the method.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from statistics import median

from dynaviz.explain.deciding import decided_by, failing, failures_alone, gap
from dynaviz.explain.point_ledger import LedgerEntry, PointLedger, TermValue
from dynaviz.explain.words import needed, number, yes_or_no
from dynaviz.scores.failure_case import FailureCase
from dynaviz.spatial.surface import GRAZING

ALONE = 2  # terms that failed alone, listed at most
SHOWN = 2  # terms of the rule that removed points, listed at most


@dataclass(frozen=True, slots=True)
class Deciding:
    """The rule that decided most points of a case.

    That which removed them, or that which came closest to it.

    Attributes:
        rule: its name.
        points: number of points that it decided.
        terms: of a removed case all its terms, of a kept case those that fail, with the median
            value; None if unknown.
        frame: of the scan that fulfilled the rule; None if it is not the same for all points, and
            for a rule that the last numbers decide.
    """

    rule: str
    points: int
    terms: tuple[TermValue, ...]
    frame: int | None = None


@dataclass(frozen=True, slots=True)
class CaseEvidence:
    """What the points of a case have in common; medians are over points.

    Attributes:
        points: number of points with a ledger.
        searched: number of scans searched.
        hit, crossed: median number of scans that hit, and that crossed, the cell of a point.
        removed: the label of most points.
        deciding: the rule that decided; None for a labeller without evidence.
        alone: of kept points and a rule that one scan may fulfil: terms that failed alone, with the
            number of scans, most frequent first.
    """

    points: int
    searched: int
    hit: float
    crossed: float
    removed: bool
    deciding: Deciding | None
    alone: tuple[tuple[TermValue, int], ...] = ()

    @property
    def text(self) -> str:
        """The evidence in a sentence or two, as a person would say it.

        It counts rays in the cell that the method uses. A look through the place of a point asks
        for more: ``dynaviz.contracts.looks``.
        """
        many = "" if self.points == 1 else f"in the median of {self.points:,} points, "
        cell = "its cell" if self.points == 1 else "the cell"
        seen = (
            f"rays of {_scans(self.crossed, self.searched)} crossed {cell}"
            if self.crossed
            else f"no rays of {_scans(self.searched)} crossed {cell}"
        )
        hit = f"those of {self.hit:g} ended in it" if self.hit else "none ended in it"
        because = ""
        if self.deciding is not None and not self.alone:
            because = f" ({_because(self.deciding, self.points, self.removed)})"
        head = "Removed" if self.removed else "Kept"
        return f"{head}: {many}{seen}, {hit}{because}.{_alone(self.alone)}"


def evidence_of(ledgers: Sequence[PointLedger]) -> CaseEvidence:
    """What ledgers, at least one, have in common."""
    removed = 2 * sum(ledger.removed for ledger in ledgers) > len(ledgers)
    alike = [ledger for ledger in ledgers if ledger.removed == removed and ledger.rules]
    deciding = _deciding(alike, removed)
    alone = [] if removed or deciding is None else failures_alone(alike, deciding.rule)
    return CaseEvidence(
        points=len(ledgers),
        searched=max(ledger.searched for ledger in ledgers),
        hit=_median(ledgers, lambda entry: entry.hits > 0),
        crossed=_median(ledgers, lambda entry: entry.crossed > 0),
        removed=removed,
        deciding=deciding,
        alone=tuple(alone),
    )


def evidence_text(ledgers: Sequence[PointLedger], case: FailureCase | None) -> str:
    """What ledgers, at least one, of a case have in common, and the measured angles of the case, in
    sentences.

    Points with the reason that decided the case stand for it, as they do in its own sentence; if
    its worst frame has none, those with the most frequent reason there.
    """
    if case is None or case.reason is None:
        return evidence_of(ledgers).text
    names = Counter(ledger.reason.name for ledger in ledgers)
    name = case.reason if case.reason in names else names.most_common(1)[0][0]
    chosen = [ledger for ledger in ledgers if ledger.reason.name == name]
    parts = [evidence_of(chosen).text]
    if name != case.reason:
        parts.insert(0, f"In its worst frame, another reason decides: {name.replace('_', ' ')}.")
    if others := len(ledgers) - len(chosen):
        parts.append(f"{others:,} other point{'s have' if others > 1 else ' has'} other reasons.")
    if case.grazed is not None:
        parts.append(
            f"The rays that ended on it met {100 * case.grazed:.0f} % of its surface at "
            f"less than {GRAZING:g}°."
        )
    return " ".join(parts)


def flip(ledger: PointLedger) -> str:
    """How far a point is from the other label, by the only term that would have to change.

    Empty if there are more.
    """
    rule = decided_by(ledger)
    if rule is None:
        return ""
    changing = [term for term in rule.terms if term.holds == ledger.removed]
    removing = sum(other.holds for other in ledger.rules)
    if len(changing) != 1 or math.isnan(changing[0].threshold) or (ledger.removed and removing > 1):
        return ""
    term = changing[0]
    value = changing[0].value
    if value is None or yes_or_no(term):
        return ""
    away = abs(value - term.threshold)
    unit = f" {term.unit}" if term.unit else ""
    text = f"The threshold is {number(away)}{unit} away" if away else "It is at the threshold"
    scans = _scans_to_flip(ledger, term, away)
    if scans is None:
        return f"{text}."
    which = "hitting" if ledger.removed else "crossing"
    would = "keep" if ledger.removed else "remove"
    return f"{text}: {scans} more {which} scan{'s' * (scans > 1)} would {would} it."


def _scans_to_flip(ledger: PointLedger, term: TermValue, away: float) -> int | None:
    """Scans like the earlier ones after which an accumulated term would be beyond its threshold.

    None if unknown.
    """
    if not any(quantity.name == term.name and quantity.total for quantity in ledger.quantities):
        return None
    down = (term.test in ("<", "<=")) != ledger.removed  # the direction of the other label
    steps = [
        change
        for entry in ledger.entries
        if (change := entry.changes.get(term.name)) and (change < 0) == down
    ]
    if not steps:
        return None
    step = abs(median(steps))
    count = math.ceil(away / step)
    return (
        count + 1
        if count * step == away and (term.test in ("<", ">")) != ledger.removed
        else max(count, 1)
    )


def _deciding(ledgers: Sequence[PointLedger], removed: bool) -> Deciding | None:
    rules = [rule for ledger in ledgers if (rule := decided_by(ledger)) is not None]
    if not rules:
        return None
    kept_by = Counter((rule.name, failing(rule)) for rule in rules)
    (name, failed), count = kept_by.most_common(1)[0]
    members = [rule for rule in rules if (rule.name, failing(rule)) == (name, failed)]
    shown = range(len(members[0].terms)) if removed else failed
    terms = tuple(_median_term([rule.terms[k] for rule in members]) for k in shown)
    frames = {rule.frame for rule in members}
    return Deciding(name, count, terms, frames.pop() if len(frames) == 1 else None)


def _median_term(terms: Sequence[TermValue]) -> TermValue:
    values = [term.value for term in terms if term.value is not None]
    first = terms[0]
    thresholds = [term.threshold for term in terms if not math.isnan(term.threshold)]
    threshold = median(thresholds) if thresholds else math.nan
    value = median(values) if values else None
    return TermValue(
        first.name,
        value,
        first.test,
        threshold,
        first.unit,
        first.holds,
        first.parameter,
        first.follows,
    )


def _median(ledgers: Sequence[PointLedger], counts: Callable[[LedgerEntry], bool]) -> float:
    return float(median(sum(map(counts, ledger.entries)) for ledger in ledgers))


def _because(deciding: Deciding, points: int, removed: bool) -> str:
    """The numbers that decided, in brackets."""
    numbers = [term for term in deciding.terms if not yes_or_no(term) and gap(term) < math.inf]
    shown = deciding.terms
    if removed and numbers:
        shown = tuple(sorted(numbers, key=gap)[:SHOWN])  # those that the least change would turn
    share = "" if deciding.points == points else f"{deciding.points:,} of them: "
    frame = "" if deciding.frame is None else f"in frame {deciding.frame}: "
    return f"{share}{frame}{'; '.join(map(needed, shown))}"


def _alone(alone: Sequence[tuple[TermValue, int]]) -> str:
    """Which terms failed alone, and in how many scans."""
    return "".join(
        f" In {_scans(count)}, only this failed: {needed(term, best=count > 1)}."
        for term, count in alone[:ALONE]
    )


def _scans(count: float, total: int = 0) -> str:
    if total:
        return f"{count:g} of {_scans(total)}"
    return f"{count:g} scan{'s' * (count != 1)}"

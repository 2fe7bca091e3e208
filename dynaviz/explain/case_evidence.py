"""The evidence of a failure case.

What the ledgers of its points have in common, in the terms of the method.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from statistics import median

from dynaviz.explain.point_ledger import LedgerEntry, PointLedger, RuleValue, TermValue
from dynaviz.explain.words import number, words, yes_or_no
from dynaviz.scores.failure_case import FailureCase
from dynaviz.spatial.surface import GRAZING


@dataclass(frozen=True, slots=True)
class Deciding:
    """The rule that decided most points of a case.

    That which removed them, or that which came closest to it.

    Attributes:
        rule: its name.
        points: number of points that it decided.
        terms: of a removed case all its terms, of a kept case those that fail, with the median
            value; None if unknown.
    """

    rule: str
    points: int
    terms: tuple[TermValue, ...]


@dataclass(frozen=True, slots=True)
class CaseEvidence:
    """What the points of a case have in common; medians are over points.

    Attributes:
        points: number of points with a ledger.
        searched: number of scans searched.
        hit, crossed: median number of scans that hit, and that crossed, the cell of a point.
        removed: the label of most points.
        deciding: the rule that decided; None for a labeller without evidence.
    """

    points: int
    searched: int
    hit: float
    crossed: float
    removed: bool
    deciding: Deciding | None

    @property
    def text(self) -> str:
        """The evidence in a sentence or two."""
        cells = (
            "Its cell was"
            if self.points == 1
            else f"In the median of {self.points:,} points, the cell was"
        )
        counts = f"hit by {_scans(self.hit)} and crossed by {self.crossed:g} of {self.searched:,}"
        decided = (
            ""
            if self.deciding is None
            else f" {_decided(self.deciding, self.points, self.removed)}"
        )
        return f"{cells} {counts}.{decided}"


def evidence_of(ledgers: Sequence[PointLedger]) -> CaseEvidence:
    """What ledgers, at least one, have in common."""
    removed = 2 * sum(ledger.removed for ledger in ledgers) > len(ledgers)
    return CaseEvidence(
        points=len(ledgers),
        searched=max(ledger.searched for ledger in ledgers),
        hit=_median(ledgers, lambda entry: entry.hits > 0),
        crossed=_median(ledgers, lambda entry: entry.crossed > 0),
        removed=removed,
        deciding=_deciding(
            [ledger for ledger in ledgers if ledger.removed == removed and ledger.rules], removed
        ),
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
            f"Rays meet {100 * case.grazed:.0f} % of its surface at less than {GRAZING:g}°."
        )
    return " ".join(parts)


def decided_by(ledger: PointLedger) -> RuleValue | None:
    """The rule that removed a point, or the one that came closest to it; None without rules."""
    if ledger.removed:
        return next((rule for rule in ledger.rules if rule.holds), None)
    return max(ledger.rules, key=_closeness, default=None)


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
    gap = abs(value - term.threshold)
    unit = f" {term.unit}" if term.unit else ""
    text = f"The threshold is {number(gap)}{unit} away"
    scans = _scans_to_flip(ledger, term, gap)
    if scans is None:
        return f"{text}."
    which = "hitting" if ledger.removed else "crossing"
    would = "keep" if ledger.removed else "remove"
    return f"{text}: {scans} more {which} scan{'s' * (scans > 1)} would {would} it."


def _scans_to_flip(ledger: PointLedger, term: TermValue, gap: float) -> int | None:
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
    count = math.ceil(gap / step)
    return (
        count + 1
        if count * step == gap and (term.test in ("<", ">")) != ledger.removed
        else max(count, 1)
    )


def _deciding(ledgers: Sequence[PointLedger], removed: bool) -> Deciding | None:
    rules = [rule for ledger in ledgers if (rule := decided_by(ledger)) is not None]
    if not rules:
        return None
    kept_by = Counter((rule.name, _failing(rule)) for rule in rules)
    (name, failing), count = kept_by.most_common(1)[0]
    members = [rule for rule in rules if (rule.name, _failing(rule)) == (name, failing)]
    shown = range(len(members[0].terms)) if removed else failing
    return Deciding(
        name, count, tuple(_median_term([rule.terms[k] for rule in members]) for k in shown)
    )


def _failing(rule: RuleValue) -> tuple[int, ...]:
    return tuple(k for k, term in enumerate(rule.terms) if not term.holds)


def _closeness(rule: RuleValue) -> tuple[int, int]:
    """A rule with unknown values does not apply.

    Of the others, one with fewer failing terms is closer.
    """
    unknown = sum(map(_unknown, rule.terms))
    return -unknown, -len(_failing(rule))


def _unknown(term: TermValue) -> bool:
    return term.value is None or math.isnan(term.threshold)


def _median_term(terms: Sequence[TermValue]) -> TermValue:
    values = [term.value for term in terms if term.value is not None]
    first = terms[0]
    thresholds = [term.threshold for term in terms if not math.isnan(term.threshold)]
    threshold = median(thresholds) if thresholds else math.nan
    value = median(values) if values else None
    return TermValue(first.name, value, first.test, threshold, first.unit, first.holds)


def _median(ledgers: Sequence[PointLedger], counts: Callable[[LedgerEntry], bool]) -> float:
    return float(median(sum(map(counts, ledger.entries)) for ledger in ledgers))


def _decided(deciding: Deciding, points: int, removed: bool) -> str:
    share = "" if deciding.points == points else f" for {deciding.points:,} of them"
    head = f"Removed{share}" if removed else f"Not removed{share}"
    return f"{head}, because {' and '.join(map(words, deciding.terms))}."


def _scans(count: float) -> str:
    return f"{count:g} scan{'s' * (count != 1)}"

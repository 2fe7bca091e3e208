"""The scans that decided the label of a point, equal ones together."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from dynaviz.contracts.evidence import TESTS
from dynaviz.explain.point_ledger import LedgerEntry, PointLedger, RuleValue, TermValue
from dynaviz.explain.words import failed, number, yes_or_no


@dataclass(frozen=True, slots=True)
class DecidingScans:
    """Scans in a row that did the same to what decided.

    Attributes:
        frames: positions in the run of the first and of the last.
        scans: number of them.
        hits, crossed: rays that end in the cell of the point, and that pass through it.
        range_m: the smallest and the largest.
        angle_deg: the same; None if the point lies on no surface.
        text: what they changed or measured, such as ``clear +17``; empty for the point's own scan
            if it changed nothing.
        removed: the verdict from the last of them on, if it changed there.
    """

    frames: tuple[int, int]
    scans: int
    hits: int
    crossed: int
    range_m: tuple[float, float]
    angle_deg: tuple[float, float] | None
    text: str
    removed: bool | None

    @property
    def span(self) -> str:
        """Its frames, such as ``26-46``."""
        first, last = self.frames
        return f"{first}" if first == last else f"{first}-{last}"


def decided_by(ledger: PointLedger) -> RuleValue | None:
    """The rule that removed a point, or the one that came closest to it; None without rules."""
    if ledger.removed:
        return next((rule for rule in ledger.rules if rule.holds), None)
    return max(ledger.rules, key=_closeness, default=None)


def failing(rule: RuleValue) -> tuple[int, ...]:
    """Which terms of a rule do not hold."""
    return tuple(k for k, term in enumerate(rule.terms) if not term.holds)


def scan_terms(entry: LedgerEntry, rule: RuleValue) -> tuple[TermValue, ...]:
    """The terms of a rule that one scan may fulfil, with the numbers of a scan.

    Empty if the scan measured none of them, or the recording has no numbers of single scans.
    """
    return tuple(
        TermValue(
            term.name,
            value,
            term.test,
            float("nan") if threshold is None else threshold,
            term.unit,
            value is not None
            and threshold is not None
            and bool(TESTS[term.test](np.array(value), threshold)),
            term.parameter,
            term.follows,
        )
        for term, (value, threshold) in zip(
            rule.terms, entry.terms.get(rule.name, ()), strict=False
        )
    )


def failures_alone(ledgers: Sequence[PointLedger], rule: str) -> Iterator[tuple[TermValue, int]]:
    """The terms of a rule that failed alone in a scan, most frequent first.

    With the numbers of the scan that came closest, and the median number of scans over the points.
    """
    counts: Counter[int] = Counter()
    closest: dict[int, TermValue] = {}
    for ledger in ledgers:
        of_rule = next((each for each in ledger.rules if each.name == rule), None)
        if of_rule is None:
            continue
        for entry in ledger.entries:
            wrong = [
                (k, term) for k, term in enumerate(scan_terms(entry, of_rule)) if not term.holds
            ]
            if len(wrong) == 1:
                ((k, term),) = wrong
                counts[k] += 1
                if k not in closest or gap(term) < gap(closest[k]):
                    closest[k] = term
    for k, count in counts.most_common():
        yield closest[k], max(round(count / len(ledgers)), 1)


def gap(term: TermValue) -> float:
    """Distance of a number from its threshold, as a share of the larger one; infinite if
    unknown.
    """
    if term.value is None or term.threshold != term.threshold:
        return float("inf")
    return abs(term.value - term.threshold) / max(abs(term.value), abs(term.threshold), 1e-9)


def deciding_scans(ledger: PointLedger) -> tuple[DecidingScans, ...]:
    """The scans that changed what the deciding rule compares, or that it judged, by frame.

    Without rules, or if none of their numbers changed, all scans that touched the point. The scan
    of the point itself, and those that changed the verdict, are always among them.
    """
    rule = decided_by(ledger)
    names = _quantities(ledger, rule)
    turns = _turns(ledger)
    rows: list[list[tuple[LedgerEntry, tuple[object, ...]]]] = []
    said = [(entry, _kind(ledger, entry, rule, names)) for entry in ledger.entries]
    silent = not any(kind for _, kind in said)
    for entry, kind in said:
        own = entry.frame == ledger.frame
        if silent:
            kind = (bool(entry.hits), bool(entry.crossed))
        if not kind and not own and entry.frame not in turns:
            continue
        together = rows and rows[-1][-1][1] == kind and not own
        together = together and rows[-1][-1][0].frame != ledger.frame
        if together and rows[-1][-1][0].frame not in turns:
            rows[-1].append((entry, kind))
        else:
            rows.append([(entry, kind)])
    return tuple(_row(ledger, [entry for entry, _ in row], rule, names, turns) for row in rows)


def _row(
    ledger: PointLedger,
    entries: Sequence[LedgerEntry],
    rule: RuleValue | None,
    names: Sequence[str],
    turns: dict[int, bool],
) -> DecidingScans:
    ranges = [entry.range_m for entry in entries]
    angles = [entry.angle_deg for entry in entries if entry.angle_deg is not None]
    return DecidingScans(
        frames=(entries[0].frame, entries[-1].frame),
        scans=len(entries),
        hits=sum(entry.hits for entry in entries),
        crossed=sum(entry.crossed for entry in entries),
        range_m=(min(ranges), max(ranges)),
        angle_deg=(min(angles), max(angles)) if angles else None,
        text=_text(ledger, entries, rule, names),
        removed=turns.get(entries[-1].frame),
    )


def _quantities(ledger: PointLedger, rule: RuleValue | None) -> list[str]:
    """Names of the quantities of which a rule compares the numbers.

    Those with the names of its terms, or else all that accumulate, or else all.
    """
    terms = {term.name for term in rule.terms} if rule else set()
    order = (
        [q.name for q in ledger.quantities if q.name in terms],
        [q.name for q in ledger.quantities if q.total],
        [q.name for q in ledger.quantities],
    )
    return next((names for names in order if names), [])


def _turns(ledger: PointLedger) -> dict[int, bool]:
    """The frames after which the verdict changed, and the verdict from then on."""
    turns = {}
    before = False  # without evidence, a point is kept
    for entry in ledger.entries:
        if entry.removed is not None and entry.removed != before:
            turns[entry.frame] = entry.removed
            before = entry.removed
    return turns


def _kind(
    ledger: PointLedger, entry: LedgerEntry, rule: RuleValue | None, names: Sequence[str]
) -> tuple[object, ...]:
    """What a scan did, so that equal scans are listed together; empty for nothing."""
    if rule is not None and rule.frame is not None:
        if entry.terms:
            return tuple(
                (k, term.value if yes_or_no(term) else None)
                for k, term in enumerate(scan_terms(entry, rule))
                if not term.holds
            ) or (("holds",) if rule.name in entry.terms else ())
        if rule.name in entry.holds:
            return ("holds",)
    changed = [(name, entry.changes[name] > 0) for name in names if entry.changes.get(name)]
    if changed:
        return tuple(changed)
    readings = {q.name: q.legend for q in ledger.quantities if not q.total}
    return tuple(
        (name, value if readings[name] else None)
        for name in names
        if name in readings and (value := entry.values.get(name)) is not None
    )


def _text(
    ledger: PointLedger,
    entries: Sequence[LedgerEntry],
    rule: RuleValue | None,
    names: Sequence[str],
) -> str:
    last = entries[-1]
    if rule is not None and (terms := scan_terms(last, rule)):
        wrong = [k for k, term in enumerate(terms) if not term.holds]
        if not wrong:
            return f"{rule.name}: all hold"
        known = [k for k in wrong if gap(terms[k]) < float("inf")] or wrong
        best = [min((scan_terms(entry, rule)[k] for entry in entries), key=gap) for k in known]
        return "; ".join(map(failed, best))
    if rule is not None and rule.frame is not None and rule.name in last.holds:
        return f"{rule.name}: all hold"
    parts = []
    for quantity in ledger.quantities:
        if quantity.name not in names:
            continue
        change = sum(entry.changes.get(quantity.name, 0.0) for entry in entries)
        value = last.values.get(quantity.name)
        if change:
            sign = "+" if change > 0 else "-"
            parts.append(f"{quantity.name} {sign}{number(abs(change))}")
        elif value is not None and not quantity.total:
            shown = quantity.legend[int(value)] if quantity.legend else number(value)
            parts.append(f"{quantity.name} {shown}")
    return ", ".join(parts)


def _closeness(rule: RuleValue) -> tuple[int, int, float]:
    """A rule with unknown values does not apply.

    Of the others, one with fewer failing terms is closer, and then one that misses by less.
    """
    unknown = sum(term.value is None or term.threshold != term.threshold for term in rule.terms)
    gaps = [gap(rule.terms[k]) for k in failing(rule)]
    return -unknown, -len(gaps), -max(gaps, default=0.0)

"""The ledgers of one or several points as the page draws them, frame by frame."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence, Set
from statistics import median
from typing import Any

from dynaviz.explain.deciding import decided_by
from dynaviz.explain.point_ledger import LedgerEntry, PointLedger, QuantityInfo
from dynaviz.explain.words import BOUNDS


def strip(ledgers: Sequence[PointLedger]) -> dict[str, Any]:
    """What each scan contributed, in plain types; values are medians over the points.

    Args:
        ledgers: at least one.

    Returns:
        ``quantity`` that is shown, or None, and ``scans``, each with its ``frame``, the ``hit`` and
        ``crossed`` shares of the points, the ``change`` and the ``value`` of the quantity, the
        share ``removed`` so far, whether it touched the points ``without_effect``, and where the
        ``sensor`` stood.
    """
    rule = decided_by(ledgers[0])
    terms = rule.terms if rule else ()
    shown = _quantity(ledgers[0].quantities, {term.name for term in terms})
    by_frame: defaultdict[int, dict[int, LedgerEntry]] = defaultdict(dict)
    for k, ledger in enumerate(ledgers):
        for entry in ledger.entries:
            by_frame[entry.frame][k] = entry
    name = "" if shown is None else shown.name
    last: dict[int, float] = {}
    removed: dict[int, bool] = {}
    scans = []
    for frame, entries in sorted(by_frame.items()):
        here = {
            k: value
            for k, entry in entries.items()
            if (value := entry.values.get(name)) is not None
        }
        last |= here
        removed |= {k: entry.removed for k, entry in entries.items() if entry.removed is not None}
        touched = [entry for entry in entries.values() if entry.hits or entry.crossed]
        changes = [entry.changes.get(name, 0.0) for entry in touched or entries.values()]
        total = shown is not None and shown.total
        known = last if total else here
        one = next(iter(entries.values()))
        scans.append(
            {
                "frame": frame,
                "hit": sum(entry.hits > 0 for entry in entries.values()) / len(ledgers),
                "crossed": sum(entry.crossed > 0 for entry in entries.values()) / len(ledgers),
                "change": median(changes) if total else None,
                "value": median(known.values()) if known else None,
                "removed": sum(removed.values()) / len(ledgers) if removed else None,
                "without_effect": total and bool(touched) and not any(changes),
                "sensor": list(one.sensor),
            }
        )
    quantity = None
    if shown is not None:
        quantity = {
            "name": shown.name,
            "unit": shown.unit,
            "total": shown.total,
            "threshold": shown.threshold,
            "bound": next((BOUNDS[term.test] for term in terms if term.name == name), "beyond"),
            "legend": shown.legend,
        }
    return {"quantity": quantity, "scans": scans, "points": len(ledgers)}


def _quantity(quantities: Sequence[QuantityInfo], terms: Set[str]) -> QuantityInfo | None:
    """The quantity that decided, by the names of the terms, or else the first with a threshold."""
    order = (
        [q for q in quantities if q.name in terms],
        [q for q in quantities if q.threshold is not None and not q.legend],
        quantities,
    )
    return next((found[0] for found in order if found), None)

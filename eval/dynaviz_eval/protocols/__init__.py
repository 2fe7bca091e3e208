"""Protocols: how benchmarks and papers count the same labels (``docs/protocols.md``)."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping

from dynaviz.protocol import ProtocolScores


def defined(scores: Mapping[str, float]) -> dict[str, float | None]:
    """Scores as plain JSON values, None where undefined."""
    return {name: None if math.isnan(value) else float(value) for name, value in scores.items()}


def summed(parts: Iterable[ProtocolScores]) -> dict[str, float]:
    """The counts of several sequences, added up."""
    total: Counter[str] = Counter()
    for part in parts:
        total.update(part.counts)  # type: ignore[arg-type]  # counts may be sums of percentages
    return dict(total)

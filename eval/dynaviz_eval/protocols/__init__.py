"""Protocols: how benchmarks and papers count the same labels (``docs/protocols.md``)."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

from dynaviz.protocol import ProtocolScores


def defined(scores: Mapping[str, float]) -> dict[str, float | None]:
    """Scores as plain JSON values, None where undefined."""
    return {name: None if math.isnan(value) else float(value) for name, value in scores.items()}


def summed(parts: Iterable[ProtocolScores]) -> dict[str, float]:
    """The counts of several sequences, added up."""
    total: dict[str, float] = {}
    for part in parts:
        for name, number in part.counts.items():
            total[name] = total.get(name, 0) + number
    return total

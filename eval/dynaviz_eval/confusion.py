"""The main metric: four counts, and the percentages derived from them."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping
from typing import Any

from dynaviz.contracts.method import MethodInfo
from dynaviz.contracts.metric import Figure, Labelled
from dynaviz.scores.scores import SCORES, Counts


def _sections(counts: Counts) -> dict[str, Any]:
    return {"counts": dataclasses.asdict(counts), "metrics": counts.metrics()}


class Confusion:
    """Sections ``counts`` and ``metrics``.

    Curves of SA, DA, AA and HA, of each frame and cumulative.
    """

    def __init__(self, info: MethodInfo) -> None:
        self._total = Counts()

    def update(self, labelled: Labelled) -> Mapping[str, float]:
        """Add the points of one scan."""
        frame = Counts.of(labelled.outcome)
        self._total += frame
        counts = {"frame": frame, "so_far": self._total}
        return {f"{name}/{when}": getattr(c, name) for name in SCORES for when, c in counts.items()}

    def finish(self) -> Mapping[str, Any]:
        """The sections."""
        return _sections(self._total)

    @staticmethod
    def combine(sections: Iterable[Mapping[str, Any]]) -> Mapping[str, Any]:
        """Combine the sections of several results by adding their counts."""
        return _sections(sum((Counts(**each["counts"]) for each in sections), Counts()))

    def figures(self) -> Mapping[str, Figure]:
        """None."""
        return {}

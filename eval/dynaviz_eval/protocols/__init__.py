"""Protocols: how benchmarks and papers count the same labels (``docs/protocol.md``)."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence

from dynaviz.contracts.protocol import ProtocolScores


class Counted(ABC):
    """A protocol whose scores follow from counts, which are added up over sequences."""

    @abstractmethod
    def counts(self) -> Mapping[str, float]:
        """The counts of all scans."""

    @staticmethod
    @abstractmethod
    def scores_of(counts: Mapping[str, float]) -> Mapping[str, float]:
        """The scores in percent that follow from counts, NaN where undefined.

        Missing counts are 0.
        """

    def finish(self) -> ProtocolScores:
        """The scores."""
        return self._of_counts(self.counts())

    @classmethod
    def combine(cls, parts: Sequence[ProtocolScores]) -> ProtocolScores:
        """Add the counts of several sequences."""
        total: dict[str, float] = {}
        for part in parts:
            for name, number in part.counts.items():
                total[name] = total.get(name, 0) + number
        return cls._of_counts(total)

    @classmethod
    def _of_counts(cls, counts: Mapping[str, float]) -> ProtocolScores:
        scores = {
            name: None if math.isnan(value) else float(value)
            for name, value in cls.scores_of(counts).items()
        }
        return ProtocolScores(scores, counts)

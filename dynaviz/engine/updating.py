"""Metrics receive a scan at the same time, on several threads."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence

from dynaviz import kernels
from dynaviz.contracts.looks import AsksLooks
from dynaviz.contracts.metric import Labelled, Metric
from dynaviz.engine.looks import LookTables, answer

TABLES = -1  # takes the place of the number of a metric


class Updates:
    """Gives scans to metrics. Those that took longest so far begin first."""

    def __init__(self, metrics: Sequence[Metric]) -> None:
        self._metrics = metrics
        self._spent = [0.0] * len(metrics)
        self._asking = [metric for metric in metrics if isinstance(metric, AsksLooks)]
        self._tables = LookTables() if self._asking else None

    def update(self, labelled: Labelled) -> dict[str, float]:
        """Add a scan to all metrics; the values to plot, in the order of the metrics.

        Returns when all are done, so that nothing runs next to the method.
        """

        def one(number: int) -> Mapping[str, float]:
            if number < 0:
                if self._tables is not None:
                    self._tables.add(labelled)
                return {}
            begin = time.perf_counter()
            values = self._metrics[number].update(labelled)
            self._spent[number] += time.perf_counter() - begin
            return values

        order = sorted(range(len(self._metrics)), key=lambda number: -self._spent[number])
        order.append(TABLES)
        found = dict(zip(order, kernels.each(one, order), strict=True))
        return {name: value for number in sorted(found) for name, value in found[number].items()}

    def look(self) -> None:
        """Give the metrics that ask for them the looks of all scans; after the last scan."""
        if self._tables is not None:
            answer(self._asking, self._tables)

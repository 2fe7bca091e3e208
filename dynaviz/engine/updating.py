"""Metrics receive a scan at the same time, on several threads."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor

from dynaviz import kernels
from dynaviz.contracts.metric import Labelled, Metric


@contextlib.contextmanager
def updating(metrics: Sequence[Metric], threads: int) -> Iterator[Callable[[Labelled], dict[str, float]]]:
    """A function that gives a scan to all metrics, and returns the values to plot, in the order of the metrics.

    It returns when all are done, so that nothing runs next to the method. Those that took longest so far begin first.
    """
    spent = [0.0] * len(metrics)

    def update(number: int, labelled: Labelled) -> Mapping[str, float]:
        begin = time.perf_counter()
        values = metrics[number].update(labelled)
        spent[number] += time.perf_counter() - begin
        return values

    with ThreadPoolExecutor(threads, "metrics", initializer=kernels.set_threads, initargs=(1,)) as pool:

        def update_all(labelled: Labelled) -> dict[str, float]:
            longest_first = sorted(range(len(metrics)), key=lambda number: -spent[number])
            pending = {number: pool.submit(update, number, labelled) for number in longest_first}
            return {name: value for number in range(len(metrics)) for name, value in pending[number].result().items()}

        yield update_all

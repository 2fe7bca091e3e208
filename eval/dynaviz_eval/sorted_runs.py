"""Records with integer keys, stored on disk in sorted runs and read back by intervals
of the key.
"""

from __future__ import annotations

import itertools
import tempfile
import weakref
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynaviz.arrays import I64
from dynaviz.io.temporary import store

HELD = 250_000  # records that a metric keeps in memory before it stores them as a run
_STEP = 1024  # records between two keys of a run that stay in memory
_EVERYTHING = (-(1 << 63), (1 << 63) - 1)


@dataclass(frozen=True, slots=True, eq=False)
class _Run:
    """Position of a run in the file, its number of records, and every ``_STEP``-th of its keys."""

    start: int
    count: int
    keys: I64


class SortedRuns:
    """Runs of records in a temporary file without a name, which is deleted with this object.

    Args:
        dtype: of a record; the field ``key`` is int64.

    Raises:
        DynavizError: if the disk is full.
    """

    def __init__(self, dtype: np.dtype[Any]) -> None:
        self._dtype = dtype
        self._end = 0
        self._runs: list[_Run] = []
        self._file = tempfile.TemporaryFile(buffering=0)  # noqa: SIM115  # closed with this object
        weakref.finalize(self, self._file.close)

    def __len__(self) -> int:
        return sum(run.count for run in self._runs)

    def append(self, records: NDArray[Any]) -> None:
        """Store (N,) records as one run, in any order."""
        records = records[np.argsort(records["key"], kind="stable")]
        self._runs.append(_Run(self._end, len(records), records["key"][::_STEP].copy()))
        rest = memoryview(records.view(np.uint8))  # type: ignore[arg-type]
        self._end += len(rest)
        self._file.seek(0, 2)
        store(self._file, rest, self._end, "voxels")

    def between(self, low: int, high: int) -> NDArray[Any]:
        """Records with low <= key < high of all runs, in any order."""
        return np.concatenate(
            [np.empty(0, self._dtype), *(self._read(run, low, high) for run in self._runs)]
        )

    def intervals(self, size: int = HELD) -> Iterator[tuple[int, int]]:
        """Intervals of keys that together cover all records, with about ``size`` of them each.

        Records with the same key are in one interval.
        """
        sample = np.sort(np.concatenate([np.empty(0, np.int64), *(run.keys for run in self._runs)]))
        cuts = np.unique(sample[size // _STEP :: max(size // _STEP, 1)]).tolist()
        edges = [_EVERYTHING[0], *cuts, _EVERYTHING[1]]
        yield from itertools.pairwise(edges)

    def _read(self, run: _Run, low: int, high: int) -> NDArray[Any]:
        first = max(int(np.searchsorted(run.keys, low)) - 1, 0) * _STEP
        last = min(int(np.searchsorted(run.keys, high)) * _STEP, run.count)
        self._file.seek(run.start + first * self._dtype.itemsize)
        records = np.fromfile(self._file, self._dtype, max(last - first, 0))
        begin, end = np.searchsorted(records["key"], [low, high])
        return records[begin:end]

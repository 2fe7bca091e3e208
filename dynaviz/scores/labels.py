"""The labels of a run, frame by frame, packed with one bit per point."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import overload

import numpy as np

from dynaviz.arrays import I64, U8, Bool
from dynaviz.errors import DataError
from dynaviz.io.npy import open_npy


class RunLabels(Sequence[Bool]):
    """Labels by position of the frame: ``labels[i]`` is (N,) bool, True for points that the method removed.

    Args:
        packed: (bytes,) uint8: one bit per point in the order of the sequence, as ``numpy.packbits`` packs them.
        points: (frames,) int64: number of points of each frame.
    """

    def __init__(self, packed: U8, points: I64) -> None:
        self.packed, self._ends = packed, np.concatenate([[0], np.cumsum(points)])

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> RunLabels:
        """Read the ``labels.npz`` of a run.

        Raises:
            DataError: if the file cannot be read or is damaged.
        """
        with open_npy(path, "labels.npz of a run", "Give the labels.npz of a run") as arrays:
            packed, points = arrays["dynamic"], arrays["points"].astype(np.int64)
        if packed.dtype != np.uint8 or len(packed) != -(-int(points.sum()) // 8):
            raise DataError(Path(path), "is inconsistent: its arrays have different lengths", hint="Run it again")
        return cls(packed, points)

    def __len__(self) -> int:
        return len(self._ends) - 1

    @overload
    def __getitem__(self, position: int) -> Bool: ...

    @overload
    def __getitem__(self, position: slice) -> list[Bool]: ...

    def __getitem__(self, position: int | slice) -> Bool | list[Bool]:
        if isinstance(position, slice):
            return [self[k] for k in range(*position.indices(len(self)))]
        first, end = (int(self._ends[k]) for k in (range(len(self))[position], range(len(self))[position] + 1))
        bits = np.unpackbits(self.packed[first // 8 : -(-end // 8)])
        return bits[first % 8 : first % 8 + end - first].astype(np.bool_)

    def __iter__(self) -> Iterator[Bool]:
        return (self[k] for k in range(len(self)))

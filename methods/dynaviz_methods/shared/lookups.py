"""Look up what a map knows about a few voxels, for the evidence of methods."""

from __future__ import annotations

from functools import cached_property
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dynaviz.arrays import F64, I32, I64, Bool, Intp
from dynaviz.blocks.blocks import BlockGrid


def known(values: ArrayLike, voxels: I64) -> F64:
    """(K,) float64: the values (K,) where the points have a voxel (K,), NaN where it is -1."""
    found: F64 = np.where(voxels < 0, np.nan, np.asarray(values, np.float64))
    return found


class MarkedBlocks:
    """Looks up bits of the blocks that a scan marked.

    Args:
        blocks: (B,) int32, without duplicates, in any order.
    """

    def __init__(self, blocks: I32) -> None:
        self._blocks = blocks

    @cached_property
    def _order(self) -> Intp:
        return np.argsort(self._blocks)  # few scans are asked about: not before the first question

    @cached_property
    def _sorted(self) -> I32:
        return self._blocks[self._order]

    def read(self, bits: NDArray[Any], voxels: I64) -> Bool:
        """(N,) bool: whether the bits (B, 8) of voxels (N,) are set.

        False for -1, and in all other blocks.
        """
        if not len(self._sorted):
            return np.zeros(len(voxels), np.bool_)
        blocks = voxels >> 9
        at = np.minimum(np.searchsorted(self._sorted, blocks), len(self._sorted) - 1)
        words = bits.view(np.int64)[self._order[at], voxels >> 6 & 7]
        found: Bool = (self._sorted[at] == blocks) & (words >> (voxels & 63) & 1 > 0)
        return found


def around(grid: BlockGrid, voxels: I64, margin: int = 1) -> I64:
    """(K, (2 margin + 1)^3) int64: the voxels up to ``margin`` voxels to each side.

    -1 if absent, or around -1.
    """
    shifts = np.array(list(product(range(-margin, margin + 1), repeat=3)))
    centres = (grid.keys(voxels)[:, None] + shifts + 0.5) * grid.resolution
    found = grid.locate(centres.reshape(-1, 3).astype(np.float32)).reshape(len(voxels), -1)
    found[voxels < 0] = -1
    return found

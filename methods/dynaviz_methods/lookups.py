"""Look up what a map knows about a few voxels, for the evidence of methods."""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dynaviz.arrays import F64, I32, I64, Bool
from dynaviz.blocks.blocks import BlockGrid, read


def known(values: ArrayLike, voxels: I64) -> F64:
    """(K,) float64: the values (K,) where the points have a voxel (K,), NaN where it is -1."""
    found: F64 = np.where(voxels < 0, np.nan, np.asarray(values, np.float64))
    return found


def marked(blocks: I32, bits: NDArray[Any], voxels: I64) -> Bool:
    """(K,) bool: whether the bits of voxels (K,) are set, given some blocks (B,), in any order, and their bits (B, 8).

    False for -1, and in all other blocks.
    """
    if not len(blocks):
        return np.zeros(len(voxels), np.bool_)
    order = np.argsort(blocks)
    rows = order[np.minimum(np.searchsorted(blocks, voxels >> 9, sorter=order), len(blocks) - 1)]
    of_block = np.where(blocks[rows] == voxels >> 9, rows << 9 | voxels & 511, -1)
    return read(np.ascontiguousarray(bits), of_block)


def around(grid: BlockGrid, voxels: I64, margin: int = 1) -> I64:
    """(K, (2 margin + 1)^3) int64: the voxels up to ``margin`` voxels to each side; -1 if absent, or around -1."""
    shifts = np.array(list(product(range(-margin, margin + 1), repeat=3)))
    centres = (grid.keys(voxels)[:, None] + shifts + 0.5) * grid.resolution
    found = grid.locate(centres.reshape(-1, 3).astype(np.float32)).reshape(len(voxels), -1)
    found[voxels < 0] = -1
    return found

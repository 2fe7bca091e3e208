"""Look up what a map knows about a few voxels, for the evidence of methods."""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dynaviz.arrays import F64, I32, I64, Bool
from dynaviz.blocks.blocks import BlockGrid


def known(values: ArrayLike, voxels: I64) -> F64:
    """(K,) float64: the values (K,) where the points have a voxel (K,), NaN where it is -1."""
    found: F64 = np.where(voxels < 0, np.nan, np.asarray(values, np.float64))
    return found


def marked(blocks: I32, bits: NDArray[Any], voxels: I64) -> Bool:
    """(K,) bool: whether the bits of voxels (K,) are set, given some blocks (B,), in any order, and
    their bits (B, 8).

    False for -1, and in all other blocks.
    """
    if not len(blocks) or not len(voxels):
        return np.zeros(len(voxels), np.bool_)
    wanted, which = np.unique(voxels >> 9, return_inverse=True)
    at = np.searchsorted(wanted, blocks)
    here = np.flatnonzero(wanted[np.minimum(at, len(wanted) - 1)] == blocks)
    row_of = np.full(len(wanted), -1)
    row_of[at[here]] = here
    rows = row_of[which]
    found: Bool = (rows >= 0) & (
        bits.view(np.int64)[rows, voxels >> 6 & 7] >> (voxels & 63) & 1 > 0
    )
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

"""Marks of rays, each lane in its own memory."""

from __future__ import annotations

import numpy as np

from dynaviz import kernels
from dynaviz.arrays import I32, U64, Bool

SHARED = kernels.load("dynaviz_methods.shared.kernels")


def lane_marks(blocks: int) -> tuple[U64, Bool, I32]:
    """Memory for the marks of rays, each lane's its own.

    ``bits``, ``touched`` and ``order`` of the kernels.
    """
    lanes = kernels.threads_in_use()
    shapes = (lanes, blocks, 8), (lanes, blocks), (lanes, 1 + blocks)
    return (
        np.zeros(shapes[0], np.uint64),
        np.zeros(shapes[1], np.bool_),
        np.zeros(shapes[2], np.int32),
    )


def merged(bits: U64, touched: Bool, order: I32) -> tuple[I32, U64]:
    """The blocks that any lane marked, (K,), sorted, and the bits of their voxels, (K, 8).

    Clears the marks.
    """
    blocks: I32 = np.sort(SHARED.lane_marks.collect(touched, order))
    return blocks, SHARED.lane_marks.merge(blocks, bits)

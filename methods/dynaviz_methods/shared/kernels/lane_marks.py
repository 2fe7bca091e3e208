"""Voxels that parallel lanes marked, each in its own memory, put together.

Bit v of word w is voxel 64 w + v of a block.
"""

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def collect(touched, order):
    """(K,) int32: the blocks that any lane touched, each once, in any order.

    Clears ``touched`` and ``order``.

    The work is that of the touched blocks, however large the grid is.
    """
    blocks = np.empty(order[:, 0].sum(), np.int32)
    n = 0
    for lane in range(len(order)):
        for k in range(1, order[lane, 0] + 1):
            b = order[lane, k]
            if touched[lane, b]:
                blocks[n] = b
                n += 1
                for other in range(lane, len(order)):
                    touched[other, b] = False
        order[lane, 0] = 0
    return blocks[:n].copy()


@njit(cache=True, nogil=True)
def merge(blocks, bits):
    """(K, 8) uint64: the bits of blocks (K,) int32 in all lanes; clears them."""
    merged = np.zeros((len(blocks), 8), np.uint64)
    for n in range(len(blocks)):
        for lane in range(len(bits)):
            for w in range(8):
                merged[n, w] |= bits[lane, blocks[n], w]
                bits[lane, blocks[n], w] = 0
    return merged

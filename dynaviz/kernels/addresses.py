"""Addresses of the voxels around a sensor, which need no directory.

An address repeats every 1024 voxels along x and y, and every 256 along z. From the lowest bit on,
it holds the index within a block of 8^3 voxels, as in ``blocks``; then the bits of the block's
indices along z, y and x in turn, so that adjacent blocks share pages of memory.
"""

import math
from itertools import count
from mmap import mmap

import numpy as np

from dynaviz.arrays import U64, Bool

EXTENTS = (10, 10, 8)  # along x, y and z: log2 of voxels
BLOCKS = 1 << sum(EXTENTS) - 9


def memory(lanes: int, blocks: int = BLOCKS, of_word: int = 1) -> tuple[U64, Bool]:
    """Memory for marks at addresses, all unset.

    It is mapped page by page as it is written. NumPy asks for pages of 2 MB, most of which would be
    empty.

    Returns:
        (lanes, blocks, 8, of_word) uint64: words of 64 bits, ``of_word`` for each.
        (lanes, blocks) bool: whether a block has marks.
    """
    shape = lanes, blocks, 8, of_word
    words = np.frombuffer(
        mmap(-1, max(8 * math.prod(shape), 1)), np.uint64, math.prod(shape)
    ).reshape(shape)
    return words, np.zeros((lanes, blocks), np.bool_)


def _positions() -> list[list[int]]:
    """The positions in an address, by axis, of the bits of an index, lowest first."""
    positions = [[6, 7, 8], [3, 4, 5], [0, 1, 2]]
    at = count(9)
    for n in range(3, max(EXTENTS)):
        for axis in (2, 1, 0):
            if n < EXTENTS[axis]:
                positions[axis].append(next(at))
    return positions


def _spread(positions: list[int]) -> U64:
    """(2^bits,) uint64: each index, its bits moved to their positions."""
    index = np.arange(1 << len(positions), dtype=np.uint64)
    spread = np.zeros(1 << len(positions), np.uint64)
    for n, at in enumerate(positions):
        spread |= (index >> np.uint64(n) & np.uint64(1)) << np.uint64(at)
    return spread


X, Y, Z = (_spread(positions) for positions in _positions())
ALL_X = X[-1]
ALL_Y = Y[-1]
ALL_Z = Z[-1]
# in the numbers of blocks
IN_X, IN_Y, IN_Z = (tuple(at - 9 for at in positions[3:]) for positions in _positions())
ONE_BIT, SIX, SEVEN, NINE, LAST = (np.uint64(n) for n in (1, 6, 7, 9, 63))
# up to so many voxels from a centre, voxels and blocks differ
NEAR = tuple((1 << bits - 1) - 8 for bits in EXTENTS)

"""Counts of how often each voxel of a block grid was hit, seen clear, and crossed near hits.

Bits are those of ``raycast.collect``: bit v of word w is voxel 64 w + v of a block; the row after
the last is empty.
"""

import numpy as np
from numba import njit, prange

MOST = np.uint16(65535)
LOW = np.uint64(0x0101010101010101)
ONE = np.uint64(1)
EIGHT = np.uint64(8)


@njit(cache=True, nogil=True)
def begins(goals, scratch):
    """Where rays to voxels (K,) int64 without duplicates begin, to leave out what others from the
    same origin cross.

    Of a cube of 2^3 voxels, only the first one gets a ray: the others would end a voxel beside it.
    In the middle, that is the distance between rays to a cube of 4^3, and at a quarter of the way
    between those to a block: except the first one, they begin there.

    Returns:
        (K,) float32: share of the way; 1 for no ray. ``scratch`` (blocks, 8) int64 is zero before
        and after.
    """
    found = np.empty(len(goals), np.float32)
    for k in range(len(goals)):
        block = goals[k] >> 9
        v = goals[k] & 511
        small = np.int64(1) << ((v >> 7) << 4 | (v >> 4 & 3) << 2 | v >> 1 & 3)
        large = np.int64(1) << (v >> 8 << 2 | (v >> 5 & 1) << 1 | v >> 2 & 1)
        begin = 0.5 if scratch[block, 1] & large else 0.25 if scratch[block, 1] else 0.0
        found[k] = 1.0 if scratch[block, 0] & small else begin
        scratch[block, 0] |= small
        scratch[block, 1] |= large
    for g in goals:
        scratch[g >> 9, 0] = 0
        scratch[g >> 9, 1] = 0
    return found


@njit(cache=True, nogil=True, parallel=True)
def adjacent(blocks, rows, keys, base, shape, top, children):
    """(B, 6) int32: rows of the six adjacent blocks of each block, -x, +x, -y, ... +z; B if absent.

    Args:
        blocks: (B,) int32, numbers of the blocks.
        rows: (all blocks + 1,) int32 scratch memory, zero before and after.
        keys: (all blocks, 3) int64, indices of the grid's blocks.
        base, shape, top, children: the grid's directory.
    """
    n = len(blocks)
    for r in range(n):
        rows[blocks[r]] = r + 1
    found = np.full((n, 6), np.int32(n))
    for r in prange(n):
        for axis in range(3):
            x = np.int64(keys[blocks[r], 0]) - (base[0] << 4) + (axis == 0)
            y = np.int64(keys[blocks[r], 1]) - (base[1] << 4) + (axis == 1)
            z = np.int64(keys[blocks[r], 2]) - (base[2] << 4) + (axis == 2)
            if x >> 4 < shape[0] and y >> 4 < shape[1] and z >> 4 < shape[2]:
                row = top[((x >> 4) * shape[1] + (y >> 4)) * shape[2] + (z >> 4)]
                block = children[row, (x & 15) << 8 | (y & 15) << 4 | (z & 15)]
                if block and rows[block - 1]:
                    other = rows[block - 1] - 1
                    found[r, 2 * axis + 1] = other
                    found[other, 2 * axis] = r
    for r in range(n):
        rows[blocks[r]] = 0
    return found


@njit(cache=True, nogil=True, parallel=True)
def of_two_scans(blocks, bits, before, last):
    """(B + 1, 8) uint64: hit voxels of the marked blocks, in this scan or the one before.

    The last row is empty.

    Args:
        blocks, bits: the marks of the scan, as from ``raycast.collect``.
        before: (all blocks + 1, 8) uint64: hits of the scan before. Modified: those of this one.
        last: (K,) int32: the blocks with hits of the scan before.
    """
    hits = np.zeros((len(blocks) + 1, 8), np.uint64)
    for r in prange(len(blocks)):
        for w in range(8):
            hits[r, w] = np.uint64(bits[r, 8 + w]) | before[blocks[r], w]
    for r in prange(len(last)):
        before[last[r]] = 0
    for r in prange(len(blocks)):
        for w in range(8):
            before[blocks[r], w] = np.uint64(bits[r, 8 + w])
    return hits


@njit(cache=True, nogil=True, parallel=True)
def grown(bits, sides, times):
    """Dilate voxels (B + 1, 8) uint64 by cubes of edge 2 times + 1 voxels, one axis after another.

    ``sides`` (B, 6) are the rows of adjacent blocks, as from ``adjacent``. The last row stands for
    absent ones.
    """
    n = len(sides)
    done = 0
    here = bits.copy()
    there = bits.copy()
    while done < times:
        step = min(times - done, 2 * done + 1)  # farther steps would leave gaps
        up = np.uint64(step)
        down = np.uint64(8 - step)
        low = LOW * ((ONE << up) - ONE)  # bits of a byte that come from the adjacent block
        for r in prange(n):
            for w in range(8):  # z: bits of a byte
                word = here[r, w]
                below = (word << up) & ~low | (here[sides[r, 4], w] >> down) & low
                above = (word >> up) & ~(low << down) | (here[sides[r, 5], w] << down) & (
                    low << down
                )
                there[r, w] = word | below | above
        for r in prange(n):
            for w in range(8):  # y: bytes of a word
                word = there[r, w]
                below = word << EIGHT * up | there[sides[r, 2], w] >> EIGHT * down
                above = word >> EIGHT * up | there[sides[r, 3], w] << EIGHT * down
                here[r, w] = word | below | above
        for r in prange(n):
            for w in range(8):  # x: words of a block
                below = here[r, w - step] if w >= step else here[sides[r, 0], 8 + w - step]
                above = here[r, w + step] if w + step < 8 else here[sides[r, 1], w + step - 8]
                there[r, w] = here[r, w] | below | above
        here, there = there, here
        done += step
    return here


@njit(cache=True, nogil=True, inline="always")
def _add(counts, block, w, word):
    """Add one to the counts of a word's voxels whose bit is set, up to 65535.

    Without branches, to be vectorised.
    """
    for v in range(64):
        n = counts[block, (w << 6) + v]
        counts[block, (w << 6) + v] = n + np.uint16(
            (word >> np.uint64(v) & ONE) & np.uint64(n != MOST)
        )


@njit(cache=True, nogil=True, parallel=True)
def count(blocks, bits, near, hits, clear, grazed):
    """Add one scan to the counts, up to 65535.

    A voxel that is hit counts as hit. A voxel that is crossed and not hit counts as grazed if a hit
    is near, else as clear.

    Args:
        blocks, bits: the marks of the scan, as from ``raycast.collect``.
        near: (B, 8) uint64, bits of the voxels near a hit.
        hits, clear, grazed: (all blocks + 1, 512) uint16, the counts. Modified.
    """
    for r in prange(len(blocks)):
        for w in range(8):
            hit = np.uint64(bits[r, 8 + w])
            through = np.uint64(bits[r, w]) & ~hit
            grazing = through & near[r, w]
            if hit:
                _add(hits, blocks[r], w, hit)
            if through != grazing:
                _add(clear, blocks[r], w, through ^ grazing)
            if grazing:
                _add(grazed, blocks[r], w, grazing)

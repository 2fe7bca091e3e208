"""Beliefs of voxels that are occupied or free, updated by their distance from the nearest occupied
voxel.

A voxel is block * 512 + index in the block. Bits are (B, 8) uint64: bit v of word w is voxel 64 w +
v of a block; a word is a layer in x, and v = 8 y + z. ``neighbours`` (B, 27) are the numbers of the
blocks around each block, itself at 13, x slowest; -1 if absent.
"""

import numpy as np
from numba import njit, prange

UNKNOWN = 0
OCCUPIED = 1
FREE = 2
CAP = 75  # square voxels: farther voxels have the same likelihood in double precision
RADIUS = 8  # voxels: the largest offset along one axis below CAP
SIDE = 3 * RADIUS  # voxels: a block and those around it
NEVER = np.int32(np.iinfo(np.int32).max)  # number of no scan
ONE = np.uint64(1)


def _nearest() -> np.ndarray:
    """(512,) uint8: the lowest bit set in nine bits, 9 if none."""
    return np.array([(n & -n).bit_length() - 1 if n else 9 for n in range(512)], np.uint8)


LOWEST = _nearest()
# counted from bit 8
HIGHEST = np.array([9 if n == 0 else 8 - (n.bit_length() - 1) for n in range(512)], np.uint8)


@njit(cache=True, nogil=True)
def _columns(block, neighbours, sources, along, filled):
    """Squared distances along z to the nearest source, (24, 192) uint8, and which layers in x have
    a source.
    """
    for x in range(SIDE):
        filled[x] = False
        row = (x >> 3) * 9
        for y in range(SIDE):
            first = row + (y >> 3) * 3
            column = np.uint64(0)
            for k in range(3):
                other = neighbours[block, first + k]
                if other >= 0:
                    byte = sources[other, x & 7] >> np.uint64((y & 7) << 3) & np.uint64(255)
                    column |= byte << np.uint64(8 * k)
            if column == 0:
                for z in range(8):
                    along[x, y * 8 + z] = CAP
                continue
            filled[x] = True
            for z in range(8):
                window = np.int64(column >> np.uint64(z))
                distance = min(LOWEST[window >> 8 & 511], HIGHEST[window & 511])
                along[x, y * 8 + z] = distance * distance if distance < 9 else CAP


@njit(cache=True, nogil=True)
def _distances(block, neighbours, sources, along, across, filled, squared):
    """Squared distances of a block's voxels from the nearest source, (8, 64) uint8, at most CAP.

    Exact.

    One axis after another: along z, then the least over y, then over x.
    """
    _columns(block, neighbours, sources, along, filled)
    for x in range(SIDE):
        if filled[x]:
            for j in range(64):
                across[x, j] = CAP
            for k in range(2 * RADIUS + 1):
                away = np.uint8((k - RADIUS) ** 2)
                for j in range(64):
                    across[x, j] = min(across[x, j], np.uint8(along[x, 8 * k + j] + away))
    for x in range(8):
        for j in range(64):
            squared[x, j] = CAP
        for k in range(2 * RADIUS + 1):
            if filled[x + k]:
                away = np.uint8((k - RADIUS) ** 2)
                for j in range(64):
                    squared[x, j] = min(squared[x, j], np.uint8(across[x + k, j] + away))


@njit(cache=True, nogil=True, inline="always")
def _filtered(occupied, remembered, likelihood, change):
    """One step of the hidden Markov model: the beliefs of occupied and free after a look."""
    free = 1.0 - occupied
    if remembered:
        stay = 1.0 - change
        occupied, free = stay * occupied + change * free, change * occupied + stay * free
    else:
        occupied = change
        free = change
    occupied = likelihood * occupied
    free = (1.0 - likelihood) * free
    total = occupied + free
    return occupied / total, free / total


@njit(cache=True, nogil=True, parallel=True)
def update(
    blocks, observed, sources, neighbours, number, memory, truncate, likelihoods, change, sure,
    belief, seen, since,
    state, known, turned, field, lanes,
):  # fmt: skip
    """Update the voxels that a scan observed.

    Args:
        blocks: (K,) int32, the blocks with observed voxels; observed: (K, 8) uint64, their bits.
        sources: (B, 8) uint64, bits of the voxels from which distances count.
        number: number of the scan, from 1.
        memory: a voxel last seen more than this number of scans ago is new again.
        truncate: whether voxels seen in scans up to ``memory + 1`` never become new again.
        likelihoods: (76,) float64, likelihood of occupied for each squared distance in voxels.
        change: probability that a voxel changes its state between two scans.
        sure: belief above which the state is decided.
        belief: (B, 512) float64, belief of occupied. Modified, as all that follow.
        seen: (B, 512) int32, number of the scan that last observed a voxel; 0 for new voxels.
        since: (B, 512) int32, number of the scan in which the state last changed.
        state: (B, 512) uint8, UNKNOWN, OCCUPIED or FREE.
        known: (B, 8) uint64, bits of the voxels with a decided state.
        turned: (B, 8) uint64, bits of the voxels that turn from free to occupied in this scan.
        field: (K, 512) uint8, squared distances; (0, 512) to discard them.
        lanes: number of threads.
    """
    for lane in prange(lanes):
        along = np.empty((SIDE, SIDE * 8), np.uint8)
        across = np.empty((SIDE, 64), np.uint8)
        filled = np.empty(SIDE, np.bool_)
        squared = np.empty((8, 64), np.uint8)
        for n in range(lane, len(blocks), lanes):
            b = blocks[n]
            _distances(b, neighbours, sources, along, across, filled, squared)
            if len(field):
                for v in range(512):
                    field[n, v] = squared[v >> 6, v & 63]
            for w in range(8):
                word = observed[n, w]
                new = np.uint64(0)
                decided = np.uint64(0)
                if word == 0:
                    continue
                for j in range(64):
                    if not word >> np.uint64(j) & ONE:
                        continue
                    v = w << 6 | j
                    last = seen[b, v]
                    forgotten = number - last > memory + 1 and not (truncate and last <= memory + 1)
                    if forgotten:
                        state[b, v] = UNKNOWN
                    remembered = last > 0 and not forgotten
                    occupied, free = _filtered(
                        belief[b, v], remembered, likelihoods[squared[w, j]], change
                    )
                    belief[b, v] = occupied
                    seen[b, v] = number
                    best = FREE if free > occupied else OCCUPIED
                    if max(occupied, free) > sure and state[b, v] != best:
                        if state[b, v] == FREE:
                            new |= ONE << np.uint64(j)
                        state[b, v] = best
                        since[b, v] = number
                    if state[b, v] != UNKNOWN:
                        decided |= ONE << np.uint64(j)
                turned[b, w] = new
                known[b, w] = known[b, w] & ~word | decided


@njit(cache=True, nogil=True, parallel=True)
def expire(blocks, oldest, seen, known, first):
    """Clear the known bits of voxels last observed in scan ``oldest`` or earlier.

    Args:
        blocks: (K,) int32, blocks to look at.
        seen: (B, 512) int32, as in ``update``.
        known: (B, 8) uint64, as in ``update``. Modified.
        first: (B,) int32, a scan before which no voxel with a known bit was last observed; blocks
            whose ``first`` is after ``oldest`` are skipped. Set to the first such scan, NEVER
            without known bits.
    """
    for n in prange(len(blocks)):
        b = blocks[n]
        if first[b] > oldest:
            continue
        first[b] = NEVER
        for w in range(8):
            word = known[b, w]
            if word:
                for j in range(64):
                    bit = ONE << np.uint64(j)
                    if word & bit:
                        last = seen[b, w << 6 | j]
                        if last <= oldest:
                            word &= ~bit
                        elif last < first[b]:
                            first[b] = last
                known[b, w] = word


@njit(cache=True, nogil=True, parallel=True)
def erase(used, blocks, size, origin, reach, seen, state, known):
    """Make voxels new again whose corner is farther than ``reach`` metres from an origin (3,).

    Args:
        used: (K,) int32, blocks to look at.
        blocks: (B, 3), indices of all blocks; size: edge of a voxel, metres.
        seen, state: (B, 512); known: (B, 8), as in ``update``. Modified.

    Returns:
        (K,) bool: whether a voxel of each block is not new.
    """
    kept = np.ones(len(used), np.bool_)
    for n in prange(len(used)):
        b = used[n]
        farthest = 0.0
        for axis in range(3):
            low = (blocks[b, axis] << 3) * size - origin[axis]
            high = (blocks[b, axis] << 3 | 7) * size - origin[axis]
            farthest += max(low * low, high * high)
        if farthest <= reach * reach:
            continue
        kept[n] = False
        for v in range(512):
            x = (blocks[b, 0] << 3 | v >> 6) * size - origin[0]
            y = (blocks[b, 1] << 3 | (v >> 3 & 7)) * size - origin[1]
            z = (blocks[b, 2] << 3 | (v & 7)) * size - origin[2]
            if x * x + y * y + z * z > reach * reach:
                seen[b, v] = 0
                state[b, v] = UNKNOWN
                known[b, v >> 6] &= ~(ONE << np.uint64(v & 63))
            elif seen[b, v]:
                kept[n] = True
    return kept

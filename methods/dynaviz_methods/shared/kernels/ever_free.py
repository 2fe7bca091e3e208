"""Ever-free voxels, as words of bits with 64 voxels each.

Bits are (B, 8) uint64: bit v of word w is voxel 64 w + v of a block; a word is a layer in x, and v
= 8 y + z. ``neighbours`` (B, 27) are the numbers of the blocks around each block, itself at 13, x
slowest; -1 if absent.
"""

import numpy as np
from numba import njit, prange

_FULL = np.uint64(0xFFFFFFFFFFFFFFFF)
_ONE = np.uint64(1)
_SEVEN = np.uint64(7)
_EIGHT = np.uint64(8)
_LAST = np.uint64(56)
_LOW_Z = np.uint64(0x0101010101010101)
_HIGH_Z = np.uint64(0x8080808080808080)


@njit(cache=True, nogil=True)
def put(voxels, bits):
    """Set the bits of voxels (N,), -1 for none.

    Return the blocks (K,) int32 that were empty before.
    """
    blocks = np.empty(len(voxels), np.int32)
    n = 0
    for i in range(len(voxels)):
        if voxels[i] >= 0:
            b = voxels[i] >> 9
            w = voxels[i] >> 6 & 7
            if not bits[b, w]:  # may be the first in its block
                empty = True
                for other in range(8):
                    empty &= bits[b, other] == 0
                if empty:
                    blocks[n] = b
                    n += 1
            bits[b, w] |= _ONE << np.uint64(voxels[i] & 63)
    return blocks[:n].copy()


@njit(cache=True, nogil=True, inline="always")
def _count(counts, start, needed, occupied, lately, limit):
    """Count frames of occupancy for one word.

    Return its number of voxels, and the bits that reach the limit.
    """
    reached = np.uint64(0)
    n = 0
    for v in range(64):
        bit = _ONE << np.uint64(v)
        if needed & bit:
            if occupied & bit:
                count = min(counts[start + n] + 1, limit + 1) if lately & bit else 1
                counts[start + n] = count
                if count == limit:
                    reached |= bit
            n += 1
    return n, reached


@njit(cache=True, nogil=True)
def _size(word):
    n = 0
    while word:
        word &= word - _ONE
        n += 1
    return n


@njit(cache=True, nogil=True, parallel=True)
def occupy(
    active, frame, burn_in, gap, limit, hit, updated, observed, near, recent, stamps, needed, first,
    counts, clear,
    reached,
):  # fmt: skip
    """Update occupancy, its counts and the clear voxels of the active blocks (A,) in this frame.

    Sets the bits of voxels whose count reaches the limit in ``reached``.

    Args:
        recent: (B, burn_in + 1, 8) uint64, occupied bits of the last frames, as a ring buffer.
        stamps: (B, burn_in + 1) int32, the frames of its entries.

    Returns:
        (A,) bool: blocks with a voxel that reaches the limit.
    """
    turn = frame % (burn_in + 1)
    any_reached = np.zeros(len(active), np.bool_)
    for a in prange(len(active)):
        b = active[a]
        start = first[b]
        stamps[b, turn] = frame
        for w in range(8):
            occupied = hit[b, w] | (updated[b, w] & near[b, w])
            recent[b, turn, w] = occupied
            blocked = occupied
            lately = np.uint64(0)
            for k in range(burn_in + 1):
                age = frame - stamps[b, k]
                if 0 < age <= burn_in:
                    blocked |= recent[b, k, w]
                if 0 < age <= gap:
                    lately |= recent[b, k, w]
            clear[b, w] = (
                observed[b, w] & ~near[b, w] & ~blocked if frame >= burn_in else np.uint64(0)
            )
            reached[b, w] = 0
            if occupied:
                n, reached[b, w] = _count(counts, start, needed[b, w], occupied, lately, limit)
                any_reached[a] |= reached[b, w] != 0
            else:
                n = 64 if needed[b, w] == _FULL else _size(needed[b, w])
            start += n
    return any_reached


@njit(cache=True, nogil=True, inline="always")
def _word(bits, block, w, missing):
    return bits[block, w] ^ missing if block >= 0 else missing


@njit(cache=True, nogil=True, inline="always")
def _along_z(before, here, after):
    """One layer of three adjacent blocks, each bit spread to its neighbours in z."""
    inside = here | (here & ~_HIGH_Z) << _ONE | (here & ~_LOW_Z) >> _ONE
    return inside | (before & _HIGH_Z) >> _SEVEN | (after & _LOW_Z) << _SEVEN


@njit(cache=True, nogil=True)
def _spread(bits, around, missing, out):
    """Spread the bits of a block and its neighbours to their 26 neighbours.

    With ``missing`` = ones, spread ~bits.
    """
    for w in range(8):
        out[w] = 0
    for layer in range(-1, 9):
        x = (layer + 8) // 8 * 9
        w = layer & 7
        row = np.uint64(0)
        for y in range(3):
            j = x + 3 * y
            line = _along_z(
                _word(bits, around[j], w, missing),
                _word(bits, around[j + 1], w, missing),
                _word(bits, around[j + 2], w, missing),
            )
            if y == 0:
                row |= line >> _LAST
            elif y == 1:
                row |= line | line << _EIGHT | line >> _EIGHT
            else:
                row |= line << _LAST
        for near in range(max(layer - 1, 0), min(layer + 1, 7) + 1):
            out[near] |= row


@njit(cache=True, nogil=True)
def spread(bits, neighbours):
    """(B, 8) uint64: all bits, each spread to its 26 neighbours."""
    out = np.empty_like(bits)
    for b in range(len(bits)):
        _spread(bits, neighbours[b], np.uint64(0), out[b])
    return out


@njit(cache=True, nogil=True, parallel=True)
def release(active, neighbours, updated, clear, free, revoked, new, lanes):
    """Set voxels ever-free that are updated and clear, and whose 26 neighbours are clear.

    ``new`` (A, 8) are these.

    They no longer count as ``revoked``.
    """
    for lane in prange(lanes):
        blocked = np.empty(8, np.uint64)
        for a in range(lane, len(active), lanes):
            b = active[a]
            any_left = False
            for w in range(8):
                new[a, w] = updated[b, w] & clear[b, w] & ~free[b, w]
                any_left |= new[a, w] != 0
            if any_left:
                _spread(clear, neighbours[b], _FULL, blocked)
                for w in range(8):
                    new[a, w] &= ~blocked[w]
                    free[b, w] |= new[a, w]
                    revoked[b, w] &= ~new[a, w]


@njit(cache=True, nogil=True, parallel=True)
def revoke(blocks, neighbours, reached, free, revoked, lost, lanes):
    """Revoke ever-free voxels that reach the occupancy limit, and their 26 neighbours.

    ``lost`` (A, 8) are these.
    """
    for lane in prange(lanes):
        spread = np.empty(8, np.uint64)
        for a in range(lane, len(blocks), lanes):
            b = blocks[a]
            _spread(reached, neighbours[b], np.uint64(0), spread)
            for w in range(8):
                lost[a, w] = free[b, w] & spread[w]
                free[b, w] &= ~spread[w]
                revoked[b, w] |= lost[a, w]

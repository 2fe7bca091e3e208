"""Places: quarters of the blocks of a grid, 4 x 4 x 8 voxels.

Their evidence, and what they inherit from objects.

Place p is in block p >> 2. A scan visits the places that contain points of its objects. Those that
were visited have rows.
"""

import numpy as np
from numba import njit, prange

from dynaviz.kernels.blocks import BIT_OF, SEQUENCE

ONE = np.uint64(1)
HALF = np.uint64(0xFFFFFFFF)


@njit(cache=True, nogil=True)
def visit(voxels, objects, count, now, up, stamps):
    """The places that a scan visits, by object.

    Where two objects meet, the place is that of the first point.

    Args:
        voxels: (N,) int64; objects: (N,) int32: the voxel and the object of each point, -1 for
            none.
        count: number of objects.
        now: number of this scan.
        up: (B, 8) uint64: bits of the voxels that ever contained a point of an object. Modified.
        stamps: (B, 4) int32: the last scan that visited each place. Modified.

    Returns:
        places: (V,) int32; begins: (O + 1,) int64: where those of each object begin.
    """
    places = np.empty(len(voxels), np.int32)
    owners = np.empty(len(voxels), np.int32)
    n = 0
    begins = np.zeros(count + 2, np.int64)
    for i in range(len(voxels)):
        v = voxels[i]
        if v < 0 or objects[i] < 0:
            continue
        block = v >> 9
        up[block, v >> 6 & 7] |= ONE << np.uint64(v & 63)
        quarter = (v >> 8 & 1) << 1 | v >> 5 & 1
        if stamps[block, quarter] != now:
            stamps[block, quarter] = now
            places[n] = block << 2 | quarter
            owners[n] = objects[i]
            begins[objects[i] + 2] += 1
            n += 1
    begins = np.cumsum(begins)
    grouped = np.empty(n, np.int32)
    for k in range(n):
        at = owners[k] + 1
        grouped[begins[at]] = places[k]
        begins[at] += 1
    return grouped, begins[: count + 1].copy()


@njit(cache=True, nogil=True)
def clearness(hits, clear, grazed, weights):
    """The evidence that a voxel is empty at times, at most 1.

    Below 0 if it was rather always occupied.

    Args:
        hits, clear, grazed: number of scans that hit the voxel, saw it clear, and crossed it near a
            hit.
        weights: of a crossing near a hit, and of a hit, against one clear crossing; clear crossings
            for full evidence; the prior: the evidence that a place must exceed, and the most that
            hits alone are against it.
    """
    near, hit, votes, prior = weights
    against = near * grazed + hit * hits
    if clear > against:
        return min(clear / votes, 1.0) * (clear - against) / (clear + against)
    return prior * (clear - against) / (clear + against + 1.0)


@njit(cache=True, nogil=True)
def of_voxel(v, hits, clear, grazed, weights):
    """The evidence of a voxel; 0 for -1, or if no other scan touched it."""
    h = hits[v >> 9, v & 511]
    c = clear[v >> 9, v & 511]
    q = grazed[v >> 9, v & 511]
    return clearness(h, c, q, weights) if v >= 0 and (h > 1 or c > 0 or q > 0) else 0.0


@njit(cache=True, nogil=True)
def of_points(voxels, hits, clear, grazed, weights):
    """(N,) float32: the evidence of each point's voxel, as from ``of_voxel``."""
    found = np.empty(len(voxels), np.float32)
    for i in range(len(voxels)):
        found[i] = of_voxel(voxels[i], hits, clear, grazed, weights)
    return found


@njit(cache=True, nogil=True)
def distinct(places, rows):
    """The distinct ones of some places (V,) int32, (R,).

    ``rows`` (4 B,) int32, zero before, is 1 there after.
    """
    found = np.empty(len(places), np.int32)
    n = 0
    for p in places:
        if rows[p] == 0:
            found[n] = p
            rows[p] = 1
            n += 1
    return found[:n].copy()


@njit(cache=True, nogil=True, parallel=True)
def evidence(places, up, hits, clear, grazed, weights):
    """(R + 1,) float32: the evidence of the place in each row, (R + 1,) int32.

    0 in row 0, which is for none.

    The evidence of a place is the mean over its voxels with points of objects, less the prior,
    weighted with the scans that hit them; nearer 0 if these were fewer than ``votes``.

    Args:
        up, hits, clear, grazed, weights: as in ``visit`` and ``clearness``.
    """
    found = np.zeros(len(places), np.float32)
    for k in prange(1, len(places)):
        block = places[k] >> 2
        x0 = (places[k] >> 1 & 1) * 4
        y0 = (places[k] & 1) * 4
        total = 0.0
        summed = 0.0
        for w in range(x0, x0 + 4):
            word = up[block, w] & HALF << np.uint64(8 * y0)
            while word:
                rest = word & (word - ONE)
                v = w << 6 | BIT_OF[(word ^ rest) * SEQUENCE >> np.uint64(58)]
                h = hits[block, v]
                c = clear[block, v]
                q = grazed[block, v]
                word = rest
                if h > 1 or c > 0 or q > 0:
                    summed += h * (clearness(h, c, q, weights) - weights[3])
                    total += h
        found[k] = summed / max(total, weights[2])
    return found


@njit(cache=True, nogil=True, inline="always")
def combined(r, own, shared, link):
    """The evidence of the place in a row, with what it inherits; above 0 if it is dynamic.

    See ``certainties``.
    """
    return own[r] + link * max(shared[r], 0.0)


@njit(cache=True, nogil=True, parallel=True)
def certainties(rows, begins, own, shared, link, full):
    """How certain it is that each object is dynamic, (O,) float64 from -1 to 1.

    The mean of its places.

    Args:
        rows: (V,) int32: the row of the place of each visit, by object; begins: (O + 1,) int64: the
            first ones.
        own, shared: (R + 1,) float32: evidence of places, and the mean certainty of the objects
            that were there.
        link: weight of what a place inherits from these; full: what is full certainty. Places weigh
            1, certain ones 2.
    """
    found = np.empty(len(begins) - 1)
    for of in prange(len(found)):
        total = 0.0
        weight = 0.0
        for k in range(begins[of], begins[of + 1]):
            f = min(max(combined(rows[k], own, shared, link) / full, -1.0), 1.0)
            total += f * (1.0 + abs(f))
            weight += 1.0 + abs(f)
        found[of] = total / max(weight, 1.0)
    return found


@njit(cache=True, nogil=True)
def share(firsts, numbers, rows, begins, certain, size):
    """What places inherit from the objects that were there.

    Args:
        firsts: (F + 1,) int64: the first object of each scan; numbers: (F,) int32, of these scans.
        rows, begins: as in ``certainties``; certain: (O,) float64, of objects.
        size: number of rows, R + 1.

    Returns:
        shared: (R + 1,) float32: mean certainty, 0 where none was.
        source: (R + 1,) int32: number of the last scan with a certainty above 0; -1 for none.
    """
    visits = np.zeros(size, np.int32)
    shared = np.zeros(size, np.float32)
    source = np.full(size, np.int32(-1))
    for t in range(len(numbers)):
        for of in range(firsts[t], firsts[t + 1]):
            for k in range(begins[of], begins[of + 1]):
                r = rows[k]
                visits[r] += 1
                shared[r] += (certain[of] - shared[r]) / visits[r]
                if certain[of] > 0:
                    source[r] = numbers[t]
    return shared, source


@njit(cache=True, nogil=True, parallel=True)
def outcomes(voxels, bands, rows, own, shared, link, hits, clear, grazed, weights, codes):
    """(N,) uint8: the reason code of each point, without feet.

    Args:
        voxels: (N,) int64, -1 for none.
        bands: (N,) uint8, as from ``scan_ground.bands``.
        rows: (4 B,) int32: the row of each place, 0 for none; own, shared, link: as in
            ``certainties``.
        hits, clear, grazed, weights: as in ``of_voxel``.
        codes: of points out of reach, near the ground, high, kept though seen clear, kept and never
            seen clear; removed by the evidence of their place alone, or with what it inherits.
    """
    out, near_ground, above, little, never, seen, followed = codes
    found = np.empty(len(voxels), np.uint8)
    for i in prange(len(voxels)):
        v = voxels[i]
        r = rows[v >> 9 << 2 | (v >> 8 & 1) << 1 | v >> 5 & 1]
        if v < 0:
            found[i] = out
        elif bands[i] < 2:
            found[i] = near_ground
        elif bands[i] > 2:
            found[i] = above
        elif combined(r, own, shared, link) > 0:
            found[i] = seen if own[r] > 0 else followed
        else:  # most voxels were never clear: to read one count is faster than all
            some = clear[v >> 9, v & 511] and of_voxel(v, hits, clear, grazed, weights) > 0
            found[i] = little if some else never
    return found

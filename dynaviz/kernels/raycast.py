"""Ray casting through a block grid, and the log-odds update.

A ray is traversed voxel by voxel (Amanatides and Woo 1987) in blocks that exist, and from border to border of blocks
and super-blocks elsewhere. Its parameter ("time") is an integer, 0 at the sensor and ``ONE`` at the point, so n periods
are exactly n times the period: leaps and single steps reach the same voxels. The two lowest bits of a time encode the
axis, so no two borders have the same time; for borders at the same place z comes first, then y, then x.
"""

import math

import numpy as np
from numba import njit, prange

REACH = 1 << 15  # voxels to each side of the world's origin
ONE = 1 << 52
END = ONE << 2 | 3  # after the last border, before anything beyond the point
START = -(1 << 60)
CHUNK = 512  # rays that a lane processes in turn, for load balance


@njit(cache=True, nogil=True, inline="always")
def _axis(start, end, tie):
    """First voxel, direction, time of the first border, and period along one axis; start and end in voxels."""
    k, goal = np.int64(math.floor(start)), np.int64(math.floor(end))
    borders = abs(goal - k)
    if borders == 0:
        return k, np.int64(1), np.int64((ONE + 1) << 2 | tie), np.int64(ONE << 2)
    length = abs(end - start)
    ahead = (k + 1 - start) if goal > k else (start - k)
    first = np.int64(ahead / length * ONE + 0.5)
    period = np.int64(min(ONE / length, 2.0 * ONE) + 0.5)  # the limit is beyond the point, and 128 periods fit
    last = first + (borders - 1) * period
    if last > ONE:  # by rounding; the ray must end in the voxel of its point
        first -= last - ONE
    elif last + period <= ONE:
        first += ONE + 1 - last - period
    return k, np.int64(1 if goal > k else -1), first << 2 | tie, period << 2


@njit(cache=True, nogil=True, inline="always")
def _passed(time, first, period):
    """Number of borders of an axis at or before a time."""
    return np.int64(0) if time < first else (time - first) // period + 1


@njit(cache=True, nogil=True, inline="always")
def _ahead(k, step, last):
    """Number of voxel borders before the one that leaves a cube of last + 1 voxels."""
    return last - (k & last) if step > 0 else k & last


@njit(cache=True, nogil=True, inline="always")
def _slot(slots, owners, masks, used, block):
    """The scratch memory of a block in this scan; allocated and cleared on first use."""
    slot = slots[block]
    if slot == 0:
        used += 1
        slot = used
        slots[block] = slot
        owners[slot] = block
        masks[slot] = 0
    return slot, used


@njit(cache=True, nogil=True, error_model="numpy")
def _walk(o, e, base, shape, top, children, slots, owners, masks, used):
    """Mark the voxels from that of o up to, but not including, that of e; both in voxels, within the grid's bounds."""
    kx, sx, fx, px = _axis(o[0], e[0], 2)
    ky, sy, fy, py = _axis(o[1], e[1], 1)
    kz, sz, fz, pz = _axis(o[2], e[2], 0)
    kx, ky, kz = kx - (base[0] << 7), ky - (base[1] << 7), kz - (base[2] << 7)

    j = ((kx >> 7) * shape[1] + (ky >> 7)) * shape[2] + (kz >> 7)
    ux, uy, uz = fx + _ahead(kx, sx, 127) * px, fy + _ahead(ky, sy, 127) * py, fz + _ahead(kz, sz, 127) * pz
    dx, dy = sx << 6, sy << 3  # steps of i
    time = np.int64(START)
    while True:  # super-blocks
        until = min(min(ux, uy), min(uz, END))
        row = top[j]
        if row:
            nx, ny, nz = _passed(time, fx, px), _passed(time, fy, py), _passed(time, fz, pz)
            x, y, z = kx + sx * nx, ky + sy * ny, kz + sz * nz
            tx, ty, tz = fx + nx * px, fy + ny * py, fz + nz * pz
            i = (x & 7) << 6 | (y & 7) << 3 | (z & 7)
            c = (x >> 3 & 15) << 8 | (y >> 3 & 15) << 4 | (z >> 3 & 15)
            bx, by, bz = tx + _ahead(x, sx, 7) * px, ty + _ahead(y, sy, 7) * py, tz + _ahead(z, sz, 7) * pz
            here = True  # i, tx, ty and tz are valid for this block
            while True:  # blocks
                limit = min(min(bx, by), min(bz, until))
                block = children[row, c]
                if block:
                    if not here:
                        nx, ny, nz = _passed(time, fx, px), _passed(time, fy, py), _passed(time, fz, pz)
                        tx, ty, tz = fx + nx * px, fy + ny * py, fz + nz * pz
                        i = (kx + sx * nx & 7) << 6 | (ky + sy * ny & 7) << 3 | (kz + sz * nz & 7)
                        here = True
                    slot, used = _slot(slots, owners, masks, used, block - 1)
                    t = min(tx, min(ty, tz))
                    while t < limit:  # voxels; without branches, since the order of axes cannot be predicted
                        masks[slot, i >> 6] |= np.int64(1) << (i & 63)
                        gx, gy = t == tx, t == ty
                        tx += px if gx else 0
                        ty += py if gy else 0
                        tz += 0 if gx or gy else pz
                        i += dx if gx else (dy if gy else sz)
                        t = min(tx, min(ty, tz))
                    if limit < END:
                        masks[slot, i >> 6] |= np.int64(1) << (i & 63)
                else:
                    here = False
                time = limit
                if limit == until:
                    break
                if limit == bx:
                    c, bx, tx, i = c + (sx << 8), bx + (px << 3), tx + px, i ^ 7 << 6
                elif limit == by:
                    c, by, ty, i = c + (sy << 4), by + (py << 3), ty + py, i ^ 7 << 3
                else:
                    c, bz, tz, i = c + sz, bz + (pz << 3), tz + pz, i ^ 7
        if until == END:
            return used
        time = until
        if until == ux:
            j, ux = j + sx * shape[1] * shape[2], ux + (px << 7)
        elif until == uy:
            j, uy = j + sy * shape[2], uy + (py << 7)
        else:
            j, uz = j + sz, uz + (pz << 7)


@njit(cache=True, nogil=True, inline="always")
def _inside(v, base, shape):
    """Whether a position in voxels is finite, within reach and within the grid's bounds."""
    for axis in range(3):
        if not abs(v[axis]) < REACH:
            return False
        k = (np.int64(math.floor(v[axis])) >> 7) - base[axis]
        if not 0 <= k < shape[axis]:
            return False
    return True


@njit(cache=True, nogil=True, parallel=True)
def mark(points, origins, casts, hits, per_metre, base, shape, top, children, slots, owners, masks, used):
    """Mark crossed and hit voxels in scratch memory, each lane in its own; see ``collect``.

    Args:
        points: (N, 3) float32, metres, world frame: ends of the rays.
        origins: (N or 1, 3) float64, metres, world frame: origins of the rays.
        casts, hits: (N,) bool: whether to cast the ray, and whether its end counts as a hit.
        per_metre: voxels per metre.
        base, shape, top, children: the grid's directory.
        slots, owners, masks, used: the grid's scratch memory.
    """
    n, several = len(points), len(origins) > 1
    for lane in prange(len(used)):
        count = np.int64(0)
        mine, owned, own_masks = slots[lane], owners[lane], masks[lane]
        for chunk in range(lane * CHUNK, n, len(used) * CHUNK):
            for p in range(chunk, min(chunk + CHUNK, n)):
                q = p if several else 0
                e = (points[p, 0] * per_metre, points[p, 1] * per_metre, points[p, 2] * per_metre)
                if not _inside(e, base, shape):
                    continue
                o = (origins[q, 0] * per_metre, origins[q, 1] * per_metre, origins[q, 2] * per_metre)
                if casts[p] and _inside(o, base, shape):
                    count = _walk(o, e, base, shape, top, children, mine, owned, own_masks, count)
                if hits[p]:
                    x = np.int64(math.floor(e[0])) - (base[0] << 7)
                    y = np.int64(math.floor(e[1])) - (base[1] << 7)
                    z = np.int64(math.floor(e[2])) - (base[2] << 7)
                    row = top[((x >> 7) * shape[1] + (y >> 7)) * shape[2] + (z >> 7)]
                    block = children[row, (x >> 3 & 15) << 8 | (y >> 3 & 15) << 4 | (z >> 3 & 15)]
                    if block:
                        slot, count = _slot(mine, owned, own_masks, count, block - 1)
                        own_masks[slot, 8 + (x & 7)] |= np.int64(1) << ((y & 7) << 3 | (z & 7))
        used[lane] = count


@njit(cache=True, nogil=True)
def collect(slots, owners, masks, used):
    """Merge the lanes, and reset the scratch memory.

    Returns:
        (B,) int32: numbers of the touched blocks.
        (B, 16) int64: bits of their crossed voxels (words 0 to 7) and hit voxels (words 8 to 15).
    """
    most = used.sum()
    blocks, bits = np.empty(most, np.int32), np.empty((most, 16), np.int64)
    n = 0
    for lane in range(len(used)):
        for slot in range(1, used[lane] + 1):
            block = owners[lane, slot]
            if slots[lane, block] == 0:  # already merged for an earlier lane
                continue
            blocks[n] = block
            bits[n] = 0
            for other in range(lane, len(used)):
                theirs = slots[other, block]
                if theirs:
                    slots[other, block] = 0
                    for w in range(16):
                        bits[n, w] |= masks[other, theirs, w]
            n += 1
    return blocks[:n], bits[:n]


@njit(cache=True, nogil=True, parallel=True)
def update_log_odds(log_odds, ever, blocks, bits, miss, hit, low, high):
    """Update each marked voxel once: add a miss and clamp, then a hit and clamp; record voxels ever crossed or hit.

    Args:
        log_odds: (all blocks + 1, 512) float32. Modified.
        ever: (all blocks + 1, 16) int64, bits as from ``collect``. Modified.
        blocks, bits: the marks of a scan, as from ``collect``.
        miss, hit: increments, log-odds.
        low, high: clamping thresholds, log-odds.
    """
    for n in prange(len(blocks)):
        block = blocks[n]
        for w in range(8):
            crossed, struck = bits[n, w], bits[n, 8 + w]
            ever[block, w] |= crossed
            ever[block, 8 + w] |= struck
            if crossed | struck:
                values = log_odds[block, w << 6 : (w << 6) + 64]
                for v in range(64):  # without branches, so that it is vectorised
                    value = values[v]
                    value = max(value + miss, low) if crossed >> v & 1 else value
                    values[v] = min(value + hit, high) if struck >> v & 1 else value

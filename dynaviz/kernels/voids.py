"""Hit, observed and void voxels of a scan in a block grid.

A ray goes from the sensor to the centre of a voxel. It is traversed voxel by voxel (Amanatides and Woo 1987), and marks
voxels only where the grid has a block. Times along it are integers, ``UNIT`` per edge of a voxel; their two lowest bits
encode the axis, so no two borders have the same time: for borders at the same place x comes first, then y, then z.

Scratch memory is that of ``dynaviz.spatial.blocks``: each lane has its own rows of 16 words, 8 for observed voxels and
8 for hit voxels, which ``raycast.collect`` merges. Bit v of word w is voxel 64 w + v of a block.
"""

import math

import numpy as np
from numba import njit, prange

REACH = 1 << 15  # voxels to each side of the world's origin
UNIT = 1 << 40
LONG = 1 << 17  # voxels: longer than any ray, and ten times this still fits in a time
CHUNK = 256  # rays that a lane processes in turn, for load balance
FULL = np.int64(-1)


@njit(cache=True, nogil=True)
def in_range(points, origins, low, high):
    """(N,) bool: points (N, 3) more than ``low`` and less than ``high`` metres from their origins, (N or 1, 3)."""
    inside = np.zeros(len(points), np.bool_)
    several = len(origins) > 1
    for p in range(len(points)):
        q = p if several else 0
        squared = 0.0
        for a in range(3):
            squared += (points[p, a] - origins[q, a]) ** 2
        inside[p] = low * low < squared < high * high  # False if not finite
    return inside


@njit(cache=True, nogil=True)
def distinct(voxels, chosen, scratch):
    """The chosen voxels without duplicates, in order; ``scratch`` (blocks, 8) int64 is zero before and after."""
    goals, n = np.empty(len(voxels) + 1, np.int64), 0
    for p in range(len(voxels)):
        if chosen[p]:
            block, word, place = voxels[p] >> 9, voxels[p] >> 6 & 7, voxels[p] & 63
            bits = scratch[block, word]
            scratch[block, word] = bits | np.int64(1) << place
            goals[n] = voxels[p]  # overwritten by the next one unless new: an unpredictable branch is slower
            n += 1 - (bits >> place & 1)
    for g in goals[:n]:
        scratch[g >> 9, g >> 6 & 7] = 0
    return goals[:n].copy()


@njit(cache=True, nogil=True)
def remember(blocks, hit, observed, void, seen_free, crossed):
    """Add a scan's bits, (B, 8) int64, to those of all scans: void voxels, and voxels that rays crossed."""
    for b in range(len(blocks)):
        for word in range(8):
            seen_free[blocks[b], word] |= void[b, word]
            crossed[blocks[b], word] |= observed[b, word] & ~hit[b, word]


@njit(cache=True, nogil=True, inline="always")
def _axis(start, along, tie):
    """First voxel, step, time of the first border, and period along one axis.

    ``start`` is in voxels, ``along`` is a component of a unit vector.
    """
    k = np.int64(math.floor(start))
    if along == 0.0:
        return k, np.int64(1), np.int64(LONG * UNIT << 2 | tie), np.int64(0)
    length = 1.0 / abs(along)
    ahead = (k + 1 - start) if along > 0 else (start - k)
    first = np.int64(min(ahead * length, 1.0 * LONG) * UNIT)
    period = np.int64(min(length, 1.0 * LONG) * UNIT)
    return k, np.int64(1 if along > 0 else -1), first << 2 | tie, period << 2


@njit(cache=True, nogil=True, inline="always")
def _block(x, y, z, shape, top, children):
    """The number of a block plus one, 0 if absent; x, y, z: blocks from the grid's first."""
    jx, jy, jz = x >> 4, y >> 4, z >> 4
    if not (0 <= jx < shape[0] and 0 <= jy < shape[1] and 0 <= jz < shape[2]):
        return np.int32(0)
    row = top[(jx * shape[1] + jy) * shape[2] + jz]
    return children[row, (x & 15) << 8 | (y & 15) << 4 | (z & 15)]  # row 0 is empty


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


@njit(cache=True, nogil=True, inline="always")
def _direction(o, c):
    """Unit vector from o to c, and their distance; a zero vector if both are equal."""
    dx, dy, dz = c[0] - o[0], c[1] - o[1], c[2] - o[2]
    length = math.sqrt(dx * dx + dy * dy + dz * dz)
    if length == 0.0:
        return (0.0, 0.0, 0.0), length
    return (dx / length, dy / length, dz / length), length


@njit(cache=True, nogil=True, inline="always")
def _within(o):
    """Whether a position in voxels is finite and within reach."""
    return abs(o[0]) < REACH and abs(o[1]) < REACH and abs(o[2]) < REACH


@njit(cache=True, nogil=True, inline="always")
def _centre(voxel, blocks):
    """The centre of a voxel, given by its number, in voxels from the world's origin."""
    block, place = voxel >> 9, voxel & 511
    x = (np.int64(blocks[block, 0]) << 3 | place >> 6) + 0.5
    y = (np.int64(blocks[block, 1]) << 3 | (place >> 3 & 7)) + 0.5
    z = (np.int64(blocks[block, 2]) << 3 | (place & 7)) + 0.5
    return x, y, z


@njit(cache=True, nogil=True)
def _hit(c, o, margin, base, shape, top, children, slots, owners, masks, used):
    """Mark the voxels from c to ``margin`` voxels towards o as hit, at most up to that of o."""
    d, length = _direction(c, o)
    x, sx, tx, px = _axis(c[0], d[0], 0)
    y, sy, ty, py = _axis(c[1], d[1], 1)
    z, sz, tz, pz = _axis(c[2], d[2], 2)
    x, y, z = x - (base[0] << 7), y - (base[1] << 7), z - (base[2] << 7)
    end = np.int64(min(margin, length) * UNIT) << 2
    while True:
        block = _block(x >> 3, y >> 3, z >> 3, shape, top, children)
        if block:
            slot, used = _slot(slots, owners, masks, used, block - 1)
            masks[slot, 8 + (x & 7)] |= np.int64(1) << ((y & 7) << 3 | (z & 7))
        t = min(tx, min(ty, tz))
        if t > end:
            return used
        if t == tx:
            x, tx = x + sx, tx + px
        elif t == ty:
            y, ty = y + sy, ty + py
        else:
            z, tz = z + sz, tz + pz


@njit(cache=True, nogil=True, inline="always")
def _passed(time, first, period):
    """Number of borders of an axis at or before a time."""
    return np.int64(0) if time < first else (time - first) // period + 1


@njit(cache=True, nogil=True, inline="always")
def _is_full(mask):
    """Whether all voxels of a block are marked as observed."""
    return mask[0] & mask[1] & mask[2] & mask[3] & mask[4] & mask[5] & mask[6] & mask[7] == FULL


@njit(cache=True, nogil=True)
def _observe(o, c, beyond, base, shape, top, children, struck, hits, slots, owners, masks, used):
    """Mark the voxels from o to the first hit one as observed, then until an axis is ``beyond`` voxels farther."""
    d, length = _direction(o, c)
    kx, sx, fx, px = _axis(o[0], d[0], 0)
    ky, sy, fy, py = _axis(o[1], d[1], 1)
    kz, sz, fz, pz = _axis(o[2], d[2], 2)
    kx, ky, kz = kx - (base[0] << 7), ky - (base[1] << 7), kz - (base[2] << 7)
    bx, by, bz = kx >> 3, ky >> 3, kz >> 3
    # Times at which the ray leaves its block along each axis.
    ux = fx + (7 - (kx & 7) if sx > 0 else kx & 7) * px
    uy = fy + (7 - (ky & 7) if sy > 0 else ky & 7) * py
    uz = fz + (7 - (kz & 7) if sz > 0 else kz & 7) * pz
    i, tx, ty, tz = (kx & 7) << 6 | (ky & 7) << 3 | (kz & 7), fx, fy, fz
    end = np.int64((length + 1.0) * UNIT) << 2 | 3  # the goal is hit, so the ray never gets farther
    time, here, stopped = np.int64(-1), True, False
    dx, dy = sx << 6, sy << 3  # steps of i
    while True:  # blocks
        limit = min(min(ux, uy), min(uz, end))
        block = _block(bx, by, bz, shape, top, children) - 1
        marks = block >= 0
        if marks and not struck[block]:
            slot = slots[block]
            marks = slot == 0 or not _is_full(masks[slot])
        if marks:
            if not here:  # after blocks that were skipped
                nx, ny, nz = _passed(time, fx, px), _passed(time, fy, py), _passed(time, fz, pz)
                tx, ty, tz = fx + nx * px, fy + ny * py, fz + nz * pz
                i = (kx + sx * nx & 7) << 6 | (ky + sy * ny & 7) << 3 | (kz + sz * nz & 7)
                here = True
            slot, used = _slot(slots, owners, masks, used, block)
            t = min(tx, min(ty, tz))
            while True:  # voxels; without branches, since the order of axes cannot be predicted
                bit = np.int64(1) << (i & 63)
                masks[slot, i >> 6] |= bit
                if hits[block, i >> 6] & bit:
                    stopped = True
                    break
                if t >= limit:
                    break
                gx, gy = t == tx, t == ty
                tx += px if gx else 0
                ty += py if gy else 0
                tz += 0 if gx or gy else pz
                i += dx if gx else (dy if gy else sz)
                t = min(tx, min(ty, tz))
        else:
            here = False
        if stopped or limit == end:
            break
        time = limit
        if limit == ux:
            bx, ux, tx, i = bx + sx, ux + (px << 3), tx + px, i ^ 7 << 6
        elif limit == uy:
            by, uy, ty, i = by + sy, uy + (py << 3), ty + py, i ^ 7 << 3
        else:
            bz, uz, tz, i = bz + sz, uz + (pz << 3), tz + pz, i ^ 7
    if not stopped:
        return used

    x, y, z = bx << 3 | i >> 6, by << 3 | (i >> 3 & 7), bz << 3 | (i & 7)
    left_x, left_y, left_z = beyond, beyond, beyond
    while length > 0.0 and min(left_x, min(left_y, left_z)) > 0:
        t = min(tx, min(ty, tz))
        if t == tx:
            x, tx, left_x = x + sx, tx + px, left_x - 1
        elif t == ty:
            y, ty, left_y = y + sy, ty + py, left_y - 1
        else:
            z, tz, left_z = z + sz, tz + pz, left_z - 1
        block = _block(x >> 3, y >> 3, z >> 3, shape, top, children) - 1
        if block >= 0:
            slot, used = _slot(slots, owners, masks, used, block)
            masks[slot, x & 7] |= np.int64(1) << ((y & 7) << 3 | (z & 7))
    return used


@njit(cache=True, nogil=True, parallel=True)
def hit(goals, starts, origins, margin, blocks, base, shape, top, children, slots, owners, masks, used):
    """Mark voxels ``goals`` (G,) and those up to ``margin`` voxels in front of them as hit, from origins[starts]."""
    for lane in prange(len(used)):
        count = 0
        for chunk in range(lane * CHUNK, len(goals), len(used) * CHUNK):
            for g in range(chunk, min(chunk + CHUNK, len(goals))):
                s = starts[g]
                o, c = (origins[s, 0], origins[s, 1], origins[s, 2]), _centre(goals[g], blocks)
                if _within(o):
                    lanes = (slots[lane], owners[lane], masks[lane])
                    count = _hit(c, o, margin, base, shape, top, children, *lanes, count)
        used[lane] = count


@njit(cache=True, nogil=True, parallel=True)
def observe(
    goals, starts, origins, beyond, struck, hits, blocks, base, shape, top, children, slots, owners, masks, used
):
    """Mark the voxels that rays to ``goals`` (G,) observe: up to the first hit voxel, and ``beyond`` voxels more.

    ``hits`` (B, 8) are the bits of the hit voxels, ``struck`` (B,) bool are the blocks that contain any.
    """
    for lane in prange(len(used)):
        count = 0
        for chunk in range(lane * CHUNK, len(goals), len(used) * CHUNK):
            for g in range(chunk, min(chunk + CHUNK, len(goals))):
                s = starts[g]
                o, c = (origins[s, 0], origins[s, 1], origins[s, 2]), _centre(goals[g], blocks)
                if _within(o):
                    lanes = (slots[lane], owners[lane], masks[lane])
                    count = _observe(o, c, beyond, base, shape, top, children, struck, hits, *lanes, count)
        used[lane] = count


@njit(cache=True, nogil=True, parallel=True)
def sides(touched, rows, blocks, base, shape, top, children):
    """(n, 6) int32: rows of the six adjacent blocks of each touched block, -x, +x, -y, ... +z; n if absent."""
    adjacent = np.full((len(touched), 6), np.int32(len(touched)))
    for n in prange(len(touched)):
        for side in range(6):
            step = 1 if side & 1 else -1
            x = np.int64(blocks[touched[n], 0]) - (base[0] << 4) + (step if side >> 1 == 0 else 0)
            y = np.int64(blocks[touched[n], 1]) - (base[1] << 4) + (step if side >> 1 == 1 else 0)
            z = np.int64(blocks[touched[n], 2]) - (base[2] << 4) + (step if side >> 1 == 2 else 0)
            block = _block(x, y, z, shape, top, children)
            if block and rows[block - 1]:
                adjacent[n, side] = rows[block - 1] - 1
    return adjacent


@njit(cache=True, nogil=True, parallel=True)
def erode(observed, adjacent, times):
    """Erode voxels (n + 1, 8) uint64, the last row empty, by cubes of edge 2 times + 1 voxels, one axis after another.

    ``adjacent`` (n, 6) are the rows of adjacent blocks, as from ``sides``.
    """
    n = len(adjacent)
    here, there = observed.copy(), np.zeros_like(observed)
    low, high = np.uint64(0x0101010101010101), np.uint64(0x8080808080808080)
    one, seven, eight, most = np.uint64(1), np.uint64(7), np.uint64(8), np.uint64(56)
    for _ in range(times):
        for r in prange(n):
            for w in range(8):  # z: bits of a byte
                word, below, above = here[r, w], here[adjacent[r, 4], w], here[adjacent[r, 5], w]
                lower = (word << one) & ~low | (below >> seven) & low
                upper = (word >> one) & ~high | (above << seven) & high
                there[r, w] = word & lower & upper
        for r in prange(n):
            for w in range(8):  # y: bytes of a word
                word, below, above = there[r, w], there[adjacent[r, 2], w], there[adjacent[r, 3], w]
                here[r, w] = word & (word << eight | below >> most) & (word >> eight | above << most)
        for r in prange(n):
            for w in range(8):  # x: words of a block
                below = here[r, w - 1] if w > 0 else here[adjacent[r, 0], 7]
                above = here[r, w + 1] if w < 7 else here[adjacent[r, 1], 0]
                there[r, w] = here[r, w] & below & above
        here, there = there, here
    return here

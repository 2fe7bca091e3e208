"""Rays that hit and observe voxels of a block grid.

A ray goes from the sensor to the centre of a voxel. It is traversed voxel by voxel (Amanatides and
Woo 1987), and marks voxels only where the grid has a block. Times along it are integers, ``UNIT``
per edge of a voxel; their two lowest bits encode the axis, so no two borders have the same time:
for borders at the same place x comes first, then y, then z.

Scratch memory is that of ``dynaviz.blocks.blocks``: each lane has its own rows of 16 words, 8 for
observed voxels and 8 for hit voxels, which ``raycast.collect`` merges. Bit v of word w is voxel 64
w + v of a block. In live use, voxels around the sensor are marked at addresses first, as in
``raycast``.
"""

import math

import numpy as np
from numba import njit, prange

from dynaviz.kernels.addresses import (
    ALL_X,
    ALL_Y,
    ALL_Z,
    LAST,
    NEAR,
    NINE,
    ONE_BIT,
    SEVEN,
    SIX,
    X,
    Y,
    Z,
)
from dynaviz.kernels.scratch import slot_of_block

REACH = 1 << 15  # voxels to each side of the world's origin
UNIT = 1 << 40
LONG = 1 << 17  # voxels: longer than any ray, and ten times this still fits in a time
START = -1
CHUNK = 256  # rays that a lane processes in turn, for load balance
FULL = np.int64(-1)


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
    jx = x >> 4
    jy = y >> 4
    jz = z >> 4
    if not (0 <= jx < shape[0] and 0 <= jy < shape[1] and 0 <= jz < shape[2]):
        return np.int32(0)
    row = top[(jx * shape[1] + jy) * shape[2] + jz]
    return children[row, (x & 15) << 8 | (y & 15) << 4 | (z & 15)]  # row 0 is empty


@njit(cache=True, nogil=True, inline="always")
def _direction(o, c):
    """Unit vector from o to c, and their distance; a zero vector if both are equal."""
    dx = c[0] - o[0]
    dy = c[1] - o[1]
    dz = c[2] - o[2]
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
    block = voxel >> 9
    place = voxel & 511
    x = (np.int64(blocks[block, 0]) << 3 | place >> 6) + 0.5
    y = (np.int64(blocks[block, 1]) << 3 | (place >> 3 & 7)) + 0.5
    z = (np.int64(blocks[block, 2]) << 3 | (place & 7)) + 0.5
    return x, y, z


@njit(cache=True, nogil=True)
def _hit(c, o, block, margin, base, shape, top, children, slots, owners, masks, used):
    """Mark the voxels from c, in a block, to ``margin`` voxels towards o as hit, at most up to that
    of o.
    """
    d, length = _direction(c, o)
    x, sx, tx, px = _axis(c[0], d[0], 0)
    y, sy, ty, py = _axis(c[1], d[1], 1)
    z, sz, tz, pz = _axis(c[2], d[2], 2)
    x = x - (base[0] << 7)
    y = y - (base[1] << 7)
    z = z - (base[2] << 7)
    end = np.int64(min(margin, length) * UNIT) << 2
    slot, used = slot_of_block(slots, owners, masks, used, block)
    while True:
        if slot:
            masks[slot, 8 + (x & 7)] |= np.int64(1) << ((y & 7) << 3 | (z & 7))
        t = min(tx, min(ty, tz))
        if t > end:
            return used
        bx = x >> 3
        by = y >> 3
        bz = z >> 3
        if t == tx:
            x = x + sx
            tx = tx + px
        elif t == ty:
            y = y + sy
            ty = ty + py
        else:
            z = z + sz
            tz = tz + pz
        if x >> 3 != bx or y >> 3 != by or z >> 3 != bz:
            other = _block(x >> 3, y >> 3, z >> 3, shape, top, children)
            slot = np.int32(0)
            if other:
                slot, used = slot_of_block(slots, owners, masks, used, other - 1)


@njit(cache=True, nogil=True, inline="always")
def _passed(time, first, period):
    """Number of borders of an axis at or before a time."""
    return np.int64(0) if time < first else (time - first) // period + 1


@njit(cache=True, nogil=True, inline="always")
def _is_full(mask):
    """Whether all voxels of a block are marked as observed."""
    return mask[0] & mask[1] & mask[2] & mask[3] & mask[4] & mask[5] & mask[6] & mask[7] == FULL


@njit(cache=True, nogil=True)
def _observe_beyond(
    along_x, along_y, along_z, time, beyond, used, base, shape, top, children, slots, owners, masks
):
    """Mark the voxels of a ray from the next border, at a time, until an axis is ``beyond`` voxels
    farther.
    """
    kx, sx, fx, px = along_x
    ky, sy, fy, py = along_y
    kz, sz, fz, pz = along_z
    nx = _passed(time - 1, fx, px)
    ny = _passed(time - 1, fy, py)
    nz = _passed(time - 1, fz, pz)
    x = kx + sx * nx - (base[0] << 7)
    y = ky + sy * ny - (base[1] << 7)
    z = kz + sz * nz - (base[2] << 7)
    tx = fx + nx * px
    ty = fy + ny * py
    tz = fz + nz * pz
    left_x = beyond
    left_y = beyond
    left_z = beyond
    while min(left_x, min(left_y, left_z)) > 0:
        t = min(tx, min(ty, tz))
        if t == tx:
            x = x + sx
            tx = tx + px
            left_x = left_x - 1
        elif t == ty:
            y = y + sy
            ty = ty + py
            left_y = left_y - 1
        else:
            z = z + sz
            tz = tz + pz
            left_z = left_z - 1
        block = _block(x >> 3, y >> 3, z >> 3, shape, top, children) - 1
        if block >= 0:
            slot, used = slot_of_block(slots, owners, masks, used, block)
            masks[slot, x & 7] |= np.int64(1) << ((y & 7) << 3 | (z & 7))
    return used


@njit(cache=True, nogil=True)
def _observe(
    along_x,
    along_y,
    along_z,
    time,
    end,
    beyond,
    struck,
    hits,
    used,
    base,
    shape,
    top,
    children,
    slots,
    owners,
    masks,
):
    """Mark the voxels of a ray from a time on, up to the first hit one, and
    ``beyond`` voxels more.
    """
    kx, sx, fx, px = along_x
    ky, sy, fy, py = along_y
    kz, sz, fz, pz = along_z
    nx = _passed(time, fx, px)
    ny = _passed(time, fy, py)
    nz = _passed(time, fz, pz)
    kx = kx - (base[0] << 7)
    ky = ky - (base[1] << 7)
    kz = kz - (base[2] << 7)
    bx = kx + sx * nx
    by = ky + sy * ny
    bz = kz + sz * nz
    tx = fx + nx * px
    ty = fy + ny * py
    tz = fz + nz * pz
    i = (bx & 7) << 6 | (by & 7) << 3 | (bz & 7)
    # Times at which the ray leaves its block along each axis.
    ux = tx + (7 - (bx & 7) if sx > 0 else bx & 7) * px
    uy = ty + (7 - (by & 7) if sy > 0 else by & 7) * py
    uz = tz + (7 - (bz & 7) if sz > 0 else bz & 7) * pz
    bx = bx >> 3
    by = by >> 3
    bz = bz >> 3
    # here: i, tx, ty and tz are valid for this block
    here = True
    stopped = False
    t = end
    # steps of i
    dx = sx << 6
    dy = sy << 3
    while True:  # blocks
        limit = min(min(ux, uy), min(uz, end))
        block = _block(bx, by, bz, shape, top, children) - 1
        marks = block >= 0
        if marks and not struck[block]:
            slot = slots[block]
            marks = slot == 0 or not _is_full(masks[slot])
        if marks:
            if not here:  # after blocks that were skipped
                nx = _passed(time, fx, px)
                ny = _passed(time, fy, py)
                nz = _passed(time, fz, pz)
                tx = fx + nx * px
                ty = fy + ny * py
                tz = fz + nz * pz
                i = (kx + sx * nx & 7) << 6 | (ky + sy * ny & 7) << 3 | (kz + sz * nz & 7)
                here = True
            slot, used = slot_of_block(slots, owners, masks, used, block)
            t = min(tx, min(ty, tz))
            while True:  # voxels; without branches, since the order of axes cannot be predicted
                bit = np.int64(1) << (i & 63)
                masks[slot, i >> 6] |= bit
                if hits[block, i >> 6] & bit:
                    stopped = True
                    break
                if t >= limit:
                    break
                gx = t == tx
                gy = t == ty
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
            bx = bx + sx
            ux = ux + (px << 3)
            tx = tx + px
            i = i ^ 7 << 6
        elif limit == uy:
            by = by + sy
            uy = uy + (py << 3)
            ty = ty + py
            i = i ^ 7 << 3
        else:
            bz = bz + sz
            uz = uz + (pz << 3)
            tz = tz + pz
            i = i ^ 7
    if stopped:
        used = _observe_beyond(
            along_x,
            along_y,
            along_z,
            t,
            beyond,
            used,
            base,
            shape,
            top,
            children,
            slots,
            owners,
            masks,
        )
    return used


@njit(cache=True, nogil=True, inline="always")
def _moved(at, axis, step):
    """The address one voxel along an axis, as in ``raycast``."""
    return ((at | ~axis) + step) & axis | at & ~axis


@njit(cache=True, nogil=True, inline="always")
def _observed(at, pairs, touched):
    """Mark the voxel at an address; returns whether it is hit."""
    block = at >> NINE
    word = at >> SIX & SEVEN
    bit = ONE_BIT << (at & LAST)
    pairs[block, word, 0] |= bit
    touched[block] = True
    return pairs[block, word, 1] & bit


@njit(cache=True, nogil=True)
def _observe_near(along_x, along_y, along_z, until, pairs, touched):
    """Mark the voxels of a ray at their addresses, up to the first hit one, or up to a time.

    Returns whether a voxel was hit, and the time of the border after it, or ``until``.
    """
    kx, sx, ta, pa = along_x
    ky, sy, tb, pb = along_y
    kz, sz, tc, pc = along_z
    at = X[kx & len(X) - 1] | Y[ky & len(Y) - 1] | Z[kz & len(Z) - 1]
    a = ALL_X
    da = X[1] if sx > 0 else ALL_X
    b = ALL_Y
    db = Y[1] if sy > 0 else ALL_Y
    c = ALL_Z
    dc = Z[1] if sz > 0 else ALL_Z
    if pa > pc:  # c becomes the axis with the fewest borders
        ta, pa, a, da, tc, pc, c, dc = tc, pc, c, dc, ta, pa, a, da
    if pb > pc:
        tb, pb, b, db, tc, pc, c, dc = tc, pc, c, dc, tb, pb, b, db
    while True:
        limit = min(tc, until)
        t = min(ta, tb)
        while (
            t < limit
        ):  # one branch, which is never taken but once: the order of a and b cannot be predicted
            if _observed(at, pairs, touched):
                return True, t
            first = ta < tb
            axis = a if first else b
            step = da if first else db
            ta += pa if first else 0
            tb += 0 if first else pb
            at = _moved(at, axis, step)
            t = min(ta, tb)
        if _observed(at, pairs, touched):
            return True, min(t, tc)
        if limit == until:
            return False, until
        at = _moved(at, c, dc)
        tc += pc


@njit(cache=True, nogil=True, inline="always")
def _until(end, goal, axes, centre):
    """The time until which a ray stays where addresses around a voxel are unique.

    ``START`` if it starts elsewhere.
    """
    until = end
    for axis in range(3):
        k, _, first, period = axes[axis]
        borders = NEAR[axis] - abs(k - centre[axis])
        if borders <= 0:
            return np.int64(START)
        if abs(np.int64(math.floor(goal[axis])) - centre[axis]) >= NEAR[axis] and borders <= (
            end - first
        ) // max(period, 1):
            until = min(until, first + borders * period)
    return until


@njit(cache=True, nogil=True)
def _observe_all(o, c, beyond, centre, struck, hits, where, near, used):
    """Mark the voxels from o to the first hit one, at addresses as far as they reach, and
    ``beyond`` voxels more.
    """
    pairs, touched = near
    d, length = _direction(o, c)
    x = _axis(o[0], d[0], 0)
    y = _axis(o[1], d[1], 1)
    z = _axis(o[2], d[2], 2)
    end = np.int64((length + 1.0) * UNIT) << 2 | 3  # the goal is hit, so the ray never gets farther
    until = _until(end, c, (x, y, z), centre) if len(touched) else np.int64(START)
    if length == 0.0:
        beyond = 0
    stopped = False
    time = until
    if until > START:
        stopped, time = _observe_near(x, y, z, until, pairs, touched)
    if stopped:
        used = _observe_beyond(x, y, z, time, beyond, used, *where)
    elif time < end:
        used = _observe(x, y, z, time, end, beyond, struck, hits, used, *where)
    return used


@njit(cache=True, nogil=True, parallel=True)
def hit(
    goals, starts, origins, margin, blocks, base, shape, top, children, slots, owners, masks, used
):
    """Mark voxels ``goals`` (G,) and those up to ``margin`` voxels in front of them as hit, from
    origins[starts].
    """
    for lane in prange(len(used)):
        count = 0
        for chunk in range(lane * CHUNK, len(goals), len(used) * CHUNK):
            for g in range(chunk, min(chunk + CHUNK, len(goals))):
                s = starts[g]
                o = (origins[s, 0], origins[s, 1], origins[s, 2])
                c = _centre(goals[g], blocks)
                if _within(o):
                    lanes = (slots[lane], owners[lane], masks[lane])
                    count = _hit(
                        c, o, goals[g] >> 9, margin, base, shape, top, children, *lanes, count
                    )
        used[lane] = count


@njit(cache=True, nogil=True)
def _place_hits(struck, blocks, hits, mask, centre, pairs):
    """Copy the masked bits of struck blocks (K,) to their addresses around a voxel, where they have
    some.
    """
    for block in struck:
        x = np.int64(blocks[block, 0])
        y = np.int64(blocks[block, 1])
        z = np.int64(blocks[block, 2])
        dx = x - (centre[0] >> 3)
        dy = y - (centre[1] >> 3)
        dz = z - (centre[2] >> 3)
        if abs(dx) < len(X) >> 4 and abs(dy) < len(Y) >> 4 and abs(dz) < len(Z) >> 4:
            at = X[x << 3 & len(X) - 1] | Y[y << 3 & len(Y) - 1] | Z[z << 3 & len(Z) - 1]
            for w in range(8):
                pairs[at >> NINE, w, 1] = np.uint64(hits[block, w] & mask)


@njit(cache=True, nogil=True, parallel=True)
def observe(
    goals, starts, origins, beyond, struck, has, hits, blocks, base, shape, top, children, slots,
    owners, masks, used,
    pairs, centre, touched,
):  # fmt: skip
    """Mark the voxels that rays observe: up to the first hit voxel, and ``beyond`` voxels more.

    Args:
        goals, starts, origins, blocks, base to used: as in ``hit``.
        beyond: voxels.
        struck: (K,) int32, blocks with hit voxels; has: (B,) bool, whether a block has any.
        hits: (B, 8) int64, bits of the hit voxels.
        pairs: (lanes, addresses.BLOCKS, 8, 2) uint64, scratch memory for addresses: words of
            observed voxels and of hit voxels side by side, since each step reads both; without
            blocks, only the directory is used.
        centre, touched: as in ``raycast.mark``.
    """
    for lane in prange(len(used)):
        count = np.int64(0)
        if pairs.shape[1]:
            _place_hits(struck, blocks, hits, FULL, centre, pairs[lane])
        where = base, shape, top, children, slots[lane], owners[lane], masks[lane]
        near = pairs[lane], touched[lane]
        for chunk in range(lane * CHUNK, len(goals), len(used) * CHUNK):
            for g in range(chunk, min(chunk + CHUNK, len(goals))):
                s = starts[g]
                o = (origins[s, 0], origins[s, 1], origins[s, 2])
                c = _centre(goals[g], blocks)
                if _within(o):
                    count = _observe_all(o, c, beyond, centre, has, hits, where, near, count)
        if pairs.shape[1]:
            _place_hits(struck, blocks, hits, np.int64(0), centre, pairs[lane])
        used[lane] = count

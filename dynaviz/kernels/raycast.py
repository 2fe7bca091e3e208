"""Ray casting through a block grid.

A ray is traversed voxel by voxel (Amanatides and Woo 1987) in blocks that exist, and from border to
border of blocks and super-blocks elsewhere. Its parameter ("time") is an integer, 0 at the sensor
and ``ONE`` at the point, so n periods are exactly n times the period: leaps and single steps reach
the same voxels. The two lowest bits of a time encode the axis, so no two borders have the same
time; for borders at the same place z comes first, then y, then x.

In live use, nearly all blocks around the sensor exist. There, voxels are marked at addresses that
need no directory, and the marks are then moved to the blocks.
"""

import math

import numpy as np
from numba import njit, prange

from dynaviz.kernels.addresses import (
    ALL_X,
    ALL_Y,
    ALL_Z,
    IN_X,
    IN_Y,
    IN_Z,
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
ONE = 1 << 52
END = ONE << 2 | 3  # after the last border, before anything beyond the point
START = -(1 << 60)
CHUNK = 512  # rays that a lane processes in turn, for load balance


@njit(cache=True, nogil=True, inline="always")
def _axis(start, end, tie):
    """First voxel, direction, time of the first border, and period along one axis.

    Start and end in voxels.
    """
    k = np.int64(math.floor(start))
    goal = np.int64(math.floor(end))
    borders = abs(goal - k)
    if borders == 0:
        return k, np.int64(1), np.int64((ONE + 1) << 2 | tie), np.int64(ONE << 2)
    length = abs(end - start)
    ahead = (k + 1 - start) if goal > k else (start - k)
    first = np.int64(ahead / length * ONE + 0.5)
    # the limit is beyond the point, and 128 periods fit
    period = np.int64(min(ONE / length, 2.0 * ONE) + 0.5)
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


@njit(cache=True, nogil=True, error_model="numpy")
def _walk(along_x, along_y, along_z, time, base, shape, top, children, slots, owners, masks, used):
    """Mark the voxels of a ray within the grid's bounds from a time on, except that of its end."""
    kx, sx, fx, px = along_x
    ky, sy, fy, py = along_y
    kz, sz, fz, pz = along_z
    kx = kx - (base[0] << 7)
    ky = ky - (base[1] << 7)
    kz = kz - (base[2] << 7)

    nx = _passed(time, fx, px)
    ny = _passed(time, fy, py)
    nz = _passed(time, fz, pz)
    x = kx + sx * nx
    y = ky + sy * ny
    z = kz + sz * nz
    j = ((x >> 7) * shape[1] + (y >> 7)) * shape[2] + (z >> 7)
    ux = nx + _ahead(x, sx, 127)
    uy = ny + _ahead(y, sy, 127)
    uz = nz + _ahead(z, sz, 127)
    ux = fx + ux * px
    uy = fy + uy * py
    uz = fz + uz * pz
    # steps of i
    dx = sx << 6
    dy = sy << 3
    while True:  # super-blocks
        until = min(min(ux, uy), min(uz, END))
        row = top[j]
        if row:
            nx = _passed(time, fx, px)
            ny = _passed(time, fy, py)
            nz = _passed(time, fz, pz)
            x = kx + sx * nx
            y = ky + sy * ny
            z = kz + sz * nz
            tx = fx + nx * px
            ty = fy + ny * py
            tz = fz + nz * pz
            i = (x & 7) << 6 | (y & 7) << 3 | (z & 7)
            c = (x >> 3 & 15) << 8 | (y >> 3 & 15) << 4 | (z >> 3 & 15)
            bx = tx + _ahead(x, sx, 7) * px
            by = ty + _ahead(y, sy, 7) * py
            bz = tz + _ahead(z, sz, 7) * pz
            here = True  # i, tx, ty and tz are valid for this block
            while True:  # blocks
                limit = min(min(bx, by), min(bz, until))
                block = children[row, c]
                if block:
                    if not here:
                        nx = _passed(time, fx, px)
                        ny = _passed(time, fy, py)
                        nz = _passed(time, fz, pz)
                        tx = fx + nx * px
                        ty = fy + ny * py
                        tz = fz + nz * pz
                        i = (kx + sx * nx & 7) << 6 | (ky + sy * ny & 7) << 3 | (kz + sz * nz & 7)
                        here = True
                    slot, used = slot_of_block(slots, owners, masks, used, block - 1)
                    t = min(tx, min(ty, tz))
                    while (
                        t < limit
                    ):  # voxels; without branches, since the order of axes cannot be predicted
                        masks[slot, i >> 6] |= np.int64(1) << (i & 63)
                        gx = t == tx
                        gy = t == ty
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
                    c = c + (sx << 8)
                    bx = bx + (px << 3)
                    tx = tx + px
                    i = i ^ 7 << 6
                elif limit == by:
                    c = c + (sy << 4)
                    by = by + (py << 3)
                    ty = ty + py
                    i = i ^ 7 << 3
                else:
                    c = c + sz
                    bz = bz + (pz << 3)
                    tz = tz + pz
                    i = i ^ 7
        if until == END:
            return used
        time = until
        if until == ux:
            j = j + sx * shape[1] * shape[2]
            ux = ux + (px << 7)
        elif until == uy:
            j = j + sy * shape[2]
            uy = uy + (py << 7)
        else:
            j = j + sz
            uz = uz + (pz << 7)


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


@njit(cache=True, nogil=True, inline="always")
def _mark(at, bits, touched):
    """Mark the voxel at an address."""
    block = at >> NINE
    bits[block, at >> SIX & SEVEN] |= ONE_BIT << (at & LAST)
    touched[block] = True


@njit(cache=True, nogil=True, inline="always")
def _moved(at, axis, step):
    """The address one voxel along an axis, given by the bits of its indices.

    The carry passes through the other bits, which are set (dilated integers, Raman and Wise 2008).
    """
    return ((at | ~axis) + step) & axis | at & ~axis


@njit(cache=True, nogil=True)
def _walk_near(along_x, along_y, along_z, until, bits, touched):
    """Mark the voxels of a ray up to a time, except that of its end, at their addresses."""
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
        while t < limit:  # without branches, since the order of a and b cannot be predicted
            _mark(at, bits, touched)
            first = ta < tb
            axis = a if first else b
            step = da if first else db
            ta += pa if first else 0
            tb += 0 if first else pb
            at = _moved(at, axis, step)
            t = min(ta, tb)
        if limit < END:
            _mark(at, bits, touched)
        if limit == until:
            break
        at = _moved(at, c, dc)
        tc += pc


@njit(cache=True, nogil=True, inline="always")
def _index(n, positions, middle):
    """Index along an axis, from the world's origin, of block n of the addresses around block
    ``middle``.
    """
    index = np.int64(0)
    half = np.int64(1) << len(positions) - 1
    for bit in range(len(positions)):
        index |= (n >> positions[bit] & 1) << bit
    return middle + ((index - middle + half) & (2 * half - 1)) - half


@njit(cache=True, nogil=True, inline="always")
def _until(e, axes, centre):
    """The time until which a ray stays where addresses around a voxel are unique.

    ``START`` if it starts elsewhere.
    """
    until = np.int64(END)
    for axis in range(3):
        k, _, first, period = axes[axis]
        borders = NEAR[axis] - abs(k - centre[axis])
        if borders <= 0:
            return np.int64(START)
        if (
            abs(np.int64(math.floor(e[axis])) - centre[axis]) >= NEAR[axis]
            and borders <= (END - first) // period
        ):
            until = min(until, first + borders * period)
    return until


@njit(cache=True, nogil=True)
def _mark_lane(
    lane, points, origins, begins, hits, per_metre, base, shape, top, children, slots, owners,
    masks, used, centre,
    bits, touched,
):  # fmt: skip
    """Mark the voxels of one lane's rays; see ``mark``.

    Returns the number of blocks that it touched.
    """
    n = len(points)
    several = len(origins) > 1
    count = np.int64(0)
    for chunk in range(lane * CHUNK, n, len(used) * CHUNK):
        for p in range(chunk, min(chunk + CHUNK, n)):
            q = p if several else 0
            e = (points[p, 0] * per_metre, points[p, 1] * per_metre, points[p, 2] * per_metre)
            if not _inside(e, base, shape):
                continue
            o = (origins[q, 0] * per_metre, origins[q, 1] * per_metre, origins[q, 2] * per_metre)
            if begins[p] > 0:
                o = (
                    o[0] + begins[p] * (e[0] - o[0]),
                    o[1] + begins[p] * (e[1] - o[1]),
                    o[2] + begins[p] * (e[2] - o[2]),
                )
            if begins[p] < 1 and _inside(o, base, shape):
                x = _axis(o[0], e[0], 2)
                y = _axis(o[1], e[1], 1)
                z = _axis(o[2], e[2], 0)
                until = _until(e, (x, y, z), centre) if len(touched) else np.int64(START)
                if until > START:
                    _walk_near(x, y, z, until, bits, touched)
                if until < END:
                    count = _walk(
                        x, y, z, until, base, shape, top, children, slots, owners, masks, count
                    )
            if hits[p]:
                x = np.int64(math.floor(e[0])) - (base[0] << 7)
                y = np.int64(math.floor(e[1])) - (base[1] << 7)
                z = np.int64(math.floor(e[2])) - (base[2] << 7)
                row = top[((x >> 7) * shape[1] + (y >> 7)) * shape[2] + (z >> 7)]
                block = children[row, (x >> 3 & 15) << 8 | (y >> 3 & 15) << 4 | (z >> 3 & 15)]
                if block:
                    slot, count = slot_of_block(slots, owners, masks, count, block - 1)
                    masks[slot, 8 + (x & 7)] |= np.int64(1) << ((y & 7) << 3 | (z & 7))
    return count


@njit(cache=True, nogil=True, parallel=True)
def mark(
    points, origins, begins, hits, per_metre, base, shape, top, children, slots, owners, masks,
    used, centre, bits,
    touched,
):  # fmt: skip
    """Mark crossed and hit voxels in scratch memory, each lane in its own; see ``collect``.

    Args:
        points: (N, 3) float32, metres, world frame: ends of the rays.
        origins: (N or 1, 3) float64, metres, world frame: origins of the rays.
        begins: (N,) float32: share of the way to its end where each ray begins, 0 for the origin; 1
            for none.
        hits: (N,) bool: whether the end counts as a hit.
        per_metre: voxels per metre.
        base, shape, top, children: the grid's directory.
        slots, owners, masks, used: the grid's scratch memory.
        centre: (3,) int64, voxel around which addresses are unique.
        bits, touched: scratch memory for addresses (``addresses.memory``); without blocks, only the
            directory is used.
    """
    for lane in prange(len(used)):
        used[lane] = _mark_lane(
            np.int64(lane), points, origins, begins, hits, per_metre, base, shape, top, children,
            slots[lane],
            owners[lane], masks[lane], used, centre, bits[lane], touched[lane],
        )  # fmt: skip


@njit(cache=True, nogil=True, parallel=True)
def gather(base, shape, top, children, slots, owners, masks, used, centre, bits, touched):
    """Move the marks at addresses to the blocks that exist, each lane its own, and reset the memory
    for addresses.

    Arguments are those of ``mark``.
    """
    for lane in prange(len(used)):
        count = used[lane]
        for n in range(touched.shape[1]):
            if not touched[lane, n]:
                continue
            touched[lane, n] = False
            x = _index(n, IN_X, centre[0] >> 3) - (base[0] << 4)
            y = _index(n, IN_Y, centre[1] >> 3) - (base[1] << 4)
            z = _index(n, IN_Z, centre[2] >> 3) - (base[2] << 4)
            jx = x >> 4
            jy = y >> 4
            jz = z >> 4
            if 0 <= jx < shape[0] and 0 <= jy < shape[1] and 0 <= jz < shape[2]:
                row = top[(jx * shape[1] + jy) * shape[2] + jz]
                block = children[row, (x & 15) << 8 | (y & 15) << 4 | (z & 15)]
                if block:
                    slot, count = slot_of_block(
                        slots[lane], owners[lane], masks[lane], count, block - 1
                    )
                    for w in range(8):
                        masks[lane, slot, w] |= np.int64(bits[lane, n, w])
            bits[lane, n] = 0
        used[lane] = count


@njit(cache=True, nogil=True)
def collect(slots, owners, masks, used):
    """Merge the lanes, and reset the scratch memory.

    Returns:
        (B,) int32: numbers of the touched blocks.
        (B, 16) int64: bits of their crossed voxels (words 0 to 7) and hit voxels (words 8 to 15).
    """
    most = used.sum()
    blocks = np.empty(most, np.int32)
    bits = np.empty((most, 16), np.int64)
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

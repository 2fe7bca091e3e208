"""Conservative free space.

Voxels that rays pass through in enough consecutive scans, and whose neighbours are so too.

A voxel is block * 512 + index in the block. Bits are (B, 8) uint64: bit v of word w is voxel 64 w +
v of a block. ``neighbours`` (B, 27) are the numbers of the blocks around each block, itself at 13,
x slowest; -1 if absent.
"""

import math

import numpy as np
from numba import njit, prange

REACH = 1 << 15  # voxels to each side of the world's origin
CHUNK = 128  # rays that a lane processes in turn, for load balance
ONE = np.uint64(1)
FULL = np.uint64(0xFFFFFFFFFFFFFFFF)


@njit(cache=True, nogil=True, inline="always")
def _holds(bits, voxel):
    return bits[voxel >> 9, voxel >> 6 & 7] >> np.uint64(voxel & 63) & ONE


@njit(cache=True, nogil=True, inline="always")
def _beside(voxel, k, neighbours):
    """The k-th of the 27 voxels around a voxel, itself at 13; -1 if the grid has no block there."""
    block = voxel >> 9
    place = voxel & 511
    x = (place >> 6) + k // 9 - 1
    y = (place >> 3 & 7) + k // 3 % 3 - 1
    z = (place & 7) + k % 3 - 1
    side = ((x >> 3) + 1) * 9 + ((y >> 3) + 1) * 3 + (z >> 3) + 1
    if side != 13:
        block = np.int64(neighbours[block, side])
        if block < 0:
            return np.int64(-1)
    return block << 9 | (x & 7) << 6 | (y & 7) << 3 | (z & 7)


@njit(cache=True, nogil=True)
def place(points, origin, ranges, heights, per_metre, base, shape, top, children):
    """(N,) int64: voxel of each point within range; -1 beyond the grid, -2 out of range.

    Args:
        points: (N, 3) float32, metres, world frame.
        origin: (3,) float64, metres.
        ranges, heights: (2,) float64, metres: limits of the range and of the height above the
            origin, both included.
        per_metre: voxels per metre.
        base, shape, top, children: the grid's directory.
    """
    found = np.full(len(points), np.int64(-1))
    for i in range(len(points)):
        px = np.float64(points[i, 0])
        py = np.float64(points[i, 1])
        pz = np.float64(points[i, 2])
        fx = px * per_metre
        fy = py * per_metre
        fz = pz * per_metre
        if not (abs(fx) < REACH and abs(fy) < REACH and abs(fz) < REACH):  # also where not finite
            continue
        squared = (px - origin[0]) ** 2 + (py - origin[1]) ** 2 + (pz - origin[2]) ** 2
        if not (
            ranges[0] ** 2 <= squared <= ranges[1] ** 2
            and heights[0] <= pz - origin[2] <= heights[1]
        ):
            found[i] = -2
            continue
        x = np.int64(math.floor(fx)) - (base[0] << 7)
        y = np.int64(math.floor(fy)) - (base[1] << 7)
        z = np.int64(math.floor(fz)) - (base[2] << 7)
        jx = x >> 7
        jy = y >> 7
        jz = z >> 7
        if not (0 <= jx < shape[0] and 0 <= jy < shape[1] and 0 <= jz < shape[2]):
            continue
        row = top[(jx * shape[1] + jy) * shape[2] + jz]
        block = children[row, (x >> 3 & 15) << 8 | (y >> 3 & 15) << 4 | (z >> 3 & 15)]
        if block:
            found[i] = np.int64(block - 1) << 9 | (x & 7) << 6 | (y & 7) << 3 | (z & 7)
    return found


@njit(cache=True, nogil=True)
def centres(points, voxels, ranks, count):
    """(count, 3) float64, metres.

    Mean of the points of each voxel, updated point by point in their order.

    Args:
        points: (N, 3) float32, metres; voxels: (N,) int64, negative for none.
        ranks: (B * 512,) int32, number of each voxel.
    """
    means = np.zeros((count, 3))
    n = np.zeros(count, np.int64)
    for i in range(len(points)):
        if voxels[i] >= 0:
            r = ranks[voxels[i]]
            n[r] += 1
            for axis in range(3):
                means[r, axis] += (points[i, axis] - means[r, axis]) / n[r]
    return means


@njit(cache=True, nogil=True)
def hit(voxels, limit, recorded, free, free_count, hit_count, revoked, neighbours, levels):
    """Count a hit of each occupied voxel, set level 3 where it was free, and revoke what is hit too
    often.

    Args:
        voxels: (N,) int64, occupied voxels.
        limit: consecutive hits after which a voxel is no longer free.
        recorded: (B,) bool, blocks that a ray has passed.
        free, revoked: (B, 8) uint64, bits. Modified.
        free_count, hit_count: (B, 512) int32. Modified.
        levels: (N,) uint8. Modified.
    """
    lost = np.empty(len(voxels), np.int64)
    n = 0
    for i in range(len(voxels)):
        b = voxels[i] >> 9
        v = voxels[i] & 511
        if not recorded[b]:
            continue
        hit_count[b, v] += 1
        free_count[b, v] = 0
        if _holds(free, voxels[i]):
            levels[i] = 3
        if hit_count[b, v] >= limit:
            lost[n] = voxels[i]
            n += 1
    for i in range(n):
        for k in range(27):
            other = _beside(lost[i], k, neighbours)
            if other >= 0:
                bit = ONE << np.uint64(other & 63)
                if free[other >> 9, other >> 6 & 7] & bit:
                    revoked[other >> 9, other >> 6 & 7] |= bit
                free[other >> 9, other >> 6 & 7] &= ~bit
    return lost[:n].copy()


@njit(cache=True, nogil=True)
def grow(voxels, ranks, occupied, neighbours, levels):
    """Grow level 3 over occupied voxels: one step to level 2, two more to level 1."""
    for step in range(3):
        before = levels.copy()
        for i in range(len(voxels)):
            if before[i] == 0:
                continue
            if step == 0 and before[i] != 3:
                continue
            for k in range(27):
                other = _beside(voxels[i], k, neighbours)
                if other >= 0 and _holds(occupied, other) and levels[ranks[other]] == 0:
                    levels[ranks[other]] = 2 if step == 0 else 1


@njit(cache=True, nogil=True, inline="always")
def _axis(o, u, size, port):
    """First voxel, step, parameter of the first border and period along one axis.

    The ray's parameter ends at 1.
    """
    k = np.int64(math.floor(o * (1.0 / size)))
    if u == 0.0:
        return k, np.int64(0), 1.0, 1.0
    period = size / abs(u)
    first = -np.fmod(o, size) / u
    if first < 0.0 or (first == 0.0 and u > 0.0 and not port):
        first += period
    return k, np.int64(1 if u > 0 else -1), first, period


@njit(cache=True, nogil=True)
def _walk(o, e, size, port, occupied, base, shape, top, children, bits, touched, order):
    """Mark the voxels from o to the last one before e, or before the first occupied one."""
    ux = e[0] - o[0]
    uy = e[1] - o[1]
    uz = e[2] - o[2]
    x, sx, tx, px = _axis(o[0], ux, size, port)
    y, sy, ty, py = _axis(o[1], uy, size, port)
    z, sz, tz, pz = _axis(o[2], uz, size, port)
    x = x - (base[0] << 7)
    y = y - (base[1] << 7)
    z = z - (base[2] << 7)
    bx = by = bz = np.int64(-1 << 40)
    block = np.int32(0)
    while True:
        if bx != x >> 3 or by != y >> 3 or bz != z >> 3:
            bx = x >> 3
            by = y >> 3
            bz = z >> 3
            jx = bx >> 4
            jy = by >> 4
            jz = bz >> 4
            block = np.int32(0)
            if 0 <= jx < shape[0] and 0 <= jy < shape[1] and 0 <= jz < shape[2]:
                row = top[(jx * shape[1] + jy) * shape[2] + jz]
                block = children[row, (bx & 15) << 8 | (by & 15) << 4 | (bz & 15)]
        if block:
            bit = ONE << np.uint64((y & 7) << 3 | (z & 7))
            if occupied[block - 1, x & 7] & bit:
                return
            if not touched[block - 1]:
                touched[block - 1] = True
                order[0] += 1
                order[order[0]] = block - 1
            bits[block - 1, x & 7] |= bit
        if tx < ty and tx < tz:
            x = x + sx
            tx = tx + px
        elif ty < tz:
            y = y + sy
            ty = ty + py
        else:
            z = z + sz
            tz = tz + pz
        if not (tx < 1.0 or ty < 1.0 or tz < 1.0):
            return


@njit(cache=True, nogil=True, parallel=True)
def cast(
    targets,
    origin,
    reach,
    heights,
    size,
    port,
    occupied,
    base,
    shape,
    top,
    children,
    bits,
    touched,
    order,
):
    """Mark the voxels of rays, each lane in its own memory.

    See ``integer_lines.collect`` and ``merge``.

    Args:
        targets: (N, 3) float64, metres; origin: (3,) float64, metres.
        reach: longest ray, metres; heights: (2,) float64, lowest and highest end above the origin,
            metres.
        size: edge of a voxel, metres; port: start as the public program does on a border of voxels.
        occupied: (B, 8) uint64, voxels that stop a ray.
        base, shape, top, children: the grid's directory.
        bits: (lanes, B, 8) uint64; touched: (lanes, B) bool; order: (lanes, 1 + B) int32. Modified.
    """
    n = len(targets)
    for lane in prange(len(bits)):
        mine = bits[lane]
        flags = touched[lane]
        own = order[lane]
        for chunk in range(lane * CHUNK, n, len(bits) * CHUNK):
            for i in range(chunk, min(chunk + CHUNK, n)):
                ux = targets[i, 0] - origin[0]
                uy = targets[i, 1] - origin[1]
                uz = targets[i, 2] - origin[2]
                squared = ux * ux + uy * uy + uz * uz
                e = (targets[i, 0], targets[i, 1], targets[i, 2])
                if not (squared <= reach * reach and heights[0] < uz < heights[1]):
                    share = 1.0
                    if uz > 0:
                        share = heights[1] / uz
                    elif uz < 0:
                        share = heights[0] / uz
                    share = min(reach / math.sqrt(squared), share)
                    e = (origin[0] + ux * share, origin[1] + uy * share, origin[2] + uz * share)
                o = (origin[0], origin[1], origin[2])
                _walk(o, e, size, port, occupied, base, shape, top, children, mine, flags, own)


@njit(cache=True, nogil=True, parallel=True)
def count(
    blocks, crossed, needed, port, recorded, free, free_count, hit_count, seen, often, candidates
):
    """Count the voxels that rays crossed in a scan.

    Args:
        blocks: (K,) int32; crossed: (K, 8) uint64, bits of the crossed voxels in them.
        needed: scans in a row after which a voxel is a candidate.
        port: skip blocks that are free entirely, as the public program does.
        seen, often: (B, 8) uint64, voxels ever crossed, and ever crossed often enough. Modified.
        candidates: (K, 8) uint64. Set to the bits of voxels that are not free yet but crossed often
            enough.
    """
    for n in prange(len(blocks)):
        b = blocks[n]
        recorded[b] = True
        whole = True
        for w in range(8):
            seen[b, w] |= crossed[n, w]
            candidates[n, w] = 0
            whole &= free[b, w] == FULL
        if whole and port:
            continue
        for w in range(8):
            word = crossed[n, w]
            if word:
                for j in range(64):
                    bit = ONE << np.uint64(j)
                    if word & bit:
                        v = w << 6 | j
                        free_count[b, v] += 1
                        hit_count[b, v] = 0
                        if free_count[b, v] >= needed:
                            often[b, w] |= bit
                            if not free[b, w] & bit:
                                candidates[n, w] |= bit


@njit(cache=True, nogil=True)
def release(candidates, needed, neighbours, recorded, free, free_count, revoked):
    """Set candidates (N,) int64 free whose 26 neighbours were crossed often enough.

    Return (M,) int64, those.
    """
    found = np.empty(len(candidates), np.int64)
    n = 0
    for voxel in candidates:
        clear = True
        for k in range(27):
            other = _beside(voxel, k, neighbours)
            if (
                other < 0
                or not recorded[other >> 9]
                or free_count[other >> 9, other & 511] < needed
            ):
                clear = False
                break
        if clear:
            found[n] = voxel
            n += 1
    for i in range(n):
        bit = ONE << np.uint64(found[i] & 63)
        free[found[i] >> 9, found[i] >> 6 & 7] |= bit
        revoked[found[i] >> 9, found[i] >> 6 & 7] &= ~bit
    return found[:n].copy()

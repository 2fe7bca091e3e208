"""Voxels of points and integer lines through a block grid.

An integer line (Bresenham in three dimensions, driven by the longest axis) joins two voxels by
steps to one of 26 neighbours. Bit v of word w is voxel 64 w + v of a block.
"""

import math

import numpy as np
from numba import njit, prange

REACH = 1 << 15  # voxels to each side of the world's origin
CHUNK = 256  # lines that a lane processes in turn, for load balance
ONE = np.uint64(1)


@njit(cache=True, nogil=True)
def locate(points, size, truncate, base, shape, top, children):
    """(N,) int64: voxel of each point, block number * 512 + index in the block.

    -1 if the grid has no block there.

    Args:
        points: (N, 3), metres, world frame.
        size: edge of a voxel, metres.
        truncate: round indices towards zero instead of down.
        base, shape, top, children: the grid's directory.
    """
    found = np.full(len(points), np.int64(-1))
    for i in range(len(points)):
        fx = points[i, 0] / size
        fy = points[i, 1] / size
        fz = points[i, 2] / size
        if not (abs(fx) < REACH and abs(fy) < REACH and abs(fz) < REACH):  # also where not finite
            continue
        if truncate:
            fx = math.trunc(fx)
            fy = math.trunc(fy)
            fz = math.trunc(fz)
        x = np.int64(math.floor(fx)) - (base[0] << 7)
        y = np.int64(math.floor(fy)) - (base[1] << 7)
        z = np.int64(math.floor(fz)) - (base[2] << 7)
        jx = x >> 7
        jy = y >> 7
        jz = z >> 7
        if not (0 <= jx < shape[0] and 0 <= jy < shape[1] and 0 <= jz < shape[2]):
            continue
        row = top[(jx * shape[1] + jy) * shape[2] + jz]
        # row 0 is empty
        block = children[row, (x >> 3 & 15) << 8 | (y >> 3 & 15) << 4 | (z >> 3 & 15)]
        if block:
            found[i] = np.int64(block - 1) << 9 | (x & 7) << 6 | (y & 7) << 3 | (z & 7)
    return found


@njit(cache=True, nogil=True)
def squared_ranges(points, origin):
    """(N,) float64, square metres.

    Squared range of points (N, 3) from an origin (3,), in double precision.
    """
    squared = np.zeros(len(points))
    for i in range(len(points)):
        for axis in range(3):
            squared[i] += (points[i, axis] - origin[axis]) ** 2
    return squared


@njit(cache=True, nogil=True, inline="always")
def _step(k, rest, length, most, direction):
    """The next index along one axis, and the rest of its error term.

    Without branches, which cannot be predicted.
    """
    rest -= length
    over = rest >> 63  # -1 if the axis takes a step, else 0
    return k + (direction & over), rest + (most & over)


@njit(cache=True, nogil=True)
def _line(s, e, farthest, shape, top, children, bits, touched, order):
    """Mark the voxels of the line from s to e, both included, within ``farthest`` voxels of s.

    Relative to the grid.
    """
    dx = abs(e[0] - s[0])
    dy = abs(e[1] - s[1])
    dz = abs(e[2] - s[2])
    gx = 1 if s[0] < e[0] else -1
    gy = 1 if s[1] < e[1] else -1
    gz = 1 if s[2] < e[2] else -1
    most = max(dx, max(dy, dz))
    rx = ry = rz = most >> 1
    x, y, z = s
    ends_far = dx * dx + dy * dy + dz * dz > farthest
    bx = x >> 3
    by = y >> 3
    bz = z >> 3
    block = np.int32(-1)  # unknown
    for _ in range(most + 1):
        if ends_far and (x - s[0]) ** 2 + (y - s[1]) ** 2 + (z - s[2]) ** 2 > farthest:
            return
        if block < 0 or bx != x >> 3 or by != y >> 3 or bz != z >> 3:
            bx = x >> 3
            by = y >> 3
            bz = z >> 3
            row = top[((bx >> 4) * shape[1] + (by >> 4)) * shape[2] + (bz >> 4)]
            block = children[row, (bx & 15) << 8 | (by & 15) << 4 | (bz & 15)]
            if block and not touched[block - 1]:
                touched[block - 1] = True
                order[0] += 1
                order[order[0]] = block - 1
        if block:
            bits[block - 1, x & 7] |= ONE << np.uint64((y & 7) << 3 | (z & 7))
        x, rx = _step(x, rx, dx, most, gx)
        y, ry = _step(y, ry, dy, most, gy)
        z, rz = _step(z, rz, dz, most, gz)


@njit(cache=True, nogil=True, parallel=True)
def cast(goals, blocks, start, farthest, base, shape, top, children, bits, touched, order):
    """Mark the voxels of lines from one voxel to others, where the grid has blocks.

    Each lane in its own memory.

    Args:
        goals: (N,) int64, voxels in which lines end.
        blocks: (B, 3), indices of the grid's blocks from the world's origin.
        start: (3,) int64, index of the voxel in which all lines start.
        farthest: lines end at this squared distance from ``start``, square voxels.
        base, shape, top, children: the grid's directory.
        bits: (lanes, B, 8) uint64. Modified.
        touched: (lanes, B) bool, blocks in which a lane marked a voxel. Modified.
        order: (lanes, 1 + B) int32, the number of these blocks, and the blocks, in any order.
            Modified.
    """
    n = len(goals)
    s = (start[0] - (base[0] << 7), start[1] - (base[1] << 7), start[2] - (base[2] << 7))
    inside = 0 <= s[0] < shape[0] << 7 and 0 <= s[1] < shape[1] << 7 and 0 <= s[2] < shape[2] << 7
    for lane in prange(len(bits)):
        mine = bits[lane]
        flags = touched[lane]
        own = order[lane]
        for chunk in range(lane * CHUNK, n if inside else 0, len(bits) * CHUNK):
            for i in range(chunk, min(chunk + CHUNK, n)):
                block = goals[i] >> 9
                place = goals[i] & 511
                x = (np.int64(blocks[block, 0]) << 3 | place >> 6) - (base[0] << 7)
                y = (np.int64(blocks[block, 1]) << 3 | (place >> 3 & 7)) - (base[1] << 7)
                z = (np.int64(blocks[block, 2]) << 3 | (place & 7)) - (base[2] << 7)
                _line(s, (x, y, z), farthest, shape, top, children, mine, flags, own)

"""The directory of a block grid: super-blocks of 16^3 blocks of 8^3 voxels, present only where points lie.

``top`` is dense over the bounds, one int32 a super-block: 0 where empty, else the row of ``children``. A row of
``children`` holds for each of its 4096 blocks 0, or the block's number plus one. Zeros cost no memory until written.
"""

import math

import numpy as np
from numba import njit

REACH = 1 << 15  # voxels to each side of the world's origin, as in OctoMap's keys of 16 bit


@njit(cache=True, nogil=True)
def directory(blocks, base, shape):
    """Number the blocks (B, 3), indices from the world's origin, in their order; base: first super-block."""
    top = np.zeros(shape[0] * shape[1] * shape[2], np.int32)
    rows = 1
    for n in range(len(blocks)):
        x, y, z = blocks[n, 0] - (base[0] << 4), blocks[n, 1] - (base[1] << 4), blocks[n, 2] - (base[2] << 4)
        j = ((x >> 4) * shape[1] + (y >> 4)) * shape[2] + (z >> 4)
        if top[j] == 0:
            top[j] = rows
            rows += 1
    children = np.zeros((rows, 4096), np.int32)
    for n in range(len(blocks)):
        x, y, z = blocks[n, 0] - (base[0] << 4), blocks[n, 1] - (base[1] << 4), blocks[n, 2] - (base[2] << 4)
        j = ((x >> 4) * shape[1] + (y >> 4)) * shape[2] + (z >> 4)
        children[top[j], (x & 15) << 8 | (y & 15) << 4 | (z & 15)] = n + 1
    return top, children


@njit(cache=True, nogil=True)
def voxels_of(blocks, bits):
    """Voxels whose bit is set; bits (B, 8), bit v of word w is voxel 64 w + v of its block."""
    count = 0
    for n in range(len(blocks)):
        for w in range(8):
            word = bits[n, w]
            while word:
                word &= word - 1
                count += 1
    voxels = np.empty(count, np.int64)
    count = 0
    for n in range(len(blocks)):
        for w in range(8):
            word, first = bits[n, w], np.int64(blocks[n]) << 9 | w << 6
            if word:
                for v in range(64):
                    if word >> v & 1:
                        voxels[count] = first | v
                        count += 1
    return voxels


@njit(cache=True, nogil=True)
def keys_of(voxels, blocks):
    """Indices (N, 3) from the world's origin of voxels, of the grid's blocks (B, 3)."""
    keys = np.empty((len(voxels), 3), np.int32)
    for i in range(len(voxels)):
        block, place = voxels[i] >> 9, voxels[i] & 511
        keys[i, 0] = blocks[block, 0] << 3 | place >> 6
        keys[i, 1] = blocks[block, 1] << 3 | (place >> 3 & 7)
        keys[i, 2] = blocks[block, 2] << 3 | (place & 7)
    return keys


@njit(cache=True, nogil=True)
def locate(points, per_metre, base, shape, top, children):
    """Voxel of each point: block number * 512 + place in the block; -1 where the grid has no block."""
    found = np.full(len(points), np.int64(-1))
    for i in range(len(points)):
        fx, fy, fz = points[i, 0] * per_metre, points[i, 1] * per_metre, points[i, 2] * per_metre
        if not (abs(fx) < REACH and abs(fy) < REACH and abs(fz) < REACH):  # also where not finite
            continue
        x = np.int64(math.floor(fx)) - (base[0] << 7)
        y = np.int64(math.floor(fy)) - (base[1] << 7)
        z = np.int64(math.floor(fz)) - (base[2] << 7)
        jx, jy, jz = x >> 7, y >> 7, z >> 7
        if not (0 <= jx < shape[0] and 0 <= jy < shape[1] and 0 <= jz < shape[2]):
            continue
        row = top[(jx * shape[1] + jy) * shape[2] + jz]
        block = children[row, (x >> 3 & 15) << 8 | (y >> 3 & 15) << 4 | (z >> 3 & 15)]  # row 0 is empty
        if block:
            found[i] = np.int64(block - 1) << 9 | (x & 7) << 6 | (y & 7) << 3 | (z & 7)
    return found


@njit(cache=True, nogil=True)
def read(voxels, bits):
    """(N,) bool: whether the bits of voxels are set, in (B, 8 or more) uint64; never for -1."""
    found = np.zeros(len(voxels), np.bool_)
    for i in range(len(voxels)):
        if voxels[i] >= 0:
            found[i] = bits[voxels[i] >> 9, voxels[i] >> 6 & 7] >> np.uint64(voxels[i] & 63) & np.uint64(1)
    return found

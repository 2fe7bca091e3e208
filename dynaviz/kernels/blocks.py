"""The directory of a block grid.

Super-blocks of 16^3 blocks of 8^3 voxels, allocated only where points lie.

``top`` is dense over the bounds, with one int32 per super-block: 0 if empty, else its row in
``children``. Each row of ``children`` has 4096 entries, one per block: 0 if absent, else the
block's number plus one. Zeros take no memory until written.
"""

import math

import numpy as np
from numba import njit, prange

REACH = 1 << 15  # voxels to each side of the world's origin, as in OctoMap's keys of 16 bit
# de Bruijn: its 64 windows of 6 bits differ, which numbers single bits
SEQUENCE = np.uint64(0x03F79D71B4CB0A89)
BIT_OF = np.argsort([((int(SEQUENCE) << v) % (1 << 64)) >> 58 for v in range(64)])


@njit(cache=True, nogil=True)
def voxels_of(blocks, bits):
    """(N,) int64: voxels whose bit is set.

    Args:
        blocks: (B,) int32, numbers of the blocks.
        bits: (B, 8), 64-bit words; bit v of word w is voxel 64 w + v of its block.
    """
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
            word = np.uint64(bits[n, w])
            first = np.int64(blocks[n]) << 9 | w << 6
            while word:
                rest = word & (word - np.uint64(1))
                voxels[count] = first | BIT_OF[(word ^ rest) * SEQUENCE >> np.uint64(58)]
                count += 1
                word = rest
    return voxels


@njit(cache=True, nogil=True, inline="always")
def _key(voxel, blocks):
    """The indices of a voxel from the world's origin; blocks.

    (B, 3), indices of the grid's blocks.
    """
    block = voxel >> 9
    place = voxel & 511
    x = place >> 6
    y = place >> 3 & 7
    z = place & 7
    return blocks[block, 0] << 3 | x, blocks[block, 1] << 3 | y, blocks[block, 2] << 3 | z


@njit(cache=True, nogil=True)
def keys_of(voxels, blocks):
    """(N, 3) int32: indices of voxels (N,) from the world's origin; blocks.

    (B, 3), indices of the grid's blocks.
    """
    keys = np.empty((len(voxels), 3), np.int32)
    for i in range(len(voxels)):
        keys[i, 0], keys[i, 1], keys[i, 2] = _key(voxels[i], blocks)
    return keys


@njit(cache=True, nogil=True)
def centres_of(voxels, blocks, resolution):
    """(N, 3) float32, metres: centres of voxels (N,) int64; blocks.

    (B, 3), indices of the grid's blocks.
    """
    centres = np.empty((len(voxels), 3), np.float32)
    for i in range(len(voxels)):
        x, y, z = _key(voxels[i], blocks)
        centres[i, 0] = (x + 0.5) * resolution
        centres[i, 1] = (y + 0.5) * resolution
        centres[i, 2] = (z + 0.5) * resolution
    return centres


@njit(cache=True, nogil=True, parallel=True)
def locate(points, per_metre, base, shape, top, children):
    """(N,) int64: voxel of each point, block number * 512 + index in the block.

    -1 if the grid has no block there.

    Args:
        points: (N, 3), metres, world frame.
        per_metre: voxels per metre.
        base, shape, top, children: the directory.
    """
    found = np.full(len(points), np.int64(-1))
    for i in prange(len(points)):
        fx = points[i, 0] * per_metre
        fy = points[i, 1] * per_metre
        fz = points[i, 2] * per_metre
        if not (abs(fx) < REACH and abs(fy) < REACH and abs(fz) < REACH):  # also where not finite
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
        # row 0 is empty
        block = children[row, (x >> 3 & 15) << 8 | (y >> 3 & 15) << 4 | (z >> 3 & 15)]
        if block:
            found[i] = np.int64(block - 1) << 9 | (x & 7) << 6 | (y & 7) << 3 | (z & 7)
    return found


@njit(cache=True, nogil=True)
def read(voxels, bits):
    """(N,) bool: whether the bits of voxels (N,) are set in words (B, 8 or more); False for -1."""
    found = np.zeros(len(voxels), np.bool_)
    for i in range(len(voxels)):
        if voxels[i] >= 0:
            found[i] = bits[voxels[i] >> 9, voxels[i] >> 6 & 7] >> np.uint64(
                voxels[i] & 63
            ) & np.uint64(1)
    return found

"""The ground under a map: where each column of blocks is densest near its lowest points, and a surface below that.

A column is 8 voxels a side, as blocks are; a layer is one voxel high. Blocks are sorted by x, y and z, so those of a
column follow each other.
"""

import numpy as np
from numba import njit, prange

LEAST = 3  # points that make a layer, and
SHARE = 0.03  # the share of their column's that they must be: reflections below the ground are fewer
RISE = 3  # layers above the first in which the ground is looked for


@njit(cache=True, nogil=True)
def add(voxels, points, number, height):
    """Add points (N, 3) in their voxels (N,) to the layers (B, 8): their number, and the sum of their heights in mm."""
    for i in range(len(voxels)):
        if voxels[i] >= 0:
            block, layer = voxels[i] >> 9, voxels[i] & 7
            number[block, layer] += 1
            height[block, layer] += np.int64(np.round(np.float64(points[i, 2]) * 1000.0))  # exact in any order


@njit(cache=True, nogil=True, parallel=True)
def floors(columns, starts, blocks, number, height, floor):
    """Set the floor (C,) of some columns: metres, infinite where a column has too few points.

    Args:
        columns: (K,) int64, which.
        starts: (C + 1,) int64, the first block of each column, and the end.
        blocks: (B, 3) int64, their keys.
        number, height: (B, 8), as ``add`` fills them.
    """
    for k in prange(len(columns)):
        c = columns[k]
        first, last = starts[c], starts[c + 1]
        total = number[first:last].sum()
        least = max(LEAST, int(SHARE * total))
        floor[c] = np.inf
        below, below_sum, below_at = np.int64(0), np.int64(0), np.int64(-(1 << 40))  # the layer under this one
        bottom, most = np.int64(1 << 40), np.int64(0)
        for b in range(first, last):
            for layer in range(8):
                at = np.int64(blocks[b, 2]) << 3 | layer
                n, total_height = np.int64(number[b, layer]), height[b, layer]
                if n == 0 and below_at != at - 1:
                    continue
                pair, pair_sum = n, total_height
                if below_at == at - 1:
                    pair, pair_sum = n + below, total_height + below_sum
                if pair >= least and bottom > at:
                    bottom = at
                if bottom <= at <= bottom + RISE and pair > most:
                    most = pair
                    floor[c] = pair_sum / (1000.0 * pair)
                below, below_sum, below_at = n, total_height, at
            if bottom + RISE < np.int64(blocks[b, 2]) << 3:
                break


@njit(cache=True, nogil=True, parallel=True)
def pits(surface, deep):
    """Cells (X, Y) that lie ``deep`` below more than three in four of the 5 x 5 around them, as reflections do."""
    rows, columns = surface.shape
    found = np.zeros(surface.shape, np.bool_)
    for x in prange(rows):
        for y in range(columns):
            around, level = 0, 0
            for i in range(max(x - 2, 0), min(x + 3, rows)):
                for j in range(max(y - 2, 0), min(y + 3, columns)):
                    if surface[i, j] < np.inf:
                        around += 1
                        level += surface[i, j] <= surface[x, y] + deep
            found[x, y] = 4 * level < around
    return found


@njit(cache=True, nogil=True)
def lower(surface, step):
    """Press a surface (X, Y) down, in place, until no cell is higher than one beside it by more than ``step``."""
    rows, columns = surface.shape
    slant = step * np.sqrt(2.0)
    for x in range(rows):
        for y in range(columns):
            z = surface[x, y]
            if x > 0:
                z = min(z, surface[x - 1, y] + step)
                if y > 0:
                    z = min(z, surface[x - 1, y - 1] + slant)
                if y < columns - 1:
                    z = min(z, surface[x - 1, y + 1] + slant)
            if y > 0:
                z = min(z, surface[x, y - 1] + step)
            surface[x, y] = z
    for x in range(rows - 1, -1, -1):
        for y in range(columns - 1, -1, -1):
            z = surface[x, y]
            if x < rows - 1:
                z = min(z, surface[x + 1, y] + step)
                if y > 0:
                    z = min(z, surface[x + 1, y - 1] + slant)
                if y < columns - 1:
                    z = min(z, surface[x + 1, y + 1] + slant)
            if y < columns - 1:
                z = min(z, surface[x, y + 1] + step)
            surface[x, y] = z


@njit(cache=True, nogil=True)
def spanned(voxels, column, columns):
    """The lowest and the highest key, (2, 2) int64, of the columns that hold voxels; the first above the last: none."""
    bounds = np.empty((2, 2), np.int64)
    bounds[0], bounds[1] = 1 << 40, -(1 << 40)
    for i in range(len(voxels)):
        if voxels[i] >= 0:
            c = column[voxels[i] >> 9]
            for axis in range(2):
                bounds[0, axis] = min(bounds[0, axis], columns[c, axis])
                bounds[1, axis] = max(bounds[1, axis], columns[c, axis])
    return bounds


@njit(cache=True, nogil=True)
def heights(points, voxels, column, columns, first, surface):
    """(N,) float32: how far points (N, 3) lie above a surface whose first cell is column ``first``.

    Infinite for -1, beside the surface, and where the surface is infinite.
    """
    found = np.full(len(voxels), np.float32(np.inf))
    for i in range(len(voxels)):
        if voxels[i] >= 0:
            c = column[voxels[i] >> 9]
            x, y = columns[c, 0] - first[0], columns[c, 1] - first[1]
            if 0 <= x < surface.shape[0] and 0 <= y < surface.shape[1] and surface[x, y] < np.inf:
                found[i] = points[i, 2] - surface[x, y]
    return found

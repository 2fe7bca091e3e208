"""Cells of a rolling window that rays reach, and the blocks of a grid that come and go with them.

The flags of cells lie in a cube of ``size``^3 bytes that wraps around: cell (x, y, z) is at the
remainders modulo its edge, a power of two. Cells farther apart than the edge never exist at the
same time.
"""

import math

import numpy as np
from numba import njit

PRESENT = np.uint8(1)
VISITED = np.uint8(2)
ENDED = np.uint8(4)


@njit(cache=True, nogil=True, inline="always")
def _at(x, y, z, mask):
    """Place of a cell in the flags."""
    return ((x & mask) * (mask + 1) + (y & mask)) * (mask + 1) + (z & mask)


@njit(cache=True, nogil=True, inline="always")
def _add_around(x, y, z, flags, mask, cells, count, reach):
    """Add a cell and those up to ``reach`` cells to each side.

    Returns the number of cells, at most ``len(cells)``.
    """
    for i in range(x - reach, x + reach + 1):
        for j in range(y - reach, y + reach + 1):
            for k in range(z - reach, z + reach + 1):
                at = _at(i, j, k, mask)
                if not flags[at] & PRESENT and count < len(cells):
                    flags[at] |= PRESENT
                    cells[count, 0] = i
                    cells[count, 1] = j
                    cells[count, 2] = k
                    count += 1
    return count


@njit(cache=True, nogil=True)
def visit(points, origins, reach, per_metre, around, flags, mask, cells, count):
    """Add the cells within ``around`` cells of those that rays cross, up to a distance from their
    origins.

    One ray per cell with points is followed, to the cell's centre, in steps of three quarters of a
    cell. Both ends of any other ray to that cell are within half a cell of it, so all of it lies
    within one cell of those visited.

    Args:
        points: (N, 3) float32, metres, world frame.
        origins: (N or 1, 3) float64, metres, world frame; finite.
        reach: rays are followed up to this length, metres.
        per_metre: cells per metre.
        around: at least 1, cells.
        flags: (size^3,) uint8. Modified.
        mask: size - 1.
        cells: (capacity, 3) int32: the cells that exist. Modified.
        count: number of cells that exist.

    Returns:
        int: the number of cells now.
    """
    several = len(origins) > 1
    ends = np.empty((len(points), 4), np.int64)
    n = 0
    for p in range(len(points)):
        q = p if several else 0
        dx = points[p, 0] - origins[q, 0]
        dy = points[p, 1] - origins[q, 1]
        dz = points[p, 2] - origins[q, 2]
        squared = dx * dx + dy * dy + dz * dz
        if not squared < np.inf:
            continue
        part = 1.0 if squared <= reach * reach else reach / math.sqrt(squared)
        x = np.int64(math.floor((origins[q, 0] + part * dx) * per_metre))
        y = np.int64(math.floor((origins[q, 1] + part * dy) * per_metre))
        z = np.int64(math.floor((origins[q, 2] + part * dz) * per_metre))
        at = _at(x, y, z, mask)
        if several or not flags[at] & ENDED:
            flags[at] |= ENDED
            ends[n, 0] = x
            ends[n, 1] = y
            ends[n, 2] = z
            ends[n, 3] = q
            n += 1
    for e in range(n):
        q = ends[e, 3]
        ox = origins[q, 0] * per_metre
        oy = origins[q, 1] * per_metre
        oz = origins[q, 2] * per_metre
        dx = ends[e, 0] + 0.5 - ox
        dy = ends[e, 1] + 0.5 - oy
        dz = ends[e, 2] + 0.5 - oz
        steps = math.ceil(max(abs(dx), abs(dy), abs(dz)) / 0.75) + 1
        for s in range(steps + 1):
            t = s / steps
            x = np.int64(math.floor(ox + t * dx))
            y = np.int64(math.floor(oy + t * dy))
            z = np.int64(math.floor(oz + t * dz))
            at = _at(x, y, z, mask)
            if not flags[at] & VISITED:
                flags[at] |= VISITED
                count = _add_around(x, y, z, flags, mask, cells, count, around)
        flags[_at(ends[e, 0], ends[e, 1], ends[e, 2], mask)] &= ~ENDED
    return count


@njit(cache=True, nogil=True)
def drop(centre, limit, inner, flags, mask, cells, count):
    """Drop the cells farther than ``limit`` from a centre, all in cells.

    Returns the number of the others.

    Cells farther than ``inner`` count as not visited, so that those dropped next to them return
    when rays do.
    """
    kept = 0
    for n in range(count):
        x = np.int64(cells[n, 0])
        y = np.int64(cells[n, 1])
        z = np.int64(cells[n, 2])
        dx = x + 0.5 - centre[0]
        dy = y + 0.5 - centre[1]
        dz = z + 0.5 - centre[2]
        squared = dx * dx + dy * dy + dz * dz
        at = _at(x, y, z, mask)
        if squared > limit * limit:
            flags[at] = 0
            continue
        if squared > inner * inner:
            flags[at] &= ~VISITED
        cells[kept, 0] = x
        cells[kept, 1] = y
        cells[kept, 2] = z
        kept += 1
    return kept


@njit(cache=True, nogil=True)
def add_blocks(blocks, base, shape, top, children, sizes, keys, free, free_children, left):
    """Add blocks to the directory of a grid (see ``kernels/blocks.py``), unless they exist.

    Args:
        blocks: (K, 3) int32, indices of blocks within the directory's bounds.
        base, shape, top, children: the directory. Modified.
        sizes: (rows of children,) int32, number of blocks in each. Modified.
        keys: (capacity, 3) int64, indices of the grid's blocks. Modified.
        free, free_children: numbers of blocks and rows of children that are free; the last is used
            next.
        left: (2,) int64, how many of these are left. Modified.

    Returns:
        (A,) int32: numbers of the added blocks; and whether there was room for all.
    """
    added = np.empty(len(blocks), np.int32)
    n = 0
    for k in range(len(blocks)):
        x = np.int64(blocks[k, 0]) - (base[0] << 4)
        y = np.int64(blocks[k, 1]) - (base[1] << 4)
        z = np.int64(blocks[k, 2]) - (base[2] << 4)
        j = ((x >> 4) * shape[1] + (y >> 4)) * shape[2] + (z >> 4)
        c = (x & 15) << 8 | (y & 15) << 4 | (z & 15)
        if top[j] and children[top[j], c]:
            continue
        if left[0] == 0 or (top[j] == 0 and left[1] == 0):
            return added[:n], False
        if top[j] == 0:
            left[1] -= 1
            top[j] = free_children[left[1]]
        left[0] -= 1
        block = free[left[0]]
        children[top[j], c] = block + 1
        sizes[top[j]] += 1
        keys[block, 0] = blocks[k, 0]
        keys[block, 1] = blocks[k, 1]
        keys[block, 2] = blocks[k, 2]
        added[n] = block
        n += 1
    return added[:n], True


@njit(cache=True, nogil=True)
def remove_blocks(blocks, base, shape, top, children, sizes, keys, free, free_children, left):
    """Remove blocks by their numbers (K,), which are not free yet.

    The other arguments are those of ``add_blocks``.
    """
    for k in range(len(blocks)):
        block = blocks[k]
        x = keys[block, 0] - (base[0] << 4)
        y = keys[block, 1] - (base[1] << 4)
        z = keys[block, 2] - (base[2] << 4)
        j = ((x >> 4) * shape[1] + (y >> 4)) * shape[2] + (z >> 4)
        row = top[j]
        children[row, (x & 15) << 8 | (y & 15) << 4 | (z & 15)] = 0
        sizes[row] -= 1
        if sizes[row] == 0:
            top[j] = 0
            free_children[left[1]] = row
            left[1] += 1


@njit(cache=True, nogil=True)
def far_blocks(keys, exists, centre, limit):
    """(K,) int32: the existing blocks whose centres are farther than ``limit`` from a centre, all
    in blocks.
    """
    found = np.empty(len(keys), np.int32)
    n = 0
    for block in range(len(keys)):
        if exists[block]:
            dx = keys[block, 0] + 0.5 - centre[0]
            dy = keys[block, 1] + 0.5 - centre[1]
            dz = keys[block, 2] + 0.5 - centre[2]
            if dx * dx + dy * dy + dz * dz > limit * limit:
                found[n] = block
                n += 1
    return found[:n].copy()


@njit(cache=True, nogil=True)
def join(blocks, base, shape, top, children, keys, neighbours):
    """Enter the 27 neighbours of new blocks (K,), in the order of x, y and z, and the blocks in
    those of theirs.

    Args:
        base, shape, top, children, keys: as for ``add_blocks``.
        neighbours: (capacity, 27) int32, -1 if absent. Modified.
    """
    for n in range(len(blocks)):
        block = blocks[n]
        for side in range(27):
            x = keys[block, 0] - (base[0] << 4) + side // 9 - 1
            y = keys[block, 1] - (base[1] << 4) + side // 3 % 3 - 1
            z = keys[block, 2] - (base[2] << 4) + side % 3 - 1
            other = np.int32(-1)
            if 0 <= x >> 4 < shape[0] and 0 <= y >> 4 < shape[1] and 0 <= z >> 4 < shape[2]:
                row = top[((x >> 4) * shape[1] + (y >> 4)) * shape[2] + (z >> 4)]
                other = children[row, (x & 15) << 8 | (y & 15) << 4 | (z & 15)] - np.int32(1)
            neighbours[block, side] = other
            if other >= 0:
                neighbours[other, 26 - side] = block


@njit(cache=True, nogil=True)
def part(blocks, neighbours):
    """Remove blocks (K,) that go from the neighbours of others; see ``join``."""
    for n in range(len(blocks)):
        for side in range(27):
            other = neighbours[blocks[n], side]
            if other >= 0:
                neighbours[other, 26 - side] = -1
        neighbours[blocks[n]] = -1

"""Objects of one scan: points in adjacent cells, and the evidence of their voxels."""

import math

import numpy as np
from numba import njit, prange

from dynaviz.kernels.keys import REACH, X_SHIFT, Y_SHIFT

ONE = np.uint64(1)
# Each array expression in a parallel kernel wakes threads, which may take 0.1 ms: write it in a function of its own.
PARTS = 4  # into which points are divided, for threads
FEW = 8192  # points: up to so many are one part
FIRST_SLOTS = 1024  # of a hash table that grows
# Half of the 26 neighbours of a cell, the others being covered from their side: one above it, and three in each of four
# columns. Per column, the steps from the cell's key to the lowest and the highest of theirs.
COLUMNS = np.array([0, 1 << Y_SHIFT, (1 << X_SHIFT) - (1 << Y_SHIFT), 1 << X_SHIFT, (1 << X_SHIFT) + (1 << Y_SHIFT)])
RUNS = np.stack([COLUMNS + np.array([1, -1, -1, -1, -1]), COLUMNS + 1], 1)


@njit(cache=True, nogil=True, inline="always")
def _slot(slots, cells, key):
    """The slot of a key in a hash table of numbers of cells, or the free slot for it; its size is a power of two."""
    mask = len(slots) - 1
    # The highest bits of the product depend on all of the key, x included.
    s = np.int64(np.uint64(key) * np.uint64(0x9E3779B97F4A7C15) >> np.uint64(44)) & mask
    while slots[s] >= 0 and cells[slots[s]] != key:
        s = (s + 1) & mask
    return s


@njit(cache=True, nogil=True)
def _larger(slots, cells, count):
    """A table of twice the size for the first ``count`` cells."""
    larger = np.full(2 * len(slots), np.int32(-1))
    for c in range(count):
        larger[_slot(larger, cells, cells[c])] = c
    return larger


@njit(cache=True, nogil=True)
def _root(parent, i):
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i


@njit(cache=True, nogil=True)
def _rows(chosen):
    """Rows (K,) int32 of the chosen points; without branches, which would be unpredictable."""
    rows, n = np.empty(len(chosen), np.int32), 0
    for i in range(len(chosen)):
        rows[n] = i
        n += chosen[i]
    return rows[:n]


@njit(cache=True, nogil=True)
def _divided(chosen):
    """The rows (K,) of chosen points, (N,) bool, and the ends of the parts into which they are divided for threads."""
    rows = _rows(chosen)
    parts = PARTS if len(rows) > FEW else 1
    return rows, np.arange(parts + 1) * len(rows) // parts


@njit(cache=True, nogil=True, error_model="numpy")
def _fill(points, rows, size, tall, first, slots, mine, cells, count):
    """Find the cells of points from the one in rows[first] on, until half of the slots are taken.

    Returns the place in ``rows`` of the next point, and the number of cells.
    """
    for place in range(first, len(rows)):
        i = rows[place]
        x = np.int64(math.floor(points[i, 0] / size)) + REACH
        y = np.int64(math.floor(points[i, 1] / size)) + REACH
        z = np.int64(math.floor(points[i, 2] / tall)) + REACH
        key = x << X_SHIFT | y << Y_SHIFT | z
        s = _slot(slots, cells, key)
        if slots[s] < 0:
            if 2 * count >= len(slots):
                return np.int64(place), count
            slots[s], cells[count] = count, key
            count += 1
        mine[i] = slots[s]
    return np.int64(len(rows)), count


@njit(cache=True, nogil=True)
def _part(points, rows, size, tall, mine, cells):
    """Number the cells of the points in some rows, in ``mine`` and ``cells``; returns how many these are."""
    slots, place, count = np.full(FIRST_SLOTS, np.int32(-1)), np.int64(0), np.int64(0)
    while True:
        place, count = _fill(points, rows, size, tall, place, slots, mine, cells, count)
        if place == len(rows):
            return count
        slots = _larger(slots, cells, count)


@njit(cache=True, nogil=True)
def _merged(rows, ends, found, counts, mine):
    """Number the cells that all parts found in the order of parts; returns what ``cells_of`` does."""
    total, size = counts.sum(), FIRST_SLOTS
    while size < 2 * total:
        size *= 2
    slots, cells, count = np.full(size, np.int32(-1)), np.empty(total, np.int64), np.int64(0)
    for part, most in enumerate(counts):
        numbers = np.empty(most, np.int32)
        for c in range(most):
            s = _slot(slots, cells, found[part, c])
            if slots[s] < 0:
                slots[s], cells[count] = count, found[part, c]
                count += 1
            numbers[c] = slots[s]
        for i in rows[ends[part] : ends[part + 1]]:
            mine[i] = numbers[mine[i]]
    return mine, cells[:count], slots


@njit(cache=True, nogil=True)
def _parts(chosen):
    """Rows (K,) of the chosen points, the parts of these rows, and memory for the cells of each part and of points."""
    rows, ends = _divided(chosen)
    parts = len(ends) - 1
    found, mine = np.empty((parts, len(rows) // parts + 1), np.int64), np.full(len(chosen), np.int32(-1))
    return rows, ends, np.zeros(parts, np.int64), found, mine


@njit(cache=True, nogil=True, parallel=True)
def cells_of(points, chosen, size, tall):
    """The cells that contain chosen points: (N,) int32, the cell of each point, -1 for others; and (C,) their keys.

    Cells are numbered in the order of first points. Then their hash table: their numbers by slot, -1 in free slots.
    Tables grow with the number of cells, far below that of points, so that they stay in the processor's cache.
    """
    rows, ends, counts, found, mine = _parts(chosen)
    if len(counts) == 1:
        counts[0] = _part(points, rows, size, tall, mine, found[0])
    else:
        for part in prange(len(counts)):
            counts[part] = _part(points, rows[ends[part] : ends[part + 1]], size, tall, mine, found[part])
    return _merged(rows, ends, found, counts, mine)


@njit(cache=True, nogil=True)
def connect(points, chosen, size, tall):
    """Join the chosen points to objects: connected components of cells that share a face, an edge or a corner.

    Args:
        points: (N, 3) float32, metres.
        chosen: (N,) bool; chosen points must be finite.
        size, tall: edge of a cell in x and y, and in z, metres.

    Returns:
        (N,) int32: number of each point's object, in the order of first points; -1 for points that are not chosen.
        The number of objects.
    """
    mine, cells, _ = cells_of(points, chosen, size, tall)
    count, parent = len(cells), np.arange(len(cells))
    order = np.argsort(cells)
    keys = cells[order]
    for run in range(len(RUNS)):
        at = 0
        for c in range(count):
            while at < count and keys[at] < keys[c] + RUNS[run, 0]:
                at += 1
            other = at
            while other < count and keys[other] <= keys[c] + RUNS[run, 1]:
                a, b = _root(parent, order[c]), _root(parent, order[other])
                parent[max(a, b)] = min(a, b)
                other += 1
    names, objects = np.full(count, np.int32(-1)), 0
    for c in range(count):
        root = _root(parent, c)
        if names[root] < 0:
            names[root] = objects
            objects += 1
        names[c] = names[root]
    for i in range(len(points)):
        if mine[i] >= 0:
            mine[i] = names[mine[i]]
    return mine, objects


@njit(cache=True, nogil=True)
def _shares(objects, n):
    """Rows (K,) of the points of n objects, the parts of these rows, and sums (parts, n, 7) of zeros."""
    rows, ends = _divided(objects >= 0)
    return rows, ends, np.zeros((len(ends) - 1, n, 7), np.int64)


@njit(cache=True, nogil=True)
def _total(sums):
    """(7, n) int64: the sums of all parts, (parts, n, 7)."""
    return sums.sum(0).T.copy()


@njit(cache=True, nogil=True, inline="always")
def _weighed(voxel, hits, passed, grazed, votes):
    """The evidence of a voxel with points: whether it votes, its vote, the evidence against it, whether seen clear."""
    block, place = voxel >> 9, voxel & 511
    hit, near = np.int64(hits[block, place]), np.int64(grazed[block, place])
    crossed, against = np.int64(passed[block, place]), hit + 3 * near
    seen = crossed - near
    vote = 1000 * min(seen, votes) * min(3 * seen, against) // against if seen else np.int64(0)
    return hit > 1 or crossed > 0, vote, against, seen > 0


@njit(cache=True, nogil=True, error_model="numpy")
def _add_evidence(sums, rows, objects, voxels, hits, passed, grazed, between, after, votes):
    """Add the evidence of the points in some rows to the sums (n, 7) int64 of their objects."""
    for i in rows:
        own, block, place = sums[objects[i]], voxels[i] >> 9, voxels[i] & 511
        counts, vote, against, clear = _weighed(voxels[i], hits, passed, grazed, votes)
        own[0] += 1
        own[1] += counts
        own[2] += vote
        own[6] += against
        if clear:
            own[3] += 1
            own[4] += np.int64(between[block, place >> 6] >> np.uint64(place & 63) & ONE)
            own[5] += np.int64(after[block, place >> 6] >> np.uint64(place & 63) & ONE)


@njit(cache=True, nogil=True, parallel=True)
def evidence(objects, n, voxels, hits, passed, grazed, between, after, votes):
    """Sum the evidence over the points of each of n objects.

    A voxel that was hit once and crossed by no other scan does not vote. The vote of the others, in thousandths of a
    scan, is the number of scans that saw it clear, at most ``votes``, times the ratio of that number to the evidence
    against it, at most 1. Evidence against it is each scan that crossed it near a hit, and a third of each scan that
    hit it, because a dynamic object makes hits as well. All sums are integers, so the order of points does not matter.

    Args:
        objects: (N,) int32, the object of each point, or -1.
        voxels: (N,) int64, the voxel of each point; points of objects must have one.
        hits, passed, grazed: (blocks, 512) uint16, number of scans that hit each voxel, crossed it without a hit, and
            crossed it near one. The others that crossed it saw it clear.
        between, after: (blocks, 8) uint64, bits of the voxels seen clear between two hits, and after the last hit.
        votes: maximum vote of a voxel, scans.

    Returns:
        (7, n) int64: points, voting points, sum of votes, points in voxels that were ever seen clear, between two hits,
        and after the last hit, and the evidence against votes, thirds of a scan.
    """
    rows, ends, sums = _shares(objects, n)
    if len(sums) == 1:
        _add_evidence(sums[0], rows, objects, voxels, hits, passed, grazed, between, after, votes)
    else:
        for part in prange(len(sums)):
            own = rows[ends[part] : ends[part + 1]]
            _add_evidence(sums[part], own, objects, voxels, hits, passed, grazed, between, after, votes)
    return _total(sums)


@njit(cache=True, nogil=True)
def read(voxels, counts):
    """(N,) int32: counts (blocks, 512) of voxels (N,); voxel -1 reads the last block."""
    found = np.empty(len(voxels), np.int32)
    for i in range(len(voxels)):
        found[i] = counts[voxels[i] >> 9, voxels[i] & 511]
    return found


@njit(cache=True, nogil=True)
def spread(verdict, objects):
    """(N,) uint8: the verdict (n,) on each point's object, (N,) int32; 0 for points without one, -1."""
    found = np.empty(len(objects), np.uint8)
    for i in range(len(objects)):
        found[i] = verdict[objects[i]] if objects[i] >= 0 else 0
    return found


@njit(cache=True, nogil=True)
def look_up(codes, table):
    """(N,) bool: the entries of a table, bool, at codes (N,) uint8."""
    found = np.empty(len(codes), np.bool_)
    for i in range(len(codes)):
        found[i] = table[codes[i]]
    return found


@njit(cache=True, nogil=True)
def surroundings(points, size, tall, voxels, hits, passed, grazed, votes):
    """The evidence around each point: in its cell and in the 26 cells around it.

    Args:
        points: (N, 3) float32, metres; finite.
        size, tall: edge of a cell in x and y, and in z, metres.
        voxels, hits, passed, grazed, votes: as in ``evidence``.

    Returns:
        (N,) int32: the cell of each point.
        Three arrays (C,) float64, by cell: mean vote of the points around it that vote, from 0 to 1; and of all points
        around it, the mean evidence against votes, scans, and the share in voxels that were ever seen clear.
    """
    mine, cells, slots = cells_of(points, np.ones(len(points), np.bool_), size, tall)
    sums = np.zeros((len(cells), 5), np.int64)
    for i in range(len(points)):
        counts, vote, against, clear = _weighed(voxels[i], hits, passed, grazed, votes)
        own = sums[mine[i]]
        own[0] += 1
        own[1] += counts
        own[2] += vote
        own[3] += against
        own[4] += clear
    mean_vote, mean_against, touched = np.empty(len(cells)), np.empty(len(cells)), np.empty(len(cells))
    total = np.empty(5, np.int64)
    for c in range(len(cells)):
        total[:] = 0
        for j in range(27):
            key = cells[c] + ((j // 9 - 1) << X_SHIFT) + ((j // 3 % 3 - 1) << Y_SHIFT) + (j % 3 - 1)
            other = slots[_slot(slots, cells, key)]
            if other >= 0:
                for k in range(5):
                    total[k] += sums[other, k]
        mean_vote[c] = total[2] / (1000 * votes * max(total[1], 1))
        mean_against[c] = total[3] / (3 * total[0])
        touched[c] = total[4] / total[0]
    return mine, mean_vote, mean_against, touched


@njit(cache=True, nogil=True, parallel=True)
def outcomes(voxels, verdict, low, high, hits, passed, grazed, votes, codes):
    """(N,) uint8: the reason code of each point; low points get that of all low points.

    Args:
        voxels: (N,) int64, the voxel of each point, -1 for none.
        verdict: (N,) uint8, the code that the point's object has for it, or 0.
        low, high: (N,) bool.
        hits, passed, grazed: (blocks, 512) uint16, as in ``evidence``.
        votes: number of scans that must have seen a voxel clear for its points to be alone.
        codes: seven reason codes: of points never clear, of those too little clear, high, settled, alone, low and out
            of reach. A later one overrules an earlier one, but high points are not alone; verdicts other than settled
            overrule the first five.
    """
    never, little, above, settled, alone, near_ground, out = codes
    found = np.empty(len(voxels), np.uint8)
    for i in prange(len(voxels)):
        block, place = voxels[i] >> 9, voxels[i] & 511
        if voxels[i] < 0:
            found[i] = out
        elif low[i]:
            found[i] = near_ground
        elif verdict[i] != 0 and verdict[i] != settled:
            found[i] = verdict[i]
        else:
            seen = np.int64(passed[block, place]) - np.int64(grazed[block, place])
            if high[i]:
                found[i] = above
            elif seen >= votes and 2 * seen > np.int64(hits[block, place]) + np.int64(passed[block, place]):
                found[i] = alone
            elif verdict[i] != 0:
                found[i] = settled
            else:
                found[i] = little if seen > 0 else never
    return found

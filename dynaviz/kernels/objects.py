"""Objects of one scan: points in adjacent cells, the evidence of their voxels, and the trails of dynamic objects."""

import math

import numpy as np
from numba import njit, prange

from dynaviz.kernels.keys import REACH, X_SHIFT, Y_SHIFT


@njit(cache=True, nogil=True, inline="always")
def _slot(slots, key):
    """The slot of a key in a table whose size is a power of two, or the free slot for it."""
    mask = len(slots) - 1
    s = np.int64(np.uint64(key) * np.uint64(0x9E3779B97F4A7C15) >> np.uint64(20)) & mask
    while slots[s] >= 0 and slots[s] != key:
        s = (s + 1) & mask
    return s


@njit(cache=True, nogil=True)
def _root(parent, i):
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i


@njit(cache=True, nogil=True)
def _cells(points, chosen, size, tall):
    """The cells that contain chosen points: (N,) int32, the cell of each point, -1 for others; and (C,) their keys.

    Then the hash table of the cells: the keys by slot, and the numbers of the cells by slot.
    """
    n, length = chosen.sum(), 16
    while length < 2 * n:
        length *= 2
    slots, ranks = np.full(length, np.int64(-1)), np.empty(length, np.int64)
    cells, count, mine = np.empty(n, np.int64), 0, np.full(len(points), np.int32(-1))
    s, last = np.int64(0), np.int64(-1)
    for i in range(len(points)):
        if not chosen[i]:
            continue
        x = np.int64(math.floor(points[i, 0] / size)) + REACH
        y = np.int64(math.floor(points[i, 1] / size)) + REACH
        z = np.int64(math.floor(points[i, 2] / tall)) + REACH
        key = x << X_SHIFT | y << Y_SHIFT | z
        if key != last:  # consecutive points often share a cell
            s, last = _slot(slots, key), key
        if slots[s] < 0:
            slots[s], ranks[s], cells[count] = key, count, key
            count += 1
        mine[i] = ranks[s]
    return mine, cells[:count], slots, ranks


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
    mine, cells, slots, ranks = _cells(points, chosen, size, tall)
    count, parent = len(cells), np.arange(len(cells))
    for c in range(count):
        for j in range(13):  # half of the 26 neighbours; the other half is covered from their side
            key = cells[c] + ((j // 9 - 1) << X_SHIFT) + ((j // 3 % 3 - 1) << Y_SHIFT) + (j % 3 - 1)
            s = _slot(slots, key)
            if slots[s] >= 0:
                a, b = _root(parent, c), _root(parent, ranks[s])
                parent[max(a, b)] = min(a, b)
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
def evidence(objects, n, voxels, hits, passed, clear, votes):
    """Sum the evidence over the points of each of n objects.

    A voxel that was hit once and crossed by no other scan does not vote. The vote of the others, in thousandths of a
    scan, is the number of scans that saw it clear, at most ``votes``, times the ratio of that number to the evidence
    against it, at most 1. Evidence against it is each scan that crossed it near a hit, and a third of each scan that
    hit it, because a dynamic object makes hits as well. All sums are integers, so the order of points does not matter.

    Args:
        objects: (N,) int32, the object of each point, or -1.
        voxels: (N,) int64, the voxel of each point; points of objects must have one.
        hits, passed, clear: (blocks, 512) uint16, number of scans that hit, crossed, and saw clear each voxel.
        votes: maximum vote of a voxel, scans.

    Returns:
        Four arrays (n,) int64: points, voting points, sum of votes, and points in voxels that were ever seen clear.
    """
    size, having = np.zeros(n, np.int64), np.zeros(n, np.int64)
    sum_of_votes, touched = np.zeros(n, np.int64), np.zeros(n, np.int64)
    for i in range(len(objects)):
        k = objects[i]
        if k >= 0:
            block, place = voxels[i] >> 9, voxels[i] & 511
            size[k] += 1
            seen = np.int64(clear[block, place])
            having[k] += hits[block, place] > 1 or passed[block, place] > 0
            if seen:
                touched[k] += 1
                against = np.int64(hits[block, place]) + 3 * (np.int64(passed[block, place]) - seen)
                sum_of_votes[k] += 1000 * min(seen, votes) * min(3 * seen, against) // against
    return size, having, sum_of_votes, touched


@njit(cache=True, nogil=True, parallel=True)
def read(voxels, counts):
    """(N,) int32: counts (blocks, 512) of voxels (N,); voxel -1 reads the last block."""
    found = np.empty(len(voxels), np.int32)
    for i in prange(len(voxels)):
        found[i] = counts[voxels[i] >> 9, voxels[i] & 511]
    return found


@njit(cache=True, nogil=True)
def trails(objects, n, places, since, last, proof):
    """For each of n objects: its number of points at recent trails, and the maximum proof there.

    Args:
        objects: (N,) int32, the object of each point, or -1.
        places: (N,) int64, the quarter column of each point.
        since: first scan that counts as recent.
        last: (all places,) int32, the last scan with a dynamic object in each place.
        proof: (all places,) int32, number of scans in which that object was dynamic.

    Returns:
        (n,) int64 and (n,) int32.
    """
    count, most = np.zeros(n, np.int64), np.zeros(n, np.int32)
    for i in range(len(objects)):
        k = objects[i]
        if k >= 0 and last[places[i]] >= since:
            count[k] += 1
            most[k] = max(most[k], proof[places[i]])
    return count, most


@njit(cache=True, nogil=True)
def count(objects, n, chosen):
    """(n,) int64: number of chosen points, (N,) bool, of each object."""
    found = np.zeros(n, np.int64)
    for i in range(len(objects)):
        if objects[i] >= 0:
            found[objects[i]] += chosen[i]
    return found


@njit(cache=True, nogil=True)
def leave(objects, moving, proven, places, now, last, proof, first):
    """Mark the places of moving objects, (n,) bool, with this scan and their proof, (n,), or the maximum of several.

    ``first`` keeps the first scan with such an object in each place.
    """
    for i in range(len(objects)):
        k = objects[i]
        if k >= 0 and moving[k]:
            place = places[i]
            proof[place] = max(proof[place], proven[k]) if last[place] == now else proven[k]
            last[place] = now
            first[place] = min(first[place], now)


@njit(cache=True, nogil=True)
def surroundings(points, chosen, size, tall, voxels, hits, passed, clear, votes):
    """The evidence around each chosen point: in its cell and in the 26 cells around it.

    Args:
        points: (N, 3) float32, metres.
        chosen: (N,) bool; chosen points must be finite. Others are ignored.
        size, tall: edge of a cell in x and y, and in z, metres.
        voxels, hits, passed, clear, votes: as in ``evidence``.

    Returns:
        Two arrays (N,) float64: mean vote of the points that vote, from 0 to 1, and mean evidence against votes of all
        points, scans. Zero for points that are not chosen.
    """
    mine, cells, slots, ranks = _cells(points, chosen, size, tall)
    count, sums = len(cells), np.zeros((len(cells), 4), np.int64)
    for i in range(len(points)):
        if mine[i] < 0:
            continue
        block, place = voxels[i] >> 9, voxels[i] & 511
        seen, hit, crossed = np.int64(clear[block, place]), np.int64(hits[block, place]), np.int64(passed[block, place])
        against = hit + 3 * (crossed - seen)
        own = sums[mine[i]]
        own[0] += 1
        own[1] += hit > 1 or crossed > 0
        own[2] += 1000 * min(seen, votes) * min(3 * seen, against) // against
        own[3] += against
    mean_vote, mean_against = np.zeros(len(points)), np.zeros(len(points))
    around = np.zeros((count, 2))
    for c in range(count):
        total = np.zeros(4, np.int64)
        for j in range(27):
            s = _slot(slots, cells[c] + ((j // 9 - 1) << X_SHIFT) + ((j // 3 % 3 - 1) << Y_SHIFT) + (j % 3 - 1))
            if slots[s] >= 0:
                total += sums[ranks[s]]
        around[c, 0] = total[2] / (1000 * votes * max(total[1], 1))
        around[c, 1] = total[3] / (3 * total[0])
    for i in range(len(points)):
        if mine[i] >= 0:
            mean_vote[i], mean_against[i] = around[mine[i]]
    return mean_vote, mean_against


@njit(cache=True, nogil=True)
def in_or_next_to(points, chosen, cell):
    """(N,) bool: points in a cell, seen from above, that contains a chosen point or is adjacent to such a cell.

    Args:
        points: (N, 3) float32, metres.
        chosen: (N,) bool.
        cell: edge of a cell, metres.
    """
    found = np.zeros(len(points), np.bool_)
    cells = np.empty((len(points), 2), np.int64)
    low, high = np.array([REACH, REACH]), np.array([-REACH, -REACH])
    for i in range(len(points)):
        if chosen[i]:
            for axis in range(2):
                k = np.int64(math.floor(points[i, axis] / cell))
                cells[i, axis] = k
                low[axis], high[axis] = min(low[axis], k), max(high[axis], k)
    if low[0] > high[0]:
        return found
    picture = np.zeros((high[0] - low[0] + 3, high[1] - low[1] + 3), np.bool_)
    for i in range(len(points)):
        if chosen[i]:
            x, y = cells[i, 0] - low[0], cells[i, 1] - low[1]
            picture[x : x + 3, y : y + 3] = True
    for i in range(len(points)):
        if math.isfinite(points[i, 0]) and math.isfinite(points[i, 1]):
            x = np.int64(math.floor(points[i, 0] / cell)) - low[0] + 1
            y = np.int64(math.floor(points[i, 1] / cell)) - low[1] + 1
            if 0 <= x < picture.shape[0] and 0 <= y < picture.shape[1]:
                found[i] = picture[x, y]
    return found


@njit(cache=True, nogil=True)
def local_level(points, chosen, height, cell, few):
    """(N,) float32, metres: mean height of the chosen points in each point's square cell, seen from above.

    0 in cells with fewer than ``few`` chosen points, and for points that are not finite.

    Args:
        points: (N, 3) float32, metres.
        chosen: (N,) bool; chosen points must be finite.
        height: (N,) float32, metres.
        cell: edge of a cell, metres.
        few: minimum number of points.
    """
    keys, runs, last = np.full(len(points), np.int64(-1)), 0, np.int64(-1)
    for i in range(len(points)):
        if math.isfinite(points[i, 0]) and math.isfinite(points[i, 1]):
            x, y = math.floor(points[i, 0] / cell), math.floor(points[i, 1] / cell)
            if max(abs(x), abs(y)) < REACH:
                keys[i] = (np.int64(x) + REACH) << X_SHIFT | np.int64(y) + REACH
                if chosen[i] and keys[i] != last:
                    runs, last = runs + 1, keys[i]
    length = 1024
    while length < 2 * runs:
        length *= 2
    slots, number, total = np.full(length, np.int64(-1)), np.zeros(length, np.int64), np.zeros(length, np.int64)
    level = np.zeros(len(points), np.float32)
    for adds in (True, False):  # add the chosen points, then look up all points
        s, last = np.int64(0), np.int64(-1)
        for i in range(len(points)):
            if keys[i] < 0 or (adds and not chosen[i]):
                continue
            if keys[i] != last:  # consecutive points often share a cell
                s, last = _slot(slots, keys[i]), keys[i]
            if adds:
                slots[s] = last
                number[s] += 1
                total[s] += np.int64(np.round(np.float64(height[i]) * 1e6))  # integers: any order
            elif slots[s] >= 0 and number[s] >= few:
                level[i] = total[s] / (1e6 * number[s])
    return level

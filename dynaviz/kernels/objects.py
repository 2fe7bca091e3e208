"""Objects of one scan: points in cells that touch, what scans saw of their voxels, and where movers were lately."""

import math

import numpy as np
from numba import njit, prange

from dynaviz.kernels.keys import REACH, X_SHIFT, Y_SHIFT


@njit(cache=True, nogil=True, inline="always")
def _slot(slots, key):
    """Where a key is in a table of a power of two, or would be put."""
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
def connect(points, chosen, size, tall):
    """Objects of the chosen points: those whose cells touch at a side, an edge or a corner.

    Args:
        points: (N, 3) float32, metres.
        chosen: (N,) bool; they are finite.
        size, tall: edges of a cell in x and y, and in z, metres.

    Returns:
        (N,) int32, the number of each point's object, in order of first points; -1 for points that are not chosen.
        The number of objects.
    """
    n = chosen.sum()
    length = 16
    while length < 2 * n:
        length *= 2
    slots, ranks = np.full(length, np.int64(-1)), np.empty(length, np.int64)
    cells, parent, count = np.empty(n, np.int64), np.empty(n, np.int64), 0
    mine = np.full(len(points), np.int32(-1))
    s, last = np.int64(0), np.int64(-1)
    for i in range(len(points)):
        if not chosen[i]:
            continue
        x = np.int64(math.floor(points[i, 0] / size)) + REACH
        y = np.int64(math.floor(points[i, 1] / size)) + REACH
        z = np.int64(math.floor(points[i, 2] / tall)) + REACH
        key = x << X_SHIFT | y << Y_SHIFT | z
        if key != last:  # points that follow each other often share a cell
            s, last = _slot(slots, key), key
        if slots[s] < 0:
            slots[s], ranks[s], cells[count], parent[count] = key, count, key, count
            count += 1
        mine[i] = ranks[s]
    for c in range(count):
        for j in range(13):  # half of the cells around; the others have this one in their half
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
    """Of n objects: their points, those with a say, the votes of these, and how many points were ever seen through.

    A voxel that was hit once and crossed by no other scan has no say. The vote of others, in thousandths of a scan, is
    how often it was seen clear through, ``votes`` at most, times the ratio of that to what speaks against it, at
    most 1: each scan that crossed it beside a hit, and a third for each that hit it, for a mover makes hits as well.
    These are whole numbers, so the order of points does not matter.

    Args:
        objects: (N,) int32, the object of each point, or -1.
        voxels: (N,) int64, the voxel of each point; where there is an object there is a voxel.
        hits, passed, clear: (blocks, 512) uint16, how often each voxel was hit, crossed, and seen clear through.
        votes: the most scans that a voxel's vote has.

    Returns:
        Four times (n,) int64.
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
    """(N,) int32: counts, (blocks, 512), of voxels (N,); of the last block where there is none, -1."""
    found = np.empty(len(voxels), np.int32)
    for i in prange(len(voxels)):
        found[i] = counts[voxels[i] >> 9, voxels[i] & 511]
    return found


@njit(cache=True, nogil=True)
def trails(objects, n, places, since, last, proof):
    """Of n objects: how many points lie in places (N,) whose ``last`` is not before ``since``; the most proof there.

    Args:
        objects: (N,) int32, the object of each point, or -1.
        last: (all places,) int32, the last scan with a mover there.
        proof: (all places,) int32, in how many scans that mover had been judged dynamic.
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
    """Of n objects: how many of their points are chosen, (N,) bool."""
    found = np.zeros(n, np.int64)
    for i in range(len(objects)):
        if objects[i] >= 0:
            found[objects[i]] += chosen[i]
    return found


@njit(cache=True, nogil=True)
def leave(objects, moving, proven, places, now, last, proof):
    """Mark the places of moving objects, (n,) bool, with this scan and with their proof, (n,); of several the most."""
    for i in range(len(objects)):
        k = objects[i]
        if k >= 0 and moving[k]:
            place = places[i]
            proof[place] = max(proof[place], proven[k]) if last[place] == now else proven[k]
            last[place] = now


@njit(cache=True, nogil=True)
def beside(points, chosen, cell):
    """Which points (N, 3) are, in plan view, in a cell that holds a chosen one, or in one that touches such a cell."""
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

"""Nearest neighbours: points in Morton order, a binary tree of bounding boxes over them, and a
search in it.

All arithmetic is float32 in one fixed order. Rounding is monotone, so the distance to a box never
exceeds that to a point inside it, and the result equals the minimum over all pairs, bit by bit.
"""

import numpy as np
from numba import njit

LEAF = 16  # points per leaf of the tree
PACKET = 32  # queries that descend the tree together, at most ...
SPAN = np.float32(0.3)  # ... within a cube of this edge, metres
_DIGIT = 11  # bits by which points are sorted at once


@njit(cache=True, nogil=True)
def morton_order(points, low, inverse, axis_bits, index_bits):
    """(N,) int64: rows of points (N, 3) float32 in the order of their Morton codes.

    Args:
        low: (3,) float64, lower corner of the cells, metres.
        inverse: cells per metre.
        axis_bits, index_bits: bits per axis, and bits of a row; at most 64 in all.
    """
    keys = np.empty(len(points), np.uint64)
    other = np.empty(len(points), np.uint64)
    counts = np.zeros(((3 * axis_bits + _DIGIT - 1) // _DIGIT, 1 << _DIGIT), np.int64)
    top = np.float64((1 << axis_bits) - 1)
    last = np.uint64((1 << _DIGIT) - 1)
    for i in range(len(points)):
        code = np.uint64(0)
        for axis in range(3):
            cell = (np.float64(points[i, axis]) - low[axis]) * inverse
            k = np.uint64(min(max(cell, 0.0), top))
            k = (k | (k << np.uint64(32))) & np.uint64(0x1F00000000FFFF)
            k = (k | (k << np.uint64(16))) & np.uint64(0x1F0000FF0000FF)
            k = (k | (k << np.uint64(8))) & np.uint64(0x100F00F00F00F00F)
            k = (k | (k << np.uint64(4))) & np.uint64(0x10C30C30C30C30C3)
            k = (k | (k << np.uint64(2))) & np.uint64(0x1249249249249249)
            code |= k << np.uint64(axis)
        keys[i] = (code << np.uint64(index_bits)) | np.uint64(i)
        for digit in range(len(counts)):
            counts[digit, code >> np.uint64(_DIGIT * digit) & last] += 1
    for digit in range(len(counts)):  # sort by the lowest digit of the codes first
        end = 0
        for value in range(1 << _DIGIT):
            count = counts[digit, value]
            counts[digit, value] = end
            end += count
        shift = np.uint64(index_bits + _DIGIT * digit)
        for i in range(len(keys)):
            value = keys[i] >> shift & last
            other[counts[digit, value]] = keys[i]
            counts[digit, value] += 1
        keys, other = other, keys
    for i in range(len(keys)):
        keys[i] &= np.uint64((1 << index_bits) - 1)
    return keys.view(np.int64)


@njit(cache=True, nogil=True)
def boxes(points):
    """(2 L, 6) float32: lower and upper corner of each node.

    Node k has the children 2 k and 2 k + 1.
    """
    leaves = 1
    while leaves * LEAF < len(points):
        leaves *= 2
    tree = np.empty((2 * leaves, 6), np.float32)
    tree[:, :3] = np.inf  # an empty box is infinitely far from everywhere
    tree[:, 3:] = -np.inf
    for i in range(len(points)):
        node = leaves + i // LEAF
        for axis in range(3):
            tree[node, axis] = min(tree[node, axis], points[i, axis])
            tree[node, 3 + axis] = max(tree[node, 3 + axis], points[i, axis])
    for node in range(leaves - 1, 0, -1):
        for axis in range(3):
            tree[node, axis] = min(tree[2 * node, axis], tree[2 * node + 1, axis])
            tree[node, 3 + axis] = max(tree[2 * node, 3 + axis], tree[2 * node + 1, 3 + axis])
    return tree


@njit(cache=True, nogil=True, inline="always")
def _to_box(tree, node, box):
    """Squared distance between a node of the tree and a box, (6,) lower and upper corner.

    0 if they overlap.
    """
    zero = np.float32(0)
    dx = max(max(tree[node, 0] - box[3], box[0] - tree[node, 3]), zero)
    dy = max(max(tree[node, 1] - box[4], box[1] - tree[node, 4]), zero)
    dz = max(max(tree[node, 2] - box[5], box[2] - tree[node, 5]), zero)
    return dx * dx + dy * dy + dz * dz


@njit(cache=True, nogil=True)
def _to_points(points, leaf, x, y, z, best):
    """Lower the squared distances of a packet to those to the points of a leaf.

    Return the largest.
    """
    for i in range(leaf * LEAF, min(leaf * LEAF + LEAF, len(points))):
        px = points[i, 0]
        py = points[i, 1]
        pz = points[i, 2]
        for k in range(PACKET):  # without branches: eight at a time
            dx = px - x[k]
            dy = py - y[k]
            dz = pz - z[k]
            d = dx * dx + dy * dy + dz * dz
            best[k] = d if d < best[k] else best[k]
    worst = best[0]
    for k in range(1, PACKET):
        worst = max(worst, best[k])
    return worst


@njit(cache=True, nogil=True)
def search(points, tree, reach, enough, queries):
    """(N,) float32: squared distance of each query to the nearest point, square metres.

    At most ``reach`` (squared).

    Consecutive queries that are close to each other descend the tree as one packet, which begins at
    the leaf where the previous one ended: sort them. A packet stops when all are within a squared
    distance of ``enough`` of a point; 0 searches the nearest.
    """
    out = np.empty(len(queries), np.float32)
    leaves = len(tree) // 2
    near = -1
    begin = 0
    nodes = np.empty(64, np.int64)
    bounds = np.empty(64, np.float32)
    box = np.empty(6, np.float32)
    x = np.empty(PACKET, np.float32)
    y = np.empty(PACKET, np.float32)
    z = np.empty(PACKET, np.float32)
    best = np.empty(PACKET, np.float32)
    while begin < len(queries):
        for axis in range(6):
            box[axis] = queries[begin, axis % 3]
        end = begin
        wide = False
        while end < min(begin + PACKET, len(queries)) and not wide:
            for axis in range(3):
                at = queries[end, axis]
                wide |= max(box[3 + axis], at) - min(box[axis], at) > SPAN
            if not wide:
                for axis in range(3):
                    at = queries[end, axis]
                    box[axis] = min(box[axis], at)
                    box[3 + axis] = max(box[3 + axis], at)
                end += 1
        for k in range(PACKET):  # the last query fills up the packet
            q = min(begin + k, end - 1)
            x[k] = queries[q, 0]
            y[k] = queries[q, 1]
            z[k] = queries[q, 2]
            best[k] = reach
        first = near
        worst = _to_points(points, first, x, y, z, best) if first >= 0 else reach
        nodes[0] = 1
        bounds[0] = np.float32(0)
        depth = 1
        while depth > 0 and worst > enough:
            depth -= 1
            node = nodes[depth]
            if bounds[depth] >= worst:
                continue
            while node < leaves:  # descend into the closer child; push the other if it may matter
                left = _to_box(tree, 2 * node, box)
                right = _to_box(tree, 2 * node + 1, box)
                node = 2 * node
                if right < left:
                    node += 1
                    left, right = right, left
                if right < worst:
                    nodes[depth] = node ^ 1
                    bounds[depth] = right
                    depth += 1
                if left >= worst:
                    break
            else:
                if node - leaves != first:
                    closer = _to_points(points, node - leaves, x, y, z, best)
                    if closer < worst:
                        worst = closer
                        near = node - leaves
        for k in range(end - begin):
            out[begin + k] = best[k]
        begin = end
    return out

"""Cells of many frames joined into cases.

Cells that touch within a few frames belong to one case.
"""

import numpy as np
from numba import njit

from dynaviz.arrays import F32, F64, I32, I64, U8, Bool
from dynaviz.kernels.disjoint_sets import root_of
from dynaviz.kernels.hash_table import first_slot
from dynaviz.kernels.keys import BITS, MASK, REACH, X_SHIFT, Y_SHIFT

# columns of a remembered cell
GROUP = 0
CASE = 1
LAST = 2


@njit(cache=True, nogil=True, inline="always")
def _find(table, cells, key, group):
    """The row of a cell, or the free row where it would be inserted.

    Four cells in a vertical row get adjacent rows, since neighbours are looked up together.
    """
    mask = len(table) - 1
    s = first_slot(key >> 2, mask >> 2) << 2 | key & 3
    while table[s] >= 0 and (table[s] != key or cells[s, GROUP] != group):
        s = (s + 1) & mask
    return s


@njit(cache=True, nogil=True, inline="always")
def _fits(low: I32, high: I32, a: int, b: int, limit: int) -> bool:
    """Whether the union of two cases spans at most ``limit`` cells along each axis."""
    longest = 0
    for axis in range(3):
        longest = max(longest, max(high[a, axis], high[b, axis]) - min(low[a, axis], low[b, axis]))
    return longest < limit


@njit(cache=True, nogil=True)
def link(
    keys: I64,
    groups: I64,
    frame: int,
    gap: int,
    limit: int,
    table: I64,
    cells: I64,
    parent: I32,
    low: I32,
    high: I32,
    used: int,
) -> tuple[I32, Bool, int, int]:
    """Assign the points of a frame to cases.

    The case of an adjacent cell of the same group, or a new one.

    Args:
        keys: (N,) int64 packed cell of each point.
        groups: (N,) int64: points of different groups never join.
        frame: number of the frame.
        gap: number of frames for which a cell is remembered.
        limit: maximum extent of a case along an axis, cells.
        table: (2^k,) int64: key of each remembered cell, -1 if free; at most half full. Modified.
        cells: (2^k, 3) int64: group, case and last frame of each remembered cell. Modified.
        parent: (L,) int32: union-find forest of the cases; room for N more. Modified.
        low, high: (L, 3) int32: bounds of each case, cells. Modified.
        used: number of cases before the call.

    Returns:
        cases: (N,) int32, to be looked up in ``parent``.
        first: (N,) bool: whether the point is the first of its cell in this frame.
        fresh: number of cells added to the table.
        used: number of cases after the call.
    """
    cases = np.empty(len(keys), np.int32)
    first = np.zeros(len(keys), np.bool_)
    fresh = 0
    for i in range(len(keys)):
        key = keys[i]
        group = groups[i]
        own = _find(table, cells, key, group)
        known = table[own] >= 0
        if (
            known and frame - cells[own, LAST] <= gap
        ):  # then it is already joined to the adjacent cells
            cases[i] = cells[own, CASE]
            first[i] = cells[own, LAST] != frame
            cells[own, LAST] = frame
            continue
        case = used  # a new case, until it is joined to a neighbour's
        parent[case] = case
        for axis in range(3):
            at = np.int32((key >> np.int64(X_SHIFT - BITS * axis) & MASK) - REACH)
            low[case, axis] = at
            high[case, axis] = at
        for dx in range(-1, 2):
            for dy in range(-1, 2):
                for dz in range(-1, 2):
                    step = (np.int64(dx) << X_SHIFT) + (np.int64(dy) << Y_SHIFT) + np.int64(dz)
                    s = _find(table, cells, key + step, group)
                    if table[s] < 0 or frame - cells[s, LAST] > gap:
                        continue
                    a = root_of(parent, case)
                    b = root_of(parent, cells[s, CASE])
                    if a != b and _fits(low, high, a, b, limit):
                        keep = min(a, b)
                        gone = max(a, b)
                        parent[gone] = keep
                        for axis in range(3):
                            low[keep, axis] = min(low[keep, axis], low[gone, axis])
                            high[keep, axis] = max(high[keep, axis], high[gone, axis])
        root = root_of(parent, case)
        used += root == used
        fresh += not known
        table[own] = key
        cells[own, GROUP] = group
        cells[own, CASE] = root
        cells[own, LAST] = frame
        cases[i] = root
        first[i] = True
    return cases, first, fresh, used


@njit(cache=True, nogil=True)
def roots(parent: I32, used: int) -> I32:
    """(used,) int32: the root of each case."""
    found = np.empty(used, np.int32)
    for label in range(used):
        found[label] = root_of(parent, label)
    return found


@njit(cache=True, nogil=True)
def remember(keys: I64, cells: I64, size: int) -> tuple[I64, I64]:
    """A new table of ``size`` rows, a power of two, with the cells whose key is not -1."""
    table = np.full(size, np.int64(-1))
    filled = np.empty((size, 3), np.int64)
    for i in range(len(keys)):
        if keys[i] >= 0:
            s = _find(table, filled, keys[i], cells[i, GROUP])
            table[s] = keys[i]
            for column in range(3):
                filled[s, column] = cells[i, column]
    return table, filled


@njit(cache=True, nogil=True)
def fold(
    cases: I32,
    used: int,
    points: F32,
    ranges: F32,
    first: Bool,
    touching: Bool,
    ground: Bool,
    reasons: U8,
    codes: int,
) -> tuple[I64, I64, F32, F32, F64, I64]:
    """Sum up the points of a frame by case, in the order of case numbers.

    Args:
        cases: (N,) int32, a number below ``used`` for each point.
        used: number of cases.
        points: (N, 3) float32, metres.
        ranges: (N,) float32, metres.
        first, touching, ground: (N,) bool, points to count.
        reasons: (N,) uint8.
        codes: number of reason codes; larger ones count as the last.

    Returns:
        numbers: (K,) int64: the cases with points, ascending.
        counts: (K, 5) int64: position of a point; numbers of points and of first, touching and
            ground points.
        low, high: (K, 4) float32, metres: lowest and highest coordinates and range.
        sums: (K,) float64, metres: sum of ranges.
        crossed: (K, codes) int64: points by reason.
    """
    row = np.full(used, np.int32(-1))
    for i in range(len(cases)):
        row[cases[i]] = 0
    n = np.int32(0)
    for case in range(used):
        if row[case] == 0:
            row[case] = n
            n += 1
    numbers = np.empty(n, np.int64)
    counts = np.zeros((n, 5), np.int64)
    sums = np.zeros(n)
    low = np.full((n, 4), np.float32(np.inf))
    high = np.full((n, 4), np.float32(-np.inf))
    crossed = np.zeros((n, codes), np.int64)
    for i in range(len(cases)):
        k = row[cases[i]]
        numbers[k] = cases[i]
        counts[k, 0] = i
        counts[k, 1] += 1
        counts[k, 2] += first[i]
        counts[k, 3] += touching[i]
        counts[k, 4] += ground[i]
        for axis in range(3):
            low[k, axis] = min(low[k, axis], points[i, axis])
            high[k, axis] = max(high[k, axis], points[i, axis])
        low[k, 3] = min(low[k, 3], ranges[i])
        high[k, 3] = max(high[k, 3], ranges[i])
        sums[k] += ranges[i]
        crossed[k, min(reasons[i], codes - 1)] += 1
    return numbers, counts, low, high, sums, crossed

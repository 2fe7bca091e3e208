"""Objects that moved as a whole: their outline is displaced, and nothing else explains it.

A car that moves by less than its length leaves no place clear but those at its ends. Yet how far it
reaches in eight directions changes by one translation.
"""

import numpy as np
from numba import njit

from dynaviz_methods.seethrough.kernels.places import combined

WAYS = np.array([[1, 0], [0, 1], [1, 1], [1, -1], [-1, 0], [0, -1], [-1, -1], [-1, 1]])
# eight horizontal unit vectors, opposite ones four apart
WAYS = WAYS / np.hypot(WAYS[:, :1], WAYS[:, 1:])


@njit(cache=True, nogil=True)
def reaches(points, objects, count):
    """(O, 8) float32, metres, world frame.

    How far each object reaches in the ``WAYS``, along x + y and x - y as well.

    Args:
        points: (N, 3) float32, metres, world frame; objects: (N,) int32, that of each, -1 for none.
        count: number of objects.
    """
    found = np.full((count, 8), np.float32(-np.inf))
    slant = np.float32(WAYS[2, 0])
    for i in range(len(points)):
        of = objects[i]
        if of >= 0:
            x = points[i, 0]
            y = points[i, 1]
            along = x, y, slant * (x + y), slant * (x - y)
            for k in range(4):
                found[of, k] = max(found[of, k], along[k])
                found[of, k + 4] = max(found[of, k + 4], -along[k])
    return found


@njit(cache=True, nogil=True)
def moved(
    firsts, at, columns, width, reach, guard, steps, least, centres, rows, begins, own, shared, link
):
    """(O,) bool: objects that moved along themselves, of whose middle nothing was ever seen clear.

    Each object is compared with the earlier ones that it continues, up to ``steps`` before it. It
    has moved if it is displaced from more than a share of the earlier ones, or of the later ones.

    Args:
        firsts, at, columns, width: as in ``tracks.follow``.
        reach: (O, 8) float32, metres, as from ``reaches``; guard: metres; steps: number of scans;
            least: the share.
        centres: (R + 1, 2) float32, metres: those of places; rows, begins, own, shared, link: as in
            ``places.certainties``.
    """
    came, gone = first_and_last_visits(firsts, rows, begins, len(own))
    when = scans_of_objects(firsts, len(reach))
    before = predecessors(firsts, at, columns, width)
    of_places = (own, shared, link)
    compared = np.zeros((2, len(reach)), np.int64)
    displaced = np.zeros((2, len(reach)), np.int64)
    for of in range(len(reach)):
        other = before[of]
        for _ in range(steps):
            if other < 0:
                break
            compared[0, of] += 1
            compared[1, other] += 1
            way = displacement(reach[other], reach[of], guard)
            if way >= 0:
                back = (way + 4) % 8
                mine = rows[begins[of] : begins[of + 1]]
                theirs = rows[begins[other] : begins[other + 1]]
                new, dynamic_here = end_of(
                    mine, way, reach[other, way], centres, came, when[other], *of_places
                )
                old, dynamic_there = end_of(
                    theirs, back, reach[of, back], centres, gone, -when[of], *of_places
                )
                if new and old and (dynamic_here or dynamic_there):
                    displaced[0, of] += 1
                    displaced[1, other] += 1
            other = before[other]
    over = displaced > least * compared
    return over[0] | over[1]


@njit(cache=True, nogil=True)
def first_and_last_visits(firsts, rows, begins, size):
    """For each row of a place, (size,) int64: the first scan that visited it, -1 for none; and the
    last one, negated.
    """
    came = np.full(size, -1)
    gone = np.empty(size, np.int64)
    for t in range(len(firsts) - 1):
        for r in rows[begins[firsts[t]] : begins[firsts[t + 1]]]:
            came[r] = t if came[r] < 0 else came[r]
            gone[r] = -t
    return came, gone


@njit(cache=True, nogil=True)
def scans_of_objects(firsts, count):
    """(O,) int64: the scan of each object."""
    when = np.empty(count, np.int64)
    for t in range(len(firsts) - 1):
        when[firsts[t] : firsts[t + 1]] = t
    return when


@njit(cache=True, nogil=True)
def predecessors(firsts, at, columns, width):
    """(O,) int64: the earlier object that each one continues; -1 for none.

    The last one with which it shares most columns, if these are more than half of one of them.
    """
    found = np.full(len(at) - 1, -1)
    shared = np.zeros(len(at) - 1, np.int64)
    last = np.full(width, -1)
    for t in range(len(firsts) - 1):
        for of in range(firsts[t], firsts[t + 1]):
            most = -1
            its = columns[at[of] : at[of + 1]]
            for c in its:
                other = last[c]
                if other >= 0:
                    shared[other] += 1
                    most = other if most < 0 or shared[other] > shared[most] else most
            if most >= 0 and 2 * shared[most] > min(at[most + 1] - at[most], len(its)):
                found[of] = most
            for c in its:
                if last[c] >= 0:
                    shared[last[c]] = 0
        for of in range(firsts[t], firsts[t + 1]):
            last[columns[at[of] : at[of + 1]]] = of
    return found


@njit(cache=True, nogil=True)
def displacement(before, after, guard):
    """Along which of the ``WAYS`` an outline is displaced, given how far it reaches.

    (8,) metres each; -1 if it is not. By a translation of at least twice the guard, to half of it.
    """
    x = (after[0] - before[0] - after[4] + before[4]) / 2
    y = (after[1] - before[1] - after[5] + before[5]) / 2
    if (
        x * x + y * y < 4 * guard * guard
    ):  # most objects stand: to see this first saves a third of the time
        return -1
    way = 0
    far = 0.0
    for k in range(8):
        along = x * WAYS[k, 0] + y * WAYS[k, 1]
        if abs(after[k] - before[k] - along) > guard / 2:
            return -1
        if along > far:
            way = k
            far = along
    return way if far >= 2 * guard else -1


@njit(cache=True, nogil=True)
def end_of(rows, way, limit, centres, scans, than, own, shared, link):
    """Whether most places of an object beyond a limit along one of the ``WAYS`` are of scans after
    one, so that nothing else was there; and whether most of them are dynamic.
    """
    count = 0
    free = 0
    dynamic = 0
    for r in rows:
        if centres[r, 0] * WAYS[way, 0] + centres[r, 1] * WAYS[way, 1] > limit:
            count = count + 1
            free = free + (scans[r] > than)
            dynamic += combined(r, own, shared, link) > 0
    return 2 * free > count, 2 * dynamic > count

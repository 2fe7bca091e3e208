"""When places, such as quarter columns, had points above the ground and dynamic objects."""

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def note(places, squares, within, up, now, seen, first, scans, viewed):
    """Note which places have points in a scan, and which squares around them were seen at all.

    Args:
        places: (N,) int64, the place of each point.
        squares: (all places / 4,) int32, the square that contains each four places.
        within: (N,) bool: points that show that a square was seen.
        up: (N,) bool: points that show that something is in a place.
        now: number of this scan.
        seen, first, scans: (all places,) int32: the last and the first scan with something, and their number. Modified.
        viewed: (2, squares) int32: the first and the last scan in which each square was seen. Modified.
    """
    for i in range(len(places)):
        place = places[i]
        if within[i]:
            square = squares[place >> 2]
            viewed[0, square] = min(viewed[0, square], now)
            viewed[1, square] = now
        if up[i] and seen[place] != now:
            seen[place], first[place] = now, min(first[place], now)
            scans[place] += 1


@njit(cache=True, nogil=True)
def trails(objects, n, places, now, lately, before, movers, seen, dynamic, first):
    """What was in the places of each of n objects, in earlier and later scans.

    Args:
        objects: (N,) int32, the object of each point, or -1.
        places: (N,) int64, the quarter column of each point.
        now: number of this scan.
        lately, before: numbers of scans.
        movers: (3, all places) int32: the last scan with a dynamic object in each place, the number of scans in which
            that object was dynamic, and the first scan with one.
        seen, dynamic, first: (all places,) int32: the last scan with points and with dynamic objects, over all scans,
            and the first scan with points.

    Returns:
        (4, n) int64: points where a dynamic object was at most ``lately`` scans ago, the maximum number of scans in
        which it was dynamic, points where the last object ever seen is dynamic, in this scan or later, and points where
        something was more than ``before`` scans before any dynamic object.
    """
    found = np.zeros((n, 4), np.int64)
    for i in range(len(objects)):
        k, place = objects[i], places[i]
        if k < 0:
            continue
        if movers[0, place] >= now - lately:
            found[k, 0] += 1
            found[k, 1] = max(found[k, 1], movers[1, place])
        found[k, 2] += dynamic[place] >= now and seen[place] <= dynamic[place] + lately
        found[k, 3] += first[place] < movers[2, place] - before
    return found.T.copy()


@njit(cache=True, nogil=True)
def leave(objects, moving, leaves, proven, places, now, last, proof, first):
    """Mark the places of moving objects, (n,) bool, with this scan and their proof, (n,), or the maximum of several.

    Only the points in ``leaves``, (N,) bool, leave a mark. ``first`` keeps the first scan with such an object in each
    place.
    """
    for i in range(len(objects)):
        k = objects[i]
        if k >= 0 and moving[k] and leaves[i]:
            place = places[i]
            proof[place] = max(proof[place], proven[k]) if last[place] == now else proven[k]
            last[place] = now
            first[place] = min(first[place], now)

"""When each place was last and first seen with points, and with dynamic objects: the trails that objects follow."""

from __future__ import annotations

import numpy as np

from dynaviz import kernels
from dynaviz.arrays import I32, I64, Bool

LATELY = 3  # number of scans for which the position of a dynamic object is remembered
BEFORE = 30  # number of scans before the first dynamic object: what was already in its place then stays there
NEVER = 1 << 30  # later than any scan
AT_ONCE = 2  # scans between the first or last sight of a square and of what is there from the beginning or to the end
MOSTLY = 0.5  # minimum share of the scans in that time in which it was seen


class Trails:
    """The scans in which places, such as quarter columns, had points above the ground and dynamic objects.

    Attributes:
        labelled, observed: (3, places) int32, of dynamic objects when scans are labelled, and when they are observed:
            the last scan with one, the number of scans in which that one was dynamic, and the first scan with one.

    Args:
        squares: (places / 4,) int32, the square that contains each four places, a few metres wide; from 0 on.
    """

    def __init__(self, squares: I32) -> None:
        places = 4 * len(squares)
        self.labelled, self.observed = _no_movers(places), _no_movers(places)
        self._squares = squares
        self._seen, self._dynamic = (np.full(places, -LATELY - 1, np.int32) for _ in range(2))
        self._first, self._scans = np.full(places, NEVER, np.int32), np.zeros(places, np.int32)
        self._viewed = np.tile(np.array([[NEVER], [-1]], np.int32), int(squares.max()) + 1)

    def observe(self, places: I64, within: Bool, up: Bool, dynamic: Bool, now: int) -> None:
        """Note what is in the places of a scan.

        Args:
            places: (N,) int64, the place of each point.
            within: (N,) bool, points in the map; up: points above the ground; dynamic: points of objects that are
                dynamic by their votes.
            now: position of the scan.
        """
        kernels.places.note(places, self._squares, within, up, now, self._seen, self._first, self._scans, self._viewed)
        self._dynamic[places[dynamic]] = now

    def restart(self) -> I32:
        """Forget the dynamic objects of labelled scans; returns them as they were."""
        before, self.labelled = self.labelled, _no_movers(self.labelled.shape[1])
        return before

    def forget(self, columns: I64, squares: I64) -> None:
        """Forget what was first seen in columns of four places, and in squares, that are now elsewhere."""
        for first in (self._first, self.labelled[2], self.observed[2]):
            first[:-4].reshape(-1, 4)[columns] = NEVER
        self._scans[:-4].reshape(-1, 4)[columns] = 0
        self._viewed[0, squares] = NEVER

    def around(self, objects: I32, n: int, places: I64, now: int, movers: I32) -> I64:
        """(4, n) int64: what was in the places of each of n objects; see ``kernels/places.py``.

        Args:
            objects: (N,) int32, the object of each point, or -1; places: (N,) int64.
            now: position of the scan.
            movers: ``labelled`` or ``observed``.
        """
        over_all = self._seen, self._dynamic, self._first
        found: I64 = kernels.places.trails(objects, n, places, now, LATELY, BEFORE, movers, *over_all)
        return found

    def spans(self, parts: I32, n: int, places: I64, now: int, movers: I32) -> I64:
        """(3, n) int64: for how many scans something is in the places of each of n parts, summed over their points.

        First those before the first dynamic object there, at most until now; then those after now. Places where all
        points were low in their scans count as empty. The third row counts points in places where something was as soon
        as the square around them was seen.

        Args:
            parts: (N,) int32, the part of each point, or -1; places, now, movers: as in ``around``.
        """
        rows = np.flatnonzero(parts >= 0)
        where = places[rows]
        earlier = np.maximum(np.minimum(movers[2, where], now) - self._first[where], 0)
        later = np.maximum(self._seen[where] - now, 0)
        sums = [np.bincount(parts[rows], scans, n) for scans in (earlier, later, self._from_the_beginning(where))]
        return np.array(sums, np.float64).astype(np.int64)

    def always(self, places: I64, lasting: int) -> Bool:
        """(K,) bool: places where something was from the first to the last sight of the square around them.

        Args:
            places: (K,) int64.
            lasting: minimum time for which something must be there, scans.
        """
        span = self._seen[places] - self._first[places] + 1
        to_the_end = self._seen[places] >= self._viewed[1, self._squares[places >> 2]] - AT_ONCE
        lasts = (span >= lasting) & (self._scans[places] >= MOSTLY * span)
        always: Bool = self._from_the_beginning(places) & to_the_end & lasts
        return always

    def _from_the_beginning(self, places: I64) -> Bool:
        """(K,) bool: places where something was as soon as the square around them was seen."""
        since: Bool = self._first[places] <= self._viewed[0, self._squares[places >> 2]] + AT_ONCE
        return since


def _no_movers(places: int) -> I32:
    return np.tile(np.array([[-LATELY - 1], [0], [NEVER]], np.int32), places)

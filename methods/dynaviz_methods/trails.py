"""When each place was last and first seen with points, and with dynamic objects: the trails that objects follow."""

from __future__ import annotations

import numpy as np

from dynaviz import kernels
from dynaviz.arrays import I32, I64

LATELY = 3  # number of scans for which the position of a dynamic object is remembered
BEFORE = 30  # number of scans before the first dynamic object: what was already in its place then stays there
NEVER = 1 << 30  # later than any scan


class Trails:
    """The scans in which places, such as quarter columns, had points above the ground and dynamic objects.

    Attributes:
        labelled, observed: (3, places) int32, of dynamic objects when scans are labelled, and when they are observed:
            the last scan with one, the number of scans in which that one was dynamic, and the first scan with one.

    Args:
        places: number of places.
    """

    def __init__(self, places: int) -> None:
        self.labelled, self.observed = _no_movers(places), _no_movers(places)
        self._seen, self._dynamic = (np.full(places, -LATELY - 1, np.int32) for _ in range(2))
        self._first = np.full(places, NEVER, np.int32)

    def observe(self, up: I64, dynamic: I64, now: int) -> None:
        """Note the places of points above the ground, and of objects that are dynamic by their votes, in this scan."""
        self._seen[up], self._first[up] = now, np.minimum(self._first[up], now)
        self._dynamic[dynamic] = now

    def restart(self) -> I32:
        """Forget the dynamic objects of labelled scans; returns them as they were."""
        before, self.labelled = self.labelled, _no_movers(self.labelled.shape[1])
        return before

    def forget(self, columns: I64) -> None:
        """Forget what was first seen in columns of four places that are now elsewhere."""
        for first in (self._first, self.labelled[2], self.observed[2]):
            first[:-4].reshape(-1, 4)[columns] = NEVER

    def around(self, objects: I32, n: int, places: I64, now: int, movers: I32) -> I64:
        """(4, n) int64: what was in the places of each of n objects; see ``kernels/objects.py``.

        Args:
            objects: (N,) int32, the object of each point, or -1; places: (N,) int64.
            now: position of the scan.
            movers: ``labelled`` or ``observed``.
        """
        over_all = self._seen, self._dynamic, self._first
        found: I64 = kernels.objects.trails(objects, n, places, now, LATELY, BEFORE, movers, *over_all)
        return found

    def spans(self, parts: I32, n: int, places: I64, now: int, movers: I32) -> I64:
        """(2, n) int64: the scans for which something is in the places of each of n parts, summed over their points.

        First those before the first dynamic object there, at most until now; then those after now.

        Args:
            parts: (N,) int32, the part of each point, or -1; places, now, movers: as in ``around``.
        """
        rows = np.flatnonzero(parts >= 0)
        where = places[rows]
        earlier = np.minimum(movers[2, where], now) - self._first[where]
        later = self._seen[where] - now
        sums = [np.bincount(parts[rows], scans, n) for scans in (earlier, later)]
        return np.array(sums, np.float64).astype(np.int64)


def _no_movers(places: int) -> I32:
    return np.tile(np.array([[-LATELY - 1], [0], [NEVER]], np.int32), places)

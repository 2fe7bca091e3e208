"""Parts of objects that stay: rays stop at them, and they were there before any mover, or as long as they were seen."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from dynaviz import kernels
from dynaviz.arrays import F32, F64, I32, I64, Bool, Intp

UNSEEN = 0.05  # maximum mean vote of a cell whose rays stop
MANY = 10  # minimum number of points
UNTOUCHED = 0.05  # maximum share of points seen clear
TOUCHED = 0.3  # the same for a part that lasts
SINCE = 0.7  # share of points in places where something was from the beginning
EARLIER = 0.5  # scans: or minimum mean time for which something was there before any dynamic object
EARLIER_FOLLOWED = 6.0  # the same for parts of an object that is followed: a car that parks was there a moment before
LASTING = 8  # scans: minimum mean time for which something is there before any dynamic object, or after this scan
ALWAYS = 0.7  # minimum share of points in places where something always was, for a part that lasts
LONG = 30  # scans: minimum time for that: a crowd, or a car that waits, may be there for less
WIDE = 3.5  # metres: minimum width of a part that lasts: places of a crowd are always taken, one after the other
NOTHING = np.empty(0, np.intp), np.empty(0, np.intp)  # no rows that stay, and none that last

Sums = Callable[[I32, int], I64]


def staying(
    points: F32,
    objects: I32,
    cells: tuple[float, float],
    votes: int,
    earliest: F64,
    always: Bool,
    tally: Sums,
    spans: Sums,
) -> tuple[Intp, Intp]:
    """Rows of the points of parts that stay, and of those that last: connected cells with hardly any votes.

    Hardly any point of a part that stays was ever seen clear. A part that lasts may be seen clear more often, but is
    wide, and something always was in its places.

    Args:
        points: (N, 3) float32, metres.
        objects: (N,) int32, the object of each point.
        cells: edge of the cells that join points to objects, horizontally and vertically, metres.
        votes: maximum vote of a voxel, scans.
        earliest: (objects,) float64, scans: how long before any dynamic object something must have been in the places
            of a part, if it was not there from the beginning.
        always: (N,) bool: points in places where something was from the beginning to the end, for ``LONG``.
        tally: from the group of each point, (N,) int32, -1 for none, and the number of groups: the evidence of each,
            as in ``kernels.objects.evidence``.
        spans: from the same, (3, groups) int64: sums of the scans for which something was there earlier, and later; and
            the number of points where something was from the beginning.
    """
    mine, keys, _ = kernels.objects.cells_of(points, np.ones(len(points), np.bool_), *cells)
    _, having, voted, *_ = tally(mine, len(keys))
    stop = voted <= 1000 * UNSEEN * votes * np.maximum(having, 1)
    chosen = stop[mine]
    rows = np.flatnonzero(chosen)
    parts, n = kernels.objects.connect(points, chosen, *cells)
    size, _, _, touched, _, _, against = tally(parts, n)
    earlier, later, since = spans(parts, n)
    part = parts[rows]
    of = np.zeros(n, np.int32)
    of[part] = objects[rows]
    first = since >= SINCE * size
    before = first | (earlier >= earliest[of] * size)
    stays = before & (earlier + later >= LASTING * size) & (size > MANY) & (against >= 3 * size)
    stays &= touched <= UNTOUCHED * size
    lasts = ~stays & (touched <= TOUCHED * size) & (np.bincount(part, always[rows], n) >= ALWAYS * size)
    lasts[lasts] = [_width(points[rows[part == k]]) >= WIDE for k in np.flatnonzero(lasts)]
    return rows[stays[part]], rows[lasts[part]]


def _width(points: F32) -> float:
    """The horizontal diagonal of the box around some points, (N, 3), metres."""
    return float(np.hypot(*np.ptp(points[:, :2], axis=0)))

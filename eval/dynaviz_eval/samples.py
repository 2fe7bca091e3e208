"""Points chosen by a number that follows from their frame and row: the same for every method.

Those with the smallest numbers of a group are a sample of it, however the group grows or joins.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dynaviz.arrays import F32, I64, U8, U64, Bool, Intp

POINT = np.dtype(
    [
        ("group", np.int64), ("frame", np.int32), ("row", np.int32), ("priority", np.uint64),
        ("xyz", np.float32, 3), ("height", np.float32), ("reason", np.uint8),
        ("removed", np.bool_),
    ]
)  # fmt: skip
_AHEAD = 2.0  # times the points wanted: how many of a frame are tried


def priorities(frame: int, rows: Intp) -> U64:
    """(K,) uint64: pseudo-random numbers of points, given their frame and rows in its scan."""
    x = rows.astype(np.uint64) + (np.uint64(frame + 1) << np.uint64(32))
    for shift, factor in ((30, 0xBF58476D1CE4E5B9), (27, 0x94D049BB133111EB)):
        x = (x ^ (x >> np.uint64(shift))) * np.uint64(factor)
    mixed: U64 = x ^ (x >> np.uint64(31))
    return mixed


def likely(priority: U64, sizes: I64, wanted: int) -> Bool:
    """(K,) bool: points that can be among the ``wanted`` of their group.

    Args:
        priority: (K,) of the points of a frame.
        sizes: (K,) number of points of the frame in each one's group.
        wanted: points of each group.
    """
    share = np.minimum(_AHEAD * wanted / np.maximum(sizes, 1), 1.0)
    chosen: Bool = priority < share * float(1 << 64)
    return chosen | (share >= 1.0)


def records(
    frame: int,
    rows: Intp,
    groups: I64,
    priority: U64,
    points: F32,
    heights: F32 | None,
    reasons: U8,
    removed: Bool | bool,
) -> NDArray[np.void]:
    """(K,) records of points of a frame."""
    found = np.empty(len(rows), POINT)
    found["frame"] = frame
    found["row"] = rows
    found["group"] = groups
    found["priority"] = priority
    found["xyz"] = points
    found["height"] = np.nan if heights is None else heights
    found["reason"] = reasons
    found["removed"] = removed
    return found


def smallest(sample: NDArray[np.void], wanted: int) -> NDArray[np.void]:
    """The ``wanted`` points of each group with the smallest numbers, sorted by group."""
    sample = sample[np.lexsort((sample["priority"], sample["group"]))]
    _, starts, sizes = np.unique(sample["group"], return_index=True, return_counts=True)
    rank = np.arange(len(sample)) - np.repeat(starts, sizes)
    return sample[rank < wanted]


class Sample:
    """At most ``wanted`` points of each group, of points that come frame by frame.

    Args:
        wanted: points of each group.
    """

    def __init__(self, wanted: int) -> None:
        self._wanted = wanted
        self._parts = [np.empty(0, POINT)]
        self._waiting = 0
        self._limits: dict[int, float] = {}

    def add(self, points: NDArray[np.void]) -> None:
        """Add records of points."""
        if not len(points):
            return
        groups, of = np.unique(points["group"], return_inverse=True)
        limits = np.array([self._limits.get(group, np.inf) for group in groups.tolist()])
        points = points[points["priority"] <= limits[of]]
        self._parts.append(points)
        self._waiting += len(points)
        if self._waiting > 4 * self._wanted * max(len(self._limits), 1):
            self.settle()

    def settle(self) -> NDArray[np.void]:
        """Drop the points that are not among those wanted; the others, sorted by group."""
        found = smallest(np.concatenate(self._parts), self._wanted)
        self._parts = [found]
        self._waiting = 0
        groups, starts, sizes = np.unique(found["group"], return_index=True, return_counts=True)
        full = sizes >= self._wanted
        last = found["priority"][starts + sizes - 1]
        self._limits = dict(
            zip(groups[full].tolist(), last[full].astype(np.float64).tolist(), strict=True)
        )
        return found

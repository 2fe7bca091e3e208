"""Which points or voxels of a state are drawn if there are too many.

All around errors, fewer elsewhere.
"""

from __future__ import annotations

import numpy as np

from dynaviz import kernels
from dynaviz.arrays import F32, I64, Bool
from dynaviz.contracts.scan import Label, Scan

# metres from the sensor along each axis: the part of a state that is drawn
REACH = np.array([60.0, 60.0, 30.0])
CELL = 1.0  # metres: edge of the cells around errors
SHARE = 0.5  # of the budget, at most, for what lies around errors
NEAR = 8.0  # metres: beyond twice this range, the rest is thinned more
FINE = 0.1  # metres: least distance of what is left
ROUNDS = 5  # of thinning; what is still too much is cut
MORE = 4  # a round of thinning ends at this many times the points wanted, and cells are made larger
ENOUGH = 5  # a round looks at this many times the points wanted, if there are more
_SHAPE = tuple((2 * REACH / CELL).astype(int).tolist())


class Budget:
    """Chooses what to draw of the states of one scan.

    Args:
        scan: the scan; what lies around its true dynamic points is drawn first, if it has labels.
        most: number of points or voxels of a state, at most.
        errors: (K, 3) float32, metres, world frame: wrong points, drawn around first too; None if
            not known yet.
    """

    def __init__(self, scan: Scan, most: int, errors: F32 | None = None) -> None:
        self._most = most
        self._centre = scan.position.copy()
        self._corner = scan.position - REACH
        self._interest: Bool = np.zeros(_SHAPE, np.bool_)
        if scan.labels is not None:
            self._mark(scan.points[scan.labels == Label.DYNAMIC])
        if errors is not None:
            self._mark(errors)

    def chosen(self, xyz: F32) -> I64:
        """Indices of (N, 3) points, metres, world frame, to draw: at most ``most``, ascending."""
        points = kernels.as_readonly(xyz, np.float32)
        first, others = kernels.thinning.split(points, self._corner, CELL, self._interest)
        if len(first) + len(others) > self._most:
            first = self._fitted(
                points, first, max(int(SHARE * self._most), self._most - len(others))
            )
            others = self._fitted(points, others, self._most - len(first))
        return np.sort(np.concatenate([first, others]))

    def _fitted(self, points: F32, rows: I64, room: int) -> I64:
        """At most ``room`` of these rows, spread evenly over the places."""
        excess = len(rows) / max(room, 1)
        size = FINE
        for _ in range(ROUNDS):
            if excess <= 1:
                return rows
            size *= max(1.2, float(np.sqrt(excess)))  # the number of cells falls with the square
            share = min(1.0, ENOUGH * room / len(rows))
            kept, complete = kernels.thinning.thinned(
                points, rows, self._centre, size, NEAR, MORE * room, share
            )
            if complete:
                rows = kept
                excess = len(kept) / max(room, 1)
            else:
                excess = 2.0
        return (
            rows if len(rows) <= room else rows[np.linspace(0, len(rows) - 1, room).astype(np.intp)]
        )

    def _mark(self, points: F32) -> None:
        """Mark the cells of points, and those around them."""
        kernels.thinning.mark(
            kernels.as_readonly(points, np.float32), self._corner, CELL, self._interest
        )

"""The rays of a scan that touch points.

Which, from where, at which angle, and how far they go on.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from dynaviz import kernels
from dynaviz.arrays import F32, F64, I64, Bool, Intp
from dynaviz.contracts.scan import Scan
from dynaviz.spatial.surface import angles

CUBE = 4.0  # metres: cells in a cube of this edge are searched together


@dataclass(frozen=True, slots=True, eq=False)
class Touching:
    """The rays of a scan that touch cells, by cell.

    Attributes:
        hits, crossed: (K,) int64, number of rays that end in each cell, and that pass through it.
        origins: (K, 3) float64, metres, world frame: origin of the first ray that touches it, or of
            the scan.
        lengths: (K,) float64, metres, of the rays that pass through it, median; NaN without any.
    """

    hits: I64
    crossed: I64
    origins: F64
    lengths: F64

    @classmethod
    def of(cls, scan: Scan, cells: F64) -> Touching:
        """The rays that touch (K, 2, 3) cells."""
        rays, found, ends = _touched(scan, cells)
        order = np.lexsort((rays, ~ends, found))  # of each cell, first those that end in it
        rays = rays[order]
        found = found[order]
        ends = ends[order]
        hits, crossed = (
            np.bincount(found[chosen], minlength=len(cells)) for chosen in (ends, ~ends)
        )
        origins = np.repeat(scan.origins[:1], len(cells), 0)
        one = len(scan.origins) == 1
        if not one and len(found):
            touched, first = np.unique(found, return_index=True)
            origins[touched] = scan.origins[rays[first]]
        passing = rays[~ends]
        of_cell = found[~ends]
        from_sensor = scan.points[passing] - (scan.origins if one else scan.origins[passing])
        away = np.linalg.norm(from_sensor, axis=1)
        away = away[np.lexsort((away, of_cell))]
        lengths = np.full(len(cells), np.nan)
        some = np.flatnonzero(crossed)
        first = (np.cumsum(crossed) - crossed)[some]
        half = crossed[some] // 2
        lengths[some] = (away[first + half] + away[first + crossed[some] - 1 - half]) / 2
        return cls(hits, crossed, origins, lengths)

    def seen(self, cells: Intp, points: F32, normals: F64) -> list[Geometry]:
        """Of each of (K,) cells, with a point (K, 3) and the normal of its surface (K, 3): origin,
        range, angle, numbers of rays, and how far crossing rays go on, as in ``LedgerEntry``.
        """
        origins = self.origins[cells]
        directions = points - origins
        away = np.sqrt((directions * directions).sum(1))
        return list(
            zip(
                [(x, y, z) for x, y, z in origins.tolist()],
                away.tolist(),
                plain(angles(directions, normals)),
                self.hits[cells].tolist(),
                self.crossed[cells].tolist(),
                plain(self.lengths[cells] - away),
                strict=True,
            )
        )


Geometry = tuple[tuple[float, float, float], float, float | None, int, int, float | None]


def plain(numbers: F64) -> list[float | None]:
    """Numbers (K,); None for NaN."""
    return [None if math.isnan(number) else number for number in numbers.tolist()]


def _touched(scan: Scan, cells: F64) -> tuple[I64, I64, Bool]:
    """Pairs of a ray and a cell that it touches, and whether it ends there."""
    cubes = np.floor(np.nan_to_num(cells[:, 0]) / CUBE)
    order = np.lexsort(cubes.T)
    edges = np.flatnonzero((cubes[order[1:]] != cubes[order[:-1]]).any(1)) + 1
    starts = np.concatenate([[0], edges, [len(cells)]])
    groups = len(starts) - 1
    threads = kernels.threads_in_use()
    # as many for each thread
    size = -(-groups // (threads * -(-groups // (threads * kernels.witnesses.MOST))))

    def search(first: int) -> tuple[I64, I64, Bool]:
        some = starts[first : first + size + 1]
        mine = order[some[0] : some[-1]]
        low, high = (np.ascontiguousarray(cells[mine, side]) for side in (0, 1))
        rays, boxes, ends = kernels.witnesses.touched(
            scan.points, scan.origins, some - some[0], low, high
        )
        return rays, mine[boxes], ends

    found = kernels.each(search, range(0, groups, size))
    rays, boxes, ends = (np.concatenate(each) for each in zip(*found, strict=True))
    return rays, boxes, ends


def touching(scan: Scan, cells: F64) -> Intp:
    """(K,) the points of a scan whose rays touch any of some cells, (C, 2, 3), or pass nearby.

    A method's walk along a ray rounds differently.
    """
    if not len(cells):
        return np.empty(0, np.intp)
    margin = (cells[:, 1] - cells[:, 0]) / 2
    around = np.stack([cells[:, 0] - margin, cells[:, 1] + margin], 1)
    return np.unique(_touched(scan, around)[0])

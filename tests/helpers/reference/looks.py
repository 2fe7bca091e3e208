"""Looks, slowly: a search tree over the directions to all returns of a scan.

``eval/README.md`` states the criteria; none of the product's code for looks is used.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from dynaviz.contracts.scan import Scan

MARGIN = 0.3  # metres
AROUND = np.radians(3.0)
GRAZING = np.sin(np.radians(20.0))
NEAREST = 4
APART = 0.03  # metres
HIT, THROUGH, HIDDEN, BETWEEN, OUTSIDE = range(5)
NAMES = ("hit", "through", "hidden", "between", "outside")


class Returns:
    """The returns of one scan, by direction from the origins of its rays.

    Origins in one cube of 0.03 m count as one.
    """

    def __init__(self, scan: Scan) -> None:
        origins = np.broadcast_to(np.asarray(scan.origins, float), scan.points.shape)
        _, of = np.unique(np.round(origins / APART), axis=0, return_inverse=True)
        self.parts = [
            FromOrigin(origins[of == part].mean(0), scan.points[of == part].astype(float))
            for part in range(of.max() + 1)
        ]

    def look(self, places: np.ndarray, cap: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """What the scan saw at each place: the most telling of what was seen from each origin.

        Args:
            places: (K, 3) metres, world frame.
            cap: radians: the largest angle to a return that answers.

        Returns:
            (K,) codes; (K,) metres from a place to the end behind it of the ray nearest to its
            direction, infinite without; and (K, 3) unit directions to the places.
        """
        found, beyond, ways = self.parts[0].look(places, cap)
        for part in self.parts[1:]:
            code, end, way = part.look(places, cap)
            better = code < found
            found[better] = code[better]
            beyond[better] = end[better]
            ways[better] = way[better]
        return found, beyond, ways


class FromOrigin:
    """Returns whose rays have one origin."""

    def __init__(self, origin: np.ndarray, points: np.ndarray) -> None:
        self.origin = origin
        away = points - origin
        away = away[np.isfinite(away).all(1)]
        ranges = np.linalg.norm(away, axis=1)
        near = ranges > 0.05
        self.ranges = ranges[near]
        self.ways = away[near] / self.ranges[:, None]
        self.tree = cKDTree(self.ways)

    def spacing(self, count: int = 2000) -> float:
        """The largest angle from a direction to a return that answers for it, radians."""
        chosen = np.random.default_rng(0).choice(len(self.ways), min(count, len(self.ways)), False)
        gaps, _ = self.tree.query(self.ways[chosen], k=NEAREST)
        return 1.5 * float(np.median(gaps[:, -1]))

    def look(self, places: np.ndarray, cap: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """As that of ``Returns``."""
        away = places.astype(float) - self.origin
        distance = np.linalg.norm(away, axis=1)
        ways = away / distance[:, None]
        gaps, rows = self.tree.query(ways, k=NEAREST)
        near = gaps < cap
        ends = np.where(near, self.ranges[np.minimum(rows, len(self.ranges) - 1)], np.nan)
        beyond = ends - distance[:, None]
        found = np.where(gaps[:, 0] <= AROUND, BETWEEN, OUTSIDE)
        found[near.any(1)] = HIDDEN
        with np.errstate(invalid="ignore"):
            passed = beyond >= MARGIN
            found[passed.any(1)] = THROUGH
            found[(np.abs(beyond) < MARGIN).any(1)] = HIT
        nearest = passed.argmax(1)  # the returns are sorted by angle
        behind = np.take_along_axis(beyond, nearest[:, None], 1)[:, 0]
        return found, np.where(passed.any(1), behind, np.inf), ways

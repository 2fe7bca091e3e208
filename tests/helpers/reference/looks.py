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
HIT, THROUGH, HIDDEN, BETWEEN, OUTSIDE = range(5)
NAMES = ("hit", "through", "hidden", "between", "outside")


class Returns:
    """The returns of one scan, by direction from the one origin of its rays."""

    def __init__(self, scan: Scan) -> None:
        self.sensor = np.asarray(scan.position, float)
        away = scan.points.astype(float) - self.sensor
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
        """What the scan saw at each place.

        Args:
            places: (K, 3) metres, world frame.
            cap: radians: the largest angle to a return that answers.

        Returns:
            (K,) codes; (K,) metres from a place to the nearest end behind it, infinite without; and
            (K, 3) unit directions to the places.
        """
        away = places.astype(float) - self.sensor
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
        return found, np.where(passed, beyond, np.inf).min(1), ways

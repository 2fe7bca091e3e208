"""A slow, simple ERASOR.

A list of points per voxel, a list of voxels per bin, eigenvectors from LAPACK.
"""

from __future__ import annotations

import math
from collections import defaultdict

import numpy as np

from dynaviz.contracts.scan import Scan

Key = tuple[int, int, int]


def voxels_of(points: np.ndarray, size: float) -> list[Key]:
    return [tuple(key) for key in np.floor(points * np.float32(1 / size)).astype(int).tolist()]


def centroids(points: np.ndarray, size: float) -> dict[Key, np.ndarray]:
    members = defaultdict(list)
    for key, point in zip(voxels_of(points, size), points.astype(np.float64), strict=True):
        members[key].append(point)
    return {key: np.mean(inside, 0).astype(np.float32) for key, inside in members.items()}


class Reference:
    """Reasons by voxel of the raw map."""

    def __init__(self, params, raw_map: np.ndarray, height: float):
        self.p, self.height, self.seen = params, height, 0
        self.map = centroids(raw_map, params.map_voxel)
        self.order = [
            "beyond_range",
            "outside_height_band",
            "too_few_points",
            "map_not_higher",
            "low_bin",
        ]
        self.order += ["ground_of_flagged_bin", "bin_ratio"]
        self.by_voxel = dict.fromkeys(self.map, "beyond_range")

    def observe(self, scan: Scan) -> None:
        self.seen += 1
        if self.seen % self.p.removal_interval:
            return
        foot = scan.position - (0, 0, self.height)
        left = {key: point for key, point in self.map.items() if self.by_voxel[key] != "bin_ratio"}
        map_bins = self.in_bins(left, foot)
        scan_bins = self.in_bins(centroids(scan.points, self.p.query_voxel), foot)
        for b, keys in map_bins.items():
            for key, reason in self.reasons(b, keys, scan_bins.get(b, []), left, foot).items():
                self.by_voxel[key] = max(self.by_voxel[key], reason, key=self.order.index)
        self.last = map_bins, scan_bins

    def in_bins(self, points: dict[Key, np.ndarray], foot: np.ndarray) -> dict[object, list]:
        bins = defaultdict(list)
        for key, point in points.items():
            x, y, z = point - foot
            if math.hypot(x, y) >= self.p.max_range:
                continue
            ring = math.floor(math.hypot(x, y) / (self.p.max_range / self.p.rings))
            sector = math.floor(math.degrees(math.atan2(y, x)) % 360 / (360 / self.p.sectors))
            bins[(ring, sector) if self.p.min_height < z < self.p.max_height else "outside"].append(
                (key, z)
            )
        return bins

    def reasons(
        self, b, members: list, scanned: list, points: dict[Key, np.ndarray], foot: np.ndarray
    ):
        def everyone(reason: str) -> dict[Key, str]:
            return dict.fromkeys((key for key, _ in members), reason)

        if b == "outside":
            return everyone("outside_height_band")
        if len(scanned) < self.p.min_points:
            return everyone("too_few_points")
        of_map, of_scan = (max(z for _, z in m) - min(z for _, z in m) for m in (members, scanned))
        if of_scan > of_map or of_map == 0 or of_scan / of_map >= self.p.scan_ratio:
            return everyone("map_not_higher")
        if of_map <= self.p.min_difference:
            return everyone("low_bin")
        ground = self.ground(np.array([points[key] - foot for key, _ in members]))
        names = {True: "ground_of_flagged_bin", False: "bin_ratio"}
        return {
            key: names[bool(is_ground)] for (key, _), is_ground in zip(members, ground, strict=True)
        }

    def ground(self, points: np.ndarray) -> np.ndarray:
        lowest = np.sort(points[:, 2])[self.p.ground_skip :][: self.p.ground_lowest]
        ground = points[:, 2] < (lowest.mean() if len(lowest) else 0.0) + self.p.ground_seed
        for _ in range(self.p.ground_iterations):
            if not ground.any():
                break
            centre = points[ground].mean(0)
            away = points[ground] - centre
            normal = np.linalg.eigh(away.T @ away)[1][:, 0]
            normal *= -1 if normal[2] < 0 else 1
            ground = (points - centre) @ normal < self.p.ground_distance
        return ground

    def names(self, scan: Scan) -> list[str]:
        """Names of the reasons of a scan's points."""
        return [self.by_voxel[key] for key in voxels_of(scan.points, self.p.map_voxel)]

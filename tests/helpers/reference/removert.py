"""A slow, simple Removert.

A dictionary of pixels per image, points one by one, all in double precision.
"""

from __future__ import annotations

import math
from collections import defaultdict

import numpy as np

from dynaviz.contracts.scan import Scan

Span = tuple[float, float]


def pixel(
    local: np.ndarray, resolution: float, elevation: Span, azimuth: Span, clamp: bool = False
):
    """(row, column) of a point in the frame of the image; None if outside, or at the centre."""
    x, y, z = local
    if not 0 < np.linalg.norm(local) < math.inf:
        return None
    rows, columns = (
        max(1, round((span[1] - span[0]) * resolution)) for span in (elevation, azimuth)
    )
    down = (elevation[1] - math.degrees(math.atan2(z, math.hypot(x, y)))) / (
        elevation[1] - elevation[0]
    )
    along = (math.degrees(math.atan2(y, x)) - azimuth[0]) / (azimuth[1] - azimuth[0])
    row, column = math.floor(rows * down + 0.5), math.floor(columns * along + 0.5)
    if not clamp and not (0 <= row <= rows and 0 <= column <= columns):
        return None
    return min(max(row, 0), rows - 1), min(max(column, 0), columns - 1)


def centroids(points: np.ndarray, size: float) -> dict[object, np.ndarray]:
    members = defaultdict(list)
    for i, point in enumerate(points):
        if np.isfinite(point).all():
            members[name(i, point, size)].append(point.astype(np.float64))
    return {key: np.mean(inside, 0).astype(np.float32) for key, inside in members.items()}


def name(i: int, point: np.ndarray, size: float) -> object:
    """Key of a raw point's map point: its row in the raw map, or its voxel."""
    return tuple(math.floor(c * np.float32(1 / size)) for c in point) if size else i


def as_cloud(points: list[np.ndarray]) -> np.ndarray:
    return np.array(points, float).reshape(-1, 3)


class Reference:
    def __init__(self, params, raw_map: np.ndarray, elevation: Span, azimuth: Span):
        self.p, self.raw_map = params, raw_map
        self.view = elevation, azimuth
        self.map = centroids(raw_map, params.voxel)
        self.nearer: dict[object, set[int]] = defaultdict(
            set
        )  # resolutions at which a scan sees past a map point
        self.surfaces: dict[object, int] = defaultdict(
            int
        )  # scans with a surface there, at the first resolution
        self.in_view: set[object] = set()
        self.first: dict[int, int] = {}
        self.end = 0

    def observe(self, scan: Scan) -> None:
        self.first[scan.index] = self.end
        self.end += len(scan)
        for k, resolution in enumerate((*self.p.resolutions, *self.p.revert_resolutions)):
            image: dict[object, float] = {}
            for point in scan.points:
                at, distance = self.place(scan, point, resolution)
                if at is not None:
                    image[at] = min(distance, image.get(at, math.inf))
            farthest = max(image.values(), default=0.0)
            self.reach = farthest + 200 if self.p.port else farthest * (1 + self.p.threshold)
            (self.judge_nearest if self.p.port else self.judge_all)(scan, k, resolution, image)

    def place(self, scan: Scan, point: np.ndarray, resolution: float):
        away = point.astype(np.float64) - scan.position
        local = away if self.p.port else scan.T_world_sensor[:3, :3].T @ away
        return pixel(local, resolution, *self.view, clamp=self.p.port), float(np.linalg.norm(away))

    def judge_all(self, scan: Scan, k: int, resolution: float, image: dict) -> None:
        for key, point in self.map.items():
            at, distance = self.place(scan, point, resolution)
            if at not in image or distance > self.reach:
                continue
            if image[at] - distance > self.p.threshold * image[at]:
                self.nearer[key].add(k)
            if k == 0:
                self.in_view.add(key)
                self.surfaces[key] += abs(image[at] - distance) <= self.p.threshold * image[at]

    def judge_nearest(self, scan: Scan, k: int, resolution: float, image: dict) -> None:
        nearest: dict[object, tuple[float, object]] = {}
        for key, point in self.map.items():
            at, distance = self.place(scan, point, resolution)
            if (
                at is not None
                and distance < nearest.get(at, (math.inf, None))[0]
                and distance <= self.reach
            ):
                nearest[at] = distance, key
        for at, (distance, key) in nearest.items():
            if at in image:
                difference = abs(image[at] - distance)
                if self.p.threshold * image[at] < difference < 200:
                    self.nearer[key].add(k)
                elif k == 0:
                    self.surfaces[key] += 1
        self.in_view = set(self.map)

    def removed(self, key: object) -> bool:
        revert = set(
            range(len(self.p.resolutions), len(self.p.resolutions) + len(self.p.revert_resolutions))
        )
        return bool(self.nearer[key] - revert) and revert <= self.nearer[key]

    def by_map(self, key: object) -> str:
        resolutions = [k for k in self.nearer[key] if k < len(self.p.resolutions)]
        if self.removed(key):
            return f"nearer_than_scan_at_res_{min(min(resolutions), 2) + 1}"
        if resolutions:
            return "reverted"
        if self.surfaces[key] >= 2:
            return "agrees"
        return "hidden" if key in self.in_view else "out_of_view"

    def keys(self, scan: Scan) -> list[object]:
        """None for points that are not finite."""
        numbered = enumerate(scan.points, self.first[scan.index])
        return [
            name(i, point, self.p.voxel) if np.isfinite(point).all() else None
            for i, point in numbered
        ]

    def label(self, scan: Scan) -> list[bool]:
        keys = self.keys(scan)
        if not self.p.scan_neighbours:
            return [key is not None and self.removed(key) for key in keys]
        own = as_cloud(
            [point for key, point in zip(keys, scan.points, strict=True) if key is not None]
        )
        left = as_cloud([point for key, point in self.map.items() if not self.removed(key)])
        return [
            key is not None
            and abs(self.density(point, own) - self.density(point, left)) >= self.p.scan_difference
            for key, point in zip(keys, scan.points, strict=True)
        ]

    def density(self, point: np.ndarray, cloud: np.ndarray) -> float:
        away = cloud - point.astype(float)
        squares = np.sort((away**2).sum(1))[: self.p.scan_neighbours]
        return float(squares.mean()) if len(squares) == self.p.scan_neighbours else math.inf

    def reasons(self, scan: Scan, dynamic: list[bool]) -> list[str]:
        """Names of reasons, for the labels from ``label``."""
        return [
            self.reason(key, removed) for key, removed in zip(self.keys(scan), dynamic, strict=True)
        ]

    def reason(self, key: object, dynamic: bool) -> str:
        if key is None:
            return "out_of_view"
        if dynamic == self.removed(key):
            return self.by_map(key)
        return "left_alone" if dynamic else "surrounded"

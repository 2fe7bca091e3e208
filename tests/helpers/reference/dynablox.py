"""Dynablox on dense arrays, one voxel and point at a time; slow."""

from __future__ import annotations

import math
from itertools import product

import numpy as np

SIDES = [(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)]
CUBE = list(product((-1, 0, 1), repeat=3))
NEVER_FREE, FREE, FREE_SMALL, FREE_LARGE, BESIDE, REVOKED, OUT_OF_RANGE, OUT_OF_REACH = range(8)


class Reference:
    def __init__(self, params, rows, top, bottom, low, high):
        self.p, self.rows, self.top, self.bottom = (
            params,
            rows,
            math.radians(top),
            math.radians(bottom),
        )
        self.low = np.floor(np.array(low) / params.resolution).astype(int) - 2
        self.shape = np.floor(np.array(high) / params.resolution).astype(int) + 3 - self.low
        self.distance, self.weight = np.zeros(self.shape, np.float32), np.zeros(self.shape, int)
        self.last, self.count = np.full(self.shape, -1), np.zeros(self.shape, int)
        self.free, self.revoked, self.updated = (np.zeros(self.shape, bool) for _ in range(3))
        self.frame = -1

    def key(self, point):
        return tuple(
            (
                np.floor(np.asarray(point, float) * (1.0 / self.p.resolution)).astype(int)
                - self.low
            ).tolist()
        )

    def observe(self, scan):
        """Reason code of each point."""
        self.frame += 1
        keys = [self.key(point) if self.in_range(scan, point) else None for point in scan.points]
        codes = self.judge(scan, keys)
        self.learn({key for key in keys if key is not None})
        self.integrate(scan, keys)
        return codes

    def in_range(self, scan, point):
        r = math.dist(point.astype(float), scan.position) if np.isfinite(point).all() else math.nan
        return r > 0 and self.p.min_range <= r <= (self.p.max_range or math.inf)

    def judge(self, scan, keys):
        codes = [
            OUT_OF_RANGE if k is None else REVOKED if self.revoked[k] else NEVER_FREE for k in keys
        ]
        for cluster in self.merged(scan, self.grown(keys)):
            small, large = len(cluster) < self.p.min_cluster, len(cluster) > self.p.max_cluster
            for i in cluster:
                if self.free[keys[i]]:
                    codes[i] = FREE_SMALL if small else FREE_LARGE if large else FREE
                elif not small and not large:
                    codes[i] = BESIDE
        return codes

    def grown(self, keys):
        """Lists of points; each cluster is grown completely before the next."""
        points = {}
        for i, key in enumerate(keys):
            if key is not None:
                points.setdefault(key, []).append(i)
        done, clusters = set(), []
        for seed in points:
            if not self.free[seed] or seed in done:
                continue
            cluster, stack = [], [seed]
            done.add(seed)
            while stack:
                key = stack.pop()
                cluster += points[key]
                if self.free[key]:
                    for side in SIDES:
                        other = tuple(np.add(key, side).tolist())
                        if other in points and other not in done:
                            done.add(other)
                            stack.append(other)
            clusters.append(cluster)
        return clusters

    def merged(self, scan, clusters):
        xyz = scan.points.astype(float)
        groups = []
        for cluster in clusters:
            near, apart = [cluster], []
            for group in groups:
                between = np.linalg.norm(xyz[cluster][:, None] - xyz[group][None], axis=2).min()
                (near if between < self.p.cluster_distance else apart).append(group)
            groups = [*apart, [i for group in near for i in group]]
        return groups

    def learn(self, with_points):
        reached = []
        occupied = np.argwhere(self.updated & (self.distance < self.near)).tolist()
        for k in {tuple(k) for k in occupied} | with_points:
            on_end = self.last[k] >= 0 and self.frame - self.last[k] <= self.p.temporal_buffer
            self.count[k] = self.count[k] + 1 if on_end else 1
            self.last[k] = self.frame
            if self.count[k] >= self.p.revoke_after:
                reached.append(k)
        clear = (
            (self.weight > 0)
            & (self.distance >= self.near)
            & (self.frame - self.last > self.p.burn_in)
        )
        for k in np.argwhere(self.updated & clear & ~self.free):
            if all(clear[tuple(k + d)] for d in CUBE):
                self.free[tuple(k)] = True
                self.revoked[tuple(k)] = False
        for k, d in product(reached, CUBE):
            around = tuple(np.add(k, d))
            self.revoked[around] |= self.free[around]
            self.free[around] = False

    @property
    def near(self):
        return np.float32(self.p.occupied_distance)

    def pixels(self, scan, points):
        """Row, column and range of each point, in the sensor's frame."""
        x, y, z = scan.T_world_sensor[:3, :3].T @ (np.asarray(points, float) - scan.position).T
        spacing = (self.top - self.bottom) / (self.rows - 1)
        rows = np.floor((self.top - np.arctan2(z, np.hypot(x, y))) / spacing + 0.5)
        columns = np.floor(
            (np.arctan2(y, x) + math.pi) / (2 * math.pi) * self.p.image_columns + 0.5
        )
        return zip(
            rows, columns % self.p.image_columns, np.sqrt(x * x + y * y + z * z), strict=True
        )

    def integrate(self, scan, keys):
        image = {}
        points = scan.points[[key is not None for key in keys]]
        for row, column, r in self.pixels(scan, points):
            image[row, column] = min(image.get((row, column), math.inf), r)
        self.updated[:] = False
        voxels = np.array(list(product(*(range(1, n - 1) for n in self.shape))))
        centres = (voxels + self.low + 0.5) * self.p.resolution
        for k, (row, column, r) in zip(
            map(tuple, voxels.tolist()), self.pixels(scan, centres), strict=True
        ):
            distance = image.get((row, column), math.nan) - r if 0 <= row < self.rows else math.nan
            if distance >= -self.p.truncation:
                one, cut = np.float32(1), np.float32(min(distance, self.p.truncation))
                weight = np.float32(self.weight[k])
                self.distance[k] = (self.distance[k] * weight + cut) / (weight + one)
                self.weight[k] = min(self.weight[k] + 1, self.p.max_weight)
                self.updated[k] = True

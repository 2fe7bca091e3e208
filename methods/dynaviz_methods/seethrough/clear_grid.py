"""A block grid for SeeThrough: rays to voxels with points and into the sky, and the voxels near hits."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dynaviz import kernels
from dynaviz.arrays import F32, F64, I64, U64, Bool
from dynaviz.blocks.blocks import BlockGrid, Marks
from dynaviz.contracts.extent import Extent
from dynaviz.contracts.scan import Scan
from dynaviz.contracts.sensors import Sensor
from dynaviz.spatial.grid import KeySet, in_key_range, pack, unpack
from dynaviz_methods.sky import sensor_image

SENSORS = 8  # up to so many origins are those of sensors whose scans were merged; more are those of one that moves


class ClearGrid(BlockGrid):
    """A block grid that marks the voxels near the hits of a scan.

    Args:
        extent: where points will lie.
        resolution: edge of a voxel, metres.
        spare: metres above and below the extent where blocks may be added.
        sensor: casts rays into the sky if its field of view is known.
    """

    def __init__(self, extent: Extent, resolution: float, spare: float = 0.0, sensor: Sensor | None = None) -> None:
        super().__init__(extent, resolution, spare)
        self._image = sensor_image(sensor) if sensor is not None else None
        # Scratch memory, all zero between scans.
        self._rows, self._once = np.zeros(len(self) + 1, np.int32), np.zeros((len(self) + 1, 8), np.int64)
        # Of the scan before: its hits, and the blocks that it marked; and the order of its voxels.
        self._before, self._last = self.per_block(np.zeros((len(self) + 1, 8), np.uint64)), np.empty(0, np.int32)
        self._order = 1

    def mark_once(self, scan: Scan, voxels: I64) -> Marks:
        """Mark the voxels with points, and those that rays cross on the way to them and into the sky.

        Of the voxels of a cube of 2^3, one gets a ray per origin, unless the sensor moves during the scan: the other
        rays would cross nearly the same voxels. It is the first and the last one by turns, so that a sensor that stands
        does not miss the same voxels in each scan. Rays into the sky cross voxels, but hit none.

        Args:
            scan: gives the origins of the rays.
            voxels: (N,) int64, the voxel of each point, -1 for none.
        """
        self._order = -self._order
        places, which = _distinct(scan.origins)
        parts = _by_sensor(scan, places, which)
        owners = [voxels] if len(parts) == 1 else [voxels[which == k] for k in range(len(parts))]
        rays = [self._rays(part, own, len(places) > SENSORS) for part, own in zip(parts, owners, strict=True)]
        ends, casts, hits = (np.concatenate([each[k] for each in rays]) for k in range(3))
        starts = rays[0][3]
        if len(parts) > 1:
            starts = np.concatenate([np.broadcast_to(each[3], each[0].shape) for each in rays])
        way = kernels.as_readonly(ends, np.float32), kernels.as_readonly(starts, np.float64)
        return self._cast(*way, kernels.as_readonly(casts, np.bool_), kernels.as_readonly(hits, np.bool_))

    def _rays(self, scan: Scan, voxels: I64, moves: bool) -> tuple[F32, Bool, Bool, F64]:
        """Ends (K, 3), whether to cast them and whether they hit, (K,) each, and origins (K or 1, 3) of rays.

        ``moves``: each ray has its own origin.
        """
        inside = voxels >= 0
        goals = voxels[inside] if moves else kernels.voids.distinct(voxels, inside, self._once)[:: self._order]
        goals, beyond = kernels.as_readonly(goals, np.int64), self._beyond(scan, ~inside, moves)
        known = kernels.blocks.centres_of(goals, self._blocks, self.resolution)
        around = kernels.thinning.centres(unpack(pack(scan.points[beyond], self.resolution)), self.resolution)
        sky = self._sky(scan)
        ends = np.concatenate([known, around, sky])
        casts, hits = np.ones(len(ends), np.bool_), np.arange(len(ends)) < len(goals)
        if not moves:
            casts[: len(goals)] = kernels.voids.first_of_cubes(goals, self._once)
            return ends, casts, hits, scan.origins[:1]
        own = scan.origins[inside], scan.origins[beyond], np.broadcast_to(scan.position, sky.shape)
        return ends, casts, hits, np.concatenate(own)

    def _sky(self, scan: Scan) -> F32:
        """(K, 3) float32, metres: ends of the rays into the sky, where a scan has no return; none without an image."""
        if self._image is None:
            return np.empty((0, 3), np.float32)
        ends = self._image.targets(scan, *self._image.sky(*self._image.of(scan))).astype(np.float32)
        return ends[self.reaching(ends, scan.position[None]) & in_key_range(ends, self.resolution)]

    def _beyond(self, scan: Scan, outside: Bool, moves: bool) -> I64:
        """(K,) int64: points without a voxel, around a tile of a map, of which the rays may cross its blocks."""
        if self._rectangle is None:
            return np.empty(0, np.int64)
        rows = np.flatnonzero(outside & in_key_range(scan.points, self.resolution))
        if not moves:
            rows = rows[:: self._order]
            rows = rows[KeySet().add(pack(scan.points[rows], 2 * self.resolution))]
        origins = scan.origins[rows] if len(scan.origins) > 1 else scan.origins
        return rows[self.reaching(scan.points[rows], origins)]

    def near(self, marks: Marks, times: int) -> U64:
        """(B, 8) uint64: voxels of the marked blocks within the cubes of edge 2 times + 1 voxels around the hit voxels.

        These are the hits of this scan and of the one before, for which this was called last. The cubes extend into
        adjacent blocks only if these are marked, too.
        """
        sides = kernels.clearance.adjacent(marks.blocks, self._rows, self._blocks, *self._place)
        padded = np.zeros((len(marks.blocks) + 1, 8), np.uint64)
        hits = marks.bits[:, 8:].view(np.uint64)
        padded[:-1] = hits | self._before[marks.blocks]
        self._before[self._last] = 0
        self._before[marks.blocks], self._last = hits, marks.blocks
        grown: U64 = kernels.clearance.grown(padded, sides, times)[:-1]
        return grown


def _by_sensor(scan: Scan, places: F64, which: I64) -> list[Scan]:
    """What each of the sensors of a merged scan saw from where it was; the whole scan if its sensor moved meanwhile."""
    if not 0 < len(places) <= SENSORS:
        return [scan]
    parts = [scan] if len(places) == 1 else [scan.chosen(np.flatnonzero(which == k)) for k in range(len(places))]
    poses = np.repeat(scan.T_world_sensor[None], len(places), 0)
    poses[:, :3, 3] = places
    return [replace(part, T_world_sensor=pose) for part, pose in zip(parts, poses, strict=True)]


def _distinct(origins: F64) -> tuple[F64, I64]:
    """Distinct rows (P, 3) of origins (N, 3), sorted, and the row of each (N,); fast for runs of equal rows."""
    if len(origins) == 1:
        return origins, np.zeros(1, np.int64)
    differ = [origins[1:, axis] != origins[:-1, axis] for axis in range(3)]
    starts = np.flatnonzero(np.concatenate([np.ones(min(len(origins), 1), np.bool_), np.any(differ, 0)]))
    places, which = np.unique(origins[starts], axis=0, return_inverse=True)
    return places, np.repeat(which.ravel(), np.diff(starts, append=len(origins)))

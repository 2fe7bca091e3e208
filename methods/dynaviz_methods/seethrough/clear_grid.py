"""A block grid for SeeThrough: one ray for each voxel with points, rays into the sky, and the voxels near hits."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dynaviz import kernels
from dynaviz.arrays import F32, F64, I64, U64
from dynaviz.blocks.blocks import BlockGrid, Marks
from dynaviz.contracts.extent import Extent
from dynaviz.contracts.scan import Scan
from dynaviz.contracts.sensors import Sensor
from dynaviz.spatial.grid import in_key_range, pack, unpack
from dynaviz_methods.sky import DepthImage, sensor_image

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

    def mark_once(self, scan: Scan, voxels: I64) -> Marks:
        """Cast one ray per origin to the centre of each voxel with points, and rays into the sky; mark the voxels.

        Rays into the sky cross voxels, but hit none.

        Args:
            scan: gives the origins of the rays.
            voxels: (N,) int64, the voxel of each point, -1 for none.
        """
        places, which = _distinct(scan.origins)
        goals, origins = self._rays(voxels, places, which)
        rays = [(kernels.blocks.centres_of(goals, self._blocks, self.resolution), origins)]
        if self._rectangle is not None:
            rays.append(self._beyond(scan, voxels, places, which))
        hitting = sum(len(ends) for ends, _ in rays)
        if self._image is not None:
            rays.extend(self._sky(self._image, each) for each in _by_sensor(scan, places, which))
        centres = np.concatenate([ends for ends, _ in rays])
        if len(places) > 1:
            origins = np.concatenate([np.broadcast_to(starts, ends.shape) for ends, starts in rays])
        way = kernels.as_readonly(centres, np.float32), kernels.as_readonly(origins, np.float64)
        every = kernels.as_readonly(np.ones(len(centres), np.bool_), np.bool_)
        return self._cast(*way, every, kernels.as_readonly(np.arange(len(centres)) < hitting, np.bool_))

    def _sky(self, image: DepthImage, scan: Scan) -> tuple[F32, F64]:
        """Ends (K, 3) and origin (1, 3) of the rays into the sky: where a scan has no return."""
        ends = image.targets(scan, *image.sky(*image.of(scan))).astype(np.float32)
        ends = ends[self.reaching(ends, scan.position[None]) & in_key_range(ends, self.resolution)]
        return ends, scan.position[None]

    def _rays(self, voxels: I64, places: F64, which: I64) -> tuple[I64, F64]:
        """Goals (K,) and origins (K or 1, 3) of the rays to voxels (N,), without duplicates.

        ``places`` (P, 3) are the origins, and ``which`` (N or 1,) that of each point.
        """
        if not 0 < len(places) <= SENSORS:
            rays = np.unique((voxels * len(places) + which)[voxels >= 0])
            return rays // len(places), places[rays % len(places)]
        inside = voxels >= 0
        goals = [kernels.voids.distinct(voxels, inside & (which == k), self._once) for k in range(len(places))]
        if len(places) == 1:
            return goals[0], places
        return np.concatenate(goals), np.repeat(places, [len(rays) for rays in goals], 0)

    def _beyond(self, scan: Scan, voxels: I64, places: F64, which: I64) -> tuple[F32, F64]:
        """Ends and origins, (K, 3) each, of rays that may cross blocks and end in voxels without one, one for each.

        In a tile of a map, points around the tile have no voxel. The arguments are those of ``_rays``.
        """
        rows = np.flatnonzero((voxels < 0) & self.reaching(scan.points, scan.origins))
        rows = rows[in_key_range(scan.points[rows], self.resolution)]
        of = np.broadcast_to(which, len(voxels))[rows]
        keys = pack(scan.points[rows], self.resolution)
        order = np.lexsort((of, keys))
        keys, of = keys[order], of[order]
        first = np.append(len(keys) > 0, (np.diff(keys) != 0) | (np.diff(of) != 0))[: len(keys)]
        return ((unpack(keys[first]) + 0.5) * self.resolution).astype(np.float32), places[of[first]]

    def near(self, marks: Marks, times: int) -> U64:
        """(B, 8) uint64: voxels of the marked blocks within the cubes of edge 2 times + 1 voxels around the hit voxels.

        The cubes extend into adjacent blocks only if these are marked, too.
        """
        sides = kernels.clearance.adjacent(marks.blocks, self._rows, self._blocks, *self._place)
        padded = np.zeros((len(marks.blocks) + 1, 8), np.uint64)
        padded[:-1] = marks.bits[:, 8:].view(np.uint64)
        grown: U64 = kernels.clearance.grown(padded, sides, times)[:-1]
        return grown


def _by_sensor(scan: Scan, places: F64, which: I64) -> list[Scan]:
    """What each of the sensors of a merged scan saw from where it was; the whole scan if its sensor moved meanwhile."""
    if len(places) > SENSORS:
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

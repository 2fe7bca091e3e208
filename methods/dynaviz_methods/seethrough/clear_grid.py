"""A block grid for SeeThrough.

Rays to voxels with points and into the sky, and the voxels near hits.
"""

from __future__ import annotations

import numpy as np

from dynaviz import kernels
from dynaviz.arrays import F32, F64, I64, U64, Bool
from dynaviz.blocks.blocks import BlockGrid, Marks
from dynaviz.contracts.extent import Extent
from dynaviz.contracts.scan import Scan
from dynaviz.contracts.sensors import Sensor
from dynaviz.spatial.grid import KeySet, in_key_range, pack, pack_indices, unpack
from dynaviz.spatial.scan_ground import EDGE, REACH
from dynaviz_methods.shared.sky import sensor_image

SHARED = kernels.load("dynaviz_methods.shared.kernels")

# up to so many origins are those of sensors whose scans were merged; more are those of one that
# moves
SENSORS = 8


class ClearGrid(BlockGrid):
    """A block grid that marks the voxels near the hits of a scan.

    Args:
        extent: where points will lie.
        resolution: edge of a voxel, metres.
        spare: metres above and below the extent where blocks may be added.
        sensor: casts rays into the sky if its field of view is known.
    """

    def __init__(
        self, extent: Extent, resolution: float, spare: float = 0.0, sensor: Sensor | None = None
    ) -> None:
        super().__init__(extent, resolution, spare)
        self._image = sensor_image(sensor, REACH * EDGE) if sensor is not None else None
        # Scratch memory, all zero between scans.
        self._rows = np.zeros(len(self) + 1, np.int32)
        self._once = np.zeros((len(self) + 1, 8), np.int64)
        # Of the scan before: its hits, and the blocks that it marked; and the order of its voxels.
        self._before = self.per_block(np.zeros((len(self) + 1, 8), np.uint64))
        self._last = np.empty(0, np.int32)
        self._order = 1

    def mark_once(self, scan: Scan, voxels: I64) -> Marks:
        """Mark the voxels with points, and those that rays cross on the way to them and into the
        sky.

        Unless the sensor moves during the scan, parts of rays are left out that others cross nearly
        as well: see ``clearance.begins``. Voxels come in the order of their points, forward and
        backward by turns, so that a sensor that stands does not miss the same voxels in each scan.
        Rays into the sky cross voxels, but hit none.

        Args:
            scan: gives the origins of the rays.
            voxels: (N,) int64, the voxel of each point, -1 for none.
        """
        self._order = -self._order
        places, which = _distinct(scan.origins)
        parts = _by_sensor(scan, places, which)
        owners = [voxels] if len(parts) == 1 else [voxels[which == k] for k in range(len(parts))]
        rays = [
            self._rays(part, own, len(places) > SENSORS)
            for part, own in zip(parts, owners, strict=True)
        ]
        if len(rays) == 1:
            return self._cast(*rays[0])
        rays = [
            (ends, np.broadcast_to(origins, ends.shape), begins, hits)
            for ends, origins, begins, hits in rays
        ]
        ends, origins, begins, hits = (np.concatenate(each) for each in zip(*rays, strict=True))
        return self._cast(ends, origins, begins, hits)

    def _rays(self, scan: Scan, voxels: I64, moves: bool) -> tuple[F32, F64, F32, Bool]:
        """The arguments of ``_cast`` for what one sensor saw; ``moves``.

        Each point has its own origin.
        """
        inside = voxels >= 0
        sky = self._sky(scan)
        goals = (
            voxels[inside]
            if moves
            else SHARED.voids.distinct(voxels, inside, self._once)[:: self._order]
        )
        goals = kernels.as_readonly(goals, np.int64)
        known = kernels.blocks.centres_of(goals, self._blocks, self.resolution)
        around, later, rows = self._beyond(scan, ~inside, moves)
        ends = np.concatenate([known, around, sky])
        first = (
            np.zeros(len(goals), np.float32)
            if moves
            else SHARED.clearance.begins(goals, self._once)
        )
        begins = np.concatenate([first, later, np.zeros(len(sky), np.float32)])
        origins = scan.origins[:1]
        if moves:
            own = (
                scan.origins[inside],
                scan.origins[rows],
                np.broadcast_to(scan.position, sky.shape),
            )
            origins = np.concatenate(own)
        return ends, origins, begins, np.arange(len(ends)) < len(goals)

    def _sky(self, scan: Scan) -> F32:
        """(K, 3) float32, metres: ends of the rays into the sky, where a scan has no return.

        None without an image.
        """
        if self._image is None:
            return np.empty((0, 3), np.float32)
        ends = self._image.targets(scan, *self._image.sky(*self._image.of(scan))).astype(np.float32)
        return ends[self.reaching(ends, scan.position[None]) & in_key_range(ends, self.resolution)]

    def _beyond(self, scan: Scan, outside: Bool, moves: bool) -> tuple[F32, F32, I64]:
        """Rays to voxels around a tile of a map that may cross its blocks.

        Their ends, where they begin, and points.
        """
        if self._rectangle is None:
            return np.empty((0, 3), np.float32), np.empty(0, np.float32), np.empty(0, np.int64)
        rows = np.flatnonzero(outside & in_key_range(scan.points, self.resolution))[
            :: 1 if moves else self._order
        ]
        keys = unpack(pack(scan.points[rows], self.resolution))
        begins = np.zeros(len(rows), np.float32)
        if not moves:
            first = KeySet().add(pack_indices(keys >> 1))
            rows = rows[first]
            keys = keys[first]
            large, block = (KeySet().add(pack_indices(keys >> size)) for size in (2, 3))
            begins = np.where(block, 0.0, np.where(large, 0.25, 0.5)).astype(np.float32)
        ends = kernels.thinning.centres(keys, self.resolution)
        found = self.reaching(ends, scan.origins[rows] if moves else scan.position[None])
        return ends[found], begins[found], rows[found]

    def near(self, marks: Marks, times: int) -> U64:
        """(B, 8) uint64: voxels of the marked blocks within the cubes of edge 2 times + 1 voxels
        around the hit voxels.

        These are the hits of this scan and of the one before, for which this was called last. The
        cubes extend into adjacent blocks only if these are marked, too.
        """
        sides = SHARED.clearance.adjacent(marks.blocks, self._rows, self._blocks, *self._place)
        padded = SHARED.clearance.of_two_scans(marks.blocks, marks.bits, self._before, self._last)
        self._last = marks.blocks
        grown: U64 = SHARED.clearance.grown(padded, sides, times)[:-1]
        return grown


def _by_sensor(scan: Scan, places: F64, which: I64) -> list[Scan]:
    """What each of the sensors of a merged scan saw from where it was.

    The whole scan if its sensor moved meanwhile.
    """
    if not 0 < len(places) <= SENSORS:
        return [scan]
    points = (
        [scan.points] if len(places) == 1 else [scan.points[which == k] for k in range(len(places))]
    )
    poses = np.repeat(scan.T_world_sensor[None], len(places), 0)
    poses[:, :3, 3] = places
    return [Scan(scan.index, part, pose) for part, pose in zip(points, poses, strict=True)]


def _distinct(origins: F64) -> tuple[F64, I64]:
    """Distinct rows (P, 3) of origins (N, 3), sorted, and the row of each (N,).

    Fast for runs of equal rows.
    """
    if len(origins) == 1:
        return origins, np.zeros(1, np.int64)
    differ = [origins[1:, axis] != origins[:-1, axis] for axis in range(3)]
    starts = np.flatnonzero(
        np.concatenate([np.ones(min(len(origins), 1), np.bool_), np.any(differ, 0)])
    )
    places, which = np.unique(origins[starts], axis=0, return_inverse=True)
    return places, np.repeat(which.ravel(), np.diff(starts, append=len(origins)))

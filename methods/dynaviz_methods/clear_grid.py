"""A block grid for SeeThrough: one ray for each voxel with points, and the voxels near the hits of a scan."""

from __future__ import annotations

import numpy as np

from dynaviz import kernels
from dynaviz.arrays import F32, F64, I64, U64, Intp
from dynaviz.scan import Scan
from dynaviz.spatial.blocks import BlockGrid, Marks
from dynaviz.spatial.extent import Extent
from dynaviz.spatial.grid import in_key_range, pack, unpack

RUNS = 64  # up to so many runs of equal origins are taken one by one


class ClearGrid(BlockGrid):
    """A block grid that marks the voxels near the hits of a scan."""

    def __init__(self, extent: Extent, resolution: float) -> None:
        super().__init__(extent, resolution)
        # Scratch memory, all zero between scans.
        self._rows, self._once = np.zeros(len(self) + 1, np.int32), np.zeros((len(self) + 1, 8), np.int64)

    def mark_once(self, scan: Scan, voxels: I64) -> Marks:
        """Cast one ray per origin to the centre of each voxel with points; mark the crossed and hit voxels.

        Args:
            scan: gives the origins of the rays.
            voxels: (N,) int64, the voxel of each point, -1 for none.
        """
        goals, origins = self._rays(scan.origins, voxels)
        centres: F32 = kernels.blocks.centres_of(goals, self._blocks, self.resolution)
        if self._rectangle is not None:
            more, of = self._beyond(scan, voxels)
            centres, origins = (
                np.concatenate([centres, more]),
                origins if len(origins) == 1 else np.append(origins, of, 0),
            )
        every = kernels.as_readonly(np.ones(len(centres), np.bool_), np.bool_)
        ends = kernels.as_readonly(centres, np.float32), kernels.as_readonly(origins, np.float64)
        return self._cast(*ends, every, every)

    def _rays(self, origins: F64, voxels: I64) -> tuple[I64, F64]:
        """Goals (K,) and origins (K or 1, 3) of the rays to voxels (N,) from origins (N or 1, 3), without duplicates.

        Few runs of equal origins, as of merged scans, are taken one by one: a ray that is in two of them marks the same
        voxels twice.
        """
        starts = _runs(origins)
        if not 0 < len(starts) <= RUNS:
            places, which = _distinct(origins)
            rays = np.unique((voxels * len(places) + which)[voxels >= 0])
            return rays // len(places), places[rays % len(places)]
        goals = [kernels.voids.distinct(run, run >= 0, self._once) for run in np.split(voxels, starts[1:])]
        if len(goals) == 1:
            return goals[0], origins[:1]
        return np.concatenate(goals), np.repeat(origins[starts], [len(run) for run in goals], 0)

    def _beyond(self, scan: Scan, voxels: I64) -> tuple[F32, F64]:
        """Ends and origins, (K, 3) each, of rays that may cross blocks and end in voxels without one, one for each.

        In a tile of a map, points around the tile have no voxel.
        """
        rows = np.flatnonzero((voxels < 0) & self.reaching(scan.points, scan.origins))
        rows = rows[in_key_range(scan.points[rows], self.resolution)]
        places, which = _distinct(scan.origins)
        which = which[rows] if len(which) > 1 else np.zeros(len(rows), np.int64)
        keys = pack(scan.points[rows], self.resolution)
        order = np.lexsort((which, keys))
        keys, which = keys[order], which[order]
        first = np.append(len(keys) > 0, (np.diff(keys) != 0) | (np.diff(which) != 0))[: len(keys)]
        return ((unpack(keys[first]) + 0.5) * self.resolution).astype(np.float32), places[which[first]]

    def near(self, marks: Marks, times: int) -> U64:
        """(B, 8) uint64: voxels of the marked blocks within the cubes of edge 2 times + 1 voxels around the hit voxels.

        The cubes extend into adjacent blocks only if these are marked, too.
        """
        sides = kernels.clearance.adjacent(marks.blocks, self._rows, self._blocks, *self._place)
        padded = np.zeros((len(marks.blocks) + 1, 8), np.uint64)
        padded[:-1] = marks.bits[:, 8:].view(np.uint64)
        grown: U64 = kernels.clearance.grown(padded, sides, times)[:-1]
        return grown


def _distinct(origins: F64) -> tuple[F64, I64]:
    """Distinct rows (P, 3) of origins (N, 3), sorted, and the row of each (N,); fast for runs of equal rows."""
    starts = _runs(origins)
    places, which = np.unique(origins[starts], axis=0, return_inverse=True)
    return places, np.repeat(which.ravel(), np.diff(starts, append=len(origins)))


def _runs(origins: F64) -> Intp:
    """The first row of each run of equal origins (N, 3)."""
    differ = [origins[1:, axis] != origins[:-1, axis] for axis in range(3)]
    starts: Intp = np.flatnonzero(np.concatenate([np.ones(min(len(origins), 1), np.bool_), np.any(differ, 0)]))
    return starts

"""Void voxels of a scan: crossed by rays, not hit, and away from unknown space."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dynaviz import kernels
from dynaviz.arrays import F64, I32, I64, Bool
from dynaviz.blocks.blocks import BlockGrid
from dynaviz.contracts.extent import Extent
from dynaviz.contracts.scan import Scan

KERNELS = kernels.load("dynaviz_methods.dufomap.kernels")
SHARED = kernels.load("dynaviz_methods.shared.kernels")


@dataclass(frozen=True, slots=True, eq=False)
class VoidMarks:
    """Hit, observed and void voxels of one scan, by block of a grid.

    Attributes:
        blocks: (B,) int32, block numbers, without duplicates.
        hit, observed, void: (B, 8) int64, one bit per voxel: bit v of word w is voxel 64 w + v of
            the block.
    """

    blocks: I32
    hit: I64
    observed: I64
    void: I64


class VoidGrid(BlockGrid):
    """A block grid that also covers the space around points that decides their labels.

    Args:
        extent: where points will lie.
        resolution: edge of a voxel, metres.
        hit_margin: distance in front of a point that counts as hit, metres.
        unknown_margin: distance from unknown space within which no voxel is void, voxels.
    """

    _OF_WORD = 2  # observed and hit voxels, next to each other

    def __init__(
        self, extent: Extent, resolution: float, hit_margin: float, unknown_margin: int
    ) -> None:
        # The largest distance from a point to a voxel that it hits, or that decides whether its own
        # voxel is void.
        around = max(hit_margin, unknown_margin * resolution) + resolution
        super().__init__(extent.widened(around), resolution)
        self._hit_margin = hit_margin * self._per_metre
        self._unknown_margin = unknown_margin
        # Scratch memory, cleared after each scan: whether a block is hit, its hit voxels, and its
        # row in the marks.
        self._struck = np.zeros(len(self) + 1, np.bool_)
        self._hits = np.zeros((len(self) + 1, 8), np.int64)
        self._rows = np.zeros(len(self) + 1, np.int32)

    def see(self, scan: Scan, voxels: I64, integrated: Bool) -> VoidMarks:
        """Find the hit, observed and void voxels of a scan.

        Args:
            scan: gives the origins of the rays.
            voxels: (N,) int64, the voxel of each point, from ``locate``.
            integrated: (N,) bool, points to integrate; each must have a voxel.
        """
        goals, starts, origins = self._rays(scan, voxels, integrated)
        place = (self._blocks, *self._place)
        scratch = self._scratch
        KERNELS.void_rays.hit(goals, starts, origins, self._hit_margin, *place, *scratch)
        struck, bits = kernels.raycast.collect(*scratch)
        self._struck[struck] = True
        self._hits[struck] = bits[:, 8:]
        hits = (struck, self._struck, self._hits)
        near = self._addresses(origins)
        rays = goals, starts, origins, self._unknown_margin
        KERNELS.void_rays.observe(*rays, *hits, *place, *scratch, self._words, near[0], near[2])
        marks = self._collected(near)
        blocks = marks.blocks
        observed = marks.bits[:, :8]
        hit = self._hits[blocks]
        self._struck[struck] = False
        self._hits[struck] = 0

        sides = SHARED.clearance.adjacent(blocks, self._rows, *place)
        unknown = np.full((len(blocks) + 1, 8), ~np.uint64(0))  # like all voxels of absent blocks
        unknown[:-1] = ~observed.view(np.uint64)
        known = ~SHARED.clearance.grown(unknown, sides, self._unknown_margin)[:-1].view(np.int64)
        return VoidMarks(blocks, hit, observed, known & ~hit)

    def _rays(self, scan: Scan, voxels: I64, integrated: Bool) -> tuple[I64, I64, F64]:
        """Rays to the centres of occupied voxels, without duplicates.

        Returns:
            goals: (R,) int64, the voxel in which each ray ends.
            starts: (R,) int64, the row of its origin.
            origins: (P, 3) float64, distinct origins, in voxels, world frame.
        """
        if len(scan.origins) == 1:
            goals = SHARED.voids.distinct(voxels, integrated, self._hits)
            return (
                kernels.as_readonly(goals, np.int64),
                np.zeros(len(goals), np.int64),
                scan.origins * self._per_metre,
            )
        places, which = np.unique(scan.origins, axis=0, return_inverse=True)
        rays = np.unique(voxels[integrated] * len(places) + which.ravel()[integrated])
        goals = rays // len(places)
        starts = rays % len(places)
        return (
            kernels.as_readonly(goals, np.int64),
            kernels.as_readonly(starts, np.int64),
            places * self._per_metre,
        )

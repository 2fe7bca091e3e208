"""A method: what is seldom there has moved.

for each scan
    count one more scan for each voxel that holds a point of it
a point is dynamic if fewer than min_scans scans had a point in its voxel
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from dynaviz.arrays import I64, U8, Bool
from dynaviz.method import Cause, Context, MethodInfo, Reason
from dynaviz.probe import State, Voxels
from dynaviz.scan import Scan
from dynaviz.spatial.grid import in_key_range, pack, unpack


@dataclass(frozen=True)
class SeldomParams:
    """Each field is a parameter: ``--set min_scans=5``, presets, ``dynaviz config`` and ``--grid`` follow from here.

    Attributes:
        resolution: edge of a voxel, metres.
        min_scans: scans that must have a point in a voxel for its points to be kept.
    """

    resolution: float = 0.5
    min_scans: int = 3

    def __post_init__(self) -> None:
        # dynaviz shows a ValueError to the user as it is: tell what to give.
        if not 0 < self.resolution < float("inf"):
            raise ValueError(f"resolution = {self.resolution}: give metres above 0")
        if self.min_scans < 1:
            raise ValueError(f"min_scans = {self.min_scans}: give at least 1")


SELDOM, OFTEN, NO_VOXEL = range(3)


class Seldom:
    """Removes what few scans saw."""

    info: ClassVar[MethodInfo] = MethodInfo(
        name="seldom",
        title="Seldom seen",
        paper="an example",
        reasons=(  # the codes of explain(), by position; each is for kept or for removed points, never for both
            Reason("seldom_seen", "removed: too few scans had a point in its voxel", Cause.SPARSE_RINGS),
            Reason("often_seen", "kept: enough scans had a point in its voxel", Cause.STANDING),
            Reason("no_voxel", "kept unjudged: not finite, or too far from the world's origin", Cause.OUT_OF_RANGE),
        ),
        emits=(State("scans", Voxels, "Voxels of this scan; scans that had a point in them", value_range=(0.0, 10.0)),),
    )
    Params: ClassVar[type[Any]] = SeldomParams

    def __init__(self, params: Any) -> None:
        self.params = params

    def begin(self, context: Context) -> None:
        """Start with an empty map."""
        self._probe = context.probe
        self._keys, self._scans = np.empty(0, np.int64), np.empty(0, np.int64)

    def observe(self, scan: Scan) -> None:
        """Count one more scan for each voxel that holds a point of it."""
        near = in_key_range(scan.points, self.params.resolution)
        here = np.unique(pack(scan.points[near], self.params.resolution))
        merged = np.union1d(self._keys, here)
        scans = np.zeros(len(merged), np.int64)
        scans[np.searchsorted(merged, self._keys)] = self._scans
        scans[np.searchsorted(merged, here)] += 1
        self._keys, self._scans = merged, scans
        if self._probe.wants("scans"):  # costs nothing where nobody looks
            values = self._count(here).astype(np.float32)
            self._probe.emit("scans", Voxels(unpack(here), self.params.resolution, values))

    def label(self, scan: Scan) -> Bool:
        """(N,) bool: True where too few scans had a point."""
        dynamic: Bool = self.explain(scan) == SELDOM
        return dynamic

    def explain(self, scan: Scan) -> U8:
        """(N,) uint8, positions in ``info.reasons``."""
        near = in_key_range(scan.points, self.params.resolution)
        reasons = np.full(len(scan), NO_VOXEL, np.uint8)
        counts = self._count(pack(scan.points[near], self.params.resolution))
        reasons[near] = np.where(counts < self.params.min_scans, SELDOM, OFTEN)
        return reasons

    def _count(self, keys: I64) -> I64:
        """Scans of voxels that were all observed."""
        return self._scans[np.searchsorted(self._keys, keys)]

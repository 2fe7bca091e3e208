"""An example method: points in rarely occupied voxels are dynamic.

for each scan
    add 1 to the count of each voxel that contains a point of the scan
a point is dynamic if fewer than min_scans scans have a point in its voxel
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from dynaviz import kernels
from dynaviz.arrays import I64
from dynaviz.contracts.method import Cause, Context, Labels, MethodInfo, Reason
from dynaviz.contracts.probe import State, Voxels
from dynaviz.contracts.scan import Scan
from dynaviz.spatial.grid import in_key_range, pack, unpack

KERNELS = kernels.load("dynaviz_template.kernels")  # imported and compiled on first use


@dataclass(frozen=True)
class SeldomParams:
    """Each field is a parameter for ``--set min_scans=5``, presets, ``dynaviz list`` and
    ``--grid``.

    Attributes:
        resolution: edge of a voxel, metres.
        min_scans: a point is kept if at least this many scans have a point in its voxel.
    """

    resolution: float = 0.5
    min_scans: int = 3

    def __post_init__(self) -> None:
        # The user sees this message as written: state what to give.
        if not 0 < self.resolution < float("inf"):
            raise ValueError(f"resolution = {self.resolution}: give metres above 0")
        if self.min_scans < 1:
            raise ValueError(f"min_scans = {self.min_scans}: give at least 1")


SELDOM, OFTEN, NO_VOXEL = range(3)


class Seldom:
    """Remove points in voxels that few scans hit."""

    info: ClassVar[MethodInfo] = MethodInfo(
        name="seldom",
        title="Rarely seen",
        paper="an example",
        reasons=(  # by code; each reason is for kept or for removed points, never for both
            Reason(
                "seldom_seen",
                "removed: too few scans have a point in its voxel",
                Cause.SPARSE_RINGS,
            ),
            Reason("often_seen", "kept: enough scans have a point in its voxel", Cause.STANDING),
            Reason(
                "no_voxel",
                "kept unjudged: not finite, or too far from the world origin",
                Cause.OUT_OF_RANGE,
            ),
        ),
        emits=(
            State(
                "scans",
                Voxels,
                "Voxels of this scan; scans with a point there",
                value_range=(0.0, 10.0),
            ),
        ),
        colour=(0, 140, 140),  # in every figure
    )
    Params: ClassVar[type[Any]] = SeldomParams

    def __init__(self, params: Any) -> None:
        self.params = params

    def begin(self, context: Context) -> None:
        """Start with an empty map."""
        self._probe = context.probe
        self._table = np.full(1 << 16, -1, np.int64)
        self._scans = np.zeros(1 << 16, np.int64)
        self._used = 0

    def observe(self, scan: Scan) -> None:
        """Add 1 to the count of each voxel that contains a point of the scan."""
        near = in_key_range(scan.points, self.params.resolution)
        here = np.unique(pack(scan.points[near], self.params.resolution))
        self._table, self._scans, self._used = KERNELS.counts.add(
            here, self._table, self._scans, self._used
        )
        if self._probe.wants("scans"):  # skip the work if the state is not recorded
            values = self._count(here).astype(np.float32)
            self._probe.emit("scans", Voxels(unpack(here), self.params.resolution, values))

    def label(self, scan: Scan) -> Labels:
        """Label points dynamic if too few scans have a point in their voxel.

        Reasons index ``info.reasons``.
        """
        near = in_key_range(scan.points, self.params.resolution)
        reasons = np.full(len(scan), NO_VOXEL, np.uint8)
        counts = self._count(pack(scan.points[near], self.params.resolution))
        reasons[near] = np.where(counts < self.params.min_scans, SELDOM, OFTEN)
        return Labels(reasons == SELDOM, reasons)

    def _count(self, keys: I64) -> I64:
        """Number of scans per voxel, (K,) int64."""
        found: I64 = KERNELS.counts.look_up(keys, self._table, self._scans)
        return found

"""The public program dynamic-object-removal (DOR) as a method of dynaviz.

An offline program: it cleans the map of all scans at once. So this method keeps the scans while it
observes them, and asks the program when the first label is due.

    pip install ./examples/dor_wheel
    dynaviz run dor_wheel PATH
    dynaviz bench -m dor_wheel -m seethrough -s PATH -o bench
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from dynaviz.arrays import F64, Bool
from dynaviz.contracts.method import Context, Labels, MethodInfo, Reason
from dynaviz.contracts.scan import Scan


@dataclass(frozen=True)
class Params:
    """The parameters of the program's ``fusion`` that its presets change; all others stay.

    The defaults are the program's, for recordings of 100 scans and more. For about 12 scans, it
    recommends 0.7, 3 and 4.

    Attributes:
        free_votes_fraction: share of the scans that saw a voxel and must have passed through it.
        free_votes_floor: number of scans that must have passed through it at least.
        void_min_scans: number of scans that must have seen a voxel and all around it empty.
        max_range: points farther from the sensor are not used, metres.
    """

    free_votes_fraction: float = 0.9
    free_votes_floor: int = 2
    void_min_scans: int = 11
    max_range: float = 60.0

    def __post_init__(self) -> None:
        if not 0 < self.free_votes_fraction <= 1:
            problem = f"free_votes_fraction = {self.free_votes_fraction}"
            raise ValueError(f"{problem}: give a number above 0, at most 1")
        for name in ("free_votes_floor", "void_min_scans"):
            if not getattr(self, name) >= 1:
                raise ValueError(f"{name} = {getattr(self, name)}: give a number of at least 1")
        if not self.max_range > 0:
            raise ValueError(f"max_range = {self.max_range}: give a number above 0")


class DorWheel:
    """Free space, voids and scan ratios, joined by the program's ``clean_map_by_fusion``."""

    info: ClassVar[MethodInfo] = MethodInfo(
        name="dor_wheel",
        title="DOR fusion (public program)",
        paper="package dynamic-object-removal 0.6",
        reasons=(  # by code
            Reason(
                "fused", "removed: free space, a void or the ratio of heights speaks against it"
            ),
            Reason("not_fused", "kept: neither free space, nor a void, nor the ratio of heights"),
            Reason("not_finite", "kept unjudged"),
        ),
        needs_map=True,
    )
    Params: ClassVar[type[Any]] = Params

    def __init__(self, params: Any) -> None:
        self.params = params

    def begin(self, context: Context) -> None:
        """Start without scans."""
        self._scans: list[tuple[F64, F64]] = []  # finite points, and the position of the sensor
        self._first: dict[
            int, int
        ] = {}  # row in the map of the first point of a scan, by its index
        self._rows = 0
        self._kept: Bool | None = None

    def observe(self, scan: Scan) -> None:
        """Keep the finite points of a scan."""
        points = scan.points[np.isfinite(scan.points).all(1)].astype(np.float64)
        self._first[scan.index] = self._rows
        self._rows += len(points)
        self._scans.append((points, scan.position))

    def label(self, scan: Scan) -> Labels:
        """Label points as the program cleans the map of all scans."""
        if self._kept is None:
            self._kept = self._clean()
        finite = np.isfinite(scan.points).all(1)
        first = self._first[scan.index]
        dynamic = np.zeros(len(scan), np.bool_)
        dynamic[finite] = ~self._kept[first : first + np.count_nonzero(finite)]
        reasons = np.where(dynamic, 0, 1).astype(np.uint8)
        reasons[~finite] = 2
        return Labels(dynamic, reasons)

    def _clean(self) -> Bool:
        """(M,) bool: points of the map that the program keeps."""
        from dynamic_object_removal import clean_map_by_fusion  # here, so that `list` stays fast

        known = [(points, position) for points, position in self._scans if len(points)]
        if not known:
            return np.ones(0, np.bool_)
        whole = np.concatenate([points for points, _ in known])
        _, kept = clean_map_by_fusion(
            whole,
            known,
            free_votes_fraction=self.params.free_votes_fraction,
            free_votes_floor=self.params.free_votes_floor,
            void_min_scans=self.params.void_min_scans,
            max_range=self.params.max_range,
        )
        return np.asarray(kept, np.bool_)

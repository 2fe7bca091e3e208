"""Voxel-wise preservation and rejection rates, as reported by papers of the ERASOR family.

Not the main metric.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from dynaviz.arrays import F32, I64
from dynaviz.contracts.method import MethodInfo
from dynaviz.contracts.metric import Figure, Labelled
from dynaviz.contracts.scan import Label, Outcome
from dynaviz.scores.scores import harmonic_mean, percent
from dynaviz.scores.sections import Voxelwise
from dynaviz.spatial.grid import KeySet, in_key_range, pack
from dynaviz_eval.sorted_runs import HELD, SortedRuns

EDGE = 0.2  # metres
_COUNTS = ("static", "static_kept", "dynamic", "dynamic_kept")
_RECORD = np.dtype([("key", np.int64), ("kind", np.uint8)])


class VoxelwiseMetric:
    """Section ``voxelwise``: PR, RR and F1 of voxels of 0.2 m (Lim et al., "ERASOR", RA-L 2021).

    A voxel is static if it contains a static point, else dynamic if it contains a dynamic point. It
    is kept if it contains a kept point. PR: share of static voxels kept; RR: share of dynamic
    voxels not kept; F1: their harmonic mean; all in percent. A single kept point keeps its voxel,
    so these numbers flatter a method compared with SA and DA. Unlabelled points do not count. The
    voxels of large maps are stored on disk during the run.

    For a cleaned map written by another program, a voxel is kept if it contains a point of that
    map, as in those papers; the radius of nearest-neighbour scoring is not used.
    """

    def __init__(self, info: MethodInfo, edge: float = EDGE, held: int = HELD) -> None:
        self._edge = edge  # metres
        self._static = KeySet()
        self._dynamic = KeySet()
        self._kept = KeySet()
        self._held = held  # voxels of a kind in memory
        self._stored = SortedRuns(_RECORD)
        self._has_map = False

    def cleaned_map(self, points: F32) -> None:
        """Use the voxels of a cleaned map, (M, 3) float32, metres, world frame, as
        the kept ones.
        """
        self._kept.add(pack(points, self._edge))
        self._has_map = True

    def update(self, labelled: Labelled) -> Mapping[str, float]:
        """Add the voxels of one scan."""
        if labelled.scan.labels is not None:
            finite = in_key_range(labelled.scan.points, self._edge)
            keys = np.zeros(len(labelled.scan), np.int64)
            keys[finite] = pack(labelled.scan.points[finite], self._edge)
            kept = np.isin(labelled.outcome, (Outcome.STATIC_KEPT, Outcome.FALSE_NEGATIVE))
            self._static.add(keys[finite & (labelled.scan.labels == Label.STATIC)])
            self._dynamic.add(keys[finite & (labelled.scan.labels == Label.DYNAMIC)])
            if not self._has_map:
                self._kept.add(keys[finite & kept])
            if max(len(self._static), len(self._dynamic), len(self._kept)) > self._held:
                self._store()
        return {}

    def finish(self) -> Mapping[str, Voxelwise]:
        """The section; rates are None if there are no voxels to count."""
        counts = dict.fromkeys(_COUNTS, 0)
        for static, dynamic, kept in self._parts():
            dynamic = np.setdiff1d(dynamic, static, assume_unique=True)
            found = (
                static,
                np.intersect1d(static, kept, True),
                dynamic,
                np.intersect1d(dynamic, kept, True),
            )
            for name, voxels in zip(_COUNTS, found, strict=True):
                counts[name] += len(voxels)
        PR = float(percent(counts["static_kept"], counts["static"])) if counts["static"] else None
        RR = 100.0 * (1 - counts["dynamic_kept"] / counts["dynamic"]) if counts["dynamic"] else None
        F1 = None if PR is None or RR is None else float(harmonic_mean(PR, RR))
        return {"voxelwise": Voxelwise(edge_m=self._edge, PR=PR, RR=RR, F1=F1, **counts)}

    def _store(self) -> None:
        """Move all voxels to the disk."""
        sets = (self._static, self._dynamic, self._kept)
        records = np.empty(sum(map(len, sets)), _RECORD)
        records["kind"] = np.repeat(np.arange(3), [len(voxels) for voxels in sets])
        records["key"] = np.concatenate([voxels.keys() for voxels in sets])
        self._stored.append(records)
        for voxels in sets:
            voxels.clear()

    def _parts(self) -> Iterator[tuple[I64, I64, I64]]:
        """Static, dynamic and kept voxels, each (N,) sorted keys.

        Part by part, of which each fits into memory.
        """
        if not len(self._stored):
            yield self._static.keys(), self._dynamic.keys(), self._kept.keys()
            return
        self._store()
        for low, high in self._stored.intervals():
            records = self._stored.between(low, high)
            static, dynamic, kept = (
                np.unique(records["key"][records["kind"] == kind]) for kind in range(3)
            )
            yield static, dynamic, kept

    def figures(self) -> Mapping[str, Figure]:
        """None."""
        return {}

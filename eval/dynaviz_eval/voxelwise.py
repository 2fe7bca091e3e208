"""Voxel-wise preservation and rejection rates, as reported by papers of the ERASOR family; not the main metric."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from dynaviz.arrays import F32
from dynaviz.method import MethodInfo
from dynaviz.metric import Figure, Labelled
from dynaviz.results.scores import harmonic_mean, percent
from dynaviz.scan import Label, Outcome
from dynaviz.spatial.grid import KeySet, in_key_range, pack

EDGE = 0.2  # metres


class Voxelwise:
    """Section ``voxelwise``: PR, RR and F1 of voxels of 0.2 m (Lim et al., "ERASOR", RA-L 2021).

    A voxel is static if it contains a static point, else dynamic if it contains a dynamic point. It is kept if it
    contains a kept point. PR: share of static voxels kept; RR: share of dynamic voxels not kept; F1: their harmonic
    mean; all in percent. A single kept point keeps its voxel, so these numbers flatter a method compared with SA and
    DA. Unlabelled points do not count. Memory grows with the mapped area.

    For a cleaned map written by another program, a voxel is kept if it contains a point of that map, as in those
    papers; the radius of nearest-neighbour scoring is not used.
    """

    def __init__(self, info: MethodInfo, edge: float = EDGE) -> None:
        self._edge = edge  # metres
        self._static, self._dynamic, self._kept = KeySet(), KeySet(), KeySet()
        self._has_map = False

    def cleaned_map(self, points: F32) -> None:
        """Use the voxels of a cleaned map, (M, 3) float32, metres, world frame, as the kept ones."""
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
        return {}

    def finish(self) -> Mapping[str, Any]:
        """The section; rates are None if there are no voxels to count."""
        static, kept = self._static.keys(), self._kept.keys()
        dynamic = np.setdiff1d(self._dynamic.keys(), static, assume_unique=True)
        static_kept, dynamic_kept = (len(np.intersect1d(v, kept, assume_unique=True)) for v in (static, dynamic))
        PR = float(percent(static_kept, len(static))) if len(static) else None
        RR = 100.0 * (1 - dynamic_kept / len(dynamic)) if len(dynamic) else None
        F1 = None if PR is None or RR is None else float(harmonic_mean(PR, RR))
        counts = {
            "static": len(static),
            "static_kept": static_kept,
            "dynamic": len(dynamic),
            "dynamic_kept": dynamic_kept,
        }
        return {"voxelwise": {"edge_m": self._edge, "PR": PR, "RR": RR, "F1": F1, **counts}}

    def figures(self) -> Mapping[str, Figure]:
        """None."""
        return {}

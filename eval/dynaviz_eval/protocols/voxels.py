"""PR, RR and F1 over voxels of the map, as papers on map cleaning count them.

ERASOR and FreeDOM.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from dynaviz.arrays import F32, F64, Bool
from dynaviz.contracts.method import MethodInfo
from dynaviz.contracts.metric import Labelled
from dynaviz.contracts.protocol import ProtocolInfo
from dynaviz.contracts.scan import Label
from dynaviz.scores.scores import harmonic_mean, percent
from dynaviz.spatial.grid import in_key_range, pack
from dynaviz_eval.protocols import Counted
from dynaviz_eval.voxelwise import EDGE, VoxelwiseMetric

SCORES = ("F1", "PR", "RR")
_COUNTS = ("static", "static_kept", "dynamic", "dynamic_kept")


class _Voxels(Counted):
    """PR, RR and F1 of the voxels that were counted."""

    @staticmethod
    def scores_of(counts: Mapping[str, float]) -> Mapping[str, float]:
        """F1, PR and RR."""
        static, static_kept, dynamic, dynamic_kept = (counts.get(name, 0) for name in _COUNTS)
        PR = float(percent(static_kept, static))
        RR = float(percent(dynamic - dynamic_kept, dynamic))
        return {"F1": float(harmonic_mean(PR, RR)), "PR": PR, "RR": RR}


class FreedomProtocol(_Voxels):
    """PR, RR and F1 over voxels of 0.2 m as FreeDOM counts them (Li et al., RA-L 2025).

    A voxel is static if it contains any static point, else dynamic. It is kept if it contains a
    kept point.
    """

    info: ClassVar = ProtocolInfo(
        name="freedom",
        title="FreeDOM, 0.2 m",
        source="Li et al., RA-L 2025",
        counts="voxels of 0.2 m; static with any static point; kept with any kept point",
        ignores="unlabelled points",
        combines="counts added over sequences",
        scores=SCORES,
    )
    edge: ClassVar[float] = EDGE

    def __init__(self, scoring: str) -> None:
        self._voxels = VoxelwiseMetric(MethodInfo("", "", "", ()), self.edge)

    def update(self, labelled: Labelled) -> None:
        """Add one scan."""
        self._voxels.update(labelled)

    def counts(self) -> Mapping[str, int]:
        """Voxels by truth, and those of them that are kept."""
        found = self._voxels.finish()["voxelwise"]
        return {name: getattr(found, name) for name in _COUNTS}


class FreedomIndoor(FreedomProtocol):
    """PR, RR and F1 over voxels of 0.1 m, as FreeDOM counts them indoors."""

    info: ClassVar = ProtocolInfo(
        name="freedom_indoor",
        title="FreeDOM, 0.1 m",
        source="Li et al., RA-L 2025, indoor sequences",
        counts="voxels of 0.1 m; static with any static point; kept with any kept point",
        ignores="unlabelled points",
        combines="counts added over sequences",
        scores=SCORES,
    )
    edge: ClassVar[float] = 0.1


class ErasorProtocol(_Voxels):
    """PR, RR and F1 over voxels of 0.2 m as ERASOR's script counts them (Lim et al., RA-L 2021).

    Both the map of all points and the map of the kept ones are reduced to one point per voxel: the
    mean of its points, with the label of the point next to it. A voxel of the first counts as kept
    if the nearest voxel point of the second lies within half a voxel's diagonal, 0.173 m, and has
    the same label. Memory grows with the number of points: 14 bytes each.
    """

    info: ClassVar = ProtocolInfo(
        name="erasor",
        title="ERASOR, 0.2 m",
        source="script of Lim et al., RA-L 2021",
        counts="voxel means of 0.2 m; kept if the nearest of the cleaned map lies within 0.173 m "
        "and has its label",
        ignores="unlabelled points",
        combines="counts added over sequences",
        scores=SCORES,
    )

    def __init__(self, scoring: str) -> None:
        self._points: list[F32] = []
        self._dynamic: list[Bool] = []
        self._kept: list[Bool] = []

    def update(self, labelled: Labelled) -> None:
        """Add one scan."""
        truth = labelled.scan.labels
        if truth is not None:
            chosen = (truth != Label.UNLABELLED) & in_key_range(labelled.scan.points, EDGE)
            self._points.append(labelled.scan.points[chosen])
            self._dynamic.append(truth[chosen] == Label.DYNAMIC)
            self._kept.append(~labelled.dynamic[chosen])

    def counts(self) -> Mapping[str, int]:
        """Reduce both maps to voxel points and match them."""
        from scipy.spatial import cKDTree

        if not self._points:
            return dict.fromkeys(_COUNTS, 0)
        points: F32 = np.concatenate(self._points)
        dynamic: Bool = np.concatenate(self._dynamic)
        kept: Bool = np.concatenate(self._kept)
        means, moving = voxel_points(points, dynamic)
        map_means, map_moving = voxel_points(points[kept], dynamic[kept])
        reach = EDGE * np.sqrt(3) / 2
        same = np.zeros(len(means), np.bool_)
        if len(map_means):
            answer = cKDTree(map_means).query(means, distance_upper_bound=reach, workers=-1)
            distance = np.asarray(answer[0])
            nearest = np.asarray(answer[1])
            found = distance < reach
            same[found] = map_moving[nearest[found]] == moving[found]
        numbers = (~moving).sum(), (same & ~moving).sum(), moving.sum(), (same & moving).sum()
        return {name: int(number) for name, number in zip(_COUNTS, numbers, strict=True)}


def voxel_points(points: F32, dynamic: Bool) -> tuple[F64, Bool]:
    """Reduce points to one per voxel of 0.2 m.

    Args:
        points: (N, 3) float32, metres; finite and within the range of voxel keys.
        dynamic: (N,) bool.

    Returns:
        means: (V, 3) float64, metres: mean of the points of each voxel.
        dynamic: (V,) bool: whether the point of the voxel nearest to the mean is dynamic; the first
            one of equals.
    """
    _, voxel, number = np.unique(pack(points, EDGE), return_inverse=True, return_counts=True)
    sums = [np.bincount(voxel, column, len(number)) for column in points.T.astype(np.float64)]
    means: F64 = np.stack(sums, 1) / number[:, None]
    squared = ((points - means[voxel]) ** 2).sum(1)
    order = np.lexsort((squared, voxel))
    first = (
        order[np.concatenate([[0], np.cumsum(number)[:-1]]).astype(np.intp)]
        if len(order)
        else order
    )
    return means, dynamic[first]

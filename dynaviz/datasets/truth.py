"""Ground truth of the public benchmark: one labelled cloud of all scans, matched back to each scan's points."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from dynaviz.arrays import F32, I32, U8, U16, Bool
from dynaviz.errors import DataError
from dynaviz.io.pcd import Pcd, read_header, read_pcd
from dynaviz.scan import Label

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

NEAR = 0.01  # metres within which a point of the cloud is taken for a scan's point
_HINT = "Its intensity is 0 for static, 1 for dynamic and 255 for unlabelled points"


@dataclass(frozen=True, slots=True)
class Truth:
    """What is known of a scan's points; classes and instances where the cloud has them.

    Attributes:
        labels: (N,) uint8.
        classes: (N,) uint16 or None.
        instances: (N,) int32 or None.
        unmatched: how many points of the scan have no partner in the cloud; they are unlabelled.
    """

    labels: U8
    classes: U16 | None
    instances: I32 | None
    unmatched: int = 0


def fields_of(truth: Truth | None, class_names: Mapping[int, str]) -> dict[str, Any]:
    """What is known of a scan's points, as fields of a ``Scan``; nothing without truth."""
    if truth is None:
        return {}
    fields = {"labels": truth.labels, "classes": truth.classes, "instances": truth.instances}
    return {**fields, "class_names": class_names}


class GroundTruth:
    """The labelled cloud ``gt_cloud.pcd``.

    Usually it is all scans one after the other, and a scan's truth is read from its rows alone. Where counts or
    coordinates disagree, each point takes the label of the cloud's nearest point within ``NEAR``, and the whole cloud
    is held in memory.

    Args:
        path: the cloud.
        counts: number of points of each scan, in their order.
        points_of: gives (N, 3) float32 points of a scan by its position.

    Raises:
        DataError: where the cloud cannot be read.
    """

    def __init__(self, path: Path, counts: Sequence[int], points_of: Callable[[int], F32]) -> None:
        self.path, header = path, read_header(path)
        if "intensity" not in (header.row.names or ()):
            raise DataError(path, f"has no field 'intensity', only: {' '.join(header.row.names or ())}", hint=_HINT)
        starts = np.concatenate([[0], np.cumsum(counts, dtype=np.int64)])
        if not header.points:
            raise DataError(path, "has no points", hint="Remove it where there is no ground truth")
        self._rows = list(pairwise(starts.tolist()))
        self._sliced = header.data == "binary"  # other encodings have to be read as a whole
        adds_up = header.points == starts[-1]
        some = sorted({0, len(counts) // 2, len(counts) - 1})
        self.by_index = adds_up and all(_same(self._part(k).xyz, points_of(k)) for k in some)

    def of(self, position: int, points: F32) -> Truth:
        """The truth of a scan's points, (N, 3) float32, world frame.

        Raises:
            DataError: where the cloud's intensity is no label.
        """
        if self.by_index:
            part = self._part(position)
            if _same(part.xyz, points):
                return _truth(part, np.ones(len(points), np.bool_))
        return self._nearest(points)

    def _part(self, position: int) -> Pcd:
        """The rows of a scan."""
        first, last = self._rows[position]
        if self._sliced:
            return read_pcd(self.path, (first, last))
        return Pcd(self.path, self._whole.header, self._whole.rows[first:last])

    def _nearest(self, points: F32) -> Truth:
        row = np.zeros(len(points), np.intp)
        distance = np.full(len(points), np.inf)
        finite = np.isfinite(points).all(1)
        distance[finite], row[finite] = self._tree.query(points[finite], distance_upper_bound=NEAR)
        matched = np.isfinite(distance)
        return _truth(Pcd(self.path, self._whole.header, self._whole.rows[np.where(matched, row, 0)]), matched)

    @cached_property
    def _whole(self) -> Pcd:
        return read_pcd(self.path)

    @cached_property
    def _tree(self) -> cKDTree:
        from scipy.spatial import cKDTree

        xyz = self._whole.xyz
        reachable = np.where(np.isfinite(xyz).all(1, keepdims=True), xyz, np.float32(1e9))
        return cKDTree(reachable, compact_nodes=False, balanced_tree=False)  # three times faster to build


def _same(a: F32, b: F32) -> bool:
    """Whether two clouds agree bit for bit."""
    return a.shape == b.shape and bool(np.array_equal(a.view(np.uint32), b.view(np.uint32)))


def _truth(partners: Pcd, matched: Bool) -> Truth:
    """The truth of points from their partners in the cloud, where they are matched."""
    intensity = partners["intensity"]
    labels = np.full(len(partners), Label.UNLABELLED, np.uint8)
    known = matched & (intensity != Label.UNLABELLED)
    labels[known & (intensity == Label.STATIC)] = Label.STATIC
    labels[known & (intensity == Label.DYNAMIC)] = Label.DYNAMIC
    odd = known & (labels == Label.UNLABELLED)
    if odd.any():
        raise DataError(partners.path, f"has intensity {intensity[odd][0]:g}, which is no label", hint=_HINT)
    classes = partners["class"].astype(np.uint16) * matched if "class" in partners else None
    instances = partners["instance"].astype(np.int32) * matched if "instance" in partners else None
    return Truth(labels, classes, instances, int(len(matched) - matched.sum()))

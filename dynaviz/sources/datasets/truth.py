"""Ground truth of the public benchmark.

One labelled cloud of all scans, matched to the points of each scan.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from dynaviz.arrays import F32, I32, U8, U16, Bool
from dynaviz.contracts.scan import Label
from dynaviz.errors import DataError
from dynaviz.io.pcd import Pcd, read_header, read_pcd

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

MATCH_RADIUS = 0.01  # metres between a point of a scan and its point in the labelled cloud
_HINT = "Set intensity to 0 for static, 1 for dynamic and 255 for unlabelled points"


@dataclass(frozen=True, slots=True)
class Truth:
    """Ground truth of a scan; classes and instances if available.

    Attributes:
        labels: (N,) uint8.
        classes: (N,) uint16 or None.
        instances: (N,) int32 or None.
        unmatched: number of points without a match in the labelled cloud; they are unlabelled.
    """

    labels: U8
    classes: U16 | None
    instances: I32 | None
    unmatched: int = 0


def scan_fields(truth: Truth | None, class_names: Mapping[int, str]) -> dict[str, Any]:
    """Ground truth as keyword arguments of ``Scan``; empty for None."""
    if truth is None:
        return {}
    fields = {"labels": truth.labels, "classes": truth.classes, "instances": truth.instances}
    return {**fields, "class_names": class_names}


class GroundTruth:
    """The labelled cloud ``gt_cloud.pcd``.

    Usually it is the concatenation of all scans, and only the rows of a scan are read. If counts or
    coordinates differ, each point takes the label of the nearest point of the cloud within
    ``MATCH_RADIUS``, and the whole cloud is kept in memory.

    Args:
        path: the cloud.
        counts: number of points of each scan, in order.
        points_of: returns the (N, 3) float32 points of a scan, given its position.

    Raises:
        DataError: if the cloud cannot be read.
    """

    def __init__(self, path: Path, counts: Sequence[int], points_of: Callable[[int], F32]) -> None:
        self.path = path
        header = read_header(path)
        if "intensity" not in (header.row.names or ()):
            fields = " ".join(header.row.names or ())
            raise DataError(path, f"field 'intensity' is missing (found: {fields})", hint=_HINT)
        starts = np.concatenate([[0], np.cumsum(counts, dtype=np.int64)])
        if not header.points:
            raise DataError(
                path, "contains no points", hint="Remove it if there is no ground truth"
            )
        self._row_ranges = list(pairwise(starts.tolist()))
        self._sliceable = header.data == "binary"  # other encodings are read completely
        same_count = header.points == starts[-1]
        samples = sorted({0, len(counts) // 2, len(counts) - 1})
        self.by_index = same_count and all(
            _identical(self._scan_rows(k).xyz, points_of(k)) for k in samples
        )

    def for_scan(self, position: int, points: F32) -> Truth:
        """Ground truth of the points of a scan, (N, 3) float32, world frame.

        Raises:
            DataError: if an intensity in the cloud is not a label.
        """
        if self.by_index:
            rows = self._scan_rows(position)
            if _identical(rows.xyz, points):
                return _truth(rows, np.ones(len(points), np.bool_))
        return self._match_nearest(points)

    def _scan_rows(self, position: int) -> Pcd:
        """The rows of a scan in the cloud."""
        first, last = self._row_ranges[position]
        if self._sliceable:
            return read_pcd(self.path, (first, last))
        return Pcd(self.path, self._cloud.header, self._cloud.rows[first:last])

    def _match_nearest(self, points: F32) -> Truth:
        row = np.zeros(len(points), np.intp)
        distance = np.full(len(points), np.inf)
        finite = np.isfinite(points).all(1)
        distance[finite], row[finite] = self._tree.query(
            points[finite], distance_upper_bound=MATCH_RADIUS
        )
        matched = np.isfinite(distance)
        return _truth(
            Pcd(self.path, self._cloud.header, self._cloud.rows[np.where(matched, row, 0)]), matched
        )

    @cached_property
    def _cloud(self) -> Pcd:
        return read_pcd(self.path)

    @cached_property
    def _tree(self) -> cKDTree:
        from scipy.spatial import cKDTree

        xyz = self._cloud.xyz
        finite = np.where(np.isfinite(xyz).all(1, keepdims=True), xyz, np.float32(1e9))
        # builds three times faster
        return cKDTree(finite, compact_nodes=False, balanced_tree=False)


def _identical(a: F32, b: F32) -> bool:
    """Whether two clouds are bitwise identical."""
    return a.shape == b.shape and bool(np.array_equal(a.view(np.uint32), b.view(np.uint32)))


def _truth(rows: Pcd, matched: Bool) -> Truth:
    """Ground truth of points from their rows in the cloud; unmatched points are unlabelled."""
    intensity = rows["intensity"]
    labels = np.full(len(rows), Label.UNLABELLED, np.uint8)
    known = matched & (intensity != Label.UNLABELLED)
    labels[known & (intensity == Label.STATIC)] = Label.STATIC
    labels[known & (intensity == Label.DYNAMIC)] = Label.DYNAMIC
    invalid = known & (labels == Label.UNLABELLED)
    if invalid.any():
        raise DataError(
            rows.path, f"intensity {intensity[invalid][0]:g} is not a label", hint=_HINT
        )
    classes = rows["class"].astype(np.uint16) * matched if "class" in rows else None
    instances = rows["instance"].astype(np.int32) * matched if "instance" in rows else None
    return Truth(labels, classes, instances, int(len(matched) - matched.sum()))

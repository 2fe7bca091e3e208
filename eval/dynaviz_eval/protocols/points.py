"""SA, DA and AA over points.

By index as dynaviz counts, and by nearest neighbour as the public benchmark's scripts.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from dynaviz.arrays import F32, U8
from dynaviz.contracts.metric import Labelled
from dynaviz.contracts.protocol import ProtocolInfo
from dynaviz.contracts.scan import Label, outcomes
from dynaviz.scores.scores import SCORES, Counts
from dynaviz.spatial.nearest import Nearest
from dynaviz_eval.protocols import Counted

RADIUS = 0.05  # metres: half of the benchmark's 0.1 m voxel
_COUNTS = ("static_kept", "static_removed", "dynamic_removed", "dynamic_kept")


class _Accuracy(Counted):
    """SA, DA, AA and HA of the points that were counted."""

    def __init__(self, scoring: str) -> None:
        self._counts = Counts()

    def counts(self) -> Mapping[str, int]:
        """Points by truth and answer."""
        return {name: getattr(self._counts, name) for name in _COUNTS}

    @staticmethod
    def scores_of(counts: Mapping[str, float]) -> Mapping[str, float]:
        """SA, DA, AA and HA."""
        found = Counts(*(int(counts.get(name, 0)) for name in _COUNTS))
        return {name: getattr(found, name) for name in SCORES}


class PointsProtocol(_Accuracy):
    """SA, DA, AA and HA over all labelled points, by index: the main metric of dynaviz."""

    info: ClassVar = ProtocolInfo(
        name="points",
        title="Points",
        source="dynaviz, and the text of Zhang et al., ITSC 2023",
        counts="points of all frames, each by its own label",
        ignores="unlabelled points",
        combines="counts added over frames and sequences",
        scores=("AA", "SA", "DA", "HA"),
    )

    def update(self, labelled: Labelled) -> None:
        """Add one scan."""
        self._counts += Counts.of(labelled.outcome)


class PublicBenchmark(_Accuracy):
    """SA, DA, AA and HA as the scripts of the public benchmark count.

    By nearest neighbour in the cleaned map.

    The cleaned map is all points that the run keeps. A point counts as removed if no point of that
    map lies within 0.05 m, whatever its own label. Unlike in those scripts, unlabelled points are
    not scored. For a map of another program the labels already follow this rule. Memory grows with
    the number of points: 13 bytes each.
    """

    info: ClassVar = ProtocolInfo(
        name="benchmark",
        title="Public benchmark",
        source="scripts of Zhang et al., ITSC 2023",
        counts="points of all frames; removed if no kept point lies within 0.05 m",
        ignores="unlabelled points",
        combines="counts added over frames and sequences",
        scores=("AA", "SA", "DA", "HA"),
    )

    def __init__(self, scoring: str) -> None:
        super().__init__(scoring)
        self._nearest = scoring == "nn"
        self._kept: list[F32] = []
        self._removed: list[F32] = []
        self._truth: list[U8] = []

    def update(self, labelled: Labelled) -> None:
        """Add one scan."""
        truth = labelled.scan.labels
        if truth is None:
            return
        if self._nearest:
            self._counts += Counts.of(labelled.outcome)
            return
        finite = np.isfinite(labelled.scan.points).all(1)
        asked = labelled.dynamic & finite & (truth != Label.UNLABELLED)
        self._kept.append(labelled.scan.points[~labelled.dynamic & finite])
        self._removed.append(labelled.scan.points[asked])
        self._truth.append(truth[asked])
        self._counts += Counts.of(labelled.outcome[~asked])  # kept points are in the map

    def counts(self) -> Mapping[str, int]:
        """Points by truth and answer; searches the removed points in the map of the kept ones."""
        if self._truth:
            tree = Nearest(np.concatenate(self._kept))
            near = tree.within(np.concatenate(self._removed), RADIUS)
            self._counts += Counts.of(outcomes(np.concatenate(self._truth), ~near))
        return super().counts()

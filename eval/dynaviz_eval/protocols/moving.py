"""Intersection over union of the moving points, as in moving object segmentation.

SemanticKITTI, HeLiMOS, DOALS.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import ClassVar

import numpy as np

from dynaviz.arrays import Bool
from dynaviz.contracts.metric import Labelled
from dynaviz.contracts.protocol import ProtocolInfo, ProtocolScores
from dynaviz.contracts.scan import Label, Scan
from dynaviz.scores.scores import percent
from dynaviz_eval.protocols import Counted

IGNORED = ("unlabelled", "outlier")  # names of the classes 0 and 1 of SemanticKITTI
SCORES = ("IoU", "precision", "recall")


def scored_points(scan: Scan) -> Bool:
    """(N,) bool: labelled points, without those of the classes 0 and 1 of SemanticKITTI.

    In the public benchmark, and hence in ``Scan.labels``, points of these classes are static, or
    dynamic near the car.
    """
    if scan.labels is None:
        return np.zeros(len(scan), np.bool_)
    scored: Bool = scan.labels != Label.UNLABELLED
    ignored = [number for number, name in scan.class_names.items() if name in IGNORED]
    if scan.classes is not None and ignored:
        scored &= ~np.isin(scan.classes, ignored)
    return scored


def moving_counts(labelled: Labelled, scored: Bool) -> tuple[int, int, int]:
    """True positives, false positives and false negatives of the moving class among the (N,) scored
    points.
    """
    moving = scored & (labelled.scan.labels == Label.DYNAMIC)
    predicted = scored & labelled.dynamic
    true_positives = int((moving & predicted).sum())
    return true_positives, int(predicted.sum()) - true_positives, int(moving.sum()) - true_positives


class SemanticKittiMos(Counted):
    """IoU of the moving points as in the SemanticKITTI-MOS benchmark (Chen et al., RA-L 2021)."""

    info: ClassVar = ProtocolInfo(
        name="semantickitti_mos",
        title="SemanticKITTI-MOS",
        source="Chen et al., RA-L 2021",
        counts="moving points of all frames: IoU = TP / (TP + FP + FN)",
        ignores="classes 0 (unlabelled) and 1 (outlier)",
        combines="counts added over the sequences of a split",
        scores=SCORES,
        splits={
            "train": ("00", "01", "02", "03", "04", "05", "06", "07", "09", "10"),
            "val": ("08",),
            "test": ("11", "12", "13", "14", "15", "16", "17", "18", "19", "20", "21"),
        },
    )

    def __init__(self, scoring: str) -> None:
        self._tp = self._fp = self._fn = 0

    def update(self, labelled: Labelled) -> None:
        """Add one scan."""
        tp, fp, fn = moving_counts(labelled, scored_points(labelled.scan))
        self._tp += tp
        self._fp += fp
        self._fn += fn

    def counts(self) -> Mapping[str, int]:
        """True positives, false positives and false negatives."""
        return {"TP": self._tp, "FP": self._fp, "FN": self._fn}

    @staticmethod
    def scores_of(counts: Mapping[str, float]) -> Mapping[str, float]:
        """IoU, precision and recall."""
        tp, fp, fn = (counts.get(name, 0) for name in ("TP", "FP", "FN"))
        return {
            name: float(percent(tp, whole)) for name, whole in _denominators(tp, fp, fn).items()
        }


class Helimos(SemanticKittiMos):
    """IoU of the moving points for each lidar of HeLiMOS, and the mean over the lidars (Lim et al.,
    IROS 2024).
    """

    info: ClassVar = ProtocolInfo(
        name="helimos",
        title="HeLiMOS",
        source="Lim et al., IROS 2024",
        counts="moving points of the labelled frames of one lidar: IoU = TP / (TP + FP + FN)",
        ignores="unlabelled points; frames outside the split (train.txt, val.txt, test.txt)",
        combines="mean of the scores of the lidars",
        scores=SCORES,
    )

    @classmethod
    def combine(cls, parts: Sequence[ProtocolScores]) -> ProtocolScores:
        """Mean over the lidars; None if undefined for one of them."""
        return ProtocolScores(
            {name: _mean([part.scores[name] for part in parts]) for name in SCORES}
        )


class Doals(Counted):
    """IoU of the moving points in each labelled scan of DOALS, within 0.5 to 20 m, and its mean
    over the scans.

    As in the evaluation of Dynablox (Schmid et al., RA-L 2023). A scan without moving points in
    which none is predicted has an IoU of 100 %.
    """

    info: ClassVar = ProtocolInfo(
        name="doals",
        title="DOALS",
        source="Pfreundschuh et al., ICRA 2021; Schmid et al., RA-L 2023",
        counts="moving points within 0.5 to 20 m, scan by scan",
        ignores="scans without labels; points out of range",
        combines="mean over the labelled scans (ten per sequence)",
        scores=SCORES,
    )
    range_limits: ClassVar = (0.5, 20.0)  # metres

    def __init__(self, scoring: str) -> None:
        self._scans = 0
        self._sums = dict.fromkeys(SCORES, 0.0)

    def update(self, labelled: Labelled) -> None:
        """Add one scan."""
        scan = labelled.scan
        scored = scored_points(scan)
        if not scored.any():
            return
        low, high = (np.float32(limit**2) for limit in self.range_limits)
        squared = scan.squared_ranges()
        scored &= (squared >= low) & (squared <= high)
        tp, fp, fn = moving_counts(labelled, scored)
        for name, whole in _denominators(tp, fp, fn).items():
            self._sums[name] += 100.0 * tp / whole if whole else 100.0
        self._scans += 1

    def counts(self) -> Mapping[str, float]:
        """The number of scans, and the sum of each score over them."""
        return {"scans": self._scans, **self._sums}

    @staticmethod
    def scores_of(counts: Mapping[str, float]) -> Mapping[str, float]:
        """Means of IoU, precision and recall over the scans."""
        scans = counts.get("scans", 0)
        return {name: counts[name] / scans if scans else math.nan for name in SCORES}


def _denominators(tp: float, fp: float, fn: float) -> dict[str, float]:
    return {"IoU": tp + fp + fn, "precision": tp + fp, "recall": tp + fn}


def _mean(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return sum(known) / len(known) if known and len(known) == len(values) else None

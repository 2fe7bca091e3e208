"""The lossless part of a recording.

Label, ground truth, reason and range band of each point, a column each.
"""

from __future__ import annotations

import dataclasses
import zlib
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynaviz import kernels
from dynaviz.arrays import U8, Bool
from dynaviz.contracts.metric import Labelled
from dynaviz.contracts.scan import Label, Scan, outcomes
from dynaviz.scores.scores import RANGE_EDGES

BAND_NAMES = ("0-10 m", "10-20 m", "20-30 m", "30-50 m", "50+ m")  # of the bins of RANGE_EDGES
ARCHETYPE = "dynaviz.Answers"


@dataclass(frozen=True, slots=True, eq=False)
class FrameAnswers:
    """The labels of one frame, in the order of the scan's points.

    Attributes:
        frame: position in the run.
        index: number of the frame in its data set.
        dynamic: (N,) bool, the method's labels.
        truth: (N,) uint8, a ``Label`` per point.
        reasons: (N,) uint8, the method's reason codes.
        bands: (N,) uint8, range from the sensor as an index into ``BAND_NAMES``.
    """

    frame: int
    index: int
    dynamic: Bool
    truth: U8
    reasons: U8
    bands: U8

    def __len__(self) -> int:
        return len(self.dynamic)

    @property
    def outcome(self) -> U8:
        """(N,) uint8, an ``Outcome`` per point."""
        return outcomes(self.truth, self.dynamic)

    def unscored(self) -> FrameAnswers:
        """The same answers without ground truth."""
        return dataclasses.replace(self, truth=np.full(len(self), Label.UNLABELLED, np.uint8))

    @classmethod
    def of(cls, labelled: Labelled) -> FrameAnswers:
        """From a labelled scan."""
        scan = labelled.scan
        truth = (
            np.full(len(scan), Label.UNLABELLED, np.uint8) if scan.labels is None else scan.labels
        )
        return cls(
            labelled.frame, scan.index, labelled.dynamic, truth, labelled.reasons, range_bands(scan)
        )

    def packed(self) -> dict[str, NDArray[np.generic]]:
        """Components of the recording.

        Two numbers, and four (N,) arrays, which a scan without points lacks.
        """
        numbers: dict[str, NDArray[np.generic]] = {
            "index": np.array([self.index], np.int64),
            "points": np.array([len(self)], np.int64),
        }
        columns = {
            "removed": self.dynamic.astype(np.uint8),
            "truth": self.truth,
            "reason": self.reasons,
            "band": self.bands,
        }
        return numbers | (columns if len(self) else {})

    @classmethod
    def unpacked(cls, frame: int, components: dict[str, NDArray[np.generic]]) -> FrameAnswers:
        """The inverse of ``packed``.

        Those of earlier recordings are compressed with zlib.

        Raises:
            ValueError, zlib.error: if the components are damaged.
        """
        n = int(components["points"][0])
        index = int(components["index"][0])
        if "predicted" in components:
            bits = np.unpackbits(_decompress(components["predicted"], (n + 7) // 8), count=n)
            truth, reasons, bands = (
                _decompress(components[name], n) for name in ("truth", "reasons", "bands")
            )
            return cls(frame, index, bits.astype(np.bool_), truth, reasons, bands)
        removed, truth, reasons, bands = (
            _complete(components.get(name), n) for name in ("removed", "truth", "reason", "band")
        )
        return cls(frame, index, removed.astype(np.bool_), truth, reasons, bands)


def range_bands(scan: Scan) -> U8:
    """(N,) uint8: each point's range from its ray's origin as an index into ``BAND_NAMES``.

    The last if not finite.
    """
    points, origins = (
        kernels.as_readonly(array, np.float32) for array in (scan.points, scan.origins)
    )
    bands: U8 = kernels.drawing.range_bands(
        points, origins, np.square(RANGE_EDGES).astype(np.float32)
    )
    return bands


def _decompress(blob: NDArray[np.generic], n: int) -> U8:
    return _complete(np.frombuffer(zlib.decompress(blob.tobytes()), np.uint8), n)


def _complete(array: NDArray[np.generic] | None, n: int) -> U8:
    """The array, which must have ``n`` values; none is empty."""
    values = np.empty(0, np.uint8) if array is None else array.astype(np.uint8)
    if len(values) != n:
        raise ValueError(f"{len(values)} values instead of {n}")
    return values

"""The lossless part of a recording.

Label, ground truth, reason and range band of each point, compressed by frame.
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

        Two numbers, and four (bytes,) uint8 arrays compressed with zlib.
        """
        return {
            "index": np.array([self.index], np.int64),
            "points": np.array([len(self)], np.int64),
            "predicted": _compress(np.packbits(self.dynamic)),
            "truth": _compress(self.truth),
            "reasons": _compress(self.reasons),
            "bands": _compress(self.bands),
        }

    @classmethod
    def unpacked(cls, frame: int, components: dict[str, NDArray[np.generic]]) -> FrameAnswers:
        """The inverse of ``packed``.

        Raises:
            ValueError, zlib.error: if the components are damaged.
        """
        n = int(components["points"][0])
        bits = np.unpackbits(_decompress(components["predicted"], (n + 7) // 8), count=n)
        truth, reasons, bands = (
            _decompress(components[name], n) for name in ("truth", "reasons", "bands")
        )
        return cls(frame, int(components["index"][0]), bits.astype(np.bool_), truth, reasons, bands)


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


def _compress(array: U8) -> U8:
    """Neighbouring points mostly have equal values, so run lengths suffice.

    That is also several times faster.
    """
    packer = zlib.compressobj(1, strategy=zlib.Z_RLE)
    return np.frombuffer(packer.compress(array.tobytes()) + packer.flush(), np.uint8)


def _decompress(blob: NDArray[np.generic], n: int) -> U8:
    array = np.frombuffer(zlib.decompress(blob.tobytes()), np.uint8)
    if len(array) != n:
        raise ValueError(f"{len(array)} values instead of {n}")
    return array

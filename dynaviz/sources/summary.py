"""The first pass over a sequence: extent, number of points, and a digest of the content."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable
from dataclasses import dataclass

from dynaviz.contracts.extent import Extent, GrowingExtent
from dynaviz.contracts.scan import Scan, Sequence, stream
from dynaviz.sources.origin import PoseNoise
from dynaviz.sources.pose_noise import PoseNoiseMeter


class ScanDigest:
    """Digest of scans added one by one: points, poses, ray origins and labels."""

    def __init__(self) -> None:
        self._digest = hashlib.sha256()

    def add(self, scan: Scan) -> None:
        """Add a scan."""
        for array in (scan.points, scan.T_world_sensor, scan.origins, scan.labels):
            self._digest.update(b"-" if array is None else array.tobytes())

    def hexdigest(self) -> str:
        """The SHA-256 digest of all scans so far."""
        return self._digest.hexdigest()


@dataclass(frozen=True)
class SequenceSummary:
    """What one pass over a sequence finds.

    Extent, number of frames and points, and a digest of the content.

    The digest covers points, poses, ray origins and labels of all frames in order: two runs can be
    compared point by point exactly if their digests agree. ``pose_noise`` is None if it was not
    measured, or too few planes are seen. ``seconds`` is what the pass took; 0 if unknown.
    """

    extent: Extent
    frames: int
    points: int
    digest: str
    pose_noise: PoseNoise | None = None
    seconds: float = 0.0


def summarize(
    sequence: Sequence,
    progress: Callable[[int], None] = lambda done: None,
    meter: PoseNoiseMeter | None = None,
) -> SequenceSummary:
    """Read a sequence once, frame by frame.

    Args:
        sequence: never held in memory as a whole.
        progress: called with the number of frames done.
        meter: measures the noise of poses in the same pass, which takes up to a second.

    Raises:
        DynavizError: for points or ray origins farther than ``dynaviz.contracts.extent.FAR`` from
            the world's origin.
    """
    begin = time.perf_counter()
    growing = GrowingExtent()
    digest = ScanDigest()
    points = 0
    for done, scan in enumerate(stream(sequence), 1):
        growing.add(scan)
        digest.add(scan)
        if meter:
            meter.add(done - 1, scan)
        points += len(scan)
        progress(done)
    noise = meter.result() if meter else None
    seconds = time.perf_counter() - begin
    return SequenceSummary(
        growing.extent(), len(sequence), points, digest.hexdigest(), noise, seconds
    )

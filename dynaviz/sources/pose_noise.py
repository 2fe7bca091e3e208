"""Noise of poses, measured on static planes that several frames see.

In each window of consecutive frames, points are grouped into small patches. Where the points of all
frames form a plane, the mean height of one frame's points above the plane of the others shows that
frame's error in the direction of the normal. The small motion (translation and rotation) of a frame
that explains its heights best is its error relative to the other frames. Moving objects form no
such planes, and their patches get little weight.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dynaviz.arrays import F64, Bool
from dynaviz.contracts.scan import Scan
from dynaviz.contracts.scan import Sequence as ScanSequence
from dynaviz.sources.origin import PoseNoise

WINDOW = 8  # consecutive frames that are compared
WINDOWS = 3  # spread over the sequence
PATCH = 0.8  # metres; edge of a patch
# metres from the sensor
NEAREST = 2.0
FARTHEST = 40.0
POINTS = 60_000  # of a scan, at most
FEWEST_POINTS = 4  # of a frame in a patch
FEWEST_FRAMES = 4  # of a patch
THIN = 0.15  # metres; standard deviation across a patch, at most
# second variance to third, at most; first to second, at least
FLAT = 0.2
WIDE = 0.04
FEWEST_PATCHES = 30  # that a frame needs
HUBER = 0.02  # metres; larger heights get less weight
WEAK = 0.05  # metres; expected error, which decides in directions that no plane shows


def pose_noise(sequence: ScanSequence) -> PoseNoise | None:
    """Measure the noise of a sequence's poses in some windows; None if too few planes are seen.

    Raises:
        DataError: for scans that cannot be read.
    """
    meter = PoseNoiseMeter(len(sequence))
    for position in meter.needed:
        meter.add(position, sequence[position])
    return meter.result()


class PoseNoiseMeter:
    """Measures the noise of poses while a sequence is read in order.

    It keeps the scans of one window at a time.

    Args:
        frames: number of frames of the sequence.
    """

    def __init__(self, frames: int) -> None:
        self._length = min(WINDOW, frames)
        starts = np.unique(np.linspace(0, frames - self._length, WINDOWS).astype(int))
        self.needed = sorted({int(start) + k for start in starts for k in range(self._length)})
        self._ends = {int(start) + self._length - 1 for start in starts}
        self._scans: list[Scan] = []
        self._last = -1  # position of the last of them
        self._found: list[Motion] = []

    def add(self, position: int, scan: Scan) -> None:
        """Add a scan; those at other positions than ``needed`` are ignored, and windows that lack a
        scan.
        """
        if position not in self.needed or self._length < FEWEST_FRAMES:
            return
        before = self._scans[1 - self._length :] if position == self._last + 1 else []
        self._scans = [*before, scan]
        self._last = position
        if position in self._ends and len(self._scans) == self._length:
            self._found += window_errors(self._scans)

    def result(self) -> PoseNoise | None:
        """The noise, from the scans so far; None if too few planes are seen."""
        if len(self._found) < FEWEST_FRAMES:
            return None
        squares = (
            np.sum([each.error**2 - each.variance for each in self._found], axis=0)
            .reshape(2, 3)
            .sum(1)
        )
        shown = np.sum([each.resolution**2 for each in self._found], axis=0).reshape(2, 3).sum(1)
        variances = squares / shown
        # A frame is compared with others that have errors, too, so differences vary more than
        # errors.
        shift, turn = np.sqrt(np.maximum(variances * (self._length - 1) / self._length, 0.0))
        patches = int(np.median([each.patches for each in self._found]))
        return PoseNoise(
            round(float(shift), 4), round(float(np.degrees(turn)), 3), patches, len(self._found)
        )


@dataclass(frozen=True, eq=False)
class Motion:
    """The error of a frame's pose relative to its neighbours.

    Attributes:
        error: (6,) float64: translation in metres and rotation vector in radians about the sensor,
            world axes.
        variance: (6,) float64: what range noise adds to the squares of these numbers.
        resolution: (6,) float64: how well planes show each of them, 0 to 1; the error is smaller by
            this factor.
        patches: number of patches.
    """

    error: F64
    variance: F64
    resolution: F64
    patches: int


def window_errors(scans: Sequence[Scan]) -> list[Motion]:
    """Errors of the poses of consecutive scans with enough patches, each relative to the other
    scans.
    """
    middle = np.mean([scan.position for scan in scans], axis=0)
    patches = Patches.of(scans, middle)
    found = []
    for frame, scan in enumerate(scans):
        seen = patches.counts[:, frame] >= FEWEST_POINTS
        if seen.sum() >= FEWEST_PATCHES:
            heights, normals, centres = patches.heights(frame, seen)
            if len(heights) >= FEWEST_PATCHES:
                found.append(_motion(heights, normals, centres - (scan.position - middle)))
    return found


@dataclass(frozen=True, eq=False)
class Patches:
    """Moments of the points of several frames in the patches that enough of them see.

    Attributes:
        counts: (P, F) float64: points of each frame.
        means: (P, F, 3) float64, metres: their mean.
        normals: (P, 3) float64: normal of the plane through all of them.
        planar: (P,) bool: whether they form a plane.
    """

    counts: F64
    means: F64
    normals: F64
    planar: Bool

    @classmethod
    def of(cls, scans: Sequence[Scan], middle: F64) -> Patches:
        """Patches of scans, relative to a place near them, (3,) metres."""
        points, frames = zip(
            *(_points(scan, frame, middle) for frame, scan in enumerate(scans)), strict=True
        )
        xyz = np.concatenate(points)
        frame = np.concatenate(frames)
        x, y, z = (np.floor(column / PATCH).astype(np.int64) + 2**15 for column in xyz.T)
        _, patch = np.unique(x << 34 | y << 17 | z, return_inverse=True)
        of_all = np.bincount(
            patch * len(scans) + frame, minlength=(patch.max(initial=-1) + 1) * len(scans)
        )
        enough = (of_all.reshape(-1, len(scans)) >= FEWEST_POINTS).sum(1) >= FEWEST_FRAMES
        chosen = enough[patch]
        xyz = xyz[chosen]
        frame = frame[chosen]
        patch = (np.cumsum(enough) - 1)[patch[chosen]]
        number = int(enough.sum())
        key = patch * len(scans) + frame
        counts = (
            np.bincount(key, minlength=number * len(scans))
            .reshape(number, len(scans))
            .astype(np.float64)
        )
        sums = np.stack([np.bincount(key, each, number * len(scans)) for each in xyz.T], axis=1)
        means = sums.reshape(number, len(scans), 3) / np.maximum(counts, 1)[:, :, None]
        total = np.maximum(counts.sum(1), 1)
        centre = (counts[:, :, None] * means).sum(1) / total[:, None]
        away = xyz - centre[patch]
        products = np.empty((number, 3, 3))
        for i, j in itertools.combinations_with_replacement(range(3), 2):
            products[:, i, j] = products[:, j, i] = (
                np.bincount(patch, away[:, i] * away[:, j], number) / total
            )
        values, vectors = np.linalg.eigh(products)
        planar = (
            (values[:, 0] < THIN**2)
            & (values[:, 0] < FLAT * values[:, 1])
            & (values[:, 1] > WIDE * values[:, 2])
        )
        return cls(counts, means, vectors[:, :, 0], planar)

    def heights(self, frame: int, seen: Bool) -> tuple[F64, F64, F64]:
        """Mean height of a frame's points above those of the other frames, (K,) metres; normals.

        Centres, (K, 3).
        """
        rows = np.flatnonzero(seen & self.planar)
        weights = (self.counts[rows] >= FEWEST_POINTS).astype(np.float64)
        weights[:, frame] = 0.0
        others = (weights[:, :, None] * self.means[rows]).sum(1) / weights.sum(1)[:, None]
        own = self.means[rows, frame]
        normals = self.normals[rows]
        return ((own - others) * normals).sum(1), normals, own


def _points(scan: Scan, frame: int, middle: F64) -> tuple[F64, F64]:
    """Points at usable ranges, (N, 3) metres relative to the middle, and the frame's
    number, (N,).
    """
    with np.errstate(invalid="ignore", over="ignore"):
        squares = scan.squared_ranges()
        # false for non-finite points
        rows = np.flatnonzero((squares > NEAREST**2) & (squares < FARTHEST**2))
    rows = rows[:: max(1, len(rows) // POINTS)]
    return scan.points[rows] - middle, np.full(len(rows), frame)


def _motion(heights: F64, normals: F64, arms: F64) -> Motion:
    """The motion that explains heights best; robust least squares.

    Args:
        heights: (K,) metres.
        normals: (K, 3).
        arms: (K, 3) metres, from the sensor to the patches.
    """
    A = np.hstack([normals, np.cross(arms, normals)])
    prior = np.diag([1 / WEAK**2] * 3 + [1 / np.radians(2.0) ** 2] * 3)
    x = np.zeros(6)
    data = np.zeros((6, 6))
    scale = HUBER
    for _ in range(5):
        left = heights - A @ x
        scale = max(1.4826 * float(np.median(np.abs(left))), 1e-4)
        weights = 1 / np.maximum(1.0, np.abs(left) / min(HUBER, 2 * scale))
        data = (A * weights[:, None]).T @ A / scale**2
        x = np.linalg.solve(data + prior, A.T @ (weights * heights) / scale**2)
    spread = np.linalg.inv(data + prior)
    return Motion(x, np.diag(spread @ data @ spread), np.diag(spread @ data), len(A))

"""Which places of a world rays passed through, and in how many scans they were hit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from dynaviz.arrays import F16, F32, F64, I32, I64, Bool
from dynaviz.contracts.scan import Scan
from dynaviz.spatial.grid import in_key_range, pack, unpack
from dynaviz.spatial.scan_ground import ScanGround

EDGE = 0.2  # metres, of a place
GROUND = 0.25  # metres: what is lower counts as ground
COLUMNS = 720  # of a range image
ROWS = 180
FAR = 50.0  # metres: places farther from a sensor are not looked for in its scan
BEYOND = (0.5, 0.02)  # metres, and metres per metre of range: a ray this much longer passed a place


@dataclass(frozen=True, eq=False)
class SeenPlaces:
    """The places that points are in, scan by scan.

    Attributes:
        frame: (N,) int32, position of the frame.
        place: (N,) int32, row in ``cell``; a place has one row for each scan that hit it.
        kept, removed: (N,) int32, points of the scan there, by the answer.
        ground: (N,) bool, whether most of them are on the ground.
        cell: (M, 3) int32, voxel indices of each place.
        hits, passes: (M,) int32, scans that hit the place, and whose rays passed through it.
    """

    frame: I32
    place: I32
    kept: I32
    removed: I32
    ground: Bool
    cell: I32
    hits: I32
    passes: I32


class RangeImages:
    """What scans saw at a place: range images of a sequence.

    Args:
        images: (ROWS * COLUMNS,) float16, metres, for each scan.
        poses: (4, 4) float64, metres, for each scan.
    """

    def __init__(self, images: list[F16], poses: list[F64]) -> None:
        self._images = images
        self._poses = poses

    def through(self, points: F64) -> F64:
        """(F,) share of (N, 3) points, metres, that rays of each scan passed."""
        found = np.zeros(len(self._images))
        for k, (image, pose) in enumerate(zip(self._images, self._poses, strict=True)):
            near = np.abs(points - pose[:3, 3]).max(1) < FAR
            if near.any():
                found[k] = _passed(image, points[near], pose).sum() / len(points)
        return found


class PlaceCounter:
    """Collects the places of a sequence, and a range image of each of its scans."""

    def __init__(self) -> None:
        self._rows: list[tuple[I64, I32, I32, Bool]] = []
        self._images: list[F32] = []
        self._poses: list[F64] = []

    def add(self, scan: Scan, dynamic: Bool) -> None:
        """Add a scan with its (N,) bool answers, True for removed points."""
        chosen = np.flatnonzero(in_key_range(scan.points, EDGE))
        points = scan.points[chosen]
        heights = ScanGround.of(scan.points, scan.position).heights(points)
        keys, inverse = np.unique(pack(points, EDGE), return_inverse=True)
        total = np.bincount(inverse, minlength=len(keys))
        removed = np.bincount(inverse[dynamic[chosen]], minlength=len(keys))
        low = np.bincount(inverse[heights < GROUND], minlength=len(keys))
        ground = 2 * low > total
        self._rows.append(
            (keys, (total - removed).astype(np.int32), removed.astype(np.int32), ground)
        )
        self._images.append(_image(points, scan.T_world_sensor))
        self._poses.append(scan.T_world_sensor)

    @property
    def looks(self) -> RangeImages:
        """What the scans saw."""
        return RangeImages([image.astype(np.float16) for image in self._images], self._poses)

    def finish(self) -> SeenPlaces:
        """The places, and how many scans passed through each."""
        lengths = [len(keys) for keys, *_ in self._rows]
        every = np.concatenate([keys for keys, *_ in self._rows] or [np.empty(0, np.int64)])
        keys, place, hits = np.unique(every, return_inverse=True, return_counts=True)
        cell = unpack(keys)
        middle: F64 = ((cell + 0.5) * EDGE).astype(np.float64)
        passes = np.zeros(len(keys), np.int32)
        for image, pose in zip(self._images, self._poses, strict=True):
            near = np.flatnonzero(np.abs(middle - pose[:3, 3]).max(1) < FAR)
            passes[near] += _passed(image, middle[near], pose)
        none = np.empty(0, np.int32)
        rows = self._rows or [(none.astype(np.int64), none, none, none.astype(np.bool_))]
        return SeenPlaces(
            np.repeat(np.arange(len(lengths), dtype=np.int32), lengths),
            place.astype(np.int32),
            np.concatenate([row[1] for row in rows]),
            np.concatenate([row[2] for row in rows]),
            np.concatenate([row[3] for row in rows]),
            cell,
            hits.astype(np.int32),
            passes,
        )


def _pixels(points: F32 | F64, T_world_sensor: F64) -> tuple[I64, F64]:
    """(N,) pixels of points in the range image of a sensor, and (N,) ranges, metres."""
    local = (points - T_world_sensor[:3, 3]) @ T_world_sensor[:3, :3]
    flat = np.hypot(local[:, 0], local[:, 1])
    azimuth = np.arctan2(local[:, 1], local[:, 0]) / (2 * np.pi) + 0.5
    elevation = np.arctan2(local[:, 2], flat) / np.pi + 0.5
    column = np.minimum((azimuth * COLUMNS).astype(np.int64), COLUMNS - 1)
    row = np.minimum((elevation * ROWS).astype(np.int64), ROWS - 1)
    return row * COLUMNS + column, np.hypot(flat, local[:, 2])


def _image(points: F32, T_world_sensor: F64) -> F32:
    """(ROWS * COLUMNS,) float32, metres: the shortest range in and next to each pixel; 0 without a
    point in it.
    """
    pixel, ranges = _pixels(points, T_world_sensor)
    shortest = np.full(ROWS * COLUMNS, np.inf, np.float32)
    np.minimum.at(shortest, pixel, ranges.astype(np.float32))
    seen = np.isfinite(shortest)
    image = ndimage.minimum_filter(
        shortest.reshape(ROWS, COLUMNS), 3, mode=("nearest", "wrap")
    ).ravel()
    found: F32 = np.where(seen, image, np.float32(0))
    return found


def _passed(image: F32 | F16, points: F64, T_world_sensor: F64) -> Bool:
    """(N,) bool: whether all rays around (N, 3) points, metres, are longer than they are far."""
    pixel, ranges = _pixels(points, T_world_sensor)
    beyond = np.maximum(BEYOND[0], BEYOND[1] * ranges)
    passed: Bool = image[pixel] > ranges + beyond
    return passed

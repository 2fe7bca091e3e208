"""Packed voxel keys and sets of them; wraps the voxel kernels.

A voxel of edge ``size`` has the integer index floor(p / size) per axis. The three indices are
packed into one int64 of three times 21 bits, so a world may span a million voxels to each side of
its origin.
"""

from __future__ import annotations

import numpy as np

from dynaviz import kernels
from dynaviz.arrays import F32, F64, I32, I64, Bool, Intp
from dynaviz.kernels.keys import MASK, REACH, X_SHIFT, Y_SHIFT

SHIFTS = np.array([X_SHIFT, Y_SHIFT, 0], np.int64)  # of x, y and z in a packed key


def pack(points: F32 | F64, size: float) -> I64:
    """Compute packed voxel keys.

    Args:
        points: (N, 3) float, metres; finite.
        size: edge of a voxel, metres.

    Returns:
        (N,) int64.

    Raises:
        ValueError: if a point is not finite, or farther than ``REACH`` voxels from the origin.
    """
    keys, ok = kernels.voxels.pack(kernels.as_readonly(points, np.float32), float(size))
    if not ok:
        raise ValueError(
            f"points must be finite and within {REACH * size:.0f} m of the world's origin for "
            f"{size} m voxels"
        )
    return keys  # type: ignore[no-any-return]


def in_key_range(points: F32 | F64, size: float) -> Bool:
    """(N,) bool: whether each of (N, 3) points, metres, is finite and within the key range of this
    voxel size.
    """
    limit = REACH * size
    near = np.ones(len(points), np.bool_)
    for axis in range(3):  # columns are much faster than rows
        near &= np.abs(points[:, axis]) < limit
    return near


def unpack(keys: I64) -> I32:
    """(N, 3) int32 voxel indices of packed keys."""
    return ((keys[:, None] >> SHIFTS & MASK) - REACH).astype(np.int32)


def pack_indices(indices: I32 | I64) -> I64:
    """(N,) int64 packed keys of voxel indices (N, 3), within the key range.

    The inverse of ``unpack``.
    """
    keys: I64 = ((indices.astype(np.int64) + REACH) << SHIFTS).sum(1)
    return keys


class KeySet:
    """A growing set of packed keys; memory grows with the number of distinct keys."""

    def __init__(self) -> None:
        self._slots = np.full(1024, -1, np.int64)
        self._count = 0

    def __len__(self) -> int:
        return self._count

    def add(self, keys: I64) -> Bool:
        """Add keys (N,) int64; returns (N,) bool, True at the first occurrence of each new key."""
        self._make_room(len(keys))
        new: Bool = kernels.voxels.insert(self._slots, kernels.as_readonly(keys, np.int64))
        self._count += int(new.sum())
        return new

    def first_in(self, points: F32, rows: I64, middle: F32, size: float) -> I64:
        """Add the voxels of points.

        Args:
            points: (N, 3) float32, metres.
            rows: (K,) the points to add; finite, and within ``REACH`` voxels of the middle.
            middle: (3,) float32, metres: the corner of voxel (0, 0, 0).
            size: edge of a voxel, metres.

        Returns:
            Those of the rows that are the first in a new voxel, in their order.
        """
        self._make_room(len(rows))
        points = kernels.as_readonly(points, np.float32)
        rows = kernels.as_readonly(rows, np.int64)
        first: I64 = kernels.drawing.in_new_voxels(self._slots, points, rows, middle, float(size))
        self._count += len(first)
        return first

    def _make_room(self, count: int) -> None:
        room = 2 * (self._count + count)
        if room > len(self._slots):
            self._slots = kernels.voxels.rehash(self._slots, 1 << int(room).bit_length())

    def keys(self) -> I64:
        """(len,) int64, sorted."""
        return np.sort(self._slots[self._slots >= 0])

    def clear(self) -> None:
        """Remove all keys; the memory is kept for new ones."""
        self._slots.fill(-1)
        self._count = 0


def voxel_downsample(points: F32, size: float) -> tuple[Intp, Intp]:
    """Select one point per voxel.

    Args:
        points: (N, 3) float32, metres; finite.
        size: edge of a voxel, metres.

    Returns:
        chosen: (M,) rows of the first point of each voxel, in the order of the points.
        counts: (M,) number of points in that voxel.
    """
    _, first, counts = np.unique(pack(points, size), return_index=True, return_counts=True)
    order = np.argsort(first)
    return first[order], counts[order]

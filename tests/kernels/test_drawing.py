"""Single passes over the points of a frame, compared with numpy."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dynaviz import kernels
from dynaviz.spatial.grid import KeySet, pack, voxel_downsample

pytestmark = pytest.mark.plain

MIDDLE = np.array([3.0, -2.0, 0.5], np.float32)


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 2**32 - 1), st.floats(0.05, 3.0))
def test_one_point_per_voxel(seed, size):
    random = np.random.default_rng(seed)
    points = random.uniform(-4, 4, (200, 3)).astype(np.float32)[
        random.integers(0, 200, 300)
    ]  # some are equal
    rows = np.flatnonzero(random.random(300) < 0.7)
    arguments = (
        kernels.as_readonly(points, np.float32),
        kernels.as_readonly(rows, np.int64),
        MIDDLE,
        size,
    )
    first, counts = voxel_downsample(points[rows] - MIDDLE, size)
    chosen, stands_for = kernels.drawing.downsampled(*arguments)
    assert chosen.tolist() == rows[first].tolist()
    assert stands_for.tolist() == counts.tolist()
    known = KeySet()
    half = len(rows) // 2
    new = [
        known.first_in(points, part, MIDDLE, size).tolist()
        for part in (rows[:half], rows[half:], rows)
    ]
    assert new == [*new[:2], []]
    assert [*new[0], *new[1]] == rows[first].tolist()
    assert known.keys().tolist() == np.unique(pack(points[rows] - MIDDLE, size)).tolist()


def test_rows_of_each_class():
    random = np.random.default_rng(1)
    points = random.uniform(-9, 9, (500, 3)).astype(np.float32)
    points[random.integers(0, 500, 40), random.integers(0, 3, 40)] = np.nan
    points[7] = np.inf
    classes = random.integers(0, 5, 500).astype(np.uint8)
    readonly = kernels.as_readonly(points, np.float32)
    rows, bounds = kernels.drawing.by_class(
        kernels.as_readonly(classes, np.uint8), readonly, MIDDLE, np.float32(8), 6
    )
    near = (np.abs(points - MIDDLE) < 8).all(1)
    assert 0 < near.sum() < 460
    for c in range(6):
        assert (
            rows[bounds[c] : bounds[c + 1]].tolist()
            == np.flatnonzero(near & (classes == c)).tolist()
        )

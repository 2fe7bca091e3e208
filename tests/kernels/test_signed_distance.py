from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dynaviz import kernels

KERNELS = kernels.load("dynaviz_methods.dynablox.kernels")

pytestmark = pytest.mark.boundscheck

SIZE, TRUNCATION, ROWS, COLUMNS = 0.1, 0.4, 32, 512
VIEW = (
    float(ROWS),
    float(COLUMNS),
    math.radians(12),
    (ROWS - 1) / math.radians(27),
    COLUMNS / (2 * math.pi),
)


def updated(blocks, position, axes, image) -> np.ndarray:
    """(B, 8) uint64: voxels that an image updates, if all blocks are compared with it."""
    places = np.stack(np.unravel_index(np.arange(512), (8, 8, 8)))
    offsets = np.ascontiguousarray(axes @ (places + 0.5) * SIZE, np.float32)
    bits = [np.zeros((len(blocks), 8), np.uint64) for _ in range(3)]
    voxels = np.full((len(blocks), 8), ~np.uint64(0)), 512 * np.arange(len(blocks) + 1)
    state = np.zeros(512 * len(blocks), np.float32), np.zeros(512 * len(blocks), np.uint16)
    active = np.arange(len(blocks), dtype=np.int32)
    camera = position, axes, offsets, VIEW, image
    KERNELS.signed_distance.integrate(
        active, blocks, SIZE, *camera, TRUNCATION, 0.3, 1000, *voxels, *state, *bits, 1
    )
    return bits[2]


@pytest.mark.parametrize("seed", range(6))
def test_blocks_out_of_view_have_no_voxels_that_the_image_updates(seed):
    random = np.random.default_rng(seed)
    blocks = np.unique(random.integers((-40, -40, -12), (40, 40, 12), (3000, 3)), axis=0)
    position, axes = (
        random.uniform(-3, 3, 3),
        Rotation.from_rotvec(random.normal(size=3) * (0.2, 0.2, 3)).as_matrix(),
    )
    coarse = np.exp(random.uniform(np.log(2), np.log(30), (8, 32)))  # metres: surfaces near and far
    ranges = np.where(
        random.random((ROWS, COLUMNS)) < 0.1, 0, np.kron(coarse, np.ones((4, 16)))
    ).astype(np.float32)
    pixels = np.arange(ROWS * COLUMNS, dtype=np.int32)
    image = KERNELS.signed_distance.image(pixels, ranges.ravel(), ROWS, COLUMNS)
    table = KERNELS.signed_distance.farthest(image, ROWS, COLUMNS)
    seen = KERNELS.signed_distance.in_view(
        blocks, np.arange(len(blocks)), 8 * SIZE, position, axes, VIEW, table, TRUNCATION
    )
    changes = updated(blocks, position, axes, image).any(1)
    assert not (changes & ~seen).any()
    assert (seen & ~changes).sum() < 0.5 * (~changes).sum()


@pytest.mark.parametrize("columns", [1, 5, 40])
def test_the_farthest_ranges_of_the_next_pixels_wrap_around(columns):
    image = np.random.default_rng(0).random((3, columns)).astype(np.float32)
    table = KERNELS.signed_distance.farthest(image.ravel(), 3, columns).reshape(-1, 3, columns)
    for k, found in enumerate(table):
        np.testing.assert_array_equal(
            found, np.max([np.roll(image, -n, axis=1) for n in range(1 << k)], axis=0)
        )


@pytest.mark.parametrize("columns", [64, 20_000])
def test_pixels_are_those_of_angles_in_float64(columns):
    random = np.random.default_rng(0)
    points = random.normal(size=(20_000, 3)).astype(np.float32)
    view = np.array([32, columns, np.radians(20), 31 / np.radians(40), columns / (2 * np.pi)])
    pixels, _, inside = KERNELS.signed_distance.pixels(
        points, np.zeros(3), np.eye(3), 0.1, 90.0, view
    )
    x, y, z = points.T.astype(np.float64)
    row = np.floor((view[2] - np.arctan2(z, np.hypot(x, y))) * view[3] + 0.5).astype(int)
    column = np.floor((np.arctan2(y, x) + np.pi) * view[4] + 0.5).astype(int) % columns
    expected = np.where((row >= 0) & (row < 32) & inside, row * columns + column, -1)
    np.testing.assert_array_equal(pixels, expected)

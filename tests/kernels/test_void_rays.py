from __future__ import annotations

import numpy as np
import pytest

from dynaviz import kernels
from dynaviz.contracts.extent import CELL, Extent
from dynaviz.contracts.scan import Scan
from dynaviz_methods.dufomap.voids import VoidGrid, VoidMarks

pytestmark = pytest.mark.boundscheck


def grid_around(points) -> VoidGrid:
    bounds = np.full(3, 300.0)
    return VoidGrid(
        Extent(-bounds, bounds, np.unique(np.floor(points / CELL).astype(np.int32), axis=0)),
        0.1,
        0.2,
        1,
    )


def with_addresses(grid: VoidGrid) -> VoidGrid:
    """The grid, made to observe the surroundings of the sensor without its directory, as grids that
    roll do.
    """
    grid._words, touched = kernels.addresses.memory(kernels.threads_in_use(), of_word=2)
    grid._near = grid._words[..., 0], touched
    return grid


def seen(grid: VoidGrid, scan: Scan) -> list[np.ndarray]:
    voxels = grid.locate(scan.points)
    marks: VoidMarks = grid.see(scan, voxels, voxels >= 0)
    order = np.argsort(marks.blocks)
    return [of[order] for of in (marks.blocks, marks.hit, marks.observed, marks.void)]


@pytest.mark.parametrize("distance", [3, 20, 70])  # metres; addresses reach 50 m, 12 m in height
def test_rays_observe_the_same_voxels_at_addresses_and_beyond(distance):
    random = np.random.default_rng(distance)
    for rays in (1, 3, 300):
        origin = random.uniform(-5, 5, 3)
        points = origin + random.normal(size=(rays, 3)) * (distance, distance, distance / 4)
        along = np.concatenate(
            [origin + share * (points - origin) for share in np.linspace(0, 1, 100)]
        )
        scan = Scan(0, points.astype(np.float32), np.eye(4), origins=origin[None])
        grid = with_addresses(grid_around(along))
        for ours, expected in zip(seen(grid, scan), seen(grid_around(along), scan), strict=True):
            np.testing.assert_array_equal(ours, expected)
        assert not grid._words.any()
        assert not grid._near[1].any()

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dynaviz import kernels
from dynaviz.blocks.blocks import BlockGrid, voxels_of
from dynaviz.contracts.extent import CELL, Extent
from dynaviz.contracts.scan import Scan

pytestmark = pytest.mark.boundscheck

RESOLUTION = 0.1
REACH = 26  # cells of 0.8 m to each side: some super-blocks of 12.8 m

# Positions in voxels; multiples of 1/8 give many rays that cross several borders at once.
place = st.tuples(
    *[st.floats(-200, 200, width=32) | st.integers(-1600, 1600).map(lambda n: n / 8)] * 3
)


def grid_of(cells) -> BlockGrid:
    bounds = np.full(3, REACH * CELL)
    return BlockGrid(Extent(-bounds, bounds, np.asarray(cells, np.int32)), RESOLUTION)


def along(origins, ends) -> Scan:
    ends = np.asarray(ends, np.float32) * np.float32(RESOLUTION)
    return Scan(0, ends, np.eye(4), origins=np.asarray(origins, float) * RESOLUTION)


def crossed(grid: BlockGrid, scan: Scan) -> set[tuple[int, int, int]]:
    marks = grid.mark(scan, np.ones(len(scan), bool), np.zeros(len(scan), bool))
    return {tuple(k) for k in grid.keys(voxels_of(marks.blocks, marks.bits[:, :8])).tolist()}


def everywhere(scan: Scan) -> BlockGrid:
    """A grid with all cells in the bounds of the rays, so that no block is leapt over."""
    both = np.concatenate([scan.points, scan.origins])
    low, high = (np.floor(f / CELL).astype(int) for f in (both.min(0), both.max(0)))
    axes = [np.arange(a - 1, b + 2) for a, b in zip(low, high, strict=True)]
    return grid_of(np.stack(np.meshgrid(*axes), -1).reshape(-1, 3))


@given(place, place, st.integers(0, 2**32 - 1), st.sampled_from([0.003, 0.05, 0.5]))
@settings(max_examples=150, deadline=None)
def test_leaps_and_single_steps_cross_the_same_voxels(origin, end, seed, share):
    scan = along([origin], [end])
    full = everywhere(scan)
    some = np.random.default_rng(seed).random(len(full)) < share
    sparse = grid_of(np.unique(full.keys(512 * np.flatnonzero(some)) // 8, axis=0))
    blocks = {tuple(k) for k in (sparse.keys(512 * np.arange(len(sparse))) // 8).tolist()}
    expected = {k for k in crossed(full, scan) if tuple(c // 8 for c in k) in blocks}
    assert crossed(sparse, scan) == expected


@given(place, place)
@settings(max_examples=150, deadline=None)
def test_a_ray_is_a_chain_of_neighbours_from_the_origin_to_the_point(origin, end):
    scan = along([origin], [end])
    voxels = crossed(everywhere(scan), scan)
    first = np.floor(scan.origins[0] * (1.0 / RESOLUTION)).astype(int)
    last = np.floor(scan.points[0].astype(float) * (1.0 / RESOLUTION)).astype(int)
    chain = np.array([*sorted(voxels, key=lambda k: np.abs(k - first).sum()), last])
    np.testing.assert_array_equal(chain[0], first)
    assert len(voxels) == np.abs(last - first).sum()
    assert (np.abs(np.diff(chain, axis=0)).sum(1) == 1).all()


@given(place, place)
@settings(max_examples=100, deadline=None)
def test_every_crossed_voxel_touches_the_ray(origin, end):
    scan = along([origin], [end])
    o, e = scan.origins[0] / RESOLUTION, scan.points[0].astype(float) / RESOLUTION
    low = np.array(sorted(crossed(everywhere(scan), scan))).reshape(-1, 3) - 1e-9
    d = np.where(e == o, 1e-300, e - o)
    near, far = np.sort([(low - o) / d, (low + 1 + 2e-9 - o) / d], axis=0)
    enter, leave = np.maximum(near.max(1), 0), np.minimum(far.min(1), 1)
    assert (enter <= leave + 1e-9).all()


def test_many_rays_mark_the_union_of_single_rays():
    random = np.random.default_rng(0)
    origins, ends = random.uniform(-150, 150, (2000, 3)), random.uniform(-150, 150, (2000, 3))
    grid = grid_of(random.integers(-19, 19, (3000, 3)))
    alone = set().union(
        *(crossed(grid, along([o], [e])) for o, e in zip(origins, ends, strict=True))
    )
    assert crossed(grid, along(origins, ends)) == alone
    try:
        kernels.set_threads(1)
        assert crossed(grid, along(origins, ends)) == alone
    finally:
        kernels.set_threads(None)


@pytest.mark.plain
def test_each_touched_block_is_listed_once_and_scratch_memory_is_reset():
    random = np.random.default_rng(1)
    scan = along(random.uniform(-50, 50, (3000, 3)), random.uniform(-50, 50, (3000, 3)))
    grid = everywhere(scan)
    casts = hits = np.ones(len(scan), bool)
    first, again = grid.mark(scan, casts, hits), grid.mark(scan, casts, hits)
    assert len(np.unique(first.blocks)) == len(first.blocks)
    order, other = np.argsort(first.blocks), np.argsort(again.blocks)
    np.testing.assert_array_equal(first.bits[order], again.bits[other])
    hit = np.unique(voxels_of(first.blocks, first.bits[:, 8:]))
    np.testing.assert_array_equal(hit, np.unique(grid.locate(scan.points)))
    nothing = grid.mark(scan, ~casts, ~hits)
    assert len(nothing.blocks) == 0


def test_a_ray_of_kilometres_ends_in_its_voxel():
    ends = np.array([(32767.4, 12345.6, -7.7), (-32767.4, 32000.5, 31999.5)]) / 10
    scan = Scan(0, ends.astype(np.float32), np.eye(4), origins=np.array([[0.02, 0.03, 0.04]]))
    cells = np.floor(np.concatenate([ends, [[0, 0, 0]]]) / CELL).astype(np.int32)
    offsets = np.stack(np.meshgrid(*[[-1, 0, 1]] * 3), -1).reshape(-1, 3)
    around = np.unique((cells[:, None] + offsets).reshape(-1, 3), axis=0)
    grid = BlockGrid(Extent(np.minimum(ends.min(0), 0), np.maximum(ends.max(0), 0), around), 0.1)
    for point in scan.points:
        one = Scan(0, point[None], np.eye(4), origins=scan.origins)
        keys = np.array(sorted(crossed(grid, one)))
        goal = np.floor(point.astype(float) * 10).astype(int)
        assert np.abs(keys - goal).sum(1).min() == 1
        assert (np.abs(keys).sum(1) == 0).any()


def with_addresses(grid: BlockGrid) -> BlockGrid:
    """The grid, made to mark the surroundings of the sensor without its directory, as grids that
    roll do.
    """
    words, touched = kernels.addresses.memory(kernels.threads_in_use())
    grid._near = words[..., 0], touched
    return grid


far = st.tuples(
    st.floats(-1200, 1200, width=32),
    st.floats(-1200, 1200, width=32),
    st.floats(-300, 300, width=32),
)


@given(place, far, far, st.integers(1, 7))
@settings(max_examples=25, deadline=None)
def test_rays_cross_the_same_voxels_at_addresses_and_beyond(offset, end, other, step):
    """Up to 504 voxels from the first origin, 120 in height, rays are marked at addresses."""
    first = np.array([3000.3, -2000.5, 400.7])
    origins = np.stack([first, first + offset])
    ends = origins + np.array([end, other])
    share = np.linspace(0, 1, 500)[::step, None]
    cells = (
        np.concatenate([o + share * (e - o) for o, e in zip(origins, ends, strict=True)])
        * RESOLUTION
        / CELL
    )
    bounds = np.full(3, 600.0)
    grid = BlockGrid(
        Extent(-bounds, bounds, np.unique(np.floor(cells).astype(np.int32), axis=0)), RESOLUTION
    )
    scan = along(origins, ends)
    expected = crossed(grid, scan)
    assert crossed(with_addresses(grid), scan) == expected
    assert not any(memory.any() for memory in grid._near)


@pytest.mark.plain
def test_short_rays_cross_the_same_voxels_at_addresses():
    random = np.random.default_rng(2)
    for _ in range(20):
        scan = along(random.uniform(-150, 150, (1, 3)), random.uniform(-150, 150, (1, 3)))
        assert crossed(with_addresses(everywhere(scan)), scan) == crossed(everywhere(scan), scan)

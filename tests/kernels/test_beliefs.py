"""Distances, looks and integer lines of HMM-MOS, compared with brute force."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.reference.hmm_mos import line, look
from scipy.spatial import cKDTree

from dynaviz import kernels
from dynaviz.blocks.blocks import VOXELS, voxels_of
from dynaviz.contracts.extent import CELL, Extent
from dynaviz_methods.hmm_mos.belief_map import BeliefMap

KERNELS = kernels.load("dynaviz_methods.hmm_mos.kernels")

pytestmark = pytest.mark.boundscheck

SIZE = CELL / 8  # a block is a cell of the extent


def cube(blocks: int) -> BeliefMap:
    """A map of blocks^3 blocks around the world's origin, and those around them."""
    cells = np.argwhere(np.ones((blocks,) * 3)).astype(np.int32) - blocks // 2
    edge = np.full(3, blocks * CELL / 2)
    return BeliefMap(Extent(-edge, edge, cells), SIZE, 2, 40.0, 300, False)


def points_in(keys) -> np.ndarray:
    return ((np.asarray(keys) + 0.5) * SIZE).astype(np.float32).reshape(-1, 3)


@pytest.mark.parametrize("sources", [1, 30, 4000])
def test_distances_are_exact_up_to_the_cap(sources):
    random = np.random.default_rng(sources)
    grid = cube(6)
    keys = random.integers(-24, 24, (sources, 3))
    grid.see(grid.place(points_in(keys)), np.array([0.05, 0.05, 0.05]))
    everywhere = np.arange(len(grid), dtype=np.int32)
    grid.observed = everywhere, np.full((len(grid), 8), ~np.uint64(0))
    grid.learn(0.99, keep_field=True)
    voxels = np.arange(len(grid) * VOXELS)
    distances, _ = cKDTree(keys).query(grid.keys(voxels))
    expected = np.minimum(np.rint(distances**2), 75)
    np.testing.assert_array_equal(grid.field.ravel(), expected)


@pytest.mark.plain
def test_rays_are_integer_lines_up_to_the_greatest_range():
    random = np.random.default_rng(0)
    grid = cube(4)
    for origin in ([0.05, 0.05, 0.05], [-1.13, 0.4, 1.2]):
        keys = random.integers(-15, 15, (12, 3))
        grid._max_range = 1.5
        grid.see(grid.place(points_in(keys)), np.array(origin))
        blocks, bits = grid.observed
        found = set(map(tuple, grid.keys(voxels_of(blocks, bits.view(np.int64))).tolist()))
        start = tuple(np.floor(np.array(origin) / SIZE).astype(int).tolist())
        cells = {cell for key in keys.tolist() for cell in line(start, tuple(key))}
        assert found == {c for c in cells if np.sum((np.array(c) - start) ** 2) <= 15**2}
        grid.observed = blocks[:0], bits[:0]


@pytest.mark.plain
def test_voxels_expire_in_their_scan_and_blocks_without_old_ones_are_skipped():
    random = np.random.default_rng(0)
    seen = random.integers(0, 30, (40, VOXELS)).astype(np.int32)
    bits = (random.random((40, VOXELS)) < 0.02) & (seen > 0)
    known = np.packbits(bits.reshape(40, 8, 64), -1, "little").view(np.uint64).reshape(40, 8)
    never = KERNELS.beliefs.NEVER
    first = np.where(bits, seen, never).min(1).astype(np.int32)
    blocks = np.arange(40, dtype=np.int32)
    for oldest in (3, 4, 11, 30):
        KERNELS.beliefs.expire(blocks, oldest, seen, known, first)
        bits &= seen > oldest
        np.testing.assert_array_equal(
            np.unpackbits(known.view(np.uint8), bitorder="little").reshape(40, -1), bits
        )
        np.testing.assert_array_equal(first, np.where(bits, seen, never).min(1))
    assert (first == never).all()
    known[0, 0], first[0] = 1, 31
    KERNELS.beliefs.expire(blocks, 30, seen, known, first)
    assert known[0, 0] == 1, "a block was searched that can contain no old voxel"


# Looks until the state changes, by squared distance: from new to free, new to occupied, occupied to
# free, and back.
LOOKS = {
    0: (None, 1, None, 1),
    1: (None, 17, None, 27),
    2: (11, None, 19, None),
    3: (4, None, 8, None),
    4: (3, None, 6, None),
    5: (2, None, 5, None),
    6: (2, None, 4, None),
    8: (2, None, 3, None),
    9: (2, None, 3, None),
    10: (1, None, 2, None),
    19: (1, None, 2, None),
    20: (1, None, 1, None),
    75: (1, None, 1, None),
}
NEW, OCCUPIED, FREE = ([1.0, 0, 0], 0), ([0, 1.0, 0], 1), ([0, 1e-9, 1 - 1e-9], 2)


@pytest.mark.parametrize("squared", LOOKS)
def test_the_number_of_looks_that_change_a_state(squared):
    """Both in the kernel's filter and in the plain one."""

    def plain(start, goal):
        belief = np.array(start[0])
        for n in range(1, 60):
            belief = look(belief, squared)
            if belief[goal] > 0.99:
                return n
        return None

    def compiled(start, goal):
        occupied, remembered = start[0][1], start[1] > 0
        for n in range(1, 60):
            occupied, free = KERNELS.beliefs._filtered(
                occupied, remembered, np.exp(-squared / 2), 0.005
            )
            remembered = True
            if (occupied, free)[goal - 1] > 0.99:
                return n
        return None

    for count in (plain, compiled):
        ways = ((NEW, 2), (NEW, 1), (OCCUPIED, 2), (FREE, 1))
        assert tuple(count(start, goal) for start, goal in ways) == LOOKS[squared]

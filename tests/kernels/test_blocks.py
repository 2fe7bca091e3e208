from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from dynaviz.blocks.blocks import BlockGrid, voxels_of
from dynaviz.contracts.extent import Extent
from dynaviz.contracts.scan import Scan

pytestmark = pytest.mark.boundscheck

places = arrays.arrays(
    np.float32,
    st.tuples(st.integers(1, 40), st.just(3)),
    elements=st.floats(-3000, 3000, width=32) | st.integers(-9, 9),
)


def extent_of(points) -> Extent:
    return Extent.of(Scan(0, points, np.eye(4)))


@given(places, st.sampled_from([0.1, 0.2, 0.3, 0.05, 0.7, 0.1000000015, 1.7]))
@settings(max_examples=60, deadline=None)
def test_every_point_of_the_extent_has_a_voxel(points, resolution):
    grid = BlockGrid(extent_of(points), resolution)
    voxels = grid.locate(points)
    keys = np.floor(points.astype(np.float64) * (1.0 / resolution))
    within = (np.abs(points * (1.0 / resolution)) < 32768).all(1)
    assert ((voxels >= 0) == within).all()
    np.testing.assert_array_equal(grid.keys(voxels[within]), keys[within])


def test_at_a_tenth_of_a_metre_a_cell_is_a_block():
    points = np.random.default_rng(0).uniform(-50, 50, (2000, 3)).astype(np.float32)
    extent = extent_of(points)
    assert len(BlockGrid(extent, 0.1)) == len(extent.cells)


def test_places_without_points_have_no_voxel():
    grid = BlockGrid(extent_of(np.array([[0.5, 0.5, 0.5], [20.0, 0.0, 0.0]], np.float32)), 0.1)
    elsewhere = np.array(
        [[5, 0, 0], [-1, 0, 0], [0, 900, 0], [np.nan, 0, 0], [np.inf, 0, 0], [1e30, 0, 0]],
        np.float32,
    )
    assert (grid.locate(elsewhere) == -1).all()


def test_a_map_of_kilometres_fits():
    far = np.array([[-3276.0, -3276.0, -3276.0], [3276.0, 3276.0, 3276.0]], np.float32)
    grid = BlockGrid(extent_of(far), 0.1)
    assert len(grid) == 2
    assert (grid.locate(far) >= 0).all()


@pytest.mark.plain
def test_blocks_are_added_within_the_bounds_while_there_is_room():
    points = np.array([[0.5, 0.5, 0.5], [4.5, 0.5, 0.5], [0.5, 4.5, 0.5]], np.float32)
    grid = BlockGrid(extent_of(points), 0.1, spare=4.0)
    voxels, first = grid.locate(points), int(grid.existing().sum())
    assert first == 3
    assert len(grid) == 6
    raised = points + np.array([0, 0, 2], np.float32)
    assert (grid.locate(raised) == -1).all()
    grid.extend(np.concatenate([raised[:2], raised[:2], [[999.0, 0.0, 0.0]]]).astype(np.float32))
    assert int(grid.existing().sum()) == 5
    assert (grid.locate(raised) >= 0).tolist() == [True, True, False]
    assert grid.blocks[grid.existing()].tolist()[3:] == [[0, 0, 3], [5, 0, 3]]
    grid.extend(raised + np.array([1, 0, 0], np.float32))  # one more has room
    assert int(grid.existing().sum()) == 6
    np.testing.assert_array_equal(grid.locate(points), voxels)


@pytest.mark.plain
def test_an_empty_extent_has_no_blocks():
    grid = BlockGrid(
        Extent(np.full(3, np.inf), np.full(3, -np.inf), np.zeros((0, 3), np.int32)), 0.1
    )
    assert len(grid) == 0
    assert grid.locate(np.zeros((2, 3), np.float32)).tolist() == [-1, -1]


@pytest.mark.parametrize("resolution", [0.0, -1.0, float("nan")])
def test_resolutions_must_be_positive(resolution):
    with pytest.raises(ValueError, match="resolution"):
        BlockGrid(extent_of(np.zeros((1, 3), np.float32)), resolution)


@given(arrays.arrays(np.int64, st.tuples(st.integers(0, 5), st.just(8))))
@settings(deadline=None)
def test_numbers_of_set_bits(bits):
    blocks = np.arange(3, 3 + len(bits), dtype=np.int32)
    places = [(row, w, v) for row in range(len(bits)) for w in range(8) for v in range(64)]
    expected = [512 * (3 + row) + 64 * w + v for row, w, v in places if bits[row, w] >> v & 1]
    assert voxels_of(blocks, bits).tolist() == expected

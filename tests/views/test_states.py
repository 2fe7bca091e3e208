"""How the states of a method are drawn."""

from __future__ import annotations

import numpy as np
from helpers.worlds import pose, room
from hypothesis import given, settings
from hypothesis import strategies as st

from dynaviz.contracts.probe import Plane, Points, PolarGrid, State, Voxels
from dynaviz.contracts.scan import Scan
from dynaviz.views.record import states
from dynaviz.views.record.budget import Budget


def test_a_polar_grid_from_above() -> None:
    quarters = np.array(
        [[1, 2, 3, 4], [5, 6, 7, 8]], np.float32
    )  # sector 0: azimuth 0 to 90 degrees, ahead to the left
    picture = states.from_above(quarters)
    middle, inner, outer = states.PICTURE // 2, states.PICTURE // 8, 3 * states.PICTURE // 8
    up, left = -1, -1
    for sector, (vertical, horizontal) in enumerate(
        [(up, -left), (up, left), (-up, left), (-up, -left)]
    ):
        assert (
            picture[middle + vertical * inner, middle + horizontal * inner] == quarters[0, sector]
        )
        assert (
            picture[middle + vertical * outer // 2 - vertical, middle + horizontal * outer]
            == quarters[1, sector]
        )
    assert np.isnan(picture[0, 0])


@settings(deadline=None)
@given(
    st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda n: np.linalg.norm(n) > 0.1), st.floats(-5, 5)
)
def test_a_disc_lies_in_its_plane(normal: tuple[float, float, float], offset: float) -> None:
    plane = Plane(np.array(normal), offset, np.array([1.0, 2.0, 3.0]), 4.0)
    mesh = states.draw(plane, State("plane", Plane, "a plane"), room(1, 10)[0], None)
    corners = mesh.vertex_positions.as_arrow_array().flatten().to_numpy().reshape(-1, 3)
    distance = (corners @ np.array(normal) - offset) / np.linalg.norm(normal)
    assert np.abs(distance).max() < 1e-3
    np.testing.assert_allclose(np.linalg.norm(corners[:-1] - corners[-1], axis=1), 4.0, atol=1e-3)


def test_large_states_are_cut_to_the_budget() -> None:
    keys = np.stack([np.arange(400)] * 3, 1).astype(np.int32)
    scan = Scan(0, np.zeros((1, 3), np.float32), pose(0.0, 0.0, 0.0))
    state = State("cells", Voxels, "cells")
    few = states.draw(Voxels(keys, 0.1), state, scan, Budget(scan, 10))
    assert 1 <= len(few.voxel_indices.as_arrow_array()) <= 10
    every = states.draw(Voxels(keys, 0.1), state, scan, None)
    assert len(every.voxel_indices.as_arrow_array()) == 400


def test_values_are_coloured_dark_to_bright() -> None:
    values = np.array([-1.0, 0.0, 5.0, 10.0, 99.0, np.nan], np.float32)
    state = State("found", Points, "points", value_range=(0.0, 10.0))
    drawn = states.draw(Points(np.zeros((6, 3), np.float32), values), state, room(1, 10)[0], None)
    rgba = drawn.colors.as_arrow_array().to_numpy()
    assert rgba[0] == rgba[1] == rgba[5] == 0x3B528BFF
    assert rgba[3] == rgba[4] == 0x7AD151FF
    assert rgba[2] == 0x1F968BFF


def test_an_empty_picture_is_not_drawn() -> None:
    empty = PolarGrid(np.empty((0, 8), np.float32), 10.0)
    assert states.draw(empty, State("bins", PolarGrid, "bins"), room(1, 10)[0], None) is None

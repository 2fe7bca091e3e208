"""Keys of states, and guides in polar grids."""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np
import pytest
import rerun as rr
from helpers.guessing_method import Guess
from helpers.worlds import pose

from dynaviz import colours
from dynaviz.contracts.probe import PointClasses, PolarGrid, RangeImage, State, Voxels
from dynaviz.contracts.scan import Scan
from dynaviz.views import keys
from dynaviz.views.record import states


def picture(*shown: State) -> np.ndarray:
    return picture_of(keys.strip(shown))


def picture_of(strip: rr.EncodedImage) -> np.ndarray:
    png = bytes(strip.blob.as_arrow_array().to_pylist()[0])
    decoded = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)
    assert decoded is not None
    return np.asarray(decoded)[:, :, ::-1]


def contains(drawn: np.ndarray, colour: colours.Colour) -> bool:
    return bool((drawn == np.array(colour)).all(2).any())


def test_consecutive_range_images_share_a_tab() -> None:
    tabs = [[state.name for state in tab] for tab in keys.tabs(Guess.info)]
    assert tabs == [
        [name]
        for name in ("cells", "plain_cells", "found", "kinds", "ground", "plane", "ranges", "bins")
    ]
    images = [State(f"image_{k}", RangeImage, "an image") for k in range(5)]
    tabs = [
        [state.name for state in tab]
        for tab in keys.tabs(dataclasses.replace(Guess.info, emits=tuple(images)))
    ]
    assert tabs == [["image_0", "image_1"], ["image_2", "image_3"], ["image_4"]]


def test_a_key_shows_the_colours_in_use() -> None:
    scale = picture(State("odds", Voxels, "odds", value_range=(-2.0, 3.5)))
    for end in (0.0, 1.0):
        assert contains(scale, tuple(keys.coloured(np.array([end], np.float32))[0].tolist()))
    kinds = picture(State("kinds", PointClasses, "kinds", legend=("near", "", "far")))
    assert contains(kinds, colours.CLASSES[0])
    assert contains(kinds, colours.CLASSES[2])
    assert not contains(kinds, colours.CLASSES[1])
    assert contains(picture(State("void", Voxels, "void")), colours.STATE)
    assert (
        len(
            picture(
                *[State(f"image_{k}", RangeImage, "", value_range=(0.0, 9.0)) for k in range(3)]
            )
        )
        == 3 * keys.ROW
    )


def test_the_key_marks_the_threshold_of_the_run() -> None:
    fixed = State("odds", Voxels, "odds", value_range=(-2.0, 2.0), threshold=0.0)
    of_run = dataclasses.replace(fixed, threshold="limit")
    shown = [marks(of_run, {"limit": limit}) for limit in (-1.0, 1.0)]
    assert marks(fixed, {}) == pytest.approx(keys.WIDTH / 2, abs=2)
    assert shown[1] - shown[0] == pytest.approx((keys.WIDTH - 2 * keys.MARGIN) / 2, abs=2)
    for unknown in ({}, {"limit": 5.0}):
        assert marks(of_run, unknown) is None


def marks(state: State, params: dict[str, float]) -> float | None:
    """Column of the mark on a colour bar; None without a mark."""
    row = picture_of(keys.strip([state], params))[3]
    columns = np.flatnonzero((row == np.array(keys.TEXT)).all(1))
    return float(columns.mean()) if len(columns) else None


@pytest.mark.parametrize("truth", [True, False])
def test_the_legend_shows_outcomes_and_rays(truth: bool) -> None:
    drawn = picture_of(keys.legend(truth))
    outcomes = keys.POINTS if truth else keys.POINTS_WITHOUT_TRUTH
    shades = colours.BRIGHT if truth else colours.UNSCORED
    assert all(contains(drawn, shades[outcome]) for outcome in outcomes)
    assert all(contains(drawn, ray) for ray in colours.RAYS.values())


def test_the_scale_covers_its_part_of_the_colours() -> None:
    low, high = keys.stretched(10.0, 20.0)
    assert (10.0 - low) / (high - low) == pytest.approx(keys.PART[0])
    assert (20.0 - low) / (high - low) == pytest.approx(keys.PART[1])


def test_rings_are_at_round_distances_and_the_arrow_points_where_the_sensor_moves() -> None:
    _, names = keys.rings(PolarGrid(np.ones((8, 36), np.float32), 80.0), 256)
    assert names.labels is not None
    assert names.labels.as_arrow_array().to_pylist() == ["40 m", "80 m"]
    assert names.positions is not None
    at = names.positions.as_arrow_array().to_pylist()
    assert at == [[128.0, 64.0], [128.0, 0.0]]  # apart from each other
    heading, nothing = keys.Heading(), np.zeros((1, 3), np.float32)
    assert heading.of(Scan(0, nothing, pose(0.0, 0.0, 0.0))) is None
    for _ in range(2):  # several grids of the same scan
        np.testing.assert_allclose(
            heading.of(Scan(1, nothing, pose(0.0, 2.0, 0.0))), [0.0, 1.0], atol=1e-12
        )
    np.testing.assert_allclose(
        heading.of(Scan(2, nothing, pose(0.0, 2.01, 0.0))), [0.0, 1.0], atol=1e-12
    )


def test_range_images_are_high_enough_and_classes_have_names_on_hover() -> None:
    scan = Scan(0, np.zeros((1, 3), np.float32), pose(0.0, 0.0, 0.0))
    image = states.draw(
        RangeImage(np.ones((20, 900), np.float32)), State("image", RangeImage, ""), scan, None
    )
    assert image.format.as_arrow_array().to_pylist()[0]["height"] == 200
    verdict = State("verdict", PolarGrid, "verdict", legend=("", "bad", "good"))
    drawn = states.draw(PolarGrid(np.full((4, 8), 2.0, np.float32), 10.0), verdict, scan, None)
    classes = np.frombuffer(bytes(drawn.buffer.as_arrow_array().to_pylist()[0]), np.uint8)
    assert set(classes.tolist()) == {2, states.EMPTY}
    assert states.legend(verdict) is not None

"""How states, maps and words are drawn."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from helpers.guessing_method import Guess
from helpers.worlds import pose, room
from hypothesis import given, settings
from hypothesis import strategies as st

from dynaviz.probe import Plane, Points, PolarGrid, State, Voxels
from dynaviz.results.result import Result
from dynaviz.scan import Outcome, Scan
from dynaviz.spatial.grid import pack
from dynaviz.viz import paths, report, states
from dynaviz.viz.scene import DownsampledMap

# Protanopia, deuteranopia and tritanopia at full strength, on linear RGB (Machado, Oliveira and Fernandes 2009).
EYES = {
    "common": np.eye(3),
    "protanopia": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
    "deuteranopia": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]],
    "tritanopia": [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]],
}


@pytest.mark.parametrize("eye", EYES)
def test_outcomes_differ_to_every_eye(eye: str) -> None:
    seen = [lab(np.array(EYES[eye]) @ linear(paths.COLOURS[Outcome(i)])) for i in range(4)]
    for a, b in itertools.combinations(seen, 2):
        assert np.linalg.norm(a - b) > 25  # 2.3 is just noticeable


def linear(colour: paths.Colour) -> np.ndarray:
    c = np.array(colour) / 255
    return np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)


def lab(rgb: np.ndarray) -> np.ndarray:
    """CIE L*a*b* of linear sRGB."""
    xyz = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]) @ np.clip(rgb, 0, 1)
    x, y, z = np.cbrt(xyz / [0.9505, 1.0, 1.089])
    return np.array([116 * y - 16, 500 * (x - y), 200 * (y - z)])


@settings(deadline=None, max_examples=40)
@given(st.integers(0, 2**32 - 1), st.integers(1, 60))
def test_a_map_keeps_one_point_per_voxel_below_its_cap(seed: int, cap: int) -> None:
    random = np.random.default_rng(seed)
    points = random.uniform(-1, 1, (200, 3)).astype(np.float32)
    roomy, tight = DownsampledMap(0.2, 1000), DownsampledMap(0.2, cap)
    for part in np.array_split(points, 5):
        roomy.add(part)
        tight.add(part)
    assert len(roomy.points()) == len(np.unique(pack(points, 0.2)))
    assert 1 <= len(tight.points()) <= cap
    known = {tuple(p) for p in points}
    assert {tuple(p) for p in roomy.points()} <= known
    assert {tuple(p) for p in tight.points()} <= {tuple(p) for p in roomy.points()}


def test_a_polar_grid_from_above() -> None:
    quarters = np.array(
        [[1, 2, 3, 4], [5, 6, 7, 8]], np.float32
    )  # sector 0: azimuth 0 to 90 degrees, ahead to the left
    picture = states.from_above(quarters)
    middle, inner, outer = states.PICTURE // 2, states.PICTURE // 8, 3 * states.PICTURE // 8
    up, left = -1, -1
    for sector, (vertical, horizontal) in enumerate([(up, -left), (up, left), (-up, left), (-up, -left)]):
        assert picture[middle + vertical * inner, middle + horizontal * inner] == quarters[0, sector]
        assert picture[middle + vertical * outer // 2 - vertical, middle + horizontal * outer] == quarters[1, sector]
    assert np.isnan(picture[0, 0])


@settings(deadline=None)
@given(st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda n: np.linalg.norm(n) > 0.1), st.floats(-5, 5))
def test_a_disc_lies_in_its_plane(normal: tuple[float, float, float], offset: float) -> None:
    plane = Plane(np.array(normal), offset, np.array([1.0, 2.0, 3.0]), 4.0)
    mesh = states.draw(plane, State("plane", Plane, "a plane"), room(1, 10)[0], None)
    corners = mesh.vertex_positions.as_arrow_array().flatten().to_numpy().reshape(-1, 3)
    distance = (corners @ np.array(normal) - offset) / np.linalg.norm(normal)
    assert np.abs(distance).max() < 1e-3
    np.testing.assert_allclose(np.linalg.norm(corners[:-1] - corners[-1], axis=1), 4.0, atol=1e-3)


def test_large_states_keep_what_is_nearest() -> None:
    keys = np.stack([np.arange(400)] * 3, 1).astype(np.int32)
    scan = Scan(0, np.zeros((1, 3), np.float32), pose(0.0, 0.0, 0.0))
    state = State("cells", Voxels, "cells")
    near = states.draw(Voxels(keys, 0.5), state, scan, 10)
    assert np.array(near.voxel_indices.as_arrow_array().flatten()).reshape(-1, 3).max() == 9
    every = states.draw(Voxels(keys, 0.5), state, scan, None)
    assert len(every.voxel_indices.as_arrow_array()) == 400


def test_values_are_coloured_dark_to_bright() -> None:
    values = np.array([-1.0, 0.0, 5.0, 10.0, 99.0, np.nan], np.float32)
    state = State("found", Points, "points", value_range=(0.0, 10.0))
    drawn = states.draw(Points(np.zeros((6, 3), np.float32), values), state, room(1, 10)[0], None)
    rgba = drawn.colors.as_arrow_array().to_numpy()
    assert rgba[0] == rgba[1] == rgba[5] == 0x440154FF
    assert rgba[3] == rgba[4] == 0xFDE725FF
    assert rgba[2] == 0x21918CFF


def test_a_picture_of_nothing_is_left_out() -> None:
    empty = PolarGrid(np.empty((0, 8), np.float32), 10.0)
    assert states.draw(empty, State("bins", PolarGrid, "bins"), room(1, 10)[0], None) is None


def tally() -> report.OutcomeCounts:
    counted = report.OutcomeCounts()
    for frame, wrong in enumerate([0, 3, 9, 1, 9, 2, 5]):
        outcome = np.array([Outcome.FALSE_NEGATIVE] * wrong + [Outcome.STATIC_KEPT] * 4, np.uint8)
        assert counted.add(frame, 100 + frame, outcome, np.ones(len(outcome), np.uint8)) == (wrong, 0)
    return counted


def test_the_worst_frames_come_first() -> None:
    assert [(frame, index) for frame, index, *_ in tally().worst()] == [
        (2, 102),
        (4, 104),
        (6, 106),
        (1, 101),
        (5, 105),
    ]
    assert report.OutcomeCounts().worst() == []


def test_the_report_says_what_a_reader_needs() -> None:
    result = Result(
        method="guess",
        parameters={"height": 1.0, "note": "a|b"},
        sequence={"name": "room", "digest": "f" * 64, "frames": 7, "points": 57},
        sections={"metrics": {"SA": 99.5, "DA": None}, "counts": {"static_kept": 1234}},
        runtime={"mean_s": 0.5, "std_s": 0.25, "threads": 2},
    )
    text = report.report(Guess.info, result, tally(), "errors")
    for line in (
        "## Guess on room",
        "| 99.50 % | n/a |",
        "| static kept | 1,234 |",
        "| 2 | 102 | 9 | 0 |",
        "| 1 | band | 28 | 29 | lies in the band |",
        "| orange | false negative: dynamic, but kept |",
        '| note | "a\\|b" |',
        "| seconds per frame | 0.500 ± 0.250 |",
        "| ground | points of the floor |",
    ):
        assert line in text.splitlines(), line
    assert "How to read" in report.report(Guess.info, result, tally(), "scores")
    assert "not finished" in report.before(Guess.info, "room", {}, "full")

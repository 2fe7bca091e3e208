"""The lossless part of a recording."""

from __future__ import annotations

import zlib

import numpy as np
import pytest
from helpers.worlds import pose
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from dynaviz.contracts.metric import Labelled
from dynaviz.contracts.scan import Label, Scan
from dynaviz.scores.comparison.frame_answers import BAND_NAMES, FrameAnswers, range_bands


@settings(deadline=None)
@given(n=st.integers(0, 200), data=st.data())
def test_packing_loses_nothing(n: int, data: st.DataObject) -> None:
    u8 = arrays(np.uint8, n)
    answers = FrameAnswers(
        3,
        4390,
        data.draw(arrays(bool, n)),
        data.draw(u8),
        data.draw(u8),
        data.draw(arrays(np.uint8, n, elements=st.integers(0, 4))),
    )
    back = FrameAnswers.unpacked(3, answers.packed())
    assert (back.frame, back.index, len(back)) == (3, 4390, n)
    for name in ("dynamic", "truth", "reasons", "bands"):
        np.testing.assert_array_equal(getattr(back, name), getattr(answers, name))
        assert getattr(back, name).dtype == getattr(answers, name).dtype


def test_answers_of_earlier_recordings_are_read() -> None:
    rng = np.random.default_rng(3)
    bands = rng.integers(0, 5, 50).astype(np.uint8)
    dynamic = rng.random(50) < 0.3
    earlier = {
        "index": np.array([7]),
        "points": np.array([50]),
        "predicted": compressed(np.packbits(dynamic)),
        "truth": compressed(np.ones(50, np.uint8)),
        "reasons": compressed(np.full(50, 2, np.uint8)),
        "bands": compressed(bands),
    }
    read = FrameAnswers.unpacked(4, earlier)
    np.testing.assert_array_equal(read.dynamic, dynamic)
    np.testing.assert_array_equal(read.bands, bands)
    assert set(read.truth.tolist()) == {1}
    assert set(read.reasons.tolist()) == {2}
    with pytest.raises(ValueError, match="9 values instead of 50"):
        FrameAnswers.unpacked(4, earlier | {"truth": compressed(np.ones(9, np.uint8))})


def compressed(array: np.ndarray) -> np.ndarray:
    return np.frombuffer(zlib.compress(array.tobytes()), np.uint8)


def test_truncated_data_is_an_error() -> None:
    answers = FrameAnswers(0, 0, np.ones(50, bool), *(np.zeros(50, np.uint8) for _ in range(3)))
    short = answers.packed() | {
        "truth": FrameAnswers(0, 0, *(np.zeros(9, np.uint8),) * 4).packed()["truth"]
    }
    with pytest.raises(ValueError, match="9 values instead of 50"):
        FrameAnswers.unpacked(0, short)


def test_range_bands_use_the_origin_of_each_ray() -> None:
    ranges = np.array([0, 9.9, 10, 19.9, 20, 29.9, 30, 49.9, 50, 500, np.nan], np.float32)
    points = np.zeros((len(ranges), 3), np.float32)
    points[:, 1] = ranges
    scan = Scan(0, points + np.float32([5, 0, 1]), pose(5.0))
    assert range_bands(scan).tolist() == [0, 0, 1, 1, 2, 2, 3, 3, 4, 4, 4]
    assert range_bands(scan).max() == len(BAND_NAMES) - 1
    many = Scan(0, points, pose(0.0), origins=points.astype(np.float64))
    assert range_bands(many)[:-1].tolist() == [0] * 10


def test_without_ground_truth_every_point_is_unlabelled() -> None:
    scan = Scan(0, np.zeros((3, 3), np.float32), pose(0.0))
    answers = FrameAnswers.of(
        Labelled.of(0, scan, np.array([True, False, True]), np.zeros(3, np.uint8))
    )
    assert answers.truth.tolist() == [Label.UNLABELLED] * 3
    assert answers.outcome.tolist() == [5, 4, 5]

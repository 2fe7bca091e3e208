"""Points on disk: which blocks they come back in."""

import numpy as np
import pytest

from dynaviz.errors import DynavizError
from dynaviz_eval.error_distance import LIMIT, distances
from dynaviz_eval.spool import PointSpool

pytestmark = pytest.mark.boundscheck


def along(*frames) -> PointSpool:
    """A spool of frames, with points at these positions along x."""
    spool = PointSpool()
    for frame, x in enumerate(frames):
        x = np.asarray(x, np.float32).reshape(-1)
        spool.append(frame, np.stack([x, 10 + x, -x], 1))
    return spool


def blocks(
    spool: PointSpool, axis: int, low: float, high: float, size: int
) -> list[list[tuple[float, int]]]:
    corners = np.array([np.full(3, -np.inf), np.full(3, np.inf)])
    corners[:, axis] = low, high
    found = spool.blocks(*corners, size)
    return [
        list(zip(points[:, 0].tolist(), frames.tolist(), strict=True)) for points, frames in found
    ]


def test_an_interval_includes_its_lower_end_only():
    spool = along([1, 2, 3], [], [3], [0, 5], [2])
    assert blocks(spool, 0, 2, 3, 100) == [[(2, 0), (2, 4)]]
    assert blocks(spool, 0, 3, 6, 100) == [[(3, 0), (3, 2), (5, 3)]]
    assert blocks(spool, 1, 12, 13, 100) == [[(2, 0), (2, 4)]]
    assert blocks(spool, 0, 6, 9, 100) == []
    assert spool.points == 7


def test_a_box_limits_all_axes():
    spool = along([1, 2, 3], [2, 7])
    (found,) = spool.blocks(np.array([2.0, 12, -2.5]), np.array([4.0, 18, 0]), 100)
    assert found[0].tolist() == [[2, 12, -2]] * 2
    assert found[1].tolist() == [0, 1]
    assert list(spool.blocks(np.array([2.0, 0, -1.5]), np.array([4.0, 18, 0]), 100)) == []


def test_blocks_end_with_the_frame_that_fills_them():
    spool = along([1, 2], [3], [4, 5, 6], [7])
    assert blocks(spool, 0, -np.inf, np.inf, 3) == [
        [(1, 0), (2, 0), (3, 1)],
        [(4, 2), (5, 2), (6, 2)],
        [(7, 3)],
    ]
    assert blocks(spool, 0, 2, 7, 2) == [[(2, 0), (3, 1)], [(4, 2), (5, 2), (6, 2)]]


def test_bounds_and_samples():
    spool = along([4, 1, 2, 3, 9], [-7, 8], [np.nan, 6])
    low, high = spool.bounds()
    assert (low.tolist(), high.tolist()) == ([-7, 3, -9], [9, 19, 7])
    assert spool.sample(0, 2).tolist() == [4, 2, 9, -7, 6]
    assert spool.sample(1, 64).tolist() == [14, 3, 16]


def test_partial_writes_are_continued():
    spool = PointSpool()
    whole = spool._file

    class Slow:
        def __getattr__(self, name):
            return getattr(whole, name)

        def write(self, data):
            return whole.write(data[:7])

    spool._file = Slow()
    points = np.random.default_rng(0).normal(size=(5, 3)).astype(np.float32)
    spool.append(0, points[:2])
    spool.append(1, points[2:])
    spool._file = whole
    ((found, frames),) = spool.blocks(np.full(3, -np.inf), np.full(3, np.inf), 100)
    np.testing.assert_array_equal(found, points)
    assert frames.tolist() == [0, 0, 1, 1, 1]


def test_the_error_of_a_full_disk_has_the_size():
    class Full:
        def write(self, data):
            raise OSError(28, "No space left on device")

    spool = PointSpool()
    spool._file = Full()
    with pytest.raises(DynavizError, match="cannot write 12 MB"):
        spool.append(0, np.zeros((1_000_000, 3), np.float32))


@pytest.mark.parametrize("axis", range(3))
def test_the_nearest_point_may_be_in_another_slab_up_to_the_limit(axis):
    """Wrong points on both sides of each border of slabs, with correct points just within the
    limit.
    """
    places = np.zeros((200, 3), np.float32)
    places[:, axis] = 10.0 * np.arange(200)
    wrong, right = PointSpool(), PointSpool()
    wrong.append(0, places)
    step = np.zeros(3, np.float32)
    step[axis] = LIMIT - 0.01
    for frame, sign in enumerate((-1, 1)):
        right.append(frame, (places + sign * step)[frame::2])
    fine, by_frame = distances(wrong, right, 1, block=7)
    assert fine[round((LIMIT - 0.011) * 1e4) : -1].sum() == by_frame[0, -2] == 200


def test_a_correct_point_is_found_along_each_axis():
    """A correct point 1 m away is found along each axis, in both directions."""
    wrong, right = PointSpool(), PointSpool()
    wrong.append(0, np.zeros((1, 3), np.float32))
    for frame, offset in enumerate(np.concatenate([np.eye(3), -np.eye(3)]).astype(np.float32)):
        right.append(frame, (1.0 + frame / 10) * offset[None])
        fine, _ = distances(wrong, right, 1)
        assert np.flatnonzero(fine).tolist() == [10_000]

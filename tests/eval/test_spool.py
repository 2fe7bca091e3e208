"""Points on disk: what comes back, in which pieces."""

import numpy as np
import pytest

from dynaviz.errors import DynavizError
from dynaviz_eval.error_distance import LIMIT, distances
from dynaviz_eval.spool import PointSpool


def along(*frames) -> PointSpool:
    """A spill of frames of points at some places along x."""
    spill = PointSpool()
    for frame, x in enumerate(frames):
        x = np.asarray(x, np.float32).reshape(-1)
        spill.append(frame, np.stack([x, 10 + x, -x], 1))
    return spill


def pieces(spill: PointSpool, *asked) -> list[list[tuple[float, int]]]:
    return [list(zip(points[:, 0].tolist(), frames.tolist(), strict=True)) for points, frames in spill.blocks(*asked)]


def test_an_interval_holds_its_lower_end_only():
    spill = along([1, 2, 3], [], [3], [0, 5], [2])
    assert pieces(spill, 0, 2, 3, 100) == [[(2, 0), (2, 4)]]
    assert pieces(spill, 0, 3, 6, 100) == [[(3, 0), (3, 2), (5, 3)]]
    assert pieces(spill, 1, 12, 13, 100) == [[(2, 0), (2, 4)]]
    assert pieces(spill, 0, 6, 9, 100) == []
    assert spill.points == 7


def test_blocks_end_with_the_frame_that_fills_them():
    spill = along([1, 2], [3], [4, 5, 6], [7])
    assert pieces(spill, 0, -np.inf, np.inf, 3) == [[(1, 0), (2, 0), (3, 1)], [(4, 2), (5, 2), (6, 2)], [(7, 3)]]
    assert pieces(spill, 0, 2, 7, 2) == [[(2, 0), (3, 1)], [(4, 2), (5, 2), (6, 2)]]


def test_bounds_and_samples():
    spill = along([4, 1, 2, 3, 9], [-7, 8], [np.nan, 6])
    low, high = spill.bounds()
    assert (low.tolist(), high.tolist()) == ([-7, 3, -9], [9, 19, 7])
    assert spill.sample(0, 2).tolist() == [4, 2, 9, -7, 6]
    assert spill.sample(1, 64).tolist() == [14, 3, 16]


def test_a_disk_that_takes_little_at_a_time_gets_all():
    spill = PointSpool()
    whole = spill._file

    class Slow:
        def __getattr__(self, name):
            return getattr(whole, name)

        def write(self, data):
            return whole.write(data[:7])

    spill._file = Slow()
    points = np.random.default_rng(0).normal(size=(5, 3)).astype(np.float32)
    spill.append(0, points[:2])
    spill.append(1, points[2:])
    spill._file = whole
    ((found, frames),) = spill.blocks(0, -np.inf, np.inf, 100)
    np.testing.assert_array_equal(found, points)
    assert frames.tolist() == [0, 0, 1, 1, 1]


def test_a_full_disk_is_told_with_the_size():
    class Full:
        def write(self, data):
            raise OSError(28, "No space left on device")

    spill = PointSpool()
    spill._file = Full()
    with pytest.raises(DynavizError, match="cannot hold 12 MB"):
        spill.append(0, np.zeros((1_000_000, 3), np.float32))


@pytest.mark.parametrize("axis", range(3))
def test_the_nearest_may_lie_in_another_slab_up_to_the_limit(axis):
    """One wrong point on each side of where slabs meet, and right ones just within the limit, or just beyond it."""
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


def test_each_axis_bounds_what_is_near():
    """A right point 1 m away along each axis is found, whichever way."""
    wrong, right = PointSpool(), PointSpool()
    wrong.append(0, np.zeros((1, 3), np.float32))
    for frame, offset in enumerate(np.concatenate([np.eye(3), -np.eye(3)]).astype(np.float32)):
        right.append(frame, (1.0 + frame / 10) * offset[None])
        fine, _ = distances(wrong, right, 1)
        assert np.flatnonzero(fine).tolist() == [10_000]

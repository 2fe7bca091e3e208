"""Laws of voxel keys and sets of them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from dynaviz.kernels.keys import REACH
from dynaviz.spatial.grid import KeySet, pack, unpack, voxel_downsample

pytestmark = pytest.mark.boundscheck

sizes = st.sampled_from([0.1, 0.2, 0.8, 1.0])
clouds = hnp.arrays(
    np.float32, st.tuples(st.integers(0, 60), st.just(3)), elements=st.floats(-50, 50, width=32)
)
key_lists = st.lists(st.integers(0, 2**63 - 1) | st.integers(0, 30), max_size=200).map(
    lambda k: np.array(k, np.int64)
)
slow_first = settings(deadline=None)  # the first example compiles kernels


@slow_first
@given(clouds, sizes)
def test_unpacking_gives_the_voxel_of_the_point(points: Any, size: float) -> None:
    expected = np.floor(points.astype(np.float64) * (1 / size))
    np.testing.assert_array_equal(unpack(pack(points, size)), expected)


@slow_first
@given(
    hnp.arrays(
        np.int32, st.tuples(st.integers(1, 30), st.just(3)), elements=st.integers(-REACH, REACH - 1)
    )
)
def test_different_voxels_have_different_keys_in_the_same_order(voxels: Any) -> None:
    keys = pack((voxels / 8).astype(np.float32), 0.125)  # corners, which are exact in float32
    np.testing.assert_array_equal(unpack(keys), voxels)
    np.testing.assert_array_equal(np.argsort(keys, kind="stable"), np.lexsort(voxels.T[::-1]))


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e9])
def test_points_without_a_voxel_are_rejected(bad: float) -> None:
    with pytest.raises(ValueError, match="finite and within 104858 m"):
        pack(np.array([[0, 0, 0], [0, bad, 0]], np.float32), 0.1)


@pytest.mark.plain
@slow_first
@given(st.lists(key_lists, max_size=5))
def test_a_key_set_is_a_set(batches: list[Any]) -> None:
    ours, theirs = KeySet(), set[int]()
    for batch in batches:
        new = ours.add(batch)
        for key, is_new in zip(batch.tolist(), new.tolist(), strict=True):
            assert is_new == (key not in theirs)
            theirs.add(key)
        assert len(ours) == len(theirs)
    assert ours.keys().tolist() == sorted(theirs)


@pytest.mark.plain
def test_a_key_set_grows() -> None:
    keys = np.random.default_rng(0).permutation(100_000)
    ours = KeySet()
    assert ours.add(keys).all()
    assert not ours.add(keys).any()
    np.testing.assert_array_equal(ours.keys(), np.arange(100_000))


@slow_first
@given(clouds, sizes)
def test_downsampling_keeps_the_first_point_of_each_voxel(points: Any, size: float) -> None:
    chosen, counts = voxel_downsample(points, size)
    keys = pack(points, size).tolist()
    assert chosen.tolist() == [k for k, key in enumerate(keys) if key not in keys[:k]]
    assert counts.tolist() == [keys.count(keys[k]) for k in chosen]

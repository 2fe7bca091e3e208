"""The downsampled map of a run."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from dynaviz.spatial.grid import pack
from dynaviz.viz.scene import DownsampledMap


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

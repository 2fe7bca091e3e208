"""The downsampled map of a run, and the labels of boxes."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from dynaviz.spatial.grid import pack
from dynaviz.views.record.downsampling import DownsampledMap
from dynaviz.views.record.scene import APART, LABELS, with_labels


@settings(deadline=None, max_examples=40)
@given(st.integers(0, 2**32 - 1), st.integers(1, 60))
def test_a_map_keeps_one_point_per_voxel_below_its_cap(seed: int, cap: int) -> None:
    random = np.random.default_rng(seed)
    points = random.uniform(-1, 1, (200, 3)).astype(np.float32)
    codes = random.integers(0, 5, 200).astype(np.uint8)
    middle = np.array([40.0, -7.0, 1.0], np.float32)
    roomy, tight = DownsampledMap(0.2, 1000, middle), DownsampledMap(0.2, cap, middle)
    for part in np.array_split(np.arange(200), 5):
        roomy.add(points, codes, part)
        tight.add(points, codes, part)
    (many, reasons), (few, some) = roomy.thinned(), tight.thinned()
    assert len(many) == len(np.unique(pack(points - middle, 0.2)))
    assert 1 <= len(few) <= cap
    known = {tuple(p): code for p, code in zip(points, codes, strict=True)}
    assert all(known[tuple(p)] == code for p, code in zip(many, reasons, strict=True))
    assert all(known[tuple(p)] == code for p, code in zip(few, some, strict=True))
    assert len(np.unique(pack(few - middle, 0.2))) == len(few)
    assert (np.diff(reasons.astype(int)) >= 0).all()


def test_the_costliest_boxes_of_a_frame_have_labels_that_do_not_overlap() -> None:
    frames = np.array([3, 3, 3, 7, 7, 7, 7, 7])
    cases = np.array([5, 0, 1, 4, 2, 3, 0, 1])
    along = np.array([0.0, 0.5, 2.0, 0.0, 1.0, 2.0, 3.0, 4.0]) * APART
    labelled = with_labels(
        frames, cases, np.stack([along, 0 * along, 0 * along], 1).astype(np.float32)
    )
    assert labelled.tolist() == [False, True, True, False, True, False, True, True]
    assert labelled[3:].sum() == LABELS

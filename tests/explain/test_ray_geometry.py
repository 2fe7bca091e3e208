"""The rays that touch cells, against a plain search."""

from __future__ import annotations

import numpy as np
import pytest

from dynaviz.contracts.scan import Scan
from dynaviz.explain.ray_geometry import Touching


@pytest.mark.parametrize("moving", [False, True])
def test_rays_and_their_lengths_are_those_of_a_plain_search(moving: bool) -> None:
    random = np.random.default_rng(1)
    points = random.uniform(-9, 9, (4000, 3)).astype(np.float32)
    origins = random.uniform(-0.2, 0.2, (4000 if moving else 1, 3))
    low = random.uniform(-4, 4, (60, 3))
    found = Touching.of(
        Scan(0, points, np.eye(4), origins=origins), np.stack([low, low + 0.7], axis=1)
    )
    for k, corner in enumerate(low):
        ends = ((points >= corner) & (points < corner + 0.7)).all(1)
        enter, leave = np.sort(
            [(corner + edge - origins) / (points - origins) for edge in (0, 0.7)], axis=0
        )
        crosses = (np.maximum(enter.max(1), 0) < np.minimum(leave.min(1), 1)) & ~ends
        assert (found.hits[k], found.crossed[k]) == (ends.sum(), crosses.sum())
        lengths = np.linalg.norm(points - origins, axis=1)[crosses]
        np.testing.assert_allclose(found.lengths[k], np.median(lengths) if len(lengths) else np.nan)
    assert (found.crossed > 1).sum() > 30

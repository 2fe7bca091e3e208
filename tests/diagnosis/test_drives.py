"""Two drives: which of their scans are compared."""

from __future__ import annotations

import numpy as np

from dynaviz.contracts.scan import Scan
from dynaviz.diagnosis.drives import COARSE, _Way
from dynaviz.testing import InMemory


def test_the_scan_nearest_to_a_place_is_found_in_a_long_drive():
    frames, poses = 9 * COARSE, np.tile(np.eye(4), (9 * COARSE, 1, 1))
    poses[:, 0, 3] = np.linspace(0, 300, frames)
    way = _Way(
        InMemory([Scan(k, np.zeros((1, 3), np.float32), pose) for k, pose in enumerate(poses)])
    )
    assert len(way.positions) < frames / 8
    for place in (0.0, 17.3, 151.0, 299.9):
        nearest = int(np.abs(poses[:, 0, 3] - place).argmin())
        assert (
            abs(way.nearest(np.array([place, 4.0, 0.0])).index - nearest) <= 1
        )  # every ninth is within 4 of it

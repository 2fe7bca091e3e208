"""A method that uses most kernels, on a world small enough to run them as plain Python (make
coverage).
"""

from __future__ import annotations

import numpy as np
import pytest
from helpers.worlds import room

from dynaviz.contracts.extent import Extent
from dynaviz.contracts.method import Context
from dynaviz.contracts.scan import Label
from dynaviz_methods.seethrough import SeeThrough, SeeThroughParams

pytestmark = pytest.mark.boundscheck


@pytest.mark.plain
def test_seethrough_keeps_most_of_a_room_and_labels_every_point() -> None:
    scans = room(frames=4, rays=200).scans
    method = SeeThrough(SeeThroughParams(resolution=0.8, guard=1.6, ground_height=0.8))
    method.begin(Context(Extent.of(*scans)))
    for scan in scans:
        method.observe(scan)
    for scan in scans:
        answer = method.label(scan).dynamic
        assert len(answer) == len(scan)
        assert np.mean(answer[scan.labels == Label.STATIC]) < 0.2

"""The labels of the public program on the same input, and the program itself if it is installed."""

from __future__ import annotations

import numpy as np
import pytest

from dynaviz.contracts.extent import Extent
from dynaviz.contracts.method import Context
from dynaviz_methods.dufomap.method import DufoMap

FAR = 50.0  # metres, as in the public program's example


def test_every_label_matches_the_public_program(mini):
    np.testing.assert_array_equal(mini.run(DufoMap, max_range=FAR), mini.removed["dufomap"])
    np.testing.assert_array_equal(
        mini.run(DufoMap, max_range=FAR, unknown_margin=2), mini.removed["dufomap_dp2"]
    )


def test_labels_on_real_data_match_the_public_program_except_on_borders(kitti_tracking_0012):
    golden = kitti_tracking_0012
    ours, theirs = golden.run(DufoMap, max_range=FAR), golden.removed["dufomap"]
    assert (ours != theirs).sum() < 100
    assert golden.scores(ours) == pytest.approx(golden.scores(theirs), abs=0.01)


@pytest.mark.parametrize(
    "values", [{}, {"unknown_margin": 0}, {"unknown_margin": 4}, {"hit_margin": 0.35}], ids=str
)
@pytest.mark.parametrize("online", [False, True], ids=["", "online"])
def test_other_parameters_and_online_mode_match_the_public_program(mini, values, online):
    public = pytest.importorskip("dufomap", reason="needs the public program: pip install dufomap")
    program = public.dufomap(0.1, values.get("hit_margin", 0.2), values.get("unknown_margin", 1), 1)
    theirs = []
    for scan in mini.scans:
        r = np.linalg.norm(scan.points - scan.position, axis=1)
        program.run(scan.points[(r > 0.2) & (r < FAR)], scan.T_world_sensor, False)
        if online:
            theirs.append(program.segment(scan.points, scan.T_world_sensor, False))
    theirs = theirs or [
        program.segment(scan.points, scan.T_world_sensor, False) for scan in mini.scans
    ]
    ours = (
        online_labels(mini.scans, **values)
        if online
        else mini.run(DufoMap, max_range=FAR, **values)
    )
    assert (ours != (np.concatenate(theirs) > 0)).sum() < 30


def online_labels(scans, **values):
    method = DufoMap(DufoMap.Params(max_range=FAR, **values))
    method.begin(Context(Extent.of(*scans)))
    labels = []
    for scan in scans:
        method.observe(scan)
        labels.append(method.label(scan).dynamic)
    return np.concatenate(labels)

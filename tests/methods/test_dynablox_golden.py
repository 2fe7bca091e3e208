"""Scores on two golden sequences, recorded to detect changes.

There are no labels of the public Dynablox. On these two sequences the public OctoMap scores 86.33 /
42.44 and 93.72 / 88.81 (SA / DA), the public DUFOMap 99.84 / 48.79 on the second.
"""

from __future__ import annotations

import pytest

from dynaviz_methods.dynablox.method import Dynablox


@pytest.mark.parametrize(
    ("name", "preset", "sa", "da"),
    [
        ("mini", None, 99.46, 73.13),
        ("mini", "semindoor", 99.72, 69.97),
        pytest.param("kitti_tracking_0012", "kitti", 99.96, 47.59, marks=pytest.mark.slow),
    ],
)
def test_scores(request, name, preset, sa, da):
    golden = request.getfixturevalue(name)
    static, dynamic, _ = golden.scores(golden.run(Dynablox, preset))
    assert static == pytest.approx(sa, abs=0.1)
    assert dynamic == pytest.approx(da, abs=0.5)

"""Whether a gain is more than chance.

Drawn movers, the average over movers, and the floor of SA.
"""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from dynaviz.benchmarking.gain import gain


def result(movers, static=(1000, 0), breakdown=True):
    """A result with these numbers of (points, removed) for each mover."""
    rows = [
        SimpleNamespace(
            class_=1, instance=k, dynamic_removed=removed, dynamic_kept=points - removed
        )
        for k, (points, removed) in enumerate(movers)
    ]
    points, removed = (sum(column) for column in zip(*movers, strict=True))
    counts = {"static_kept": static[0], "static_removed": static[1], "dynamic_removed": removed}
    return SimpleNamespace(
        counts={**counts, "dynamic_kept": points - removed},
        sections=SimpleNamespace(breakdown=SimpleNamespace(object=rows) if breakdown else None),
    )


def test_a_gain_on_every_mover_is_proven():
    found = gain([result([(100, 36)] * 10)] * 2, [result([(100, 49)] * 10)] * 2)
    assert (found.aa, found.low, found.high, found.movers) == pytest.approx((10, 10, 10, 10))
    assert found.sa == 0
    assert found.doubts == []
    assert str(found).startswith(
        "AA +10.00 points on other implants, 95 % interval +10.00 to +10.00"
    )


def test_a_gain_that_depends_on_one_mover_is_not():
    before, after = result([(1000, 100)] + [(100, 50)] * 9), result([(1000, 900)] + [(100, 40)] * 9)
    found = gain([before], [after])
    assert found.aa > 20
    assert found.low < 0 < found.high
    assert found.movers < 0.5
    assert found.doubts[0] == "the 95 % interval of the gain over drawn movers is not above zero"
    worse = gain([before], [result([(1000, 900)] + [(100, 30)] * 9)])
    assert "AA does not rise if each mover counts once" in worse.doubts


def test_a_gain_that_costs_static_points_is_not():
    found = gain([result([(100, 36)] * 10)], [result([(100, 81)] * 10, static=(980, 20))])
    assert found.low > 0
    assert found.sa == pytest.approx(-2)
    assert found.doubts == ["SA drops by more than 1 point"]


def test_without_objects_a_sequence_is_one_mover():
    before, after = (
        result([(100, 36), (50, 10)], breakdown=False),
        result([(100, 49), (50, 30)], breakdown=False),
    )
    found = gain([before], [after])
    assert found.low == found.high == pytest.approx(found.aa)
    assert found.movers == pytest.approx(found.aa)

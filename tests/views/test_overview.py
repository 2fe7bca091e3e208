"""The overview of a run on tiles: its ranking."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from dynaviz.contracts.scan import Outcome
from dynaviz.views.record.overview import ERRORS, Overview, ranking


def test_the_ranking_lists_tiles_with_wrong_points_only() -> None:
    good, bad = np.zeros(len(Outcome), np.int64), np.zeros(len(Outcome), np.int64)
    good[Outcome.STATIC_KEPT] = bad[Outcome.STATIC_KEPT] = 90
    bad[Outcome.FALSE_POSITIVE] = 10
    outcomes = {(0, 0): good, (-1, 2): bad, (3, 0): good}
    overview: Any = SimpleNamespace(
        _counts=SimpleNamespace(outcomes=outcomes), _path=Path("out/overview.rrd")
    )
    result: Any = SimpleNamespace(
        has_truth=True, metrics={}, method="m", sequence=SimpleNamespace(name="s")
    )
    text = Overview._text(overview, result, ranking(outcomes, ERRORS), ERRORS)
    assert "`-1_2`" in text
    assert "10.00" in text
    assert "`0_0`" not in text
    assert "2 of 3 tiles have no wrong points" in text
    assert "dynaviz view out/tiles/-1_2" in text

"""Small labelled scans with every kind of point, and studies of made results."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from dynaviz.contracts.method import MethodInfo, Reason
from dynaviz.contracts.metric import Labelled
from dynaviz.contracts.scan import Scan
from dynaviz.reports.reporting import Study
from dynaviz.scores.collect import collect
from dynaviz.scores.result import Result

INFO = MethodInfo(
    "m",
    "M",
    "none",
    (Reason("seen_free", "a ray went through"), Reason("never_seen", "no ray did")),
)


@pytest.fixture
def info() -> MethodInfo:
    return INFO


@pytest.fixture
def make_labelled() -> Callable[..., Labelled]:
    """Make labelled scans of random points, or of the given arrays."""

    def make(frame: int = 0, n: int = 400, **given) -> Labelled:
        rng = np.random.default_rng(1000 + frame)
        points = given.pop("points", rng.uniform(-8, 8, (n, 3)) * [1, 1, 0.2])
        n = len(points)
        labels = given.pop("labels", rng.choice([0, 1, 255], n, p=[0.7, 0.25, 0.05]))
        dynamic = given.pop("dynamic", rng.random(n) < np.where(labels == 1, 0.8, 0.2))
        reasons = given.pop("reasons", rng.integers(0, 2, n))
        pose = given.pop("T_world_sensor", np.eye(4))
        scan = Scan(frame + 50, points, pose, labels=labels, **given)
        return Labelled.of(frame, scan, np.asarray(dynamic), np.asarray(reasons, np.uint8))

    return make


@pytest.fixture
def study(tmp_path: Path) -> Callable[..., Study]:
    """Save results, each in a folder of its own, and collect them."""

    def make(*results: Result, failed: tuple[str, ...] = ()) -> Study:
        for number, each in enumerate(results):
            each.save(tmp_path / f"{number:02}" / "result.json")
        for method in failed:
            facts = {
                "method": method,
                "sequence": "hall",
                "variant": "v_1",
                "error": "no <memory> & 100 % | lost",
            }
            (tmp_path / method).mkdir()
            (tmp_path / method / "error.json").write_text(json.dumps(facts))
        return Study(collect([tmp_path]), tmp_path)

    return make

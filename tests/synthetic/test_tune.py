"""``dynaviz tune``: search on implants, scores on others, and what it must not use."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from helpers.toy_method import InProcessExecutor

from dynaviz.benchmarking import bench as bench_module
from dynaviz.benchmarking import tune as tune_module
from dynaviz.benchmarking.search import default_ranges, distributions
from dynaviz.benchmarking.tune import Tuned, tune
from dynaviz.contracts import params, registry
from dynaviz.contracts.scan import Label
from dynaviz.errors import UsageError
from dynaviz.sources.datasets import open_sequence
from dynaviz.synthetic.implants.implant_scene import CLASSES

pytest.importorskip("optuna", reason="needs optuna: pip install optuna")

MOVERS = "cars=0&trucks=0&cyclists=1&persons=2&parks=0"


@pytest.fixture
def cheap(monkeypatch: pytest.MonkeyPatch) -> None:
    """Runs in this process, counts as the only metric, and a panel of one method."""
    every = registry.handles

    def handles(kind: str) -> list[registry.PluginHandle]:
        return [handle for handle in every(kind) if kind != "metrics" or handle.name == "confusion"]

    monkeypatch.setattr(registry, "handles", handles)
    monkeypatch.setattr(bench_module, "LocalExecutor", InProcessExecutor)
    monkeypatch.setattr(tune_module, "default_panel", lambda without: ("beautymap",))


def tuned(street: Path, out: Path, movers: str = MOVERS, trials: int = 2) -> Tuned:
    ranges = {"scan_ratio": "0.1:0.4"}
    path = f"implant:{street}?{movers}"
    return tune(path, "erasor", out, trials=trials, seeds=1, holdout=1, ranges=ranges, frames=":5")


@pytest.mark.slow
def test_parameters_are_found_scored_and_kept(
    street_folder: Path, tmp_path: Path, cheap: None
) -> None:
    found = tuned(street_folder, tmp_path)
    assert [(score.scored_on, score.parameters) for score in found.scores] == [
        (where, parameters)
        for where in ("implants of the search", "other implants", "true labels")
        for parameters in ("default", "tuned")
    ]
    aa = [score.result.metrics["AA"] for score in found.scores]
    assert aa[1] >= aa[0]
    assert found.improved == (aa[1] > aa[0])
    assert (aa[0], aa[1]) == (found.board.searches[0].default_aa, found.board.searches[0].aa)
    assert (found.gain is not None) == found.improved
    assert found.preset.name == (
        "best-erasor.toml" if found.proven or not found.improved else "unproven-erasor.toml"
    )
    assert [file.name for file in tmp_path.glob("*-erasor.toml")] == [found.preset.name]
    resolved = params.resolve(registry.load("methods", "erasor"), config=found.preset)
    assert resolved.params.scan_ratio == found.scores[1].result.parameters["scan_ratio"]

    scan = open_sequence(str(tmp_path / "implants/seed1"))[
        2
    ]  # the labels of the street are not in it
    new = np.isin(scan.classes, list(CLASSES.values()))
    assert new.any()
    assert (scan.labels[new] == Label.DYNAMIC).all()
    assert set(np.unique(scan.labels[~new])) == {Label.STATIC, Label.UNLABELLED}
    true = open_sequence(str(street_folder))[2]
    assert (true.labels == Label.DYNAMIC).any()

    again = tuned(street_folder, tmp_path)
    assert InProcessExecutor.ran == []
    assert [score.result.metrics["AA"] for score in again.scores] == aa
    with pytest.raises(
        UsageError, match=r"tune.toml: from a search with another sequence or movers"
    ):
        tuned(street_folder, tmp_path, MOVERS.replace("persons=2", "persons=3"))


def test_default_ranges_are_valid_and_contain_the_default() -> None:
    for method in ("dufomap", "octomap", "erasor", "seethrough"):
        ranges = default_ranges(method)
        defaults = registry.load("methods", method).Params()
        space = distributions(method, ranges)  # raises for an invalid end
        assert ranges
        for name, values in space.items():
            assert values.low <= getattr(defaults, name) <= values.high
    assert "max_range" not in default_ranges("dufomap")  # 0: no limit


def test_no_seeds(street_folder: Path, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="seeds = 0, holdout = 1: give at least 1"):
        tune(street_folder, "erasor", tmp_path, seeds=0, holdout=1)
    assert not list(tmp_path.iterdir())

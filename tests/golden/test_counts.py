"""Each method's counts on simulated scenes match the recorded ones.

After a change that is meant to change labels, run ``DYNAVIZ_REWRITE=1 pytest tests/golden`` to
record new counts; the diff of ``counts.json`` then shows the changes.

The scenes are simulated here, so the last digits of their points depend on the machine's
mathematical library and vector units. If the digest of a scene is the recorded one, counts must be
equal. Otherwise each may differ by a few per thousand of all points, because last digits matter for
points on the border of a voxel or a bin.
"""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import pytest

from dynaviz import kernels
from dynaviz.contracts import registry
from dynaviz.contracts.scan import Sequence
from dynaviz.engine.loop import RunSpec, execute
from dynaviz.sources.datasets import open_sequence
from dynaviz.synthetic.simulate.write import simulate

FILE = Path(__file__).with_name("counts.json")
REWRITE = "DYNAVIZ_REWRITE" in os.environ
SCENES = {"demo": (12, 1), "square_mid360": (18, 3)}  # number of frames, and stride
KINDS = ("static_kept", "static_removed", "dynamic_removed", "dynamic_kept")
TOLERANCE = 0.003  # share of all points, if the scene itself differs in last digits
METHODS = [
    handle.name for handle in registry.handles("methods") if handle.distribution == "dynaviz"
]


@pytest.fixture(
    scope="module", params=[pytest.param("demo", marks=pytest.mark.slow), "square_mid360"]
)
def scene(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Sequence:
    folder = tmp_path_factory.mktemp("scenes") / request.param
    frames, stride = SCENES[request.param]
    return open_sequence(str(simulate(request.param, folder, frames))).select(stride=stride)


def counts(name: str, sequence: Sequence, threads: int) -> tuple[str, list[int]]:
    """The digest of the scene, and the number of points of each kind."""
    kind = registry.load("methods", name)
    params = kind.Params()
    metric = registry.load("metrics", "confusion")(kind.info)
    try:
        result = execute(RunSpec(kind(params), sequence, params, (metric,), threads=threads))
    finally:
        kernels.set_threads(None)
    return result.sequence.digest, [result.counts[kind] for kind in KINDS]


@pytest.mark.parametrize("name", METHODS)
def test_counts_match_the_recorded_ones(name: str, scene: Sequence) -> None:
    digest, found = counts(name, scene, 1)
    known: dict[str, Any] = json.loads(FILE.read_text()) if FILE.exists() else {}
    if REWRITE:
        entry = known.setdefault(scene.name, {})
        if entry.get("digest") != digest:
            entry.clear()
            entry["digest"] = digest
        entry[name] = found
        written = {place: dict(sorted(known[place].items())) for place in sorted(known)}
        FILE.write_text(_a_line_each(written))
        pytest.skip("recorded new counts")
    expected = known.get(scene.name, {}).get(name)
    assert expected, f"no counts of {name} are recorded; run DYNAVIZ_REWRITE=1 pytest tests/golden"
    same_scene = known[scene.name]["digest"] == digest
    slack = 0 if same_scene else TOLERANCE * sum(expected)
    assert found == pytest.approx(expected, abs=slack), f"{KINDS} were {expected}"


@pytest.mark.slow
@pytest.mark.parametrize("name", METHODS)
@pytest.mark.parametrize("scene", ["square_mid360"], indirect=True)
def test_counts_do_not_depend_on_the_number_of_threads(name: str, scene: Sequence) -> None:
    assert counts(name, scene, 2) == counts(name, scene, 1)


def _a_line_each(table: dict[str, dict[str, Any]]) -> str:
    """JSON with one line per method, so that a diff shows which methods changed."""
    scenes = [
        f' "{name}": {{\n'
        + ",\n".join(f'  "{key}": {json.dumps(value)}' for key, value in row.items())
        + "\n }"
        for name, row in table.items()
    ]
    return "{\n" + ",\n".join(scenes) + "\n}\n"


def test_only_known_methods_and_scenes_are_recorded() -> None:
    known = json.loads(FILE.read_text())
    assert set(known) == set(SCENES)
    for row in known.values():
        assert set(row) == {"digest", *METHODS}

"""Settings and runtimes of two runs."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from dynaviz.contracts.plugin_code import Plugin
from dynaviz.scores.comparison.settings import names, runtime_ratio, setting_changes
from dynaviz.scores.result import Result
from dynaviz.scores.sections import Environment, Machine, Runtime, Sections, SequenceInfo, Source

BASE = Result(
    "octomap", {"resolution": 0.1}, SequenceInfo("s"), runtime=Runtime(mean_s=0.2, threads=2)
)


@pytest.mark.parametrize(
    ("change", "ratio", "note"),
    [
        ({}, 1.0, ""),
        ({"runtime": Runtime(mean_s=0.5, threads=2)}, 2.5, ""),
        ({"runtime": Runtime(mean_s=0.4, threads=1)}, 2.0, "threads differ: 2, 1"),
        (
            {"environment": Environment(machine=Machine(arch="arm64", cores=4))},
            1.0,
            "machines differ: , arm64 4",
        ),
        (
            {"instrumented": True},
            None,
            "no runtime ratio: only dufomap ran with its states recorded",
        ),
        ({"runtime": Runtime()}, None, "one runtime was not measured"),
        ({"sections": Sections(source=Source())}, None, "were read from a file"),
    ],
)
def test_runtimes(change: dict[str, Any], ratio: float | None, note: str) -> None:
    found = runtime_ratio(BASE, replace(BASE, **{"method": "dufomap", **change}))
    assert found.ratio == (None if ratio is None else pytest.approx(ratio))
    assert note in "; ".join(found.notes)
    assert bool(found.notes) == bool(note)


def test_runtimes_of_two_instrumented_runs() -> None:
    instrumented = replace(BASE, instrumented=True)
    assert runtime_ratio(instrumented, instrumented).notes == (
        "both ran with their states recorded",
    )


def test_all_kinds_of_settings() -> None:
    other = replace(
        BASE, method="dufomap", parameters={"d": 1}, online=True, seed=4, scoring="nn", preset="av2"
    )
    found = {row.name: (row.first, row.second) for row in setting_changes(BASE, other)}
    assert found == {
        "method": ("octomap", "dufomap"), "scoring": ("mask", "nn"), "preset": (None, "av2"),
        "online": (False, True),
        "seed": (0, 4), "resolution": (0.1, None), "d": (None, 1),
    }  # fmt: skip


def test_names_contain_what_differs() -> None:
    assert names([BASE, replace(BASE, method="dufomap")], [Path("a.rrd"), Path("b.rrd")]) == [
        "octomap",
        "dufomap",
    ]
    assert names([BASE, replace(BASE, seed=1)], [Path(), Path()]) == [
        "octomap seed=0",
        "octomap seed=1",
    ]
    assert names([BASE, BASE], [Path("x/run.rrd"), Path("x/other.rrd")]) == [
        "octomap x",
        "octomap other",
    ]
    paths = [Path("old/octomap/run.rrd"), Path("new/octomap/run.rrd")]
    assert names([BASE, BASE], paths) == ["octomap old", "octomap new"]


def test_a_difference_in_code_is_a_setting() -> None:
    old, new = (
        replace(BASE, plugin=Plugin("mine:Method", "mine", version, digest * 8))
        for version, digest in (("1.0", "0123abcd"), ("1.1", "4567abcd"))
    )
    found = {row.name: (row.first, row.second) for row in setting_changes(old, new)}
    assert found == {"code": ("0123abcd", "4567abcd"), "version": ("1.0", "1.1")}
    assert names([old, new], [Path("a.rrd"), Path("b.rrd")]) == [
        "octomap code=0123abcd version=1.0",
        "octomap code=4567abcd version=1.1",
    ]
    assert not setting_changes(old, old)

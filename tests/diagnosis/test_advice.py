"""Advice of the doctor that is followed leads to a sequence without findings.

``benchmarks/faults.py`` has them all.
"""

from __future__ import annotations

import importlib
from pathlib import Path
from types import ModuleType

import pytest

from dynaviz.diagnosis import doctor, quick_check
from dynaviz.sources.drive import Drive
from dynaviz.spatial import geometry
from dynaviz.testing.world import crossing

SCANS = crossing()
FAULTS = ["millimetres"]
FAULTS += [
    pytest.param(kind, marks=pytest.mark.slow)
    for kind in ("camera's axes", "quaternion y x w z", "world")
]


@pytest.fixture(scope="module")
def faults() -> ModuleType:
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(Path(__file__).resolve().parents[2] / "benchmarks")
        return importlib.import_module("faults")


@pytest.mark.parametrize("kind", FAULTS)
def test_advice_that_is_followed_leads_to_no_findings(
    kind: str, faults: ModuleType, tmp_path: Path
) -> None:
    poses = [scan.T_world_sensor for scan in SCANS]
    points = [
        geometry.apply(geometry.inverse(T), scan.points)
        for scan, T in zip(SCANS, poses, strict=True)
    ]
    files = faults.Files(points, poses)
    if kind == "millimetres":
        name, wrong = kind, files.scaled(points=1000.0)
    elif kind == "world":
        name, wrong = "points in world frame", faults.Files([scan.points for scan in SCANS], poses)
    else:
        name, change = {**faults.POSES, **faults.ORDERS}[kind]
        wrong = files.posed(change)
    sequence = wrong.open(tmp_path)
    found = doctor(sequence)
    assert [finding.name for finding in found.findings] == [name], found
    assert [finding.name for finding in quick_check(Drive.of(sequence))] == [name]
    assert doctor(faults.followed(wrong, found.findings[0]).open(tmp_path)).ok

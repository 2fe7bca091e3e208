"""A simulated street, and the same with implants; most laws are checked on both."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest

from dynaviz.contracts.scan import Scan, Sequence
from dynaviz.sources.datasets import open_sequence
from dynaviz.synthetic.implants.implant_options import ImplantOptions
from dynaviz.synthetic.implants.implanted_sequence import ImplantedSequence
from dynaviz.synthetic.simulate import simulate
from dynaviz.testing import InMemory

FRAMES = 12


@pytest.fixture(scope="session")
def options() -> ImplantOptions:
    return ImplantOptions(cars=1, trucks=0, cyclists=2, persons=4, parks=0, seed=1)


@pytest.fixture(scope="session")
def street_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return simulate("demo", tmp_path_factory.mktemp("implants") / "street", frames=FRAMES)


@pytest.fixture(scope="session")
def street(street_folder: Path) -> InMemory:
    """All scans, in memory."""
    opened = open_sequence(str(street_folder))
    return InMemory([opened[k] for k in range(len(opened))], "street", opened.sensor)


@pytest.fixture(scope="session")
def implanted(street: InMemory, options: ImplantOptions) -> ImplantedSequence:
    return ImplantedSequence.of(street, options)


@pytest.fixture(scope="session")
def pairs(street: Sequence, implanted: ImplantedSequence) -> list[tuple[Scan, Scan]]:
    """Each scan without and with implants."""
    return [(street[k], implanted[k]) for k in range(len(street))]


@pytest.fixture(scope="session")
def unlabelled(street: InMemory) -> InMemory:
    scans = [
        dataclasses.replace(scan, labels=None, classes=None, instances=None)
        for scan in street.scans
    ]
    return InMemory(scans, "street", street.sensor)

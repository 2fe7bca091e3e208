"""Static points by agreement of methods."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest

from dynaviz import params, registry
from dynaviz.arrays import Bool
from dynaviz.engine.loop import Listener, RunSpec, execute
from dynaviz.errors import UsageError
from dynaviz.implants.options import ImplantOptions
from dynaviz.implants.panel import default_panel, undisputed
from dynaviz.implants.scene import CLASSES
from dynaviz.implants.sequence import ImplantedSequence
from dynaviz.metric import Labelled
from dynaviz.scan import Label
from dynaviz.testing import InMemory

PANEL = ("beautymap", "removert")


class Removed(Listener):
    """The labels of a run."""

    def __init__(self) -> None:
        self.frames: list[Bool] = []

    def labelled(self, labelled: Labelled, curves: Mapping[str, float]) -> None:
        self.frames.append(labelled.dynamic)


def removed(name: str, sequence: InMemory) -> list[Bool]:
    kind, found = registry.load("methods", name), Removed()
    resolved = params.resolve(kind)
    execute(RunSpec(kind(resolved.params), sequence, resolved.params), [found])
    return found.frames


def test_points_that_no_method_removes_are_static(unlabelled: InMemory) -> None:
    steps: list[str] = []
    static = undisputed(unlabelled, PANEL, lambda phase, done, total: steps.append(phase))
    both = [a | b for a, b in zip(*(removed(name, unlabelled) for name in PANEL), strict=True)]
    for position, gone in enumerate(both):
        np.testing.assert_array_equal(static(position), ~gone)
    assert 0 < sum(gone.sum() for gone in both) < sum(len(gone) for gone in both)
    assert {"beautymap: observe", "removert: label"} <= set(steps)


def test_a_sequence_with_a_panel(unlabelled: InMemory) -> None:
    options = ImplantOptions(cars=0, trucks=0, cyclists=0, persons=2, parks=0, seed=3, panel=("removert",))
    sequence = ImplantedSequence.of(unlabelled, options)
    gone = removed("removert", unlabelled)[-1]
    scan = sequence[-1]
    assert scan.labels is not None
    assert scan.classes is not None
    new = np.isin(scan.classes, list(CLASSES.values()))
    assert (scan.labels[new] == Label.DYNAMIC).all()
    unknown = (scan.labels[~new] == Label.UNLABELLED).sum()
    assert 0 < unknown <= gone.sum()
    assert unknown > gone.sum() - len(unlabelled.scans[-1]) + (~new).sum()
    assert "removert all keep" in sequence.facts["scores"]


def test_labels_of_the_sequence_come_first(street: InMemory) -> None:
    """A panel fills in only points without a label."""
    options = ImplantOptions(cars=0, trucks=0, cyclists=0, persons=2, parks=0, seed=3)
    plain = ImplantedSequence.of(street, options)
    static = np.ones(len(street[2]), np.bool_)
    filled = ImplantedSequence(street, plain.scene, plain.lidar, "x", ("any",), lambda position: static)
    np.testing.assert_array_equal(filled[2].labels, plain[2].labels)


def test_the_default_panel_is_installed() -> None:
    assert len(default_panel()) >= 3


def test_an_unknown_method(unlabelled: InMemory) -> None:
    with pytest.raises(UsageError, match=r"unknown method 'dufomab'\. Did you mean 'dufomap'"):
        undisputed(unlabelled, ("dufomab",), lambda *step: None)

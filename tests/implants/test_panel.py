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
from dynaviz.implants.panel import Votes, default_panel, votes
from dynaviz.implants.scene import CLASSES
from dynaviz.implants.sequence import ImplantedSequence
from dynaviz.implants.survey import Survey
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


def test_points_that_most_methods_keep_are_static_and_those_that_all_remove_dynamic(unlabelled: InMemory) -> None:
    steps: list[str] = []
    agreed = votes(unlabelled, PANEL, lambda phase, done, total: steps.append(phase))
    both = list(zip(*(removed(name, unlabelled) for name in PANEL), strict=True))
    for position, (a, b) in enumerate(both):
        np.testing.assert_array_equal(agreed.static(position), ~(a | b))
        np.testing.assert_array_equal(agreed.dynamic(position), a & b)
    assert 0 < sum((a & b).sum() for a, b in both) < sum((a | b).sum() for a, b in both)
    assert {"beautymap: observe", "removert: label"} <= set(steps)


def test_one_of_three_methods_is_outvoted() -> None:
    removes = np.array([[1, 0, 0, 0], [1, 1, 0, 0], [1, 1, 1, 0]], np.bool_)
    agreed = Votes(3, [[np.packbits(row) for row in removes]], [4])
    assert agreed.static(0).tolist() == [False, False, True, True]
    assert agreed.dynamic(0).tolist() == [True, False, False, False]


def test_implants_may_cross_the_trails_of_movers_that_the_panel_agrees_on(unlabelled: InMemory) -> None:
    gone = removed("removert", unlabelled)
    free = Survey.of(unlabelled, moving=lambda position: gone[position])
    blocked = Survey.of(unlabelled)
    assert blocked.count.sum() - free.count.sum() > 0.5 * sum(mask.sum() for mask in gone)
    assert not any(len(points) for points in blocked.dynamic)
    assert sum(len(points) for points in free.dynamic) > 100


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
    assert "most of removert keep" in sequence.facts["scores"]


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
        votes(unlabelled, ("dufomab",))

"""Static points by agreement of methods."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest

from dynaviz.arrays import Bool
from dynaviz.contracts import params, registry
from dynaviz.contracts.metric import Labelled
from dynaviz.contracts.scan import Label
from dynaviz.contracts.sensors import Sensor
from dynaviz.engine.loop import Listener, RunSpec, execute
from dynaviz.errors import UsageError
from dynaviz.sources.drive import Drive
from dynaviz.synthetic.implants.implant_options import ImplantOptions
from dynaviz.synthetic.implants.implant_scene import CLASSES
from dynaviz.synthetic.implants.implanted_sequence import ImplantedSequence
from dynaviz.synthetic.implants.panel import around, default_panel, votes
from dynaviz.synthetic.implants.survey import Survey
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


def test_points_that_most_methods_keep_are_static_and_those_that_all_remove_dynamic(
    unlabelled: InMemory,
) -> None:
    steps: list[str] = []
    agreed = votes(Drive.of(unlabelled), PANEL, lambda phase, done, total: steps.append(phase))
    both = list(zip(*(removed(name, unlabelled) for name in PANEL), strict=True))
    for position, (a, b) in enumerate(both):
        np.testing.assert_array_equal(
            agreed.static(position), ~around(unlabelled[position].points, a | b)
        )
        np.testing.assert_array_equal(agreed.dynamic(position), a & b)
    assert 0 < sum((a & b).sum() for a, b in both) < sum((a | b).sum() for a, b in both)
    assert {"beautymap: observe", "removert: label"} <= set(steps)


def test_methods_of_a_panel_get_estimates_of_an_unknown_sensor(unlabelled: InMemory) -> None:
    with pytest.warns(UserWarning, match="the sensor is unknown"):
        agreed = votes(Drive.of(InMemory(unlabelled.scans, "street", Sensor())), PANEL)
    assert sum(agreed.dynamic(position).sum() for position in range(len(unlabelled))) > 0


def test_one_of_three_methods_is_outvoted(unlabelled: InMemory) -> None:
    panel = ("beautymap", "removert", "dufomap")
    agreed = votes(Drive.of(unlabelled), panel)
    ballots = list(zip(*(removed(name, unlabelled) for name in panel), strict=True))
    for position, ballot in enumerate(ballots):
        removals = np.sum(ballot, axis=0)
        assert not agreed.static(position)[removals >= 2].any()
        np.testing.assert_array_equal(agreed.dynamic(position), removals == 3)
    kept = sum(
        agreed.static(k)[np.sum(ballot, axis=0) == 1].sum() for k, ballot in enumerate(ballots)
    )
    assert kept > 100


def test_points_next_to_removed_ones_are_not_static() -> None:
    points = np.array([[0, 0, 0], [0.2, 0, 0], [0.6, 0, 0], [np.nan, 0, 0], [9, 9, 9]], np.float32)
    chosen = np.array([1, 0, 0, 0, 0], np.bool_)
    assert around(points, chosen).tolist() == [True, True, False, False, False]
    assert around(points, ~chosen).tolist() == [True] * 5
    assert not around(points, np.zeros(5, np.bool_)).any()


def test_the_panel_of_a_method_does_not_contain_it() -> None:
    assert len(default_panel()) == len(default_panel(without="dufomap")) == 3
    assert "dufomap" in default_panel()
    assert "dufomap" not in default_panel(without="dufomap")


def test_implants_may_cross_the_trails_of_movers_that_the_panel_agrees_on(
    unlabelled: InMemory,
) -> None:
    gone = removed("removert", unlabelled)
    free = Survey.of(unlabelled, moving=lambda position: gone[position])
    blocked = Survey.of(unlabelled)
    assert blocked.count.sum() - free.count.sum() > 0.5 * sum(mask.sum() for mask in gone)
    assert not any(len(points) for points in blocked.dynamic)
    assert sum(len(points) for points in free.dynamic) > 100


def test_a_sequence_with_a_panel(unlabelled: InMemory) -> None:
    options = ImplantOptions(
        cars=0, trucks=0, cyclists=0, persons=2, parks=0, seed=3, panel=("removert",)
    )
    sequence = ImplantedSequence.of(unlabelled, options)
    gone = around(unlabelled[-1].points, removed("removert", unlabelled)[-1])
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
    filled = ImplantedSequence(
        street, plain.scene, plain.lidar, "x", ("any",), lambda position: static
    )
    np.testing.assert_array_equal(filled[2].labels, plain[2].labels)


def test_the_default_panel_is_installed() -> None:
    assert len(default_panel()) >= 3


def test_an_unknown_method(unlabelled: InMemory) -> None:
    with pytest.raises(UsageError, match=r"unknown method 'dufomab'\. Did you mean 'dufomap'"):
        votes(Drive.of(unlabelled), ("dufomab",))

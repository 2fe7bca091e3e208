"""How many scans see a place, and which methods that suits."""

from __future__ import annotations

import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import dynaviz as dv
from dynaviz.contracts import registry
from dynaviz.diagnosis import doctor
from dynaviz.diagnosis.sampling import looks, sampling
from dynaviz.testing import InMemory
from dynaviz.testing.world import SENSOR, crossing


def test_places_are_seen_from_ten_metres_before_to_ten_behind() -> None:
    along = [np.array([float(x), 0.0, 0.0]) for x in range(50)]
    assert looks(along) == 21
    assert looks(along[:8]) == 8
    assert looks(along[::5]) == 5
    assert looks([np.zeros(3)] * 30) == 30


def test_stretches_of_a_long_sequence_tell_its_speed() -> None:
    numbers = [*range(20), *range(500, 520)]
    read = [np.array([0.5 * number, 0.0, 0.0]) for number in numbers]
    assert looks(read, numbers, 1000) == 41
    assert looks(read[:20], numbers[:20], 30) == 30


def test_dense_data_suit_every_method() -> None:
    dense = sampling(100, 64)
    assert dense.kept.keys() <= {handle.name for handle in registry.handles("methods")}
    assert set(dense.kept.values()) == {1.0}
    assert not dense.poor
    assert sampling(100, None).kept == dense.kept


def test_fewer_scans_or_rings_suit_fewer_methods() -> None:
    thinned = [set(sampling(seen, 64).poor) for seen in (100, 8, 4, 2)]
    assert all(more <= less for more, less in itertools.pairwise(thinned))
    assert {"dynablox", "hmm_mos"} <= thinned[2], "they need several scans to trust free space"
    assert "octomap" not in thinned[3]
    assert set(sampling(100, 64).poor) <= set(sampling(100, 16).poor)


@pytest.mark.slow
def test_a_dense_drive_suits_every_method() -> None:
    diagnosis = doctor(InMemory(crossing(30), "drive", replace(SENSOR, rings=64)))
    assert diagnosis.sampling
    assert not diagnosis.sampling.poor
    assert "A place is seen" not in str(diagnosis)


@pytest.mark.slow
def test_a_real_drive_at_two_hertz(real_data: Path) -> None:
    diagnosis = doctor(dv.open(real_data / "nuscenes"))
    assert diagnosis.sampling
    assert (diagnosis.sampling.looks, diagnosis.sampling.rings) == (9, 32)
    assert {"dynablox", "hmm_mos"} <= diagnosis.sampling.poor.keys()
    assert {
        "octomap",
        "beautymap",
        "freedom",
    } <= diagnosis.sampling.kept.keys() - diagnosis.sampling.poor.keys()
    assert "less than half of their DA: " in " ".join(str(diagnosis).split())
    assert diagnosis.to_dict()["sampling"]["looks"] == 9

"""No method sees points at the sensor.

They are kept for a reason of their own, counted, and change no other label.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import dynaviz as dv
from dynaviz.arrays import F64
from dynaviz.contracts.at_sensor import AtSensor
from dynaviz.contracts.method import AT_SENSOR
from dynaviz.contracts.scan import Label, Scan
from dynaviz.diagnosis import quick_check
from dynaviz.sources.carrier import estimate_carrier
from dynaviz.sources.drive import Drive
from dynaviz.spatial import geometry
from dynaviz.testing import InMemory
from dynaviz.testing.world import HEIGHT, SENSOR, crossing

SCANS = crossing(16)
ROOF = np.stack(np.meshgrid([-0.9, -0.7, 0.9, 1.1], [-0.5, 0.1, 0.5], [-0.3]), -1).reshape(-1, 3)


def with_points(scan: Scan, local: F64) -> Scan:
    """The scan with points of the sensor frame, (K, 3) metres, after its own ones."""
    added = geometry.apply(scan.T_world_sensor, local).astype(np.float32)
    labels = np.append(scan.labels, np.full(len(added), Label.UNLABELLED, np.uint8))
    return dataclasses.replace(
        scan, points=np.concatenate([scan.points, added]), labels=labels, origins=None
    )


def test_what_moves_with_the_sensor_is_its_carrier() -> None:
    driven = InMemory([with_points(scan, ROOF) for scan in SCANS])
    assert estimate_carrier(Drive.of(InMemory(SCANS))) == ()
    carrier = estimate_carrier(Drive.of(driven))
    assert set(carrier) == {tuple(cube) for cube in np.floor(ROOF / 0.2).astype(int).tolist()}
    found = AtSensor(dataclasses.replace(SENSOR, carrier=carrier)).found(driven[5])
    assert found[-len(ROOF) :].all()
    assert not found[: -len(ROOF)].any()


@pytest.mark.parametrize("roll", [0.0, 90.0, 180.0])
def test_the_carrier_of_a_turned_sensor_is_above_the_ground_and_near_its_vertical_axis(
    roll: float,
) -> None:
    """Neither the ground below a turned sensor nor what is beside it moves with it by accident."""
    T_turned_upright = np.eye(4)
    T_turned_upright[:3, :3] = Rotation.from_euler("x", roll, degrees=True).as_matrix()
    x, y = np.meshgrid([-0.9, -0.5, -0.1, 0.3, 0.7], [-0.5, -0.1, 0.3])
    ground = np.stack([x, y, np.full_like(x, 0.15 - HEIGHT)], -1).reshape(-1, 3)
    beside = np.array([[0.1, 2.5, -0.3], [0.3, 2.5, -0.3]])
    turned = [
        dataclasses.replace(
            each,
            T_world_sensor=each.T_world_sensor @ geometry.inverse(T_turned_upright),
            origins=None,
        )
        for scan in SCANS
        for each in [with_points(scan, np.concatenate([ROOF, ground, beside]))]
    ]
    roof = geometry.apply(T_turned_upright, ROOF)
    found = set(estimate_carrier(Drive.of(InMemory(turned))))
    assert found == {tuple(cube) for cube in np.floor(roof / 0.2).astype(int).tolist()}


def test_a_standing_sensor_has_no_carrier() -> None:
    still = [dataclasses.replace(with_points(SCANS[0], ROOF), index=k) for k in range(16)]
    assert estimate_carrier(Drive.of(InMemory(still))) == ()


def test_who_keeps_step_with_the_sensor_is_no_carrier(monkeypatch: pytest.MonkeyPatch) -> None:
    body = np.stack(
        np.meshgrid([-1.5], np.linspace(-0.2, 0.2, 9), np.linspace(-0.4, 0.3, 15)), -1
    ).reshape(-1, 3)
    steps = 0.08 * np.sin(np.arange(len(SCANS)))  # metres, so that it never leaves its cubes
    followed = [
        with_points(scan, body + np.array([step, 0, 0]))
        for scan, step in zip(SCANS, steps, strict=True)
    ]
    assert estimate_carrier(Drive.of(InMemory(followed))) == ()
    monkeypatch.setattr("dynaviz.sources.carrier.RIGID", np.inf)
    assert estimate_carrier(Drive.of(InMemory(followed))) != ()


def test_points_at_the_sensor_change_no_other_label(tmp_path: Path) -> None:
    """DUFOMap removes nothing if a point at the sensor blocks all rays."""
    near = np.array([[0.0, 0.0, 0.0], [0.3, 0.1, -0.1], [0.0, -0.4, 0.1], [-0.2, 0.2, 0.0]])
    plain = dv.run("dufomap", InMemory(SCANS), record="none")
    blocked = InMemory([with_points(scan, np.concatenate([near[:1], ROOF])) for scan in SCANS])
    result = dv.run("dufomap", blocked, out=tmp_path, record="none")
    assert result.sequence.at_sensor == len(SCANS) * (1 + len(ROOF))
    assert plain.sequence.at_sensor == 0
    assert plain.labels is not None
    assert result.labels is not None
    for before, after in zip(plain.labels, result.labels, strict=True):
        np.testing.assert_array_equal(after[: len(before)], before)
        assert not after[len(before) :].any()
    minimum = InMemory(
        [with_points(scan, near) for scan in SCANS],
        sensor=dataclasses.replace(SENSOR, min_range=0.6),
    )
    assert dv.run("dufomap", minimum, record="none").sequence.at_sensor == len(SCANS) * len(near)


def test_every_method_has_the_reason() -> None:
    from dynaviz.contracts import registry

    for method in registry.loadable("methods").values():
        assert method.info.reasons[-1] == AT_SENSOR


@pytest.mark.slow
def test_a_car_that_sees_itself(real_data: Path) -> None:
    drive = dv.open(real_data / "nuscenes")
    assert estimate_carrier(Drive.of(drive))
    result = dv.run("dufomap", drive, record="none")
    assert result.metrics["DA"] > 40
    assert result.sequence.at_sensor > 100_000


@dataclasses.dataclass(frozen=True)
class Nested(InMemory):
    """A plug-in whose path names another sequence; it says nothing about its poses."""

    nested = True


@dataclasses.dataclass(frozen=True)
class Exact(InMemory):
    """A plug-in that states that its poses and its sensor are exact."""

    exact = True


def test_only_a_sequence_that_states_exact_poses_is_not_examined() -> None:
    driven = [with_points(scan, ROOF) for scan in SCANS]
    carrier = estimate_carrier(Drive.of(InMemory(driven)))
    assert carrier
    assert estimate_carrier(Drive.of(Nested(driven))) == carrier
    assert estimate_carrier(Drive.of(Exact(driven))) == ()
    twice = [
        dataclasses.replace(scan, points=geometry.transform(scan.T_world_sensor, scan.points))
        for scan in crossing()
    ]
    found = quick_check(Drive.of(InMemory(twice)))
    assert found
    assert quick_check(Drive.of(Nested(twice))) == found
    assert quick_check(Drive.of(Exact(twice))) == ()

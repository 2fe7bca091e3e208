"""Who comes along for the whole recording, at a distance that hardly changes, is removed."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import dynaviz as dv
from dynaviz.contracts.scan import Scan
from dynaviz.contracts.sensors import load_sensor
from dynaviz.sources.carrier import estimate_carrier
from dynaviz.sources.drive import Drive
from dynaviz.synthetic.simulate import PRESETS, objects
from dynaviz.synthetic.simulate.classes import ObjectClass
from dynaviz.synthetic.simulate.presets import Preset
from dynaviz.synthetic.simulate.recording import SceneRecorder, build
from dynaviz.synthetic.simulate.scene import SimulatedScene
from dynaviz.testing import InMemory

FRAMES = 30
BEHIND, SWAY = 1.5, 0.2  # metres


@pytest.fixture(scope="module")
def followed() -> tuple[InMemory, int]:
    """A hall in which an operator follows the sensor, and the operator's instance number."""
    preset = dataclasses.replace(PRESETS["hall_vlp16"], speed=2.0)
    scene = build(preset, FRAMES)
    ahead = scene.sensor.schedule
    scene.walk(scene.sensor.path, lambda time: ahead(time) - BEHIND + SWAY * np.sin(2 * time))
    return recorded(scene, preset)


def with_car(ahead: float, left: float) -> tuple[InMemory, int]:
    """A street in which a car keeps its place relative to the sensor, metres, and the car's
    instance number.
    """
    preset = PRESETS["street_vlp16"]
    scene = build(preset, FRAMES)
    place, path, body = (
        scene.sensor.schedule,
        scene.sensor.path,
        objects.car(np.random.default_rng(3)),
    )
    scene.move(ObjectClass.MOVING_CAR, path.shifted(left), lambda time: place(time) + ahead, body)
    return recorded(scene, preset)


def recorded(scene: SimulatedScene, preset: Preset) -> tuple[InMemory, int]:
    """The scans of a scene, and the instance number of its last mover."""
    recorder, scans = SceneRecorder(scene, preset, FRAMES), []
    for sweep in map(recorder.sweep, range(FRAMES)):
        truth = {"labels": sweep.labels, "instances": sweep.instances}
        scans.append(
            Scan(sweep.index, sweep.points, sweep.T_world_sensor, round(sweep.time * 1e9), **truth)
        )
    return InMemory(scans, "followed", load_sensor(preset.sensor)), len(scene.movers)


@pytest.mark.parametrize("method", ["seethrough", pytest.param("octomap", marks=pytest.mark.slow)])
def test_an_operator_who_follows_is_removed(method: str, followed: tuple[InMemory, int]) -> None:
    drive, operator = followed
    result = dv.run(method, drive)
    rows = [scan.instances == operator for scan in drive.scans]
    removed = sum(int((result.labels[k] & row).sum()) for k, row in enumerate(rows))
    total = sum(int(row.sum()) for row in rows)
    assert total > 10_000
    assert removed > 0.9 * total


@pytest.mark.parametrize(
    ("ahead", "left"),
    [
        pytest.param(9.0, 0.0, id="followed", marks=pytest.mark.slow),
        pytest.param(1.0, 3.0, id="beside"),
    ],
)
def test_a_car_that_comes_along_is_no_carrier(
    ahead: float, left: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    drive, car = with_car(ahead, left)
    assert estimate_carrier(Drive.of(drive)) == ()
    result = dv.run("seethrough", drive)
    rows = [scan.instances == car for scan in drive.scans]
    removed = sum(int((result.labels[k] & row).sum()) for k, row in enumerate(rows))
    total = sum(int(row.sum()) for row in rows)
    assert total > 10_000
    assert removed > 0.9 * total
    if left:  # it would be one if parts of a carrier were allowed to begin anywhere
        monkeypatch.setattr("dynaviz.sources.carrier.NEAR", np.inf)
        assert estimate_carrier(Drive.of(drive)) != ()

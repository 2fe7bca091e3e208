"""Who walks behind the sensor for the whole recording, at a distance that hardly changes, is removed."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import dynaviz as dv
from dynaviz.contracts.scan import Scan
from dynaviz.contracts.sensors import load_sensor
from dynaviz.synthetic.simulate import PRESETS
from dynaviz.synthetic.simulate.recording import SceneRecorder, build
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
    recorder, scans = SceneRecorder(scene, preset, FRAMES), []
    for sweep in map(recorder.sweep, range(FRAMES)):
        truth = {"labels": sweep.labels, "instances": sweep.instances}
        scans.append(Scan(sweep.index, sweep.points, sweep.T_world_sensor, round(sweep.time * 1e9), **truth))
    return InMemory(scans, "followed", load_sensor(preset.sensor)), len(scene.movers)


@pytest.mark.parametrize("method", ["seethrough", pytest.param("octomap", marks=pytest.mark.slow)])
def test_an_operator_who_follows_is_removed(method: str, followed: tuple[InMemory, int]) -> None:
    drive, operator = followed
    result = dv.run(method, drive)
    rows = [scan.instances == operator for scan in drive.scans]
    removed = sum(int((result.labels[k] & row).sum()) for k, row in enumerate(rows))
    total = sum(int(row.sum()) for row in rows)
    print(method, removed, total)
    assert total > 10_000
    assert removed > 0.9 * total

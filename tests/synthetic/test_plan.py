"""Which movers find a place, and what they do."""

from __future__ import annotations

import numpy as np

from dynaviz.arrays import F64
from dynaviz.contracts.scan import Scan
from dynaviz.synthetic.implants.implant_options import ImplantOptions
from dynaviz.synthetic.implants.plan import Plan, footprints, plan
from dynaviz.synthetic.implants.space import SpaceAboveGround
from dynaviz.synthetic.implants.survey import Survey
from dynaviz.testing import InMemory

FRAMES = 12
CARS = ImplantOptions(cars=2, trucks=0, cyclists=0, persons=0, parks=0, seed=0)


def plain(speed: float) -> InMemory:
    """A sensor that drives over an open plain, in m/s."""
    flat = np.stack(
        np.meshgrid(np.arange(-40, 40, 0.25), np.arange(-15, 15, 0.25), [-1.7]), -1
    ).reshape(-1, 3)
    scans = []
    for frame in range(FRAMES):
        T_world_sensor = np.eye(4)
        T_world_sensor[0, 3] = speed * frame / 10
        scans.append(Scan(frame, (flat + T_world_sensor[:3, 3]).astype(np.float32), T_world_sensor))
    return InMemory(scans, "plain")


def planned(speed: float) -> tuple[Plan, F64, F64]:
    survey = Survey.of(plain(speed))
    return plan(CARS, survey, SpaceAboveGround.of(survey)), survey.times, survey.positions[:, :2]


def test_a_car_keeps_pace_with_a_sensor_on_a_road() -> None:
    found, times, sensor = planned(8.0)
    car = next(mover for mover in found.implants if mover.note == "keeps pace")
    away = np.hypot(*(footprints(car, times).mean(1) - sensor).T)
    assert np.isfinite(away).all()
    assert np.ptp(away) < 0.2
    assert 4.0 <= away.min() <= 20.5


def test_no_car_keeps_pace_with_a_slow_sensor() -> None:
    assert {mover.note for mover in planned(1.0)[0].implants} <= {"moves", "stands", "waits"}

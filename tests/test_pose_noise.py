"""The noise of poses, measured on planes, against known errors."""

from __future__ import annotations

import numpy as np
import pytest

from dynaviz.contracts.scan import Scan
from dynaviz.sources.pose_noise import PoseNoiseMeter, pose_noise
from dynaviz.spatial import geometry
from dynaviz.synthetic.simulate.poses import transforms
from dynaviz.testing import InMemory
from dynaviz.testing.world import crossing, moved

SCANS = crossing(24)


def disturbed(shift: float, turn: float) -> list[Scan]:
    """Scans placed by poses with independent errors, standard deviations in metres and degrees."""
    random = np.random.default_rng(1)
    errors = transforms(
        random.normal(0, shift, (24, 3)), np.radians(random.normal(0, turn, (24, 3)))
    )
    found = []
    for scan, error in zip(SCANS, errors, strict=True):
        T = geometry.compose(
            geometry.compose(scan.T_world_sensor, error), geometry.inverse(scan.T_world_sensor)
        )
        found.append(moved(scan, T))
    return found


@pytest.mark.parametrize(("shift", "turn"), [(0.0, 0.0), (0.03, 0.0), (0.0, 0.2), (0.05, 0.1)])
def test_known_errors_are_measured(shift: float, turn: float) -> None:
    noise = pose_noise(InMemory(disturbed(shift, turn)))
    assert noise is not None
    assert noise.translation_m == pytest.approx(shift, rel=0.4, abs=0.008)
    assert noise.rotation_deg == pytest.approx(turn, rel=0.4, abs=0.05)
    assert noise.frames == 24


def test_the_meter_measures_while_scans_pass() -> None:
    scans, meter = disturbed(0.03, 0.1), PoseNoiseMeter(24)
    for position, scan in enumerate(scans):
        meter.add(position, scan)
    assert meter.result() == pose_noise(InMemory(scans))


def test_too_few_planes_give_no_figure() -> None:
    assert pose_noise(InMemory(SCANS[:3])) is None
    assert (
        pose_noise(
            InMemory(
                [
                    moved(Scan(k, scan.points[:40], scan.T_world_sensor), np.eye(4))
                    for k, scan in enumerate(SCANS)
                ]
            )
        )
        is None
    )
    empty = [Scan(k, np.empty((0, 3), np.float32), np.eye(4)) for k in range(9)]
    assert pose_noise(InMemory(empty)) is None

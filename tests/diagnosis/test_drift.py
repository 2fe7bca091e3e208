"""Poses that drift slowly, by height, heading or position, are named with frames and metres.

Noisy ones are not.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from helpers.worlds import thinned

import dynaviz as dv
from dynaviz.arrays import F64
from dynaviz.contracts.scan import Scan
from dynaviz.diagnosis import Confidence, doctor, quick_check
from dynaviz.diagnosis.finding import Finding
from dynaviz.sources.drive import Drive
from dynaviz.testing import InMemory
from dynaviz.testing.world import SENSOR, crossing, moved, turn

FRAMES = 30
SCANS = thinned(crossing(FRAMES))  # 0.6 m per frame
BACK = [
    *SCANS[:24],
    *thinned(crossing(FRAMES, seed=1)[22::-1]),
]  # to a place 14 m away and the same way back


def lifted(metres: float) -> F64:
    return turn(0.0, 0.0, 0.0, metres)


def ramp(frame: int, first: int, last: int) -> float:
    """0 before the first frame, 1 after the last, linear between them."""
    return float(np.clip((frame - first) / (last - first), 0.0, 1.0))


DRIFTS: dict[str, Callable[[int], F64]] = {  # error of the pose of a frame: T_given_world
    "height": lambda k: lifted(0.3 * ramp(k, 2, 18)),
    "heading": lambda k: turn(2.0 * ramp(k, 0, FRAMES), 0.0, 0.0, 0.0),
    "along the way": lambda k: turn(0.0, 0.5 * ramp(k, 0, 20), 0.0, 0.0),
    "a bad stretch": lambda k: lifted(0.35 * (ramp(k, 12, 16) - ramp(k, 20, 24))),
    "a step of GPS": lambda k: turn(0.0, 0.2 * (k > 14), 0.25 * (k > 14), 0.2 * (k > 14)),
}


def findings(scans: list[Scan]) -> tuple[Finding, ...]:
    return doctor(InMemory(scans, "drive", SENSOR)).findings


@pytest.mark.parametrize(
    "kind", [pytest.param(k, marks=[] if k == "height" else pytest.mark.slow) for k in DRIFTS]
)
def test_drift_is_named(kind: str) -> None:
    """Scans are placed by the drifting poses, as a reader places scans of the sensor frame."""
    scans = [moved(scan, DRIFTS[kind](k)) for k, scan in enumerate(SCANS)]
    found = findings(scans)
    assert [finding.name for finding in found] == ["poses drift"], found
    assert found[0].confidence <= Confidence.LIKELY
    assert "--poses small-gicp" in found[0].fix
    if kind == "height":
        check_figures(found[0])


def check_figures(found: Finding) -> None:
    first, last = [int(word) for word in found.problem.split() if word.isdigit()][:2]
    true = 0.3 * (ramp(last, 2, 18) - ramp(first, 2, 18))
    metres = float(found.problem.split("drift by ")[1].split()[0])
    assert metres == pytest.approx(true, abs=0.05)
    assert {first, last} <= set(found.frames) or found.count > len(found.frames)


@pytest.mark.slow
def test_a_place_seen_again_later() -> None:
    """The drift is too slow to show on the way, but the sensor comes back to where it started."""
    scans = [moved(scan, lifted(0.25 * ramp(k, 0, len(BACK)))) for k, scan in enumerate(BACK)]
    scans = [Scan(k, s.points, s.T_world_sensor, None, s.labels) for k, s in enumerate(scans)]
    assert [finding.name for finding in findings(scans)] == ["poses drift"]


def test_a_standing_sensor_whose_poses_wander() -> None:
    still = [
        SCANS[0].points + np.random.default_rng(k).normal(0, 0.01, SCANS[0].points.shape)
        for k in range(FRAMES)
    ]
    T = SCANS[0].T_world_sensor
    scans = [moved(Scan(k, p, T), lifted(0.4 * ramp(k, 5, 25))) for k, p in enumerate(still)]
    assert [finding.name for finding in findings(scans)] == ["poses drift"]
    assert findings([Scan(k, p, T) for k, p in enumerate(still)]) == ()


def test_noise_of_poses_is_no_drift() -> None:
    noise = np.random.default_rng(3).normal(0, 0.03, (FRAMES, 3))
    scans = [moved(scan, turn(0.0, *noise[k])) for k, scan in enumerate(SCANS)]
    assert findings(scans) == ()


def test_quick_check_names_a_drift() -> None:
    scans = [moved(scan, lifted(0.5 * ramp(k, 0, FRAMES))) for k, scan in enumerate(SCANS)]
    assert [
        finding.name for finding in quick_check(Drive.of(InMemory(scans, "drive", SENSOR)))
    ] == ["poses drift"]
    assert quick_check(Drive.of(InMemory(SCANS, "drive", SENSOR))) == ()


def test_a_real_drive_with_poses_of_gps(real_data: Path) -> None:
    drive = dv.open(real_data / "kitti_tracking/training/velodyne/0011")
    assert [finding.name for finding in quick_check(Drive.of(drive))] == ["poses drift"]
    standing = dv.open(real_data / "kitti_tracking/training/velodyne/0012")
    assert quick_check(Drive.of(standing)) == ()

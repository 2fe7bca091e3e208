"""Findings on points that were measured while the sensor moved, with poses that jitter.

Units and axes of the world.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable

import numpy as np
import pytest
from helpers.worlds import thinned

import dynaviz as dv
from dynaviz.arrays import F64
from dynaviz.contracts.scan import Scan
from dynaviz.diagnosis import Confidence, doctor, quick_check
from dynaviz.sources.drive import Drive
from dynaviz.spatial import geometry
from dynaviz.testing import InMemory
from dynaviz.testing.world import SENSOR, crossing, moved

T_LIDAR_CAM = np.array([[0.0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
Y_UP = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])  # z-up to y-up
SCANS = thinned(crossing(8))


def placed(scan: Scan, points: F64, T: F64) -> Scan:
    return dataclasses.replace(
        scan, points=points.astype(np.float32), T_world_sensor=T, origins=None
    )


def local(scan: Scan) -> F64:
    return geometry.apply(geometry.inverse(scan.T_world_sensor), scan.points)


def far(T: F64, factor: float) -> F64:
    """The pose with its position in another unit."""
    T = T.copy()
    T[:3, 3] *= factor
    return T


def names(scans: list[Scan]) -> list[str]:
    return [finding.name for finding in doctor(InMemory(scans, "moving", SENSOR)).findings]


UNITS: dict[str, Callable[[Scan], Scan]] = {
    "everything": lambda s: placed(s, s.points * 1000.0, far(s.T_world_sensor, 1000)),
    "points in the sensor frame": lambda s: placed(
        s, geometry.apply(s.T_world_sensor, 1000 * local(s)), s.T_world_sensor
    ),
    "positions, with points placed by them": lambda s: placed(
        s, geometry.apply(far(s.T_world_sensor, 1000), local(s)), far(s.T_world_sensor, 1000)
    ),
}


@pytest.mark.parametrize("kind", UNITS)
def test_millimetres(kind: str) -> None:
    found = doctor(InMemory([UNITS[kind](scan) for scan in SCANS], "moving", SENSOR)).findings
    assert [(f.name, f.confidence) for f in found] == [("millimetres", Confidence.CERTAIN)], found
    assert "by 1000" in found[0].fix
    assert ("points" in found[0].fix) == ("positions" not in kind or kind == "everything")


@pytest.mark.parametrize(
    ("up", "T"),
    [
        ("y", Y_UP),
        ("-y", geometry.inverse(T_LIDAR_CAM)),
        pytest.param("-z", np.diag([1.0, -1, -1, 1]), marks=pytest.mark.slow),
    ],
)
def test_the_fix_of_a_world_that_is_not_z_up(up: str, T: F64) -> None:
    turned = [moved(scan, T) for scan in SCANS]
    found = doctor(InMemory(turned, "moving", SENSOR)).findings
    assert [finding.name for finding in found] == ["world not z-up"], found
    assert f"{up} axis" in found[0].problem
    rotation = np.eye(4)
    rotation[:3, :3] = json.loads(found[0].fix.split("R = ")[1].split(", write")[0])
    assert names([moved(scan, rotation) for scan in turned]) == []


@pytest.fixture(scope="module")
def drive() -> list[Scan]:
    """A drive with motion during the sweep, and jitter of the poses."""
    sequence = dv.open(
        "simulate:demo?sweep_s=0.1&jitter_m=0.03&jitter_deg=0.1&frames=20", frames="2:20", stride=2
    )
    return [sequence[k] for k in range(len(sequence))]


def test_a_sensor_that_moves_during_the_sweep_has_no_findings(drive: list[Scan]) -> None:
    found = doctor(InMemory(drive, "moving", SENSOR))
    assert not [finding for finding in found.findings if finding.name != "ground height"], found
    assert found.pose_noise is not None
    assert 0.02 < found.pose_noise.translation_m < 0.04
    assert 0.06 < found.pose_noise.rotation_deg < 0.13


@pytest.mark.parametrize(
    "position",
    [
        (345.0, 321.0, 120.0),
        pytest.param((0.0, 0.0, 120.0), marks=pytest.mark.slow),
        pytest.param((-2000.0, 300.0, -5.0), marks=pytest.mark.slow),
    ],
    ids=str,
)
def test_correct_poses_far_from_the_origin_have_no_findings(
    position: tuple[float, float, float], drive: list[Scan]
) -> None:
    """There, inverted poses place the sensor far from its cloud, which then hides nothing of
    itself.
    """
    T = geometry.pose(position, [1.0, 0.0, 0.0, 0.0])
    found = names([moved(scan, T) for scan in drive])
    assert not set(found) - {"ground height"}, found


FAULTS: dict[str, Callable[[F64], F64]] = {
    "poses inverted": geometry.inverse,
    "poses of a camera": lambda T: geometry.inverse(T_LIDAR_CAM) @ T @ T_LIDAR_CAM,
}


@pytest.mark.parametrize(
    "name", ["poses inverted", pytest.param("poses of a camera", marks=pytest.mark.slow)]
)
def test_wrong_poses_of_a_sensor_that_moves_during_the_sweep(name: str, drive: list[Scan]) -> None:
    wrong = [
        placed(s, geometry.apply(T, local(s)), T)
        for s in drive
        for T in [FAULTS[name](s.T_world_sensor)]
    ]
    assert names(wrong)[:1] == [name]
    assert quick_check(Drive.of(InMemory(wrong, "moving", SENSOR)))[0].name == name
    only = [placed(s, s.points.astype(np.float64), FAULTS[name](s.T_world_sensor)) for s in drive]
    assert names(only)[:1] == [name]


def test_jitter_of_a_slow_sensor_does_not_look_like_points_in_another_frame() -> None:
    """Without the poses, the scans of a sensor that hardly moves fit better than with poses that
    jitter.
    """
    noise = np.random.default_rng(3)
    scans = []
    for k in range(8):
        T = geometry.pose(noise.normal(0, 0.04, 3), [1.0, *noise.normal(0, 0.002, 3)])
        scans.append(dataclasses.replace(moved(crossing(1, seed=k)[0], T), index=k, stamp_ns=None))
    assert names(scans) == []


def test_quick_check_of_a_correct_sequence() -> None:
    assert quick_check(Drive.of(InMemory(SCANS, "moving", SENSOR))) == ()


def test_a_run_without_ground_truth_warns_of_wrong_poses() -> None:
    T = [geometry.inverse(scan.T_world_sensor) for scan in SCANS]
    wrong = [
        placed(s, geometry.apply(T[k], local(s)), T[k]).without_truth() for k, s in enumerate(SCANS)
    ]
    with pytest.warns(
        UserWarning, match=r"^moving: poses inverted: .*'dynaviz doctor' examines all frames$"
    ):
        found = dv.run(
            "octomap", InMemory(wrong, "moving", SENSOR), settings={"resolution": 0.5}, threads=1
        )
    labelled = [dataclasses.replace(scan, labels=np.zeros(len(scan), np.uint8)) for scan in wrong]
    again = dv.run(
        "octomap", InMemory(labelled, "moving", SENSOR), settings={"resolution": 0.5}, threads=1
    )
    assert found.labels_sha256 == again.labels_sha256

"""Free space: ground, obstacles, and the trails of movers."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from dynaviz.contracts.scan import Label, Scan
from dynaviz.synthetic.implants.space import SpaceAboveGround
from dynaviz.synthetic.implants.survey import Survey, part
from dynaviz.testing import InMemory

FRAMES = 12
GROUND = np.stack(np.meshgrid(np.arange(-8, 8, 0.1), np.arange(-8, 8, 0.1), [-1.7]), -1).reshape(
    -1, 3
)
BODY = np.stack(np.meshgrid([0.0, 0.1], [0.0, 0.1], np.arange(-1.2, 0, 0.2)), -1).reshape(-1, 3)
WALL, TRAIL, RARE = (5.0, 0.0), (0.0, 4.0), (-5.0, 0.0)


@pytest.fixture(scope="module")
def yard() -> InMemory:
    """A wall that is always seen, a mover that is at one place in frames 3 and 4, and a post seen
    in every other frame.

    All of them hide the ground that they stand on.
    """
    scans = []
    for frame in range(FRAMES):
        present = [WALL] + [TRAIL] * (frame in (3, 4)) + [RARE] * (frame % 2)
        away = np.min([np.hypot(*(GROUND[:, :2] - place).T) for place in present], axis=0)
        bodies = [BODY + np.append(place, 0) for place in present]
        points = np.concatenate([GROUND[away > 0.5], *bodies]).astype(np.float32)
        scans.append(Scan(frame, points, np.eye(4)))
    return InMemory(scans, "yard")


def clear(space: SpaceAboveGround, place: tuple[float, float]) -> float:
    return float(space.clear(np.array([place]))[0])


def test_the_trail_of_a_mover_is_free_at_other_times(yard: InMemory) -> None:
    space = SpaceAboveGround.of(Survey.of(yard))
    assert clear(space, TRAIL) > 1
    for frame in range(FRAMES):
        there = space.passed(part(frame, FRAMES))
        assert len(there) > 0 if frame in (3, 4) else not len(there)
        assert (np.hypot(*(there - TRAIL).T) < 0.4).all()


def test_what_is_seen_as_often_as_the_ground_blocks(yard: InMemory) -> None:
    space = SpaceAboveGround.of(Survey.of(yard))
    assert clear(space, WALL) <= 0
    assert clear(space, RARE) <= 0


def test_the_carrier_of_the_sensor_does_not_block_its_path(yard: InMemory) -> None:
    roof = np.float32([[0.3, 0.0, -1.0], [0.4, 0.0, -1.0]])
    carried = [
        dataclasses.replace(scan, points=np.concatenate([scan.points, roof])) for scan in yard.scans
    ]
    for nearest, blocked in ((0.1, True), (1.5, False)):
        sequence = InMemory(carried, "yard", dataclasses.replace(yard.sensor, min_range=nearest))
        assert (clear(SpaceAboveGround.of(Survey.of(sequence)), (0.3, 0.0)) <= 0) == blocked


def test_labelled_points_block_however_rarely_they_are_seen(yard: InMemory) -> None:
    labelled = [
        dataclasses.replace(scan, labels=np.zeros(len(scan), np.uint8)) for scan in yard.scans
    ]
    assert (
        clear(SpaceAboveGround.of(Survey.of(dataclasses.replace(yard, scans=labelled))), TRAIL) <= 0
    )


def test_points_without_a_label_are_a_trail_though_others_have_one(yard: InMemory) -> None:
    labelled = []
    for scan in yard.scans:
        labels = np.zeros(len(scan), np.uint8)
        labels[np.hypot(*(scan.points[:, :2] - TRAIL).T) < 0.4] = Label.UNLABELLED
        labelled.append(dataclasses.replace(scan, labels=labels))
    assert (
        clear(SpaceAboveGround.of(Survey.of(dataclasses.replace(yard, scans=labelled))), TRAIL) > 1
    )


def test_the_ground_does_not_block_though_poses_drift_in_height(yard: InMemory) -> None:
    drifted = []
    for scan in yard.scans:
        lift, T_world_sensor = np.float32([0, 0, 0.05 * scan.index]), np.eye(4)
        T_world_sensor[:3, 3] = lift
        drifted.append(
            dataclasses.replace(scan, points=scan.points + lift, T_world_sensor=T_world_sensor)
        )
    space = SpaceAboveGround.of(Survey.of(dataclasses.replace(yard, scans=drifted)))
    assert clear(space, (0.0, -4.0)) > 1
    assert clear(space, WALL) <= 0


def test_parts_of_a_long_recording_follow_one_another() -> None:
    bits = [int(part(frame, 1000)).bit_length() for frame in range(1000)]
    assert bits == sorted(bits)
    assert set(bits) == set(range(1, 65))
    assert [int(part(frame, 12)) for frame in range(3)] == [1, 2, 4]

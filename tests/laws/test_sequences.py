"""Laws of sequences: whatever a sequence is made of, it knows what its source knows.

Sequences are made of others in any order, several layers deep, 500 km from the origin. A model
follows what is done to them: which frames are left, and where their points lie by now.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

import dynaviz as dv
from dynaviz.arrays import F64, I64
from dynaviz.contracts.attributes import Attributes, Unposed
from dynaviz.contracts.scan import Label, Scan
from dynaviz.contracts.sensors import Sensor
from dynaviz.diagnosis import frame_groups
from dynaviz.runs.tiles.tile import TileFrames
from dynaviz.sources.datasets.drives import Drives
from dynaviz.sources.datasets.lidars import Lidars
from dynaviz.sources.drive import Drive
from dynaviz.sources.origin import PoseRefinement
from dynaviz.spatial.trajectory import Moved, PosesOverTime, Trajectory
from dynaviz.synthetic.implants.implant_scene import ImplantScene
from dynaviz.synthetic.implants.implanted_sequence import ImplantedSequence
from dynaviz.synthetic.implants.lidar_model import LidarModel, Mount

FRAMES = 5
POINTS = 90
FEW = 40  # points of a frame that the doctor compares
PLACE = np.array([500_000.0, 5_400_000.0, 0.0])
START = 1_700_000_000_000_000_000
STEP = 100_000_000  # nanoseconds between scans
UNPOSED = 7
NEARER = np.array([499_990.0, 5_399_990.0, 0.0])  # subtracted by estimated poses
ROUNDING = 3e-4  # metres; float32 coordinates within 3 km


@dataclass(frozen=True, eq=False)
class Survey:
    """A source that states all that a source can state.

    Its frames have the numbers 10, 12, 14 and so on.
    """

    name: str
    seed: int
    origin: F64
    sensor: Sensor = Sensor(name="survey", rings=8)  # noqa: RUF009  # it is frozen
    has_labels: bool = True

    def __len__(self) -> int:
        return FRAMES

    def number(self, row: int) -> int:
        return 10 + 2 * row

    def pose(self, row: int) -> F64:
        """T_world_sensor in the world of the source."""
        pose = np.eye(4)
        pose[:3, 3] = PLACE + np.array([3.0 * row + self.seed, 2.0 * row, 1.5])
        return pose

    def coordinates(self, position: int) -> F64:
        random = np.random.default_rng([self.seed, position])
        local = random.uniform(-20, 20, (POINTS, 3)).round(3)
        coordinates: F64 = self.pose(position)[:3, 3] + local
        return coordinates

    def attributes(self, position: int) -> Attributes:
        first = 1000 * (10 * self.seed + position)
        return {"number": np.arange(first, first + POINTS)}

    def unposed(self) -> Iterator[Unposed]:
        xyz = PLACE + np.arange(3.0 * UNPOSED).reshape(-1, 3)
        yield Unposed(UNPOSED, xyz, {"number": np.arange(UNPOSED)})

    @property
    def las_file(self) -> Path:
        return Path(f"{self.name}.laz")

    @property
    def facts(self) -> Mapping[str, str]:
        return {"lasers": "8"}

    @property
    def stamps(self) -> I64:
        return START + STEP * np.arange(FRAMES, dtype=np.int64) + self.seed

    @property
    def trajectories(self) -> Mapping[int, PosesOverTime]:
        poses = np.array([self.pose(row) for row in range(FRAMES)])
        return {0: Moved(Trajectory.of(self.stamps, poses), -self.origin)}

    def scan_file(self, index: int) -> Path:
        return Path(f"{self.name}/{index}.laz")

    def __getitem__(self, position: int) -> Scan:
        row = range(FRAMES)[position]
        pose = self.pose(row)
        pose[:3, 3] -= self.origin
        return Scan(
            self.number(row),
            (self.coordinates(row) - self.origin).astype(np.float32),
            pose,
            stamp_ns=int(self.stamps[row]),
            labels=np.full(POINTS, Label.STATIC, np.uint8),
        )


@dataclass(frozen=True)
class Frame:
    """A frame of a source: its row, which of its points are left, and whether the attributes are.

    ``exact`` is False for points that lie elsewhere by now.
    """

    source: Survey
    row: int
    step: int = 1
    attributes: bool = True
    exact: bool = True


@dataclass(frozen=True, eq=False)
class Expected:
    """What a sequence must know.

    ``shift``, (3,) metres, is added to all positions of the source by other poses. ``placed`` says
    whether the result is in the world frame of the source.
    """

    frames: tuple[Frame, ...]
    sensor: Sensor
    shift: F64
    labels: bool = True
    placed: bool = True
    facts: bool = True
    numbered: bool = False  # by position, because several sources use the same numbers
    trajectories: bool = True
    unposed: int = UNPOSED
    believed: bool = False  # poses and sensor are neither estimated nor checked


State = tuple[Drive, Expected]


def surveyed(name: str = "monday", seed: int = 0) -> State:
    origin = PLACE + np.array([1000.0 * seed, 0, 0])
    source = Survey(name, seed, origin)
    frames = tuple(Frame(source, row) for row in range(FRAMES))
    return Drive.of(source), Expected(frames, source.sensor, np.zeros(3))


def sliced(state: State, draw: Callable[[Any], Any]) -> State:
    sequence, expected = state
    first = draw(st.integers(0, len(sequence) - 1))
    stride = draw(st.integers(1, 2))
    frames = expected.frames[first::stride]
    unposed = expected.unposed if len(frames) == len(expected.frames) else 0
    kept = dataclasses.replace(expected, frames=frames, unposed=unposed)
    return sequence.select(f"{first}:", stride), kept


def other_sensor(state: State, draw: Callable[[Any], Any]) -> State:
    sensor = Sensor(name="other", rings=16)
    return state[0].with_sensor(sensor), dataclasses.replace(state[1], sensor=sensor)


def renamed(state: State, draw: Callable[[Any], Any]) -> State:
    return state[0].renamed("renamed"), state[1]


def blind(state: State, draw: Callable[[Any], Any]) -> State:
    return state[0].blind(), dataclasses.replace(state[1], labels=False)


def opened(state: State, draw: Callable[[Any], Any]) -> State:
    return dv.open(state[0]), state[1]


def read_by_one(state: State, draw: Callable[[Any], Any]) -> State:
    return state[0].for_threads(), state[1]


def moved(state: State, draw: Callable[[Any], Any]) -> State:
    """In a world frame with another origin: the place in the source is the same."""
    sequence, expected = state
    assume(expected.placed)
    return sequence.at(sequence.origin + np.array([512.0, -1024.0, 0.0])), expected


def few_points(state: State, draw: Callable[[Any], Any]) -> State:
    sequence, expected = state

    def thinned(frame: Frame) -> Frame:
        left = -(-POINTS // frame.step)
        return dataclasses.replace(frame, step=frame.step * -(-left // FEW))

    frames = tuple(map(thinned, expected.frames))
    return Drive.of(frame_groups.FewPoints(sequence, {})), dataclasses.replace(
        expected, frames=frames, labels=False
    )


def displaced(sequence: Drive, offset: F64) -> F64:
    poses = np.array([sequence[k].T_world_sensor for k in range(len(sequence))])
    poses[:, :3, 3] += offset
    return poses


def inexact(expected: Expected) -> tuple[Frame, ...]:
    return tuple(dataclasses.replace(frame, exact=False) for frame in expected.frames)


def estimated_poses(state: State, draw: Callable[[Any], Any]) -> State:
    """Poses in a world frame of their own, near its origin."""
    sequence, expected = state
    assume(expected.placed)
    poses = displaced(sequence, sequence.origin - NEARER)
    return sequence.with_poses(poses), dataclasses.replace(
        expected,
        frames=inexact(expected),
        shift=expected.shift - NEARER,
        placed=False,
        trajectories=False,
        believed=False,
    )


def refined_poses(state: State, draw: Callable[[Any], Any]) -> State:
    """Poses that differ by a little, in the same world frame."""
    sequence, expected = state
    offset = np.array([0.25, 0.0, 0.5])
    found = sequence.with_refined(displaced(sequence, offset), PoseRefinement(0, 0, 0, 0))
    return found, dataclasses.replace(
        expected,
        frames=inexact(expected),
        shift=expected.shift + offset,
        trajectories=False,
        believed=False,
    )


def after_another(state: State, draw: Callable[[Any], Any]) -> State:
    sequence, expected = state
    assume(expected.placed and not expected.shift.any())
    other, more = surveyed("tuesday", 1)
    drives = Drives.of([sequence.with_sensor(other.sensor), other])
    return Drive.of(drives), Expected(
        expected.frames + more.frames,
        other.sensor,
        np.zeros(3),
        facts=False,
        numbered=True,
        trajectories=False,
        unposed=expected.unposed + UNPOSED,
    )


def beside_another(state: State, draw: Callable[[Any], Any]) -> State:
    sequence, expected = state
    assume(expected.placed and not expected.shift.any() and not expected.numbered)
    other, more = surveyed("rear", 2)
    order = [(0, k) for k in range(len(sequence))] + [(1, k) for k in range(FRAMES)]
    both = Lidars((sequence, other), ("front", "rear"), np.array(order[::-1]))
    return Drive.of(both), dataclasses.replace(
        expected,
        frames=(expected.frames + more.frames)[::-1],
        labels=True,
        numbered=True,
        unposed=expected.unposed + UNPOSED,
        believed=False,
    )


def seen_by_a_tile(state: State, draw: Callable[[Any], Any]) -> State:
    sequence, expected = state
    offset = np.array([64.0, -128.0, 0.0])
    rows = np.arange(len(sequence))
    places = np.array([sequence[k].position for k in rows])
    numbers = np.array([sequence[k].index for k in rows])
    with_truth = draw(st.booleans())
    tile = TileFrames(sequence, rows, numbers, places, offset, with_truth)
    labels = expected.labels and with_truth
    return Drive.of(tile), dataclasses.replace(expected, labels=labels, unposed=0)


def with_implants(state: State, draw: Callable[[Any], Any]) -> State:
    sequence, expected = state
    lidar = LidarModel(0.0, 0.0, 0.0, 100.0, (Mount(np.eye(4), None),))
    scene = ImplantScene(0, 0.0, 0.0, False)
    frames = tuple(
        dataclasses.replace(frame, attributes=False, exact=False) for frame in expected.frames
    )
    found = ImplantedSequence(sequence, scene, lidar, "implanted")
    return Drive.of(found), dataclasses.replace(expected, frames=frames, labels=True, believed=True)


LAYERS = (
    sliced, other_sensor, renamed, blind, opened, read_by_one, moved, few_points, estimated_poses,
    refined_poses, after_another, beside_another, seen_by_a_tile, with_implants,
)  # fmt: skip


@pytest.fixture(autouse=True, scope="module")
def few() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(frame_groups, "POINTS", FEW)
        yield


@settings(max_examples=150)
@given(layers=st.lists(st.sampled_from(LAYERS), max_size=5), data=st.data())
def test_what_the_source_knows_passes_through_all_layers(
    layers: list[Callable[..., State]], data: st.DataObject
) -> None:
    state = surveyed()
    for layer in layers:
        state = layer(state, data.draw)
    check(*state)


@pytest.mark.parametrize("layer", LAYERS)
@settings(max_examples=3)
@given(data=st.data())
def test_each_layer_passes_on_what_the_source_knows(
    layer: Callable[..., State], data: st.DataObject
) -> None:
    check(*layer(surveyed(), data.draw))


def check(sequence: Drive, expected: Expected) -> None:
    """Compare a sequence with its model, in the coordinates of the source."""
    assert len(sequence) == len(expected.frames)
    assert sequence.has_labels == expected.labels
    assert sequence.sensor == expected.sensor
    assert sequence.exact == expected.believed
    origin = sequence.origin
    trajectories = sequence.trajectories
    for position, frame in enumerate(expected.frames):
        scan = sequence[position]
        source = frame.source
        xyz = source.coordinates(frame.row)[:: frame.step] + expected.shift
        number = position if expected.numbered else source.number(frame.row)
        assert scan.stamp_ns == source.stamps[frame.row]
        assert (scan.labels is not None) <= expected.labels
        np.testing.assert_allclose(scan.points.astype(np.float64) + origin, xyz, atol=ROUNDING)
        place = source.pose(frame.row)[:3, 3] + expected.shift
        np.testing.assert_allclose(scan.position + origin, place, atol=1e-6)
        np.testing.assert_allclose(scan.origins[0] + origin, place, atol=1e-6)
        attributes = sequence.attributes(position)
        if frame.attributes:
            known = source.attributes(frame.row)["number"][:: frame.step]
            np.testing.assert_array_equal(attributes["number"], known)
        assert all(len(each) == len(scan) for each in attributes.values())
        exact = sequence.exact_points(position, scan)
        if frame.exact:
            np.testing.assert_array_equal(sequence.coordinates(position), xyz)
            np.testing.assert_array_equal(exact, xyz)
        np.testing.assert_allclose(exact, xyz, atol=ROUNDING)
        if not expected.numbered or position == scan.index:
            file = Path(f"{source.name}/{source.number(frame.row)}.laz")
            assert sequence.scan_file(number) == file
        if expected.trajectories and len(trajectories) == 1:
            at = trajectories[0].at([int(source.stamps[frame.row])])[0]
            np.testing.assert_allclose(at[:3, 3] + origin, place, atol=1e-6)
    assert bool(trajectories) == expected.trajectories
    assert (sequence.las_file is not None) == expected.placed
    assert (sequence.facts.get("lasers") == "8") == expected.facts
    pieces = list(sequence.unposed())
    assert sum(each.number for each in pieces) == expected.unposed
    for each in pieces:
        assert (each.xyz is not None) == expected.placed
        assert len(each.attributes["number"]) == each.number

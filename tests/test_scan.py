"""Scans, outcomes, parts of sequences, and reading ahead."""

from __future__ import annotations

import threading
import time
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dynaviz.contracts.scan import Label, Outcome, Scan, Sequence, outcomes, stream
from dynaviz.contracts.sensors import Sensor
from dynaviz.errors import UsageError
from dynaviz.sources.drive import Drive


class Counting:
    """A sequence of empty scans that notes what is read, and may fail at a position."""

    name, sensor, has_labels = "counting", Sensor(), False

    def __init__(self, frames: int, fails_at: int | None = None):
        self.frames, self.fails_at, self.read = frames, fails_at, []  # type: ignore[var-annotated]

    def __len__(self) -> int:
        return self.frames

    def __getitem__(self, position: int) -> Scan:
        if not 0 <= position < self.frames:
            raise IndexError(position)
        self.read.append(position)
        if position == self.fails_at:
            raise OSError(f"frame {position}")
        return Scan(position, np.zeros((0, 3), np.float32), np.eye(4))


def readers() -> list[threading.Thread]:
    return [thread for thread in threading.enumerate() if thread.name == "read-ahead"]


def test_a_scans_arrays_cannot_be_changed() -> None:
    points = np.zeros((2, 3), np.float32)
    scan = Scan(0, points, np.eye(4), labels=np.zeros(2, np.uint8))
    for array in (scan.points, scan.T_world_sensor, scan.labels, scan.origins):
        assert array is not None
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1
    points[0] = 1  # the caller's own array stays free


@pytest.mark.parametrize(
    "wrong",
    [
        {"points": np.zeros((2, 4))},
        {"T_world_sensor": np.eye(3)},
        {"labels": np.zeros(3)},
        {"origins": np.zeros((3, 3))},
    ],
)
def test_shapes_that_do_not_fit_are_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=r"scan 7: .* has shape"):
        Scan(**{"index": 7, "points": np.zeros((2, 3)), "T_world_sensor": np.eye(4), **wrong})


def test_rays_start_at_the_sensor_unless_said_otherwise() -> None:
    T_world_sensor = np.eye(4)
    T_world_sensor[:3, 3] = 1, 2, 3
    scan = Scan(0, np.zeros((2, 3), np.float32), T_world_sensor)
    np.testing.assert_array_equal(scan.origins, [[1, 2, 3]])
    np.testing.assert_array_equal(scan.position, [1, 2, 3])
    per_point = Scan(0, scan.points, T_world_sensor, origins=np.ones((2, 3)))
    np.testing.assert_array_equal(per_point.origins, np.ones((2, 3)))


def test_squared_ranges_are_from_the_origin_of_each_ray() -> None:
    points = np.array([[13, 4, 0], [10, 0, 2], [np.nan, 0, 0]])
    pose = np.eye(4)
    pose[0, 3] = 10
    np.testing.assert_array_equal(
        Scan(0, points, pose).squared_ranges(), np.array([25, 4, np.nan], np.float32)
    )
    scan = Scan(0, points, pose, origins=np.array([[13, 0, 0], [10, 0, 0], [0, 0, 0]]))
    assert scan.squared_ranges(np.array([1, 0])).tolist() == [4, 16]
    assert scan.squared_ranges().dtype == np.float32


@pytest.mark.filterwarnings("error")
def test_the_squared_range_of_a_point_too_far_away_is_infinite() -> None:
    scan = Scan(0, np.array([[1e30, 0, 0]], np.float32), np.eye(4))
    assert scan.squared_ranges().tolist() == [np.inf]


def test_a_method_sees_no_truth() -> None:
    n = np.zeros(1, np.uint8)
    bare = Scan(0, np.zeros((1, 3)), np.eye(4), labels=n, classes=n, instances=n).without_truth()
    assert (bare.labels, bare.classes, bare.instances) == (None, None, None)


@given(st.lists(st.tuples(st.integers(0, 255), st.booleans())))
def test_outcomes_cross_truth_and_answer(pairs: list[tuple[int, bool]]) -> None:
    expected = {
        (Label.STATIC, False): Outcome.STATIC_KEPT,
        (Label.STATIC, True): Outcome.FALSE_POSITIVE,
        (Label.DYNAMIC, False): Outcome.FALSE_NEGATIVE,
        (Label.DYNAMIC, True): Outcome.DYNAMIC_REMOVED,
    }
    labels, dynamic = (
        np.array([p[0] for p in pairs], np.uint8),
        np.array([p[1] for p in pairs], np.bool_),
    )
    unlabelled = [
        Outcome.UNLABELLED_REMOVED if removed else Outcome.UNLABELLED_KEPT for _, removed in pairs
    ]
    known = [expected.get(pair, other) for pair, other in zip(pairs, unlabelled, strict=True)]  # type: ignore[call-overload]
    assert outcomes(labels, dynamic).tolist() == known
    assert outcomes(None, dynamic).tolist() == unlabelled


@given(st.integers(-12, 12) | st.none(), st.integers(-12, 12) | st.none(), st.integers(1, 5))
def test_selected_frames_are_a_slice(first: int | None, last: int | None, stride: int) -> None:
    sequence = Counting(10)
    expected = list(range(10))[first:last:stride]
    frames = f"{'' if first is None else first}:{'' if last is None else last}"
    if not expected:
        with pytest.raises(UsageError, match="selects none of the"):
            Drive.of(sequence).select(frames, stride)
        return
    chosen = Drive.of(sequence).select(frames, stride)
    assert isinstance(chosen, Sequence)
    assert [chosen[k].index for k in range(len(chosen))] == expected
    with pytest.raises(IndexError):
        chosen[len(chosen)]


def test_selecting_everything_leaves_all_frames() -> None:
    drive = Drive.of(Counting(3))
    assert len(drive.select()) == 3
    assert drive.select().provenance == drive.provenance


def test_another_sensor() -> None:
    sequence, other = Counting(3), Sensor(name="other")
    assert Drive.of(sequence).with_sensor(other).sensor is other
    assert len(Drive.of(sequence).with_sensor(other)) == 3


@pytest.mark.parametrize(
    ("frames", "stride"), [("5", 1), ("a:b", 1), ("1:2:3", 1), (None, 0), (None, -1), (":", 0)]
)
def test_an_invalid_range_is_an_error(frames: str | None, stride: int) -> None:
    with pytest.raises(UsageError, match="^frames=" if stride == 1 else "^stride="):
        Drive.of(Counting(10)).select(frames, stride)


@given(st.integers(0, 20), st.integers(1, 4))
def test_a_stream_yields_every_frame_once_in_order(frames: int, ahead: int) -> None:
    sequence = Counting(frames)
    assert [scan.index for scan in stream(sequence, ahead)] == list(range(frames)) == sequence.read


def test_a_read_error_is_raised_at_its_frame() -> None:
    scans = stream(Counting(10, fails_at=3))
    assert [next(scans).index for _ in range(3)] == [0, 1, 2]
    with pytest.raises(OSError, match="frame 3"):
        next(scans)
    assert not readers()


def test_leaving_early_stops_the_reader() -> None:
    sequence = Counting(1000)
    scans = stream(sequence, ahead=2)
    assert next(scans).index == 0
    assert readers()
    scans.close()  # type: ignore[attr-defined]
    assert not readers()
    assert len(sequence.read) <= 5


def test_the_reader_waits_for_the_consumer() -> None:
    sequence = Counting(1000)
    scans = stream(sequence, ahead=3)
    next(scans)
    time.sleep(0.05)
    assert len(sequence.read) <= 1 + 3 + 1  # in use, in the queue, and one waiting to enter it
    scans.close()  # type: ignore[attr-defined]

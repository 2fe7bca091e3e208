"""SeeThrough against a plain reference, and its properties.

Whole objects with their feet, even parked.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from helpers.worlds import pose
from hypothesis import given, settings
from hypothesis import strategies as st

from dynaviz import kernels
from dynaviz.blocks.blocks import Marks
from dynaviz.contracts.extent import Extent
from dynaviz.contracts.method import Context
from dynaviz.contracts.probe import MemoryProbe
from dynaviz.contracts.scan import Label, Scan
from dynaviz.contracts.sensors import Sensor, load_sensor
from dynaviz.spatial.scan_ground import ScanGround
from dynaviz.testing import crossing
from dynaviz_methods.seethrough import REASONS, REMOVED, SeeThrough, SeeThroughParams, history
from dynaviz_methods.seethrough.clear_grid import SENSORS, ClearGrid, _distinct
from dynaviz_methods.seethrough.level import Level
from dynaviz_methods.seethrough.method import (
    BY_PLACE,
    FOLLOWED,
    FOOT,
    HIGH,
    LOW,
    OUT_OF_REACH,
    SEEN_THROUGH,
    TOO_LITTLE,
    _spacing,
)

KERNELS = kernels.load("dynaviz_methods.seethrough.kernels")
SHARED = kernels.load("dynaviz_methods.shared.kernels")

pytestmark = pytest.mark.boundscheck


def running(
    scans: list[Scan], params: SeeThroughParams | None = None, **context: object
) -> SeeThrough:
    method = begun(scans, params, **context)
    for scan in scans:
        method.observe(scan)
    return method


def begun(
    scans: list[Scan], params: SeeThroughParams | None = None, **context: object
) -> SeeThrough:
    method = SeeThrough(params or SeeThroughParams())
    method.begin(Context(Extent.of(*scans), **context))  # type: ignore[arg-type]
    return method


def plane(low: float, high: float, step: float, z: float = 0.0) -> np.ndarray:
    x, y = (a.ravel() for a in np.meshgrid(np.arange(low, high, step), np.arange(low, high, step)))
    return np.stack([x, y, np.full(len(x), z)], 1)


def block(x: float, y: float, low: float = 0.0, high: float = 1.5, wide: float = 1.0) -> np.ndarray:
    """The front of a box, facing negative x, and its top."""
    along, up = np.meshgrid(np.arange(-wide / 2, wide / 2, 0.08), np.arange(low, high, 0.08))
    front = np.stack([np.full(along.size, x), y + along.ravel(), up.ravel()], 1)
    deep, across = np.meshgrid(np.arange(0, 1.5, 0.08), np.arange(-wide / 2, wide / 2, 0.08))
    return np.concatenate(
        [front, np.stack([x + deep.ravel(), y + across.ravel(), np.full(deep.size, high)], 1)]
    )


def wall(x: float = 14.0) -> np.ndarray:
    """A wall in the background, dense enough for rays through every voxel half way to it."""
    y, z = (a.ravel() for a in np.meshgrid(np.arange(-9, 9, 0.1), np.arange(0, 6, 0.1)))
    return np.stack([np.full(len(y), x), y, z], 1)


def seen(frame: int, *things: np.ndarray) -> Scan:
    """A scan from 1.8 m above the origin of objects that do not hide each other."""
    return Scan(frame, np.concatenate(things).astype(np.float32), pose(0.0, 0.0, 1.8))


GROUND = plane(-1, 13, 0.1)


def test_a_moving_object_is_removed_completely_and_static_objects_are_kept() -> None:
    places = np.linspace(-4, 4, 12)
    scans = [seen(k, GROUND, wall(), block(7.0, y), block(4.0, 6.0)) for k, y in enumerate(places)]
    method = running(scans)
    n, b = len(GROUND) + len(wall()), len(block(7.0, 0))
    for scan in scans:
        codes = method.label(scan).reasons
        moving = codes[n : n + b]
        high = scan.points[n : n + b, 2] > 0.4
        assert REMOVED[moving[high]].all()
        assert (moving[high] == SEEN_THROUGH).any()
        assert REMOVED[moving[scan.points[n : n + b, 2] > 0.2]].all(), (
            "feet are removed with their object"
        )
        assert not REMOVED[codes[:n]].any()
        assert not REMOVED[codes[n + b :]].any()


def test_a_car_that_arrives_and_parks_is_followed() -> None:
    places = [*(2.0 - 6.0 * np.linspace(1.0, 0.0, 24) ** 2), *[2.0] * 78]  # it brakes
    scans = [seen(k, GROUND, wall(), block(7.0, y)) for k, y in enumerate(places)]
    method = running(scans)
    n = len(GROUND) + len(wall())
    reasons = [method.label(scan).reasons[n:] for scan in scans]
    high = [scan.points[n:, 2] > 0.25 for scan in scans]
    assert all(REMOVED[codes[up]].all() for codes, up in zip(reasons, high, strict=True))
    assert (reasons[-1] == FOLLOWED).sum() > 100, (
        "it hit some places more often than they were clear"
    )
    always = running(scans[24:])
    assert not any(always.label(scan).dynamic.any() for scan in scans[24:]), (
        "an object that never moves is kept"
    )


def test_a_car_that_parks_where_no_ray_passed_is_followed() -> None:
    """Nothing behind the left half returns rays: all that is known is that the car drove there."""
    background = np.concatenate([GROUND, wall()])
    background = background[(background[:, 0] < 7.0) | (background[:, 1] < 0.05 * background[:, 0])]
    places = [*np.arange(-4.0, 2.0, 0.4), *[2.0] * 60]
    scans = [seen(k, background, block(7.0, y), block(4.0, 6.0)) for k, y in enumerate(places)]
    method, n, b = running(scans), len(background), len(block(7.0, 0))
    parked = running(scans[15:])
    for scan in scans[15::15]:
        codes, high = method.label(scan).reasons, scan.points[n : n + b, 2] > 0.25
        assert (codes[n : n + b][high] == FOLLOWED).all()
        assert not REMOVED[codes[n + b :]].any()
        assert not parked.label(scan).dynamic.any(), "these scans do not show it arrive"


def test_a_parked_car_that_drives_off_is_followed_back() -> None:
    places = [*[-2.0] * 60, *np.linspace(-1.6, 1.6, 9)]
    scans = [
        seen(k, GROUND, wall(), block(7.0, y, wide=4.0), block(4.0, 6.0))
        for k, y in enumerate(places)
    ]
    method, alone, followed = running(scans), running(scans[:60]), 0
    n, b = len(GROUND) + len(wall()), len(block(7.0, 0, wide=4.0))
    for scan in scans[:60:6]:
        codes, high = method.label(scan).reasons, scan.points[n : n + b, 2] > 0.4
        away = scan.points[n : n + b, 1] < -1.0
        assert REMOVED[codes[n : n + b][high & away]].mean() > 0.85
        assert not REMOVED[codes[n + b :]].any()
        assert not alone.label(scan).dynamic.any(), "it has not moved in these scans"
        followed += (codes[n : n + b] == FOLLOWED).sum()
    assert followed > 0, "the voxels of some places were seen clear too rarely"


@pytest.mark.parametrize("sigma", [0.0, 0.02])
def test_an_object_that_moves_by_less_than_half_its_length_has_moved(sigma: float) -> None:
    """Of a long vehicle, nothing but its ends is ever seen clear."""
    places = [*[-0.4] * 12, *np.linspace(-0.4, 0.4, 5), *[0.4] * 12]
    random = np.random.default_rng(0)
    long, waiting = block(7.0, 0.0, wide=4.0), block(6.0, 6.0)
    scans = [
        seen(k, GROUND, wall(), long + np.array([0, y, 0]), waiting) for k, y in enumerate(places)
    ]
    jitter = random.normal(0, sigma, (len(scans), 3)) * (1, 1, 0)
    scans = [
        dataclasses.replace(s, points=s.points + j.astype(np.float32))
        for s, j in zip(scans, jitter, strict=True)
    ]
    method, n = running(scans), len(GROUND) + len(wall())
    for scan in scans[::4]:
        removed, high = method.label(scan).dynamic, scan.points[n : n + len(long), 2] > 0.3
        assert removed[n : n + len(long)][high].mean() > 0.99
        assert not removed[:n].any()
        assert not removed[n + len(long) :].any()


@pytest.mark.plain
@pytest.mark.parametrize(
    ("change", "found"),
    [
        ({}, True),
        ({"shift": -1.0}, True),
        ({"shift": 0.5}, False),  # the guard hides it
        ({"shift": 2.2}, True),  # more than half of its length
        ({"wider": 0.2}, True),
        ({"wider": 0.4}, False),  # someone stands next to it
        ({"new": False}, False),  # something was there before
        ({"old": False}, False),  # something is there since
        ({"dynamic": (False, True)}, True),
        ({"dynamic": (False, False)}, False),
        ({"steps": 1}, False),
        ({"least": 0.5}, False),  # from one of two earlier ones: no more than half
    ],
)
def test_an_object_has_moved_if_its_outline_has_and_one_of_its_ends_is_dynamic(
    change: dict[str, Any], found: bool
) -> None:
    """A vehicle of 4 m in the first scan, unknown in the second one, and displaced in the third.

    And something else.
    """
    case = {
        "shift": 1.0,
        "wider": 0.0,
        "new": True,
        "old": True,
        "dynamic": (True, True),
        "steps": 2,
        "least": 0.12,
    }
    case |= change
    ways = KERNELS.moves.WAYS
    outline = np.abs(ways) @ [2.0, 1.0]
    reach = np.array(
        [outline, outline, 2 * outline, outline + ways @ [case["shift"], 0.0], outline], np.float32
    )
    reach[3, 1] += case["wider"]
    x = np.arange(-1.75, 2.0, 0.5)
    after = x + case["shift"]
    ends = after[np.abs(after) > 2.0], x[np.abs(x - case["shift"]) > 2.0]
    nothing = np.empty(0)
    xs = [x, nothing if case["new"] else ends[0], x, after, nothing if case["old"] else ends[1]]
    centres = np.stack([np.arange(-4.75, 5.0, 0.5), np.zeros(20)], 1).astype(np.float32)

    def rows(xs: np.ndarray) -> np.ndarray:
        return np.abs(xs[:, None] - centres[:, 0]).argmin(1).astype(np.int32)

    evidence = np.full(len(centres), -0.1, np.float32)
    for end, dynamic in zip(ends, case["dynamic"], strict=True):
        evidence[rows(end)] = 0.1 if dynamic else -0.1
    tracks = np.array([0, 2, 3, 5]), np.arange(6), np.array([0, 1, 0, 0, 1]), 2
    of_places = (
        rows(np.concatenate(xs)),
        np.cumsum([0, *map(len, xs)]),
        evidence,
        np.zeros_like(evidence),
        0.5,
    )
    result = KERNELS.moves.moved(
        *tracks, reach, 0.3, case["steps"], case["least"], centres, *of_places
    )
    assert result.tolist() == [found, False, False, found, False]


def test_feet_stand_out_of_the_ground_of_their_own_scan() -> None:
    """An error of a pose lifts the ground of a scan above that of the map, but not its feet above
    its ground.
    """
    places = np.linspace(-4, 4, 12)
    lifted = GROUND + np.array([0, 0, 0.07])
    scans = [
        seen(k, lifted if k == 6 else GROUND, wall(), block(7.0, y)) for k, y in enumerate(places)
    ]
    removed = running(scans).label(scans[6]).dynamic[: len(GROUND)]
    assert removed.mean() < 0.005


def moved_pose(scan: Scan, lift: float, slope: float) -> Scan:
    """A scan whose pose is wrong: all of it, the sensor included, is lifted and tilted."""
    points = scan.points + np.outer(lift + slope * scan.points[:, 0], [0, 0, 1]).astype(np.float32)
    return Scan(scan.index, points, pose(0.0, 0.0, 1.8 + lift))


@pytest.mark.parametrize(("lift", "slope"), [(0.25, 0.0), (0.45, 0.0), (0.0, 0.03), (-0.4, -0.02)])
def test_errors_of_poses_in_height_and_tilt_do_no_harm(lift: float, slope: float) -> None:
    """Half of the scans do not agree with the others on the height of the road."""
    right = [seen(k, GROUND, wall(), block(7.0, y)) for k, y in enumerate(np.linspace(-4, 4, 12))]
    scans = [moved_pose(scan, lift, slope) if scan.index >= 6 else scan for scan in right]
    method, n = running(scans), len(GROUND) + len(wall())
    for scan in scans:
        removed = method.label(scan).dynamic
        assert removed[:n].mean() < 0.005
        assert removed[n:].mean() > 0.95


def test_a_little_ground_next_to_the_sensor_does_not_tilt_later_scans() -> None:
    """The first scans see a sloping surface of 3 x 3 m below the sensor, as one next to a vehicle.

    Then the road.
    """
    level, sensor, random = Level(3.0), np.zeros(3), np.random.default_rng(0)
    for reach, slope in [(1.6, 0.1)] * 2 + [(14.0, 0.0)] * 6:
        x, y = (axis.ravel() for axis in np.meshgrid(*[np.arange(-reach, reach, 0.1)] * 2))
        z = slope * x - 1.0 + random.normal(0, 0.02, len(x))
        found = level.error(
            ScanGround.of(np.stack([x, y, z], 1).astype(np.float32), sensor), sensor
        )
    assert np.abs(found[1:]).max() < 0.01
    assert abs(found[0]) < 0.1


def test_nothing_is_low_where_no_ground_is_known() -> None:
    scans = [seen(k, block(7.0, y, low=2.0, high=3.0)) for k, y in enumerate(np.linspace(-4, 4, 6))]
    assert not (running(scans).label(scans[2]).reasons == LOW).any()


@pytest.mark.plain
@given(st.integers(0, 2**32 - 1))
@settings(max_examples=10, deadline=None)
def test_the_evidence_of_places_is_the_mean_over_their_voxels(seed: int) -> None:
    random = np.random.default_rng(seed)
    hits, clear, grazed = (
        random.integers(0, most, (3, 512)).astype(np.uint16) for most in (6, 5, 4)
    )
    up = random.integers(0, 2**63, (3, 8)).astype(np.uint64)
    found = KERNELS.places.evidence(
        np.arange(-1, 12, dtype=np.int32), up, hits, clear, grazed, (0.3, 0.12, 3.0, 0.2)
    )
    assert found[0] == 0
    for place in range(12):
        total = summed = 0.0
        for voxel in range(512):
            x, y = voxel >> 6, voxel >> 3 & 7
            h, c, q = (int(of[place >> 2, voxel]) for of in (hits, clear, grazed))
            if (x >= 4, y >= 4) != (bool(place & 2), bool(place & 1)) or not int(
                up[place >> 2, x]
            ) >> (voxel & 63) & 1:
                continue
            against, others = 0.3 * q + 0.12 * h, h > 1 or c + q > 0
            empty = min(c / 3, 1) * (c - against) / (c + against) if c > against else None
            empty = 0.2 * (c - against) / (c + against + 1) if empty is None else empty
            summed, total = summed + h * (empty - 0.2) * others, total + h * others
        expected = summed / total * min(total / 3, 1) if total else 0.0
        assert found[place + 1] == pytest.approx(expected, abs=1e-5)


def test_the_certainty_of_an_object_is_the_mean_of_its_places() -> None:
    """A certain place and one with hits alone in one object.

    One that inherits what it lacks in another.
    """
    own, shared = (
        np.array([0.6, -0.1, -0.05, -0.2], np.float32),
        np.array([0.0, -1.0, 0.1, 0.0], np.float32),
    )
    places, begins = np.arange(4, dtype=np.int32), np.array([0, 2, 3, 4, 4])
    certain = KERNELS.places.certainties(places, begins, own, shared, 0.5, 1 / 3)
    mean = (1.0 * 2.0 - 0.3 * 1.3) / (2.0 + 1.3)
    np.testing.assert_allclose(certain, [mean, 0.0, -0.6, 0.0], atol=1e-6)


def test_a_place_shares_the_certainty_of_all_objects_that_were_there() -> None:
    visits = [
        (2, 0, 1.0),
        (5, 0, -0.5),
        (2, 1, -1.0),
        (5, 1, 0.25),
        (2, 2, 1.0),
    ]  # place, scan, certainty
    places, scans = (np.array([each[of] for each in visits], np.int32) for of in (0, 1))
    certain, numbers = np.array([each[2] for each in visits]), np.arange(3, dtype=np.int32)
    firsts = np.searchsorted(scans, np.arange(4))
    shared, source = KERNELS.places.share(firsts, numbers, places, np.arange(6), certain, 8)
    np.testing.assert_allclose(shared, [0, 0, 1 / 3, 0, 0, -0.125, 0, 0], atol=1e-6)
    assert source.tolist() == [-1, -1, 2, -1, -1, 1, -1, -1]


@pytest.mark.plain
@pytest.mark.parametrize(
    ("own", "shared", "reason"),
    [
        (0.1, 0.0, SEEN_THROUGH),
        (0.1, -1.0, SEEN_THROUGH),
        (-0.1, 0.3, FOLLOWED),
        (-0.1, 0.1, TOO_LITTLE),
    ],
)
def test_a_place_is_dynamic_by_itself_or_with_what_it_inherits(
    own: float, shared: float, reason: int
) -> None:
    clear = (np.full((1, 512), n, np.uint16) for n in (1, 3, 0))
    of_points = np.array([0]), np.array([2], np.uint8)
    of_places = np.ones(4, np.int32), np.float32([0, own]), np.float32([0, shared]), 0.5
    codes = KERNELS.places.outcomes(*of_points, *of_places, *clear, (0.5, 0.12, 3.0, 0.1), BY_PLACE)
    assert codes.tolist() == [reason]


@pytest.mark.parametrize(("number", "prior"), [(2, 0.0040625), (16, 0.0325), (70, 0.13)])
def test_the_prior_rises_with_the_scans(number: int, prior: float) -> None:
    places = np.linspace(-4, 4, number)
    labelled = running([seen(k, wall(), block(7.0, y)) for k, y in enumerate(places)])
    labelled.label(seen(0, wall(), block(7.0, places[0])))
    assert labelled._judged is not None
    assert labelled._judged.decision.weights == pytest.approx((0.35, 0.12, 4.0, prior))


def test_online_labels_are_those_of_a_recording_that_ends_with_the_scan() -> None:
    """A car drives off, another one parks: tracks and moves are known as soon as they are seen."""
    scans = [
        seen(k, GROUND, wall(), block(7.0, y), block(9.0, max(y, 0.5)))
        for k, y in enumerate(np.linspace(-4, 4, 12))
    ]
    online = begun(scans)
    for k in range(len(scans)):
        online.observe(scans[k])
        recorded = running(scans[: k + 1])
        recorded.label(scans[0])
        np.testing.assert_array_equal(
            online.label(scans[k]).reasons, recorded.label(scans[k]).reasons
        )


def test_online_the_objects_of_the_last_scans_decide_and_no_others_are_stored(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Scans are forgotten earlier than that, as in live use."""
    monkeypatch.setattr(history, "SCANS", 5)
    scans = [seen(k, GROUND, wall(), block(7.0, y)) for k, y in enumerate(np.linspace(-4, 4, 12))]
    forgetting, keeping = begun(scans), begun(scans)
    for k in range(len(scans)):
        forgetting.observe(scans[k])
        keeping.observe(scans[k])
        answers = [each.label(scans[k]).reasons for each in (forgetting, keeping)]
        np.testing.assert_array_equal(*answers)
        forgetting.forget(k - 1)
    assert sorted(forgetting._history._visits) == [7, 8, 9, 10, 11]
    assert len(keeping._history._visits) == len(scans)


def test_a_hit_guards_the_voxels_around_it_in_its_scan_and_in_the_next_one() -> None:
    """Rays cross the place of a point that is there in the first scan alone, on their way to a
    wall.
    """
    point, wall_behind = np.float32([[2.05, 0.05, 0.05]]), np.float32([[4.05, 0.05, 0.05]])
    grid, crossed = (
        ClearGrid(Extent.of(Scan(0, np.concatenate([point, wall_behind]), np.eye(4))), 0.1),
        [],
    )
    voxel = int(grid.locate(point)[0])
    for k, points in enumerate((point, wall_behind, wall_behind)):
        scan = Scan(k, points, np.eye(4))
        marks = grid.mark_once(scan, grid.locate(points))
        near = grid.near(marks, 3)
        rows = np.flatnonzero(marks.blocks == voxel >> 9)
        crossed.append(bool(near[rows[0], voxel >> 6 & 7] >> np.uint64(voxel & 63) & np.uint64(1)))
    assert crossed == [True, True, False]


@pytest.mark.plain
@pytest.mark.parametrize("back", [False, True])
@pytest.mark.parametrize(
    ("second", "third", "dynamic"),
    [
        ([1, 2, 3], [2, 3, 4], (True, True)),  # it moves on
        (
            [1, 2, 3, 4, 5, 6],
            [1, 2],
            (False, True),
        ),  # for one scan it is joined with something larger
        ([0], [0, 1, 2], (True, True)),  # for one scan most of it is hidden
        ([0], [0, 1], (True, False)),  # a third of it stays hidden: its track is lost
        ([3, 4, 5], [4, 5, 6], (False, False)),  # something else is next to it
    ],
)
def test_objects_continue_those_with_which_they_share_most(
    back: bool, second: list[int], third: list[int], dynamic: tuple[bool, bool]
) -> None:
    """A dynamic object moves to the columns 0 to 2 in the second scan.

    A static one is far away in all.
    """
    scans = [[1, 2, 3], [0, 1, 2], second, third]
    objects = [each for scan in (scans[::-1] if back else scans) for each in (scan, [9])]
    at, found = np.cumsum([0, *map(len, objects)]), np.zeros(8, np.bool_)
    found[6 if back else 0] = True
    KERNELS.tracks.follow(np.array([0, 2, 4, 6, 8]), at, np.concatenate(objects), 10, found, back)
    assert found[[6, 4, 2, 0] if back else [0, 2, 4, 6]].tolist() == [True, True, *dynamic]
    assert not found[1::2].any()


def followed(scans: list[list[list[int]]], dynamic: list[bool]) -> list[bool]:
    """Which objects are dynamic, those of all scans in turn: lists of their columns."""
    objects = [each for scan in scans for each in scan]
    firsts, at = (np.cumsum([0, *map(len, each)]) for each in (scans, objects))
    columns, found = np.concatenate(objects), np.array(dynamic)
    KERNELS.tracks.follow(firsts, at, columns, columns.max() + 1, found, False)
    return found.tolist()


@pytest.mark.plain
@pytest.mark.parametrize(("more", "dynamic"), [([], True), ([4, 5, 6, 7], False)])
def test_two_halves_of_an_object_continue_as_one(more: list[int], dynamic: bool) -> None:
    """What hid the middle of a car has gone; it may be joined with something static for a while."""
    halves = [[0, 1], [2, 3]]
    scans = [halves, halves, [[0, 1, 2, 3, *more]], [[0, 1, 2, 3]]]
    assert followed(scans, [True] * 4 + [False] * 2) == [True] * 4 + [dynamic, True]


@pytest.mark.plain
@pytest.mark.parametrize(("times", "dynamic"), [(1, False), (2, True)])
def test_fragments_tell_only_about_objects_of_which_they_showed_as_much(
    times: int, dynamic: bool
) -> None:
    """Far away, two columns of something were seen to move.

    Nearer, it grows into a car of four columns.
    """
    scans = [[[0, 1]]] * times + [[[0, 1, 2]], [[0, 1, 2, 3]]]
    found = followed(scans, [True] * times + [False] * 2)
    assert found == [True] * times + [dynamic] * 2


@pytest.mark.plain
@pytest.mark.parametrize(("apart", "dynamic"), [(False, True), (True, False)])
def test_errors_of_scans_apart_do_not_add_up(apart: bool, dynamic: bool) -> None:
    """Two columns look dynamic in two scans, in turn or with such between them in which they do
    not.
    """
    scans = [[[0, 1]]] * 4 + [[[0, 1, 2, 3]]]
    shown = [True, False, True, False] if apart else [True, True, False, False]
    assert followed(scans, [*shown, False]) == [True] * 4 + [dynamic]


@pytest.mark.plain
@pytest.mark.parametrize(("before", "dynamic"), [([], True), ([[2, 3]], False)])
def test_an_object_that_comes_into_view_is_followed_where_nothing_was_before(
    before: list[list[int]], dynamic: bool
) -> None:
    """Half of a car was hidden, or there is something static instead."""
    scans = [[[0, 1], *before], [[0, 1]], [[0, 1, 2, 3]]]
    assert followed(scans, [True, *[False] * len(before), True, False])[-1] == dynamic


@pytest.mark.plain
@pytest.mark.parametrize(("beside", "dynamic"), [([0], False), ([0, 3], False), ([0, 3, 4], True)])
def test_columns_in_which_a_static_object_no_larger_stands_carry_no_track(
    beside: list[int], dynamic: bool
) -> None:
    """What passes a post, such as dust around it, may be gone in the next scan.

    A wall is not taken for it.
    """
    scans = [[[0, 1], beside], [[0, 1], beside]]
    assert followed(scans, [True, False, False, False]) == [True, False, dynamic, False]


@pytest.mark.plain
def test_visits_of_an_object_whose_track_is_lost_for_a_scan_do_not_count_against_it() -> None:
    """A parked car is half hidden, so that it continues nothing, and comes into view."""
    assert followed([[[0, 1]], [[0, 1]], [[1, 2, 3]], [[0, 1, 2, 3]]], [True, True, False, False])[
        2:
    ] == [False, True]


@pytest.mark.plain
@pytest.mark.parametrize("arrives", [True, False])
def test_parts_of_a_dynamic_object_are_followed_where_its_track_came_before_anything_else(
    arrives: bool,
) -> None:
    """A car stops next to a post.

    Later something in front hides its middle, and it is seen in two parts.
    """
    arrival = [[[0, 1], [5, 6, 7, 8]], [[0, 1], [3, 4, 5, 6, 7]]] if arrives else [[[0, 1]]]
    scans = [*arrival, [[0, 1, 2, 3, 4, 5]], [[0, 1], [3, 4]], [[3, 4]]]
    before = [False, True] * 2 if arrives else [False]
    assert followed(scans, [*before, True, False, False, False]) == [
        *before,
        True,
        False,
        arrives,
        arrives,
    ]


def test_points_too_high_for_movers_are_kept() -> None:
    places = np.linspace(-4, 4, 12)
    scans = [
        seen(k, GROUND, wall(), block(7.0, y), block(7.0, y, low=4.8, high=5.6))
        for k, y in enumerate(places)
    ]
    codes = running(scans).label(scans[6]).reasons[len(GROUND) + len(wall()) + len(block(7.0, 0)) :]
    assert (codes == HIGH).all(), "even where they are seen clear"


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("online", [False, True])
def test_reflections_below_the_road_in_some_scans_change_no_label_above_it(
    online: bool, seed: int
) -> None:
    """A few or more than the ground itself, at any depth: cars are not too high for movers."""
    random = np.random.default_rng(seed)
    ground = np.concatenate([GROUND, plane(-20, 20, 0.5)])
    places = np.linspace(-4, 4, 12)
    scans = [seen(k, ground, wall(), block(7.0, y), block(4.0, 6.0)) for k, y in enumerate(places)]
    mirrored = plane(-28, 28, random.uniform(0.4, 0.9), -random.uniform(4.5, 6.5))
    mirrored = mirrored[random.random(len(mirrored)) < random.uniform(0.2, 1.0)]
    wet = set(random.permutation(np.arange(1, 12))[:6].tolist())
    reflected = [
        seen(k, scan.points, mirrored) if k in wet else scan for k, scan in enumerate(scans)
    ]

    def answers(scans: list[Scan]) -> list[np.ndarray]:
        method = begun(scans)
        if online:
            return [(method.observe(scan), method.label(scan).dynamic)[1] for scan in scans]
        for scan in scans:
            method.observe(scan)
        return [method.label(scan).dynamic for scan in scans]

    clean = answers(scans)
    found = answers(reflected)
    up = scans[0].points[:, 2] > 0.3
    assert sum(each.sum() for each in clean) > 1000
    for expected, each in zip(clean, found, strict=True):
        assert (each[: len(expected)] != expected)[up].mean() < 0.001


@pytest.mark.plain
@given(st.integers(0, 2**32 - 1), st.integers(0, 3))
@settings(max_examples=15)
def test_near_voxels_are_a_dilation(seed: int, times: int) -> None:
    from scipy import ndimage

    random = np.random.default_rng(seed)
    world = random.random((24, 24, 24)) < 0.002  # 3^3 blocks of 8^3
    points = ((np.argwhere(np.ones((24, 24, 24))) + 0.5) * 0.1).astype(np.float32)
    grid = ClearGrid(Extent.of(Scan(0, points, pose(0, 0, 0))), 0.1)
    voxels = grid.locate(points)
    bits = np.zeros((len(grid), 16), np.int64)
    hit = voxels[world.ravel()]
    np.bitwise_or.at(bits, (hit >> 9, 8 + (hit >> 6 & 7)), np.int64(1) << (hit & 63))
    near = grid.near(Marks(np.arange(len(grid), dtype=np.int32), bits), times)
    found = near[voxels >> 9, voxels >> 6 & 7] >> (voxels & 63).astype(np.uint64) & np.uint64(1)
    expected = ndimage.maximum_filter(world, 2 * times + 1, mode="constant").ravel()
    np.testing.assert_array_equal(found.astype(bool), expected)


@pytest.mark.plain
def test_counts_stop_at_their_maximum() -> None:
    most = SHARED.clearance.MOST
    blocks, bits, near = (
        np.zeros(1, np.int32),
        np.zeros((1, 16), np.int64),
        np.zeros((1, 8), np.uint64),
    )
    bits[0, 0], bits[0, 8] = 0b101111, 0b10001  # 0 and 4 are hit, 0 to 3 and 5 are crossed
    near[0, 0] = 0b01100
    hits, clear, grazed = (
        np.full((2, 512), full, np.uint16) for full in (most - 1, most - 1, most - 1)
    )
    hits[0, 0] = clear[0, 1] = grazed[0, 3] = most
    SHARED.clearance.count(blocks, bits, near, hits, clear, grazed)
    assert hits[0, :6].tolist() == [most, most - 1, most - 1, most - 1, most, most - 1]
    assert clear[0, :6].tolist() == [most - 1, most, most - 1, most - 1, most - 1, most]
    assert grazed[0, :6].tolist() == [most - 1, most - 1, most, most, most - 1, most - 1]


@pytest.mark.plain
@pytest.mark.parametrize("order", ["mixed", "runs", "empty"])
def test_distinct_origins_in_any_order(order: str) -> None:
    random = np.random.default_rng(0)
    which = {
        "mixed": random.integers(0, 3, 50),
        "runs": np.repeat([2, 0, 1, 0], 9),
        "empty": np.zeros(0, int),
    }[order]
    origins = random.normal(size=(3, 3))[which]
    places, rows = _distinct(origins)
    np.testing.assert_array_equal(places, np.unique(origins, axis=0))
    np.testing.assert_array_equal(places[rows], origins)


def test_a_scan_without_points_whose_points_have_their_own_origins_marks_nothing() -> None:
    nothing = Scan(0, np.empty((0, 3), np.float32), np.eye(4), origins=np.empty((0, 3)))
    grid = ClearGrid(Extent.of(Scan(0, wall(), np.eye(4))), 0.1, sensor=load_sensor("hdl64e"))
    assert len(grid.mark_once(nothing, grid.locate(nothing.points)).blocks) == 0


@pytest.mark.plain
def test_rays_begin_where_they_leave_those_to_voxels_near_their_end() -> None:
    random, scratch = np.random.default_rng(0), np.zeros((3, 8), np.int64)
    goals = random.permutation(3 * 512)[:300]
    index = np.stack([goals >> 6 & 7, goals >> 3 & 7, goals & 7], 1)
    cubes = [
        [(v >> 9, *at) for v, at in zip(goals, (index >> size).tolist(), strict=True)]
        for size in (1, 2, 3)
    ]
    begins = [
        (0.0, 0.25, 0.5, 1.0)[sum(cube[k] in cube[:k] for cube in cubes)] for k in range(len(goals))
    ]
    assert SHARED.clearance.begins(goals, scratch).tolist() == begins
    assert set(begins) == {0.0, 0.25, 0.5, 1.0}
    assert not scratch.any()


def test_few_origins_cast_the_same_rays_as_many() -> None:
    """The points are so sparse that hardly two of an origin are in one cube of voxels."""
    random = np.random.default_rng(0)
    points = random.uniform(-5, 5, (400, 3)).astype(np.float32)
    which = random.integers(0, SENSORS, 400)
    places = random.uniform(-1, 1, (SENSORS + 1, 3))
    places[SENSORS] = [40.0, 0.0, 0.0]  # the extra origin's ray crosses no block
    grid, marks = ClearGrid(Extent.of(Scan(0, points, pose(0, 0, 0))), 0.1), []
    for more in ([], [SENSORS]):
        ends = np.concatenate([points, np.full((len(more), 3), 50, np.float32)])
        scan = Scan(0, ends, pose(0, 0, 0), origins=places[np.append(which, more).astype(int)])
        found = grid.mark_once(scan, grid.locate(scan.points))
        marks.append(found.bits[np.argsort(found.blocks)])
    np.testing.assert_array_equal(*marks)


def joined(
    points: np.ndarray, chosen: np.ndarray, sensor: np.ndarray, voxel: float, angle: float
) -> np.ndarray:
    objects, keys, wider = KERNELS.objects.cells_of(points, chosen, sensor, voxel, angle)
    order = np.argsort(keys)
    count = KERNELS.objects.connect(objects, order, keys[order], wider)
    assert (objects[~chosen] == -1).all()
    assert set(objects[chosen]) == set(range(count))
    return objects


@pytest.mark.plain
@given(st.integers(0, 2**32 - 1), st.floats(0.05, 0.4), st.floats(0.0, 0.5))
@settings(max_examples=25)
def test_objects_are_connected_components(seed: int, voxel: float, angle: float) -> None:
    from scipy.sparse.csgraph import connected_components

    random = np.random.default_rng(seed)
    points = random.uniform(-6, 6, (random.integers(1, 200), 3)).astype(np.float32)
    chosen, sensor = random.random(len(points)) < 0.8, random.uniform(-3, 3, 2)
    objects = joined(points, chosen, sensor, voxel, angle)
    rows = np.flatnonzero(chosen)
    widest = angle * np.hypot(*(points[rows, :2].astype(np.float64) - sensor).T) / voxel
    cells = []  # of each point: the size of one of its cells, and the cell's place
    for row, most in zip(rows.tolist(), widest, strict=True):
        size = sum(2**each <= most for each in (1, 2, 3))
        border = 2 ** (size + 1)
        for of in (size, size + 1) if size < 3 and most >= border * (1 - angle) else (size,):
            edges = voxel * np.array([2**of, 2**of, 8])
            cells.append((row, of, *np.floor(points[row].astype(np.float64) / edges)))
    found = np.array(cells).reshape(-1, 5)
    adjacent = (abs(found[:, None, 2:] - found[:, 2:]) <= 1).all(2) & (
        found[:, None, 1] == found[:, 1]
    )
    _, names = connected_components(adjacent | (found[:, None, 0] == found[:, 0]))
    pairs = set(zip(objects[found[:, 0].astype(int)].tolist(), names.tolist(), strict=True))
    assert len(pairs) == len({mine for mine, _ in pairs}) == len({name for _, name in pairs})
    firsts = [np.flatnonzero(objects == k)[0] for k in range(objects.max(initial=-1) + 1)]
    assert firsts == sorted(firsts)


@pytest.mark.plain
@pytest.mark.parametrize(
    ("sensor", "degrees"),
    [
        (load_sensor("hdl64e"), 0.271),  # 26.8 / 63 degrees between rings, 0.1728 within
        (load_sensor("mid360"), 1.031),  # 20,000 points in 59 x 360 degrees
        (Sensor(rings=16, elevation=(-15.0, 15.0)), 0.632),
        (Sensor(rings=16), 0.2),
        (Sensor(elevation=(-15.0, 15.0)), 0.2),
        (Sensor(), 0.2),
    ],
)
def test_mean_angle_between_rays(sensor: Sensor, degrees: float) -> None:
    assert _spacing(sensor) == pytest.approx(degrees, abs=0.001)


@pytest.mark.plain
@pytest.mark.parametrize(
    ("distance", "apart", "count"), [(3, 0.25, 2), (3, 0.09, 1), (30, 0.35, 1), (30, 0.9, 2)]
)
def test_objects_are_joined_across_an_angle(distance: float, apart: float, count: int) -> None:
    points = np.array([[distance, 0, 1], [distance, apart, 1]], np.float32) + np.float32(0.01)
    assert joined(points, np.full(2, True), np.zeros(2), 0.1, 0.025).max() + 1 == count


@pytest.mark.plain
@pytest.mark.parametrize("angle", [0.01, 0.025, 0.06])
def test_objects_do_not_end_where_cells_become_wider(angle: float) -> None:
    along = np.arange(0.5, 80, 0.09)
    for direction in np.radians([0, 30, 45, 200]):
        line = np.stack(
            [along * np.cos(direction), along * np.sin(direction), np.ones_like(along)], 1
        )
        assert not joined(
            line.astype(np.float32), np.full(len(line), True), np.zeros(2), 0.1, angle
        ).any()


def test_labels_are_decided_once_and_repeated() -> None:
    scans = [scan.without_truth() for scan in crossing(10)]
    method = running(scans)
    first = [method.label(scan).dynamic for scan in scans]
    for scan, labels in reversed(list(zip(scans, first, strict=True))):
        again = method.label(scan)
        np.testing.assert_array_equal(again.dynamic, labels)
        np.testing.assert_array_equal(REMOVED[again.reasons], labels)


def test_states_show_clear_voxels_and_do_not_change_labels() -> None:
    scans = [scan.without_truth() for scan in crossing(8)]
    probe = MemoryProbe()
    watched, alone = running(scans, probe=probe), running(scans)
    for scan in scans:
        np.testing.assert_array_equal(watched.label(scan).reasons, alone.label(scan).reasons)
    clear = probe.values["clear"][-1]
    assert clear.values.min() >= 1
    assert clear.size == 0.1
    assert set(np.unique(probe.values["objects"][-1].classes)) >= {0, 1, 2}


def test_points_without_a_voxel_are_kept_with_their_own_reason() -> None:
    scans = [scan.without_truth() for scan in crossing(6)]
    odd = scans[2].points.copy()
    odd[:3] = [[np.nan, 0, 0], [4000, 0, 0], [0, np.inf, 0]]
    scans[2] = dataclasses.replace(scans[2], points=odd)
    method = SeeThrough(SeeThroughParams())
    method.begin(Context(Extent.of(*[s for k, s in enumerate(scans) if k != 2])))
    for scan in scans:
        method.observe(scan)
    given = method.label(scans[2])
    assert (given.reasons[:3] == OUT_OF_REACH).all()
    assert not given.dynamic[:3].any()


def test_most_of_the_crossing_is_labelled_correctly() -> None:
    scans = crossing(14)
    method = running([scan.without_truth() for scan in scans])
    kept = removed = static = dynamic = 0
    for scan in scans:
        answer, truth = method.label(scan).dynamic, scan.labels == Label.DYNAMIC
        kept, static = kept + (~answer & ~truth).sum(), static + (~truth).sum()
        removed, dynamic = removed + (answer & truth).sum(), dynamic + truth.sum()
    assert kept > 0.98 * static
    assert removed > 0.9 * dynamic


@pytest.mark.parametrize(
    ("values", "word"),
    [
        ({"resolution": 0.0}, "resolution"),
        ({"join_angle": -1.0}, "join_angle"),
        ({"join_angle": 90.0}, "join_angle"),
        ({"guard": 0.9}, "guard"),
        ({"votes": 0}, "votes"),
        ({"prior": 1.0}, "prior"),
        ({"near": -1.0}, "near"),
        ({"inherit": float("nan")}, "inherit"),
        ({"ground_height": float("nan")}, "ground_height"),
    ],
)
def test_invalid_parameters_are_rejected(values: dict[str, float], word: str) -> None:
    with pytest.raises(ValueError, match=word):
        SeeThroughParams(**values)  # type: ignore[arg-type]


def test_every_reason_belongs_to_one_label() -> None:
    assert all(reason.meaning.startswith(("kept", "removed")) for reason in REASONS)
    assert REMOVED[[SEEN_THROUGH, FOLLOWED, FOOT]].all()
    assert not REMOVED[[LOW, OUT_OF_REACH]].any()

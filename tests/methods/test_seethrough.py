"""SeeThrough against a plain reference, and its properties: whole objects with their feet, followed when parked."""

from __future__ import annotations

import dataclasses
import tracemalloc

import numpy as np
import pytest
from helpers.reference.seethrough import Reference
from helpers.worlds import pose
from hypothesis import given, settings
from hypothesis import strategies as st

from dynaviz import kernels
from dynaviz.blocks.blocks import Marks
from dynaviz.contracts.extent import Extent
from dynaviz.contracts.method import Context
from dynaviz.contracts.probe import MemoryProbe
from dynaviz.contracts.scan import Label, Scan
from dynaviz.testing import crossing
from dynaviz_methods import seethrough, staying, trails
from dynaviz_methods.clear_grid import RUNS, ClearGrid, _distinct, _runs
from dynaviz_methods.ground_height import GroundHeight
from dynaviz_methods.judgement import verdicts
from dynaviz_methods.seethrough import (
    ALWAYS,
    FOLLOWED_ON,
    FOOT,
    HIGH,
    LOW,
    OUT_OF_REACH,
    REASONS,
    REMOVED,
    SEEN_THROUGH,
    SETTLED,
    TOO_LITTLE,
    WAITED,
    SeeThrough,
    SeeThroughParams,
)

pytestmark = pytest.mark.boundscheck

COARSE = SeeThroughParams(resolution=0.4, guard=0.8, gap=0.9, ground_height=0.4)


def running(scans: list[Scan], params: SeeThroughParams | None = None, **context: object) -> SeeThrough:
    method = SeeThrough(params or SeeThroughParams())
    method.begin(Context(Extent.of(*scans), **context))  # type: ignore[arg-type]
    for scan in scans:
        method.observe(scan)
    return method


def plane(low: float, high: float, step: float, z: float = 0.0) -> np.ndarray:
    x, y = (a.ravel() for a in np.meshgrid(np.arange(low, high, step), np.arange(low, high, step)))
    return np.stack([x, y, np.full(len(x), z)], 1)


def block(x: float, y: float, low: float = 0.0, high: float = 1.5, wide: float = 1.0) -> np.ndarray:
    """The front of a box, facing negative x, and its top."""
    along, up = np.meshgrid(np.arange(-wide / 2, wide / 2, 0.08), np.arange(low, high, 0.08))
    front = np.stack([np.full(along.size, x), y + along.ravel(), up.ravel()], 1)
    deep, across = np.meshgrid(np.arange(0, 1.5, 0.08), np.arange(-wide / 2, wide / 2, 0.08))
    return np.concatenate([front, np.stack([x + deep.ravel(), y + across.ravel(), np.full(deep.size, high)], 1)])


def wall(x: float = 14.0) -> np.ndarray:
    """A wall in the background, dense enough for rays through every voxel half way to it."""
    y, z = (a.ravel() for a in np.meshgrid(np.arange(-9, 9, 0.1), np.arange(0, 6, 0.1)))
    return np.stack([np.full(len(y), x), y, z], 1)


def seen(frame: int, *things: np.ndarray) -> Scan:
    """A scan from 1.8 m above the origin of objects that do not hide each other."""
    return Scan(frame, np.concatenate(things).astype(np.float32), pose(0.0, 0.0, 1.8))


GROUND = plane(-1, 13, 0.1)


def touched_post(low: int = -1) -> list[Scan]:
    """A post that a walker touches and leaves; in scan ``low``, rays pass its upper half."""
    places = [*np.linspace(-4.0, 0.0, 12), *np.linspace(-0.4, -4.0, 10)]
    post = block(7.0, 1.1, high=1.7, wide=0.5)
    lower = post[post[:, 2] < 0.9]
    return [seen(k, GROUND, wall(), block(7.0, y), lower if k == low else post) for k, y in enumerate(places)]


def lifted(scans: list[Scan], metres: float, every: int) -> list[Scan]:
    """Scans of which some are lifted as a whole: errors of their poses."""
    up = np.array([0, 0, metres], np.float32)
    return [dataclasses.replace(s, points=s.points + up * (s.index % every == every - 1)) for s in scans]


WORLDS = {
    "crossing": (crossing(9), 7, TOO_LITTLE),
    "lifted": (lifted(crossing(9), 0.25, 3), 7, TOO_LITTLE),
    "longer": (crossing(14), 9, ALWAYS),
    "post": (touched_post(), 9, SETTLED),
    "post_seen_clear": (touched_post(3), 9, SETTLED),
}


@pytest.mark.parametrize("world", WORLDS)
def test_labels_match_the_reference(world: str, monkeypatch: pytest.MonkeyPatch) -> None:
    scans, step, expected_reason = WORLDS[world]
    for name, value in (("MANY", 2), ("LASTING", 3), ("LONG", 4), ("WIDE", 0.4)):  # the scans are thin, few and near
        monkeypatch.setattr(staying, name, value)
    for name, value in (("ALWAYS_FAR", 4), ("FAR", 0.0)):
        monkeypatch.setattr(seethrough, name, value)
    thin = [dataclasses.replace(scan, points=scan.points[::step], labels=None, origins=None) for scan in scans]
    reference, method = Reference(COARSE), running(thin, COARSE)
    for scan in thin:
        reference.observe(scan)
    expected = [reference.label(scan) for scan in thin]
    labels = [method.label(scan) for scan in thin]
    assert any((answer.reasons == expected_reason).any() for answer in labels)
    assert 50 < sum(map(np.sum, expected)) < 0.4 * sum(map(len, expected))
    differing = sum(int((a.dynamic != b).sum()) for a, b in zip(labels, expected, strict=True))
    assert differing <= 2, "only rays through corners of voxels may be traversed differently"


def test_a_moving_object_is_removed_completely_and_static_objects_are_kept() -> None:
    places = np.linspace(-4, 4, 12)
    scans = [seen(k, GROUND, wall(), block(7.0, y), block(4.0, 6.0)) for k, y in enumerate(places)]
    method = running(scans)
    n, b = len(GROUND) + len(wall()), len(block(7.0, 0))
    for scan in scans:
        codes = method.label(scan).reasons
        moving = codes[n : n + b]
        high = scan.points[n : n + b, 2] > 0.4
        assert np.isin(moving[high], SEEN_THROUGH).all()
        assert REMOVED[moving[scan.points[n : n + b, 2] > 0.2]].all(), "feet are removed with their object"
        assert not REMOVED[codes[:n]].any()
        assert not REMOVED[codes[n + b :]].any()


def test_a_car_that_arrives_and_parks_is_followed() -> None:
    places = [*np.linspace(-4.0, 2.0, 12), *[2.0] * 90]
    scans = [seen(k, GROUND, wall(), block(7.0, y)) for k, y in enumerate(places)]
    method = running(scans)
    n = len(GROUND) + len(wall())
    reasons = [method.label(scan).reasons[n:] for scan in scans]
    high = [scan.points[n:, 2] > 0.25 for scan in scans]
    assert all(REMOVED[codes[up]].all() for codes, up in zip(reasons, high, strict=True))
    assert (reasons[-1][high[-1]] == FOLLOWED_ON).all(), "it is parked for longer than its voxels were seen clear"
    always = running(scans[12:])
    assert not any(always.label(scan).dynamic.any() for scan in scans[12:]), "an object that never moves is kept"


def test_a_parked_car_that_drives_off_has_waited() -> None:
    places = [*[-2.0] * 60, *np.linspace(-1.6, 1.6, 9)]
    scans = [seen(k, GROUND, wall(), block(7.0, y, wide=4.0), block(4.0, 6.0)) for k, y in enumerate(places)]
    method, alone = running(scans), running(scans[:60])
    n, b = len(GROUND) + len(wall()), len(block(7.0, 0, wide=4.0))
    for scan in scans[:60:6]:
        codes, high = method.label(scan).reasons, scan.points[n : n + b, 2] > 0.4
        away = scan.points[n : n + b, 1] < -0.3
        waiting = codes[n : n + b]
        assert (waiting[high & away] == WAITED).all(), "its voxels were seen clear too rarely for a majority"
        assert (waiting[high & ~away] == SETTLED).all(), "in the last scan, the car is still there"
        assert not REMOVED[codes[n + b :]].any()
        assert not alone.label(scan).dynamic.any(), "it has not moved in these scans"


def test_a_pillar_beside_a_waiting_walker_is_not_followed() -> None:
    """Both share quarter columns while the walker passes; the pillar is hit before and after it was seen clear."""
    places = [*np.linspace(-4.0, 0.0, 12), *[0.0] * 30]
    pillar = block(7.6, 0.9, high=2.0, wide=0.5)
    hidden = {4, 5, 20, 21}  # scans whose rays miss the pillar, as noise and bad poses do
    scans = [seen(k, GROUND, wall(), block(7.0, y), *([] if k in hidden else [pillar])) for k, y in enumerate(places)]
    method, n = running(scans), len(GROUND) + len(wall()) + len(block(7.0, 0))
    for k in set(range(len(scans))) - hidden:
        codes = method.label(scans[k]).reasons[n:]
        assert not np.isin(codes, (FOLLOWED_ON, WAITED)).any()


def test_what_was_there_before_a_walker_came_is_not_followed(monkeypatch: pytest.MonkeyPatch) -> None:
    """A pillar that is seen clear only after its last hit, next to a walker who touches it and steps back."""
    places = [*[-4.0] * 32, *np.linspace(-4.0, 0.8, 12), 0.2, *[0.0] * 5]
    pillar = block(7.6, 1.3, high=2.0, wide=0.3)
    pillar = pillar[pillar[:, 0] == 7.6]
    last = len(places) - 1
    scans = [seen(k, GROUND, wall(), block(7.0, y), *([pillar] if k < last else [])) for k, y in enumerate(places)]
    n = len(GROUND) + len(wall()) + len(block(7.0, 0))
    followed = {}
    for before in (trails.BEFORE, trails.NEVER):
        monkeypatch.setattr(trails, "BEFORE", before)
        method = running(scans)
        codes = np.concatenate([method.label(scan).reasons[n:] for scan in scans[:last]])
        followed[before] = (codes == FOLLOWED_ON).sum()
    assert followed[trails.NEVER] > 0, "without the rule it is followed"
    assert followed[30] == 0


@pytest.mark.parametrize(
    ("proof", "between", "follows"), [(11, 5, True), (11, 6, False), (12, 14, True), (12, 15, False)]
)
def test_what_was_long_dynamic_follows_although_it_is_hit_again(proof: int, between: int, follows: bool) -> None:
    """100 points where one moved lately, 20 of them seen clear, some of these between two hits."""
    weighed = np.array([[n] for n in (100, 100, 5000, 20, 100, proof, 0, between, 0, 0)])
    waited, followed, seen = verdicts(weighed, votes=3, share=0.35)
    assert (waited[0], followed[0], seen[0]) == (False, follows, False)


@pytest.mark.parametrize(("scans", "leaves"), [(1, False), (3, True)])
def test_rarely_crossed_objects_have_not_waited(scans: int, leaves: bool) -> None:
    """100 points, hit in 39 scans; then some scans saw a fifth of their voxels clear, and a mover was there last."""
    vote = 1000 * scans * scans // 13
    weighed = np.array([[n] for n in (100, 100, 20 * vote, 20, 0, 0, 100, 0, 20, 0)])
    waited, followed, seen = verdicts(weighed, votes=3, share=0.35)
    assert (waited[0], followed[0], seen[0]) == (leaves, False, False)


def test_parts_of_a_dynamic_object_that_rays_stop_at_are_kept() -> None:
    places = np.linspace(-4.0, 4.0, 40)
    post = block(7.0, 5.1, high=0.9, wide=1.0)
    scans = [seen(k, GROUND, wall(), block(7.0, y), post) for k, y in enumerate(places)]
    method, n = running(scans), len(GROUND) + len(wall())
    codes = [method.label(scan).reasons[n:] for scan in scans]
    moving, static = codes[-1][: -len(post)], codes[-1][-len(post) :]
    away = (post[:, 2] > 0.25) & (post[:, 1] > 5.1)
    assert (static[away] == SETTLED).all(), "the post touches the mover in the last scan"
    assert REMOVED[moving].mean() > 0.9


def test_what_is_there_before_and_after_a_mover_touches_it_stays(monkeypatch: pytest.MonkeyPatch) -> None:
    """A post that a walker touches and leaves; evidence against its votes alone does not settle it."""
    monkeypatch.setattr(seethrough, "FIRM", 1e9)
    post, scans = block(7.0, 1.1, high=1.7, wide=0.5), touched_post()
    n, touching = len(GROUND) + len(wall()), 11
    removed, many = {}, staying.MANY
    for most in (many, 1 << 30):
        monkeypatch.setattr(staying, "MANY", most)
        method = running(scans)
        labels = [method.label(scan) for scan in scans]
        removed[most] = [
            codes.dynamic[n:][scan.points[n:, 2] > 0.25] for codes, scan in zip(labels, scans, strict=True)
        ]
    post_up = (post[:, 2] > 0.25).sum()
    kept, whole = removed[many][touching], removed[1 << 30][touching]
    assert whole[-post_up:].mean() > 0.9, "without the rule it is removed with the walker"
    assert kept[-post_up:].mean() < 0.1
    assert kept[:-post_up].all(), "the walker is removed"


def test_what_was_there_as_soon_as_it_could_be_seen_stays(monkeypatch: pytest.MonkeyPatch) -> None:
    """A post that a walker touches in the first scan, so that it is not known to have been there before."""
    monkeypatch.setattr(seethrough, "FIRM", 1e9)
    post, n = block(7.0, 1.1, high=1.7, wide=0.5), len(GROUND) + len(wall())
    scans = [seen(k, GROUND, wall(), block(7.0, y), post) for k, y in enumerate(np.linspace(0.0, -4.0, 12))]
    post_up = (post[:, 2] > 0.25).sum()
    removed = {}
    for share in (0.5, 2.0):
        monkeypatch.setattr(staying, "SINCE", share)
        removed[share] = running(scans).label(scans[0]).dynamic[n:][scans[0].points[n:, 2] > 0.25]
    assert removed[2.0][-post_up:].mean() > 0.9, "without the rule it is removed with the walker"
    assert removed[0.5][-post_up:].mean() < 0.1
    assert removed[0.5][:-post_up].all(), "the walker is removed"


@pytest.mark.parametrize(("distance", "first", "kept"), [(22.0, 0, True), (18.0, 0, False), (22.0, 6, False)])
def test_what_is_far_away_and_always_there_is_kept(distance: float, first: int, kept: bool) -> None:
    """A sign that every second scan misses, as with errors of poses; not if it came later than its surroundings."""
    sign, behind = block(distance, 0.0, low=1.0), wall(28.0)
    sign = sign[sign[:, 0] == np.float32(distance)]
    misses = [k % 2 == 1 or k < first for k in range(31)]
    ground = np.concatenate([GROUND, plane(-2, 2, 0.1) + np.array([distance, 0, 0])])
    scans = [seen(k, ground, behind, *([] if missed else [sign])) for k, missed in enumerate(misses)]
    codes = running(scans).label(scans[10]).reasons[-len(sign) :]
    assert (codes == ALWAYS).mean() > 0.9 if kept else REMOVED[codes].mean() > 0.9


def test_feet_stand_out_of_the_ground_of_their_own_scan() -> None:
    """An error of a pose lifts the ground of a scan above that of the map, but not its feet above its ground."""
    places = np.linspace(-4, 4, 12)
    lifted = GROUND + np.array([0, 0, 0.07])
    scans = [seen(k, lifted if k == 6 else GROUND, wall(), block(7.0, y)) for k, y in enumerate(places)]
    removed = running(scans).label(scans[6]).dynamic[: len(GROUND)]
    assert removed.mean() < 0.005


def test_an_error_of_a_pose_lifts_the_ground_far_away() -> None:
    """An error of 0.27 degrees lifts the ground at 50 m by 0.24 m; low points do not become objects."""
    far, lift = plane(0.0, 4.0, 0.2) + np.array([50.0, 0.0, 0.0]), np.array([0.0, 0.0, 0.24])
    scans = [seen(k, GROUND, wall(), far + lift if k == 4 else far) for k in range(8)]
    assert (running(scans).label(scans[4]).reasons[-len(far) :] == LOW).all()
    near = (np.linalg.norm(GROUND[:, :2], axis=1) < 5) & (GROUND[:, :2] > 0).all(1)  # less than what is right there
    scans[4] = seen(4, GROUND + lift * near[:, None], wall(), far)
    codes = running(scans).label(scans[4]).reasons[: len(GROUND)]
    assert (codes[near] != LOW).all(), "5 mm per metre at most"
    assert (codes[~near] == LOW).all()


def test_an_error_of_a_pose_lifts_the_whole_scan() -> None:
    """The ground does not become an object, which a walker would make dynamic."""
    scans = lifted([seen(k, GROUND, wall(), block(7.0, y)) for k, y in enumerate(np.linspace(-4, 4, 12))], 0.25, 7)
    removed = running(scans).label(scans[6]).dynamic
    assert removed[: len(GROUND)].mean() < 0.005
    assert removed[len(GROUND) + len(wall()) :].mean() > 0.95


def test_points_too_high_for_movers_are_kept() -> None:
    places = np.linspace(-4, 4, 12)
    scans = [seen(k, GROUND, wall(), block(7.0, y), block(7.0, y, low=4.8, high=5.6)) for k, y in enumerate(places)]
    codes = running(scans).label(scans[6]).reasons[len(GROUND) + len(wall()) + len(block(7.0, 0)) :]
    assert (codes == HIGH).all(), "even where they are seen clear"


def test_ground_under_a_roof_is_the_ground_next_to_it() -> None:
    around = GROUND[(np.abs(GROUND[:, 0] - 5) > 2) | (np.abs(GROUND[:, 1] - 5) > 2)]
    roof = plane(3.0, 7.0, 0.1, 1.4)
    points = np.concatenate([around, roof]).astype(np.float32)
    grid = ClearGrid(Extent.of(Scan(0, points, pose(0, 0, 1.8))), 0.1)
    ground, voxels = GroundHeight(grid.blocks, 0.1), grid.locate(points)
    ground.add(points, voxels)
    assert (ground.height(points, voxels, np.zeros(3))[len(around) :] > 0.5).all()


def test_without_known_ground_nothing_is_low_and_stray_returns_take_no_memory() -> None:
    points = np.concatenate([GROUND, [[3000.0, 2500.0, 1.0], [-3000.0, 0.0, 1.0]]]).astype(np.float32)
    grid = ClearGrid(Extent.of(Scan(0, points, pose(0, 0, 1.8))), 0.1)
    ground, voxels = GroundHeight(grid.blocks, 0.1), grid.locate(points)
    assert np.isinf(ground.height(points, voxels, np.zeros(3))).all()
    ground.add(points, voxels)
    tracemalloc.start()
    height = ground.height(points, voxels, np.zeros(3))
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert np.isinf(height[-2:]).all()
    assert np.abs(height[:-2]).max() < 0.2
    assert most < 150e6


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
    most = kernels.clearance.MOST
    blocks, bits, near = np.zeros(1, np.int32), np.zeros((1, 16), np.int64), np.zeros((1, 8), np.uint64)
    bits[0, 0], bits[0, 8] = 0b01111, 0b10001  # voxel 0 is hit, 1 to 3 are crossed, 4 is hit and crossed by none
    near[0, 0] = 0b01100
    hits, passed, grazed = (np.full((2, 512), full, np.uint16) for full in (most - 1, most - 1, 7))
    hits[0, 0] = passed[0, 3] = most
    counted = kernels.clearance.countable(blocks, bits, hits, passed)
    kernels.clearance.count(blocks, counted, near, hits, passed, grazed)
    assert hits[0, :5].tolist() == [most, most - 1, most - 1, most - 1, most]
    assert passed[0, :5].tolist() == [most - 1, most, most, most, most - 1]
    assert grazed[0, :5].tolist() == [7, 7, 8, 7, 7], "what is not counted as passed is not counted as grazed"


@pytest.mark.plain
@pytest.mark.parametrize("order", ["mixed", "runs", "empty"])
def test_distinct_origins_in_any_order(order: str) -> None:
    random = np.random.default_rng(0)
    which = {"mixed": random.integers(0, 3, 50), "runs": np.repeat([2, 0, 1, 0], 9), "empty": np.zeros(0, int)}[order]
    origins = random.normal(size=(3, 3))[which]
    places, rows = _distinct(origins)
    np.testing.assert_array_equal(places, np.unique(origins, axis=0))
    np.testing.assert_array_equal(places[rows], origins)


def test_few_runs_of_origins_cast_the_same_rays_as_many() -> None:
    random = np.random.default_rng(0)
    points = random.uniform(-5, 5, (400, 3)).astype(np.float32)
    which = np.repeat([0, 1, 0], [150, 150, 100])
    origins, mixed = np.array([[0.02, 0.03, 0.04], [1.3, -0.2, 0.5]]), random.permutation(400)
    grid, marks = ClearGrid(Extent.of(Scan(0, points, pose(0, 0, 0))), 0.1), []
    for order in (np.arange(400), mixed):
        assert (len(_runs(origins[which[order]])) > RUNS) == (order is mixed)
        scan = Scan(0, points[order], pose(0, 0, 0), origins=origins[which[order]])
        found = grid.mark_once(scan, grid.locate(scan.points))
        marks.append(found.bits[np.argsort(found.blocks)])
    np.testing.assert_array_equal(*marks)


@pytest.mark.plain
@given(st.integers(0, 2**32 - 1), st.floats(0.05, 2.0))
@settings(max_examples=25)
def test_objects_are_connected_components(seed: int, size: float) -> None:
    from scipy import ndimage

    random = np.random.default_rng(seed)
    points = random.uniform(-2, 2, (random.integers(0, 200), 3)).astype(np.float32)
    chosen = random.random(len(points)) < 0.8
    mine, n = kernels.objects.connect(points, chosen, size, 3 * size)
    cells = np.floor(points.astype(np.float64) / [size, size, 3 * size]).astype(int)
    assert (mine[~chosen] == -1).all()
    assert set(mine[chosen]) == set(range(n))
    if not chosen.any():
        return
    low = cells[chosen].min(0)
    picture = np.zeros(cells[chosen].max(0) - low + 1, bool)
    picture[tuple((cells[chosen] - low).T)] = True
    names, count = ndimage.label(picture, np.ones((3, 3, 3)))
    assert count == n
    pairs = set(zip(mine[chosen], names[tuple((cells[chosen] - low).T)], strict=True))
    assert len(pairs) == n
    firsts = [np.flatnonzero(mine == k)[0] for k in range(n)]
    assert firsts == sorted(firsts)


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
        ({"gap": -1.0}, "gap"),
        ({"gap": 0.003}, "gap"),
        ({"guard": 0.9}, "guard"),
        ({"votes": 0}, "votes"),
        ({"share": 1.0}, "share"),
        ({"ground_height": float("nan")}, "ground_height"),
    ],
)
def test_invalid_parameters_are_rejected(values: dict[str, float], word: str) -> None:
    with pytest.raises(ValueError, match=word):
        SeeThroughParams(**values)  # type: ignore[arg-type]


def test_every_reason_belongs_to_one_label() -> None:
    assert all(reason.meaning.startswith(("kept", "removed")) for reason in REASONS)
    assert REMOVED[[SEEN_THROUGH, FOLLOWED_ON, FOOT, WAITED]].all()
    assert not REMOVED[[LOW, OUT_OF_REACH]].any()

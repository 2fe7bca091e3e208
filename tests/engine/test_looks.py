"""Looks against a slow search of all returns, for sensors of several patterns."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import numpy as np
import pytest
from helpers.reference import looks as reference

import dynaviz as dv
from dynaviz import kernels
from dynaviz.contracts.looks import AROUND, MARGIN, AskedPlaces, CountedLooks, Look
from dynaviz.contracts.metric import Labelled
from dynaviz.contracts.scan import Scan
from dynaviz.engine.looks import LookTables

pytestmark = pytest.mark.boundscheck

SEQUENCES = (
    "simulate:street_vlp16?frames=8",
    "simulate:street_hdl64?frames=4",
    "simulate:hall_mid360?frames=6",
)


def unanswered(scan: Scan, frame: int = 0) -> Labelled:
    none = np.zeros(len(scan), np.bool_)
    return Labelled.of(frame, scan, none, none.astype(np.uint8))


def looks(scans: list[Scan], points: np.ndarray, frames: np.ndarray) -> CountedLooks:
    tables = LookTables()
    for frame, scan in enumerate(scans):
        tables.add(unanswered(scan, frame))
    points = np.ascontiguousarray(points, np.float32)
    return tables.seen(AskedPlaces(points, frames, np.arange(len(points)) % 3))


def sampled(scans: list[Scan], count: int) -> tuple[np.ndarray, np.ndarray]:
    """Points of scans, some moved off their surfaces, and their frames."""
    rng = np.random.default_rng(0)
    frames = np.sort(rng.integers(0, len(scans), count))
    points = np.stack([scans[f].points[rng.integers(len(scans[f]))] for f in frames])
    points[::3] += rng.normal(0, 0.5, (len(points[::3]), 3))
    return points.astype(np.float32), frames


def every_look(scans: list[Scan], points: np.ndarray, frames: np.ndarray) -> np.ndarray:
    """(scans, points) looks, of which grazing ones count as through."""
    tables = LookTables()
    for frame, scan in enumerate(scans):
        tables.add(unanswered(scan, frame))
    seen = tables.seen(AskedPlaces(points, frames, np.arange(len(points))))
    found = seen.by_frame.argmax(2).T.copy()
    found[found == Look.GRAZING] = Look.THROUGH
    return found


def test_looks_from_two_lidars_equal_those_of_a_slow_search(real_data: Path) -> None:
    scans = list(dv.open(real_data / "argoverse2"))
    points, frames = sampled(scans, 400)
    returns = [reference.Returns(scan) for scan in scans]
    assert min(len(each.parts) for each in returns) >= 2
    cap = returns[0].parts[0].spacing()
    codes = np.stack([each.look(points, cap)[0] for each in returns])
    expected = np.array([Look[name.upper()] for name in reference.NAMES])[codes]
    assert np.mean(every_look(scans, points, frames) == expected) >= 0.98


@pytest.mark.parametrize("name", [*SEQUENCES, "nuscenes"])
def test_looks_agree_with_the_prototype(name: str, shared: Path, real_data: Path) -> None:
    # It is cruder in three ways: all rays start at one origin, even those of two lidars (95 % of
    # looks agree there); rays at small angles to a surface are no kind of their own; and a return
    # at the sensor itself has a direction.
    path = shared / "prototypes/looks.py"
    if not path.is_file():
        pytest.skip(f"needs {path.name} in {path.parent.name}/ of the real data")
    spec = importlib.util.spec_from_file_location("prototype_of_looks", path)
    assert spec is not None
    assert spec.loader is not None
    prototype = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(prototype)
    sequence = dv.open(name if ":" in name else real_data / name)
    scans = [sequence[k] for k in range(min(len(sequence), 12))]
    points, frames = sampled(scans, 400)
    ways = prototype.Returns(scans[0])
    some = np.random.default_rng(0).choice(len(ways.ways), 2000)
    cap = 1.5 * float(np.median(ways.tree.query(ways.ways[some], k=4)[0][:, 3]))
    codes = prototype.looks(scans, points.astype(float), cap)
    expected = np.array([Look[each.upper()] for each in prototype.NAMES])[codes]
    assert np.mean(every_look(scans, points, frames) == expected) >= 0.98


@pytest.mark.parametrize("name", SEQUENCES)
def test_looks_equal_those_of_a_slow_search(name: str) -> None:
    sequence = dv.open(name)
    scans = [sequence[k] for k in range(len(sequence))]
    points, frames = sampled(scans, 300)
    seen = looks(scans, points, frames)
    returns = [reference.Returns(scan) for scan in scans]
    cap = returns[0].parts[0].spacing()
    codes = np.stack([each.look(points, cap)[0] for each in returns])
    expected = np.array([Look[name.upper()] for name in reference.NAMES])[codes]
    other = np.arange(len(scans))[:, None] != frames
    counts = np.stack([((expected == kind) & other).sum(0) for kind in Look], 1)
    counts[:, Look.THROUGH] += counts[:, Look.GRAZING]
    found = seen.counts.copy()
    found[:, Look.THROUGH] += found[:, Look.GRAZING]
    found[:, Look.GRAZING] = counts[:, Look.GRAZING] = 0
    assert np.abs(found - counts).sum() / 2 < 0.02 * other.sum()
    assert (found[:, : Look.BETWEEN].sum(0) > 20).sum() >= 3  # all kinds occur
    hit = (expected == Look.HIT) | ~other
    first = hit.argmax(0)
    last = len(scans) - 1 - hit[::-1].argmax(0)
    assert np.mean(first == seen.first_hit) > 0.95
    assert np.mean(last == seen.last_hit) > 0.95
    through = (expected == Look.THROUGH) & other
    before = np.array([through[: first[k], k].sum() for k in range(len(points))])
    after = np.array([through[last[k] + 1 :, k].sum() for k in range(len(points))])
    assert np.mean(before == seen.before) > 0.95
    assert np.mean(after == seen.after) > 0.95
    by_frame = np.stack([(expected == kind).sum(1) for kind in Look], 1)
    difference = np.abs(seen.by_frame.sum(0) - by_frame)[:, [Look.HIT, Look.HIDDEN]]
    assert difference.sum() < 0.02 * by_frame.sum()


def wall(x: float, rows: int = 40) -> np.ndarray:
    """Points of a dense upright wall at this distance."""
    side = np.linspace(-0.5, 0.5, 2 * rows)
    up = np.linspace(-0.25, 0.25, rows)
    y, z = (grid.ravel() * x for grid in np.meshgrid(side, up))
    return np.stack([np.full(len(y), x), y, z], 1)


def scan(points: np.ndarray, **fields) -> Scan:
    return Scan(0, np.asarray(points, np.float32), np.eye(4), **fields)


@pytest.mark.parametrize(
    ("place", "expected"),
    [
        ((10.0, 0, 0), Look.HIT),
        ((10.29, 0, 0), Look.HIT),
        ((9.71, 0, 0), Look.HIT),
        ((9.6, 0, 0), Look.THROUGH),
        ((10.4, 0, 0), Look.HIDDEN),
        ((5.0, 2.7, 0), Look.BETWEEN),  # 2 degrees beside the wall
        ((5.0, -4.0, 0), Look.OUTSIDE),
        ((-5.0, 0, 0), Look.OUTSIDE),
        ((5.0, 0, 5.0), Look.OUTSIDE),
    ],
)
def test_each_kind_of_look(place, expected) -> None:
    seen = looks([scan([place]), scan(wall(10))], np.array([place]), np.array([0]))
    assert seen.counts[0].tolist() == [int(kind == expected) for kind in Look]


@pytest.mark.parametrize(("slope", "expected"), [(0.2, Look.GRAZING), (0.6, Look.THROUGH)])
def test_a_ray_that_passes_a_surface_at_a_small_angle_is_grazing(slope, expected) -> None:
    x, y = (grid.ravel() for grid in np.meshgrid(np.arange(4, 6, 0.05), np.arange(-1, 1, 0.05)))
    floor = np.stack([x, y, slope * (x - 5)], 1)
    (seen,) = [looks([scan(floor), scan(wall(10, 80))], np.array([[5.0, 0, 0]]), np.array([0]))]
    assert seen.angle_known[0]
    assert seen.counts[0, expected] == 1


def test_each_ray_is_seen_from_its_own_origin() -> None:
    """Two lidars, of which only the second sees past the pillar."""
    pillar = wall(3) * [1, 0.2, 1]
    behind = wall(10)
    origins = np.repeat([[0.0, 0, 0], [0.0, 4, 0]], [len(pillar), len(behind)], axis=0)
    both = scan(np.concatenate([pillar, behind]), origins=origins)
    place = np.array([[6.0, 0, 0]])
    one = looks([scan(place), scan(pillar)], place, np.array([0]))
    two = looks([scan(place), both], place, np.array([0]))
    assert one.counts[0, Look.HIDDEN] == 1
    assert two.counts[0, Look.THROUGH] == 1


def test_looks_do_not_depend_on_the_number_of_threads() -> None:
    sequence = dv.open("simulate:street_vlp16?frames=6")
    scans = [sequence[k] for k in range(len(sequence))]
    points, frames = sampled(scans, 200)
    found = []
    for threads in (1, 2):
        before = kernels.threads_in_use()
        kernels.set_threads(threads)
        found.append(looks(scans, points, frames))
        kernels.set_threads(before)
    for name in CountedLooks.__slots__:
        np.testing.assert_array_equal(getattr(found[0], name), getattr(found[1], name))


def test_stored_directions_are_accurate() -> None:
    rng = np.random.default_rng(1)
    points = (rng.normal(size=(500, 3)) * 20).astype(np.float32)
    origin = np.array([1.0, 2.0, 3.0])
    stored = kernels.looks.table(kernels.as_readonly(points, np.float32), origin)
    back = kernels.looks.points_of(*stored, origin)
    away = np.linalg.norm(points - origin, axis=1)
    assert (np.linalg.norm(back - points, axis=1) < 3e-4 * away + 1e-4).mean() > 0.97


def test_distances_to_movers_are_measured_in_the_own_scan_and_in_any() -> None:
    place = np.array([[5.0, 0, 0]])
    near = scan([[5.0, 2.0, 0]], labels=np.ones(1, np.uint8))
    far = scan([*place, [5.0, 7.0, 0]], labels=np.array([0, 1], np.uint8))
    tables = LookTables()
    for frame, each in enumerate((far, near)):
        tables.add(unanswered(each, frame))
    asked = AskedPlaces(place.astype(np.float32), np.array([0]), np.array([-1]))
    seen = tables.seen(asked)
    assert seen.mover[0] == pytest.approx(7.0)
    assert seen.mover_ever[0] == pytest.approx(2.0, abs=0.35)
    assert (MARGIN, AROUND) == (0.3, 3.0)

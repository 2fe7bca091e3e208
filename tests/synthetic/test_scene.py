"""Scene files, schedules and options."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from dynaviz.contracts.scan import Scan
from dynaviz.errors import DataError, UsageError
from dynaviz.synthetic.implants.implant_options import ImplantOptions, parse
from dynaviz.synthetic.implants.implant_scene import Implant, ImplantScene
from dynaviz.synthetic.implants.implanted_sequence import ImplantedSequence
from dynaviz.synthetic.implants.paths import Path as MoverPath
from dynaviz.synthetic.implants.paths import paced
from dynaviz.synthetic.implants.schedule import cruise, park, pause, stand
from dynaviz.testing import InMemory

PATH = np.array([[0.0, 0, 0], [10, 0, 1], [20, 0, 2]])
CAR = Implant("car", 7, 3, PATH, np.array([[1.0, 0], [3, 20]]), 'says "hi"')
SCENE = ImplantScene(4, 0.02, 0.01, True, (CAR,), 10.0, 123, "drive")


def test_a_scene_file_round_trips(tmp_path: Path) -> None:
    file = tmp_path / "implants.toml"
    file.write_bytes(SCENE.to_toml())
    again = ImplantScene.load(file)
    assert again.to_toml() == SCENE.to_toml()
    assert (again.seed, again.start_ns, again.sequence, again.movers[0].note) == (
        4,
        123,
        "drive",
        'says "hi"',
    )
    np.testing.assert_array_equal(again.movers[0].path, PATH)


def test_a_planned_scene_gives_the_same_scans_from_its_file(
    street: InMemory, implanted: ImplantedSequence, tmp_path: Path
) -> None:
    file = tmp_path / "again.toml"
    file.write_bytes(implanted.scene.to_toml())
    again = ImplantedSequence.of(street, ImplantOptions(scene=str(file)))
    assert again.name == "street-again"
    for k in (0, 6):
        assert again[k].points.tobytes() == implanted[k].points.tobytes()
        assert again[k].instances.tobytes() == implanted[k].instances.tobytes()


def test_another_seed_gives_another_scene(street: InMemory, implanted: ImplantedSequence) -> None:
    other = ImplantedSequence.of(
        street, ImplantOptions(cars=0, trucks=0, cyclists=1, persons=1, parks=0, seed=4)
    )
    assert other.name == "street-implants-seed4"
    assert other.scene.movers[-1].path.tobytes() != implanted.scene.movers[-1].path.tobytes()


@pytest.mark.parametrize(
    ("old", "new", "problem"),
    [
        ("format = 1", "format = 9", "has format = 9, expected 1"),
        ("seed = 4\n", "", "is invalid: Object missing required field `seed`"),
        ("seed = 4", "seed = 4.5", "is invalid: Expected `int`, got `float` - at `$.seed`"),
        ("range_noise = 0.02", "range_noise = -1", "is invalid: Expected `float` >= 0"),
        (
            'kind = "car"',
            'kind = "ship"',
            "is invalid: Invalid enum value 'ship' - at `$.movers[0].kind`",
        ),
        ("[10.0, 0.0, 1.0]", "[0.0, 0.0, 1.0]", "path contains the same place twice"),
        ("[10.0, 0.0, 1.0]", "[10.0, 0.0]", "is invalid"),
        ("[3.0, 20.0]", "[0.5, 20.0]", "schedule must not decrease"),
        ("instance = 7", "instance = 0", "Expected `int` >= 1 - at `$.movers[0].instance`"),
        ("[[movers]]", "[[movers", "not valid TOML"),
    ],
)
def test_invalid_scene_files(tmp_path: Path, old: str, new: str, problem: str) -> None:
    file = tmp_path / "x.toml"
    text = SCENE.to_toml().decode()
    assert old in text
    file.write_text(text.replace(old, new))
    with pytest.raises(DataError) as error:
        ImplantScene.load(file)
    assert problem in str(error.value)
    assert "\n" not in str(error.value)


def test_time_of_a_scan() -> None:
    stamped, plain = (
        Scan(20, np.zeros((0, 3), np.float32), np.eye(4), stamp) for stamp in (2_000_000_123, None)
    )
    assert SCENE.time(stamped) == 2.0
    assert SCENE.time(plain) == 2.0  # 20 frames at 10 Hz


def test_a_mover_follows_its_path_and_the_slope() -> None:
    assert [CAR.distance(time) for time in (0.9, 1.0, 2.0, 3.0, 3.1)] == [None, 0, 10, 20, None]
    pose = CAR.pose(10.0)
    np.testing.assert_allclose(pose[:3, 3], (10, 0, 1))
    np.testing.assert_allclose(pose[:3, 0], np.array([1, 0, 0.1]) / np.sqrt(1.01), atol=1e-9)
    assert CAR.mesh(0.0) is None
    mesh = CAR.mesh(2.0)
    assert mesh is not None
    assert mesh.bounds[0, 2] > 0.5


def test_limbs_move_with_the_distance() -> None:
    person = Implant("person", 1, 3, PATH, np.array([[0.0, 0], [10, 14]]))
    first, second = (person.mesh(time) for time in (2.0, 2.25))
    assert first is not None
    assert second is not None
    step = second.vertices - first.vertices
    assert np.ptp(np.linalg.norm(step, axis=1)) > 0.1


def test_schedules_stop_where_and_when_they_should() -> None:
    steady = cruise(0, 50, 5, 20, 10)
    np.testing.assert_allclose(steady, [[6, 0], [16, 50]])
    stop = pause(0, 50, 5, 20, 10, 4, 2.5)
    at = np.interp([10, 12, 14], *stop.T)
    np.testing.assert_allclose(at, 20)
    assert (np.diff(stop, axis=0) >= 0).all()
    speed = np.diff(stop[:, 1]) / np.diff(stop[:, 0])
    assert speed.max() < 5.01
    assert np.interp(9, *stop.T) < 20 < np.interp(15, *stop.T)
    assert tuple(stop[-1]) == (pytest.approx(21), 50)
    parked = park(0, 30, 6, 5, 12, 2.5)
    np.testing.assert_allclose(np.interp([5, 8, 12], *parked.T), 30)
    assert parked[-1, 0] == 12
    assert parked[0, 1] == 0


def test_a_mover_that_stands_at_both_ends_of_its_path() -> None:
    knots = stand(30, 6, 10, 5, (0, 20), 2.5)
    assert np.interp(5, *knots.T) == pytest.approx(10, abs=0.01)
    assert (knots[0].tolist(), knots[-1].tolist()) == ([0, 0], [20, 30])
    assert np.interp([0.5, 19], *knots.T).tolist() == [0, 30]
    speed = np.diff(knots[:, 1]) / np.diff(knots[:, 0])
    assert speed.max() == pytest.approx(6, abs=0.05)
    assert (np.diff(stand(1, 8, 0.5, 5, (0, 20), 2.5), axis=0) >= 0).all()


def test_a_path_to_and_fro_turns_at_its_ends() -> None:
    path = MoverPath(np.column_stack([0.5 * np.arange(9), np.zeros(9)]), 6)
    long = paced(path, 10.0, 2.0)
    np.testing.assert_array_equal(long.xy[long.anchor], (3, 0))
    steps = np.hypot(*np.diff(long.xy, axis=0).T)
    assert steps.min() > 0.05
    assert steps[: long.anchor].sum() > 10
    assert steps[long.anchor :].sum() > 2
    assert long.xy[:, 0].min() == 0
    assert long.xy[:, 0].max() == 4
    assert np.abs(long.xy[:, 1]).max() <= 0.1


def test_a_short_way_still_stops_smoothly() -> None:
    for knots in (pause(0, 6, 10, 3, 5, 2, 2.0), park(0, 4, 10, 3, 9, 2.0)):
        assert (np.diff(knots, axis=0) >= 0).all()
        assert knots[0, 1] == 0


def test_queries_are_parsed() -> None:
    path, options = parse(
        "kitti_tracking:/data/x "
        "y?cars=6&persons=0&seed=3&frames=0:50&stride=2&panel=a,b&scene=s%20t"
    )
    assert path == "kitti_tracking:/data/x y"
    assert options == ImplantOptions(
        cars=6, persons=0, seed=3, frames="0:50", stride=2, panel=("a", "b"), scene="s t"
    )
    assert parse("/data/x") == ("/data/x", ImplantOptions())


@pytest.mark.parametrize(
    ("query", "message"),
    [
        ("carz=3", "unknown option 'carz=3'. Did you mean 'cars'?"),
        ("cars", "unknown option 'cars'"),
        ("cars=x", "cars = 'x': give a whole number"),
        ("cars=1&cars=2", "cars is given twice"),
        ("cars=-1", "cars = -1: give 0 to 1000"),
        ("seed=-1", "give a seed from 0 to 2^32 - 1"),
        ("cars=0&trucks=0&cyclists=0&persons=0&parks=0", "no movers"),
    ],
)
def test_invalid_queries(query: str, message: str) -> None:
    with pytest.raises(UsageError) as error:
        parse(f"x?{query}")
    assert message in str(error.value)
    assert "\n" not in str(error.value)


def test_a_query_needs_a_sequence() -> None:
    with pytest.raises(UsageError, match="gives no sequence"):
        parse("?cars=3")

"""What a bench is to run: files, flags, and the mistakes in them."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import tomli_w
from hypothesis import given
from hypothesis import strategies as st

from dynaviz.benchmarking.plan import ParameterSet, settings, variant
from dynaviz.benchmarking.plan_file import KEYS, plan_of, read, values_of
from dynaviz.errors import DataError, UsageError

EXAMPLE = Path(__file__).resolve().parents[2] / "examples/bench.toml"
HALL = {"simulate": "hall_vlp16"}


def test_the_example_explains_every_key() -> None:
    plan = plan_of(read(EXAMPLE))
    assert plan.search
    assert plan.holdout
    explained = set(re.findall(r"^(?:# )?(\w+) = .+# \S", EXAMPLE.read_text(), re.M))
    tables = {"sequences", "variants", "grid", "search", "ranges"}
    assert {key for keys in KEYS.values() for key in keys} - tables <= explained


def test_paths_in_a_file_are_relative_to_it(tmp_path: Path) -> None:
    file = tmp_path / "bench.toml"
    file.write_text('methods = ["octomap"]\nsequences = ["a/b", "semantickitti:c", "/d", "simulate:demo:9"]\n')
    sources = plan_of(read(file)).sources
    assert [source.path for source in sources] == [f"{tmp_path}/a/b", f"semantickitti:{tmp_path}/c", "/d", ""]
    assert [source.name for source in sources] == ["b", "c", "d", "demo-9"]


def test_files_of_poses_are_relative_to_the_file_but_topics_are_none(tmp_path: Path) -> None:
    file = tmp_path / "bench.toml"
    (tmp_path / "a.tum").touch()
    entries = [
        {"path": "a", "poses": "a.tum", "points_in": "world"},
        {"path": "b.bag", "poses": "/odom", "deskew": False},
    ]
    file.write_text(tomli_w.dumps({"methods": ["octomap"], "sequences": entries}))
    a, b = plan_of(read(file)).sources
    assert (a.poses, a.points_in, a.deskew) == (f"{tmp_path}/a.tum", "world", None)
    assert (b.poses, b.points_in, b.deskew) == ("/odom", None, False)


@pytest.mark.parametrize("name", ["nuscenes/scene-0061", "training/0012", "drive.bag#/topic", "drive.bag"])
def test_what_is_held_out_may_be_part_of_what_a_path_holds(tmp_path: Path, name: str) -> None:
    table = {"methods": ["octomap"], "sequences": [HALL], "search": {"kind": "bayes", "trials": 1}}
    table["search"]["ranges"] = {"octomap": {"resolution": "0.1:0.2"}}
    path = str(tmp_path / name)
    with pytest.raises(UsageError, match="is no sequence, nor the name of one here: hall_vlp16"):
        plan_of({**table, "holdout": [path]})
    for folder in ("nuscenes/v1.0-mini", "training/oxts", "training/velodyne/0012"):
        (tmp_path / folder).mkdir(parents=True)
    for file in ("nuscenes/v1.0-mini/scene.json", "drive.bag"):
        (tmp_path / file).touch()
    assert plan_of({**table, "holdout": [path]}).sources[1].path == path


def test_a_sequence_of_the_bench_is_held_out_by_its_path_too(tmp_path: Path) -> None:
    table = {"methods": ["octomap"], "sequences": [HALL, str(tmp_path / "a")]}
    table["search"] = {"kind": "bayes", "trials": 1, "ranges": {"octomap": {"resolution": "0.1:0.2"}}}
    plan = plan_of({**table, "holdout": [str(tmp_path / "a")]})
    assert (len(plan.sources), plan.holdout) == (2, {"a"})


def test_methods_variants_and_grids_become_sets() -> None:
    table = {
        "methods": ["octomap"],
        "sequences": ["simulate:demo"],
        "variants": [
            {"method": "octomap", "preset": "av2"},
            {"method": "removert", "name": "few", "set": {"resolutions": [2.5]}, "online": True, "seed": 7},
        ],
        "grid": {"octomap_g": {"resolution": [0.1, 0.2], "cast_ground_rays": [True, False]}},
    }
    named = {(what.method, what.variant): what for what in plan_of(table).sets}
    assert list(named)[:3] == [("octomap", ""), ("octomap", "av2"), ("removert", "few")]
    assert named["octomap", "av2"].parameters["resolution"] == 0.2
    few = named["removert", "few"]
    assert (few.parameters["resolutions"], few.online, few.seed) == ((2.5,), True, 7)
    assert len(named) == 7
    assert named["octomap_g", "cast_ground_rays=false,resolution=0.1"].parameters["cast_ground_rays"] is False


def test_every_method_runs_where_none_is_named() -> None:
    methods = {what.method for what in plan_of({"sequences": [HALL]}).sets}
    assert {"octomap", "erasor", "dynablox"} <= methods


def test_a_broken_method_is_left_out_where_none_is_named(broken_plugins: None) -> None:
    with pytest.warns(UserWarning, match="method 'a_broken_one'"):
        methods = {what.method for what in plan_of({"sequences": [HALL]}).sets}
    assert "octomap" in methods
    assert "a_broken_one" not in methods


@pytest.mark.parametrize(
    ("table", "says"),
    [
        ({"method": ["octomap"]}, "unknown key 'method'. Did you mean 'methods'"),
        ({"methods": "octomap"}, "methods = 'octomap': give a value of type list"),
        ({"methods": ["octomapp"]}, "Did you mean 'octomap'"),
        ({"sequences": []}, "at least one sequence"),
        ({"sequences": [{"path": "a", "frame": "0:3"}]}, "[[sequences]] 1: unknown key 'frame'. Did you mean 'frames'"),
        ({"sequences": [{"name": "a"}]}, "either path or simulate"),
        ({"sequences": [{"simulate": "dmo"}]}, "Did you mean 'demo'"),
        ({"sequences": [{"simulate": "demo", "frames": "0:9"}]}, "takes a number of frames"),
        ({"sequences": ["simulate:demo:few"]}, "simulate:SCENE"),
        ({"sequences": [{"path": "a", "sensor": "eye"}]}, "eye"),
        ({"sequences": [{"path": "a", "seed": 1}]}, "seed is for a scene"),
        ({"sequences": [{"simulate": "demo", "poses": "a"}]}, "poses is for a sequence with a path"),
        ({"sequences": [{"path": "a", "name": "../a"}]}, "names no folder"),
        ({"sequences": [HALL, HALL]}, "two sequences are called 'hall_vlp16'"),
        ({"variants": [{"method": "octomap"}]}, "[[variants]] 1: give a method, and what is special"),
        ({"variants": [{"method": "octomap", "set": {"resolutoin": 1}}]}, "[[variants]] 1: octomap has no parameter"),
        ({"variants": [{"method": "octomap", "online": 1}]}, "type bool"),
        ({"grid": {"octomap": {"resolution": 0.1}}}, "[grid.octomap]: give each parameter a list"),
        ({"grid": {"octomap": {"resolution": [0.1, "x"]}}}, "[grid.octomap]: octomap.resolution = 'x'"),
        ({"grid": {"octomap": {"resolution": [-1]}}}, "give a number above 0"),
        ({"grid": {"octomap": {"resolution": [0.2, 0.2]}}}, "two variants are called 'octomap-resolution=0.2'"),
        ({"record": "eror"}, "record"),
        ({"workers": 0}, "at least 1"),
        ({"timing": True, "workers": 2}, "one cell at a time"),
        ({"holdout": ["hall_vlp16"]}, "at least one sequence that is not held out"),
        ({"holdout": ["nowhere"]}, "nowhere is no sequence"),
        ({"search": {"kind": "bayes"}}, "[search]: give trials"),
        ({"search": {"kind": "bays", "trials": 1}}, "Did you mean 'bayes'"),
        ({"search": {"kind": "bayes", "trials": 1, "seed": -1, "ranges": {"octomap": {}}}}, "seed = -1: give one of 0"),
        ({"search": {"kind": "bayes", "trials": 1, "ranges": {"octomap": "0.1:0.2"}}}, "METHOD.PARAM"),
    ],
)  # fmt: skip
def test_a_mistake_is_told_with_its_place(table: dict[str, object], says: str) -> None:
    with pytest.raises(UsageError) as told:
        plan_of({"sequences": [HALL], **table})
    assert says in str(told.value)
    assert "\n" not in str(told.value)


def test_a_file_that_is_none_is_named(tmp_path: Path) -> None:
    (tmp_path / "bench.toml").write_text("methods = [")
    for name in ("bench.toml", "absent.toml"):
        with pytest.raises(DataError, match=name):
            read(tmp_path / name)


def test_values_are_as_in_toml() -> None:
    assert values_of("0.05,1,true") == [0.05, 1, True]
    assert values_of("[2.5, 1.5], [2.0]") == [[2.5, 1.5], [2.0]]
    assert values_of("near, far") == ["near", "far"]


VALUES = st.dictionaries(
    st.sampled_from(["a", "b", "c"]),
    st.one_of(
        st.integers(-9, 9), st.floats(allow_nan=False, allow_infinity=False), st.booleans(), st.text("aé /", max_size=3)
    ),
    min_size=1,
)


@given(one=VALUES, other=VALUES)
def test_a_variant_is_named_after_its_values_and_fits_a_folder(
    one: dict[str, object], other: dict[str, object]
) -> None:
    name = variant(one)
    assert name == variant(dict(reversed(one.items())))
    assert len(name) <= 48
    assert not set(name) & set('/\\: "')
    assert (repr(sorted(one.items())) == repr(sorted(other.items()))) == (name == variant(other))


def test_settings_give_back_the_same_parameters() -> None:
    what = ParameterSet.of("removert", "", {"resolutions": [2.5, 1e-7]})
    assert ParameterSet.of("removert", "", what.parameters) == what
    assert "resolutions" in settings(what.parameters)[0]

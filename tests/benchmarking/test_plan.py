"""The plan of a bench: files, flags, and mistakes in them."""

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
    tables = {"sequences", "variants", "grid", "search", "ranges", "opening"}
    assert {key for keys in KEYS.values() for key in keys} - tables <= explained


def test_paths_in_a_file_are_relative_to_it(tmp_path: Path) -> None:
    file = tmp_path / "bench.toml"
    file.write_text(
        'methods = ["octomap"]\nsequences = ["a/b", "semantickitti:c", "/d", "simulate:demo:9"]\n'
    )
    sources = plan_of(read(file)).sources
    assert [source.path for source in sources] == [
        f"{tmp_path}/a/b",
        f"semantickitti:{tmp_path}/c",
        "/d",
        "",
    ]
    assert [source.name for source in sources] == ["b", "c", "d", "demo-9"]


def test_pose_files_are_relative_to_the_file_but_topics_are_not(tmp_path: Path) -> None:
    file = tmp_path / "bench.toml"
    (tmp_path / "a.tum").touch()
    entries = [
        {"path": "a", "poses": "a.tum", "points_in": "world"},
        {"path": "b.bag", "poses": "/odom", "deskew": False},
    ]
    file.write_text(tomli_w.dumps({"methods": ["octomap"], "sequences": entries}))
    a, b = (source.options for source in plan_of(read(file)).sources)
    assert (a.poses, a.points_in, a.deskew) == (f"{tmp_path}/a.tum", "world", None)
    assert (b.poses, b.points_in, b.deskew) == ("/odom", None, False)


@pytest.mark.parametrize(
    "name", ["nuscenes/scene-0061", "training/0012", "drive.bag#/topic", "drive.bag"]
)
def test_a_held_out_sequence_may_be_part_of_a_data_set(tmp_path: Path, name: str) -> None:
    table = {"methods": ["octomap"], "sequences": [HALL], "search": {"kind": "bayes", "trials": 1}}
    table["search"]["ranges"] = {"octomap": {"resolution": "0.1:0.2"}}
    path = str(tmp_path / name)
    with pytest.raises(
        UsageError, match="neither a sequence nor the name of one in this bench: hall_vlp16"
    ):
        plan_of({**table, "holdout": [path]})
    for folder in ("nuscenes/v1.0-mini", "training/oxts", "training/velodyne/0012"):
        (tmp_path / folder).mkdir(parents=True)
    for file in ("nuscenes/v1.0-mini/scene.json", "drive.bag"):
        (tmp_path / file).touch()
    assert plan_of({**table, "holdout": [path]}).sources[1].path == path


def test_a_sequence_of_the_bench_can_be_held_out_by_its_path(tmp_path: Path) -> None:
    table = {"methods": ["octomap"], "sequences": [HALL, str(tmp_path / "a")]}
    table["search"] = {
        "kind": "bayes",
        "trials": 1,
        "ranges": {"octomap": {"resolution": "0.1:0.2"}},
    }
    plan = plan_of({**table, "holdout": [str(tmp_path / "a")]})
    assert (len(plan.sources), plan.holdout) == (2, {"a"})


def test_methods_variants_and_grids_become_sets() -> None:
    table = {
        "methods": ["octomap"],
        "sequences": ["simulate:demo"],
        "variants": [
            {"method": "octomap", "preset": "av2"},
            {
                "method": "removert",
                "name": "few",
                "set": {"resolutions": [2.5]},
                "online": True,
                "seed": 7,
            },
        ],
        "grid": {"octomap_g": {"resolution": [0.1, 0.2], "cast_ground_rays": [True, False]}},
    }
    named = {
        (parameter_set.method, parameter_set.variant): parameter_set
        for parameter_set in plan_of(table).sets
    }
    assert list(named)[:3] == [("octomap", ""), ("octomap", "av2"), ("removert", "few")]
    assert named["octomap", "av2"].parameters["resolution"] == 0.2
    few = named["removert", "few"]
    assert (few.parameters["resolutions"], few.online, few.seed) == ((2.5,), True, 7)
    assert len(named) == 7
    assert (
        named["octomap_g", "cast_ground_rays=false,resolution=0.1"].parameters["cast_ground_rays"]
        is False
    )


def test_all_methods_run_by_default() -> None:
    methods = {parameter_set.method for parameter_set in plan_of({"sequences": [HALL]}).sets}
    assert {"octomap", "erasor", "dynablox"} <= methods


def test_a_broken_method_is_skipped_by_default(broken_plugins: None) -> None:
    with pytest.warns(UserWarning, match="method 'a_broken_one'"):
        methods = {parameter_set.method for parameter_set in plan_of({"sequences": [HALL]}).sets}
    assert "octomap" in methods
    assert "a_broken_one" not in methods


@pytest.mark.parametrize(
    ("table", "expected"),
    [
        ({"method": ["octomap"]}, "unknown key 'method'. Did you mean 'methods'"),
        ({"methods": "octomap"}, "methods = 'octomap': give a value of type list"),
        ({"methods": ["octomapp"]}, "Did you mean 'octomap'"),
        ({"sequences": []}, "at least one sequence"),
        (
            {"sequences": [{"path": "a", "frame": "0:3"}]},
            "[[sequences]] 1: unknown key 'frame'. Did you mean 'frames'",
        ),
        ({"sequences": [{"name": "a"}]}, "either path or simulate"),
        ({"sequences": [{"simulate": "dmo"}]}, "Did you mean 'demo'"),
        ({"sequences": [{"simulate": "demo", "frames": "0:9"}]}, "give the number of frames"),
        ({"sequences": ["simulate:demo:few"]}, "simulate:SCENE"),
        ({"sequences": [{"path": "a", "sensor": "eye"}]}, "eye"),
        ({"sequences": [{"path": "a", "seed": 1}]}, "seed applies to a simulated scene"),
        (
            {"sequences": [{"simulate": "demo", "poses": "a"}]},
            "poses applies to a sequence with a path",
        ),
        ({"sequences": [{"path": "a", "name": "../a"}]}, "not a valid folder name"),
        ({"sequences": [HALL, HALL]}, "two sequences have the name 'hall_vlp16'"),
        (
            {"variants": [{"method": "octomap"}]},
            "[[variants]] 1: give a method and at least one of",
        ),
        (
            {"variants": [{"method": "octomap", "set": {"resolutoin": 1}}]},
            "[[variants]] 1: octomap has no parameter",
        ),
        ({"variants": [{"method": "octomap", "online": 1}]}, "type bool"),
        ({"grid": {"octomap": {"resolution": 0.1}}}, "[grid.octomap]: give each parameter a list"),
        (
            {"grid": {"octomap": {"resolution": [0.1, "x"]}}},
            "[grid.octomap]: octomap.resolution = 'x'",
        ),
        ({"grid": {"octomap": {"resolution": [-1]}}}, "give a number above 0"),
        (
            {"grid": {"octomap": {"resolution": [0.2, 0.2]}}},
            "two variants have the name 'octomap-resolution=0.2'",
        ),
        ({"record": "eror"}, "record"),
        ({"workers": 0}, "at least 1"),
        ({"timing": True, "workers": 2}, "one cell at a time"),
        ({"holdout": ["hall_vlp16"]}, "at least one sequence that is not held out"),
        ({"holdout": ["nowhere"]}, "nowhere is neither a sequence"),
        ({"search": {"kind": "bayes"}}, "[search]: give trials"),
        ({"search": {"kind": "bays", "trials": 1}}, "Did you mean 'bayes'"),
        (
            {"search": {"kind": "bayes", "trials": 1, "seed": -1, "ranges": {"octomap": {}}}},
            "seed = -1: give a seed",
        ),
        (
            {"search": {"kind": "bayes", "trials": 1, "ranges": {"octomap": "0.1:0.2"}}},
            "METHOD.PARAM",
        ),
    ],
)
def test_a_mistake_is_reported_with_its_place(table: dict[str, object], expected: str) -> None:
    with pytest.raises(UsageError) as error:
        plan_of({"sequences": [HALL], **table})
    assert expected in str(error.value)
    assert "\n" not in str(error.value)


def test_an_invalid_file_is_named(tmp_path: Path) -> None:
    (tmp_path / "bench.toml").write_text("methods = [")
    for name in ("bench.toml", "absent.toml"):
        with pytest.raises(DataError, match=name):
            read(tmp_path / name)


def test_values_follow_toml() -> None:
    assert values_of("0.05,1,true") == [0.05, 1, True]
    assert values_of("[2.5, 1.5], [2.0]") == [[2.5, 1.5], [2.0]]
    assert values_of("near, far") == ["near", "far"]


VALUES = st.dictionaries(
    st.sampled_from(["a", "b", "c"]),
    st.one_of(
        st.integers(-9, 9),
        st.floats(allow_nan=False, allow_infinity=False),
        st.booleans(),
        st.text("aé /", max_size=3),
    ),
    min_size=1,
)


@given(one=VALUES, other=VALUES)
def test_a_variant_is_named_after_its_values_with_a_valid_folder_name(
    one: dict[str, object], other: dict[str, object]
) -> None:
    name = variant(one)
    assert name == variant(dict(reversed(one.items())))
    assert len(name) <= 48
    assert not set(name) & set('/\\: "')
    assert (repr(sorted(one.items())) == repr(sorted(other.items()))) == (name == variant(other))


def test_settings_give_back_the_same_parameters() -> None:
    parameter_set = ParameterSet.of("removert", "", {"resolutions": [2.5, 1e-7]})
    assert ParameterSet.of("removert", "", parameter_set.parameters) == parameter_set
    assert "resolutions" in settings(parameter_set.parameters)[0]


def test_seeds_are_those_of_methods_and_scenes() -> None:
    table = {"methods": ["octomap"], "sequences": [HALL, {"path": "a"}], "seeds": [0, 3]}
    plan = plan_of(table)
    assert [(each.variant, each.seed) for each in plan.sets] == [("seed0", 0), ("seed3", 3)]
    assert [(each.name, each.seed) for each in plan.sources] == [
        ("hall_vlp16", 0),
        ("hall_vlp16-seed3", 3),
        ("a", 0),
    ]
    pairs = [(s.name, m.seed) for s in plan.sources for m in plan.sets if plan.pairs(s, m)]
    assert pairs == [("hall_vlp16", 0), ("hall_vlp16-seed3", 3), ("a", 0), ("a", 3)]
    one = plan_of({**table, "seeds": [3]})
    assert [(each.variant, each.seed) for each in one.sets] == [("", 3)]
    assert [each.seed for each in one.sources] == [3, 0]


@pytest.mark.parametrize(
    ("seeds", "problem"), [([1, 1], "each seed once"), (["a"], "whole numbers"), ([-1], "2^32 - 1")]
)
def test_wrong_seeds_are_named(seeds: list[object], problem: str) -> None:
    with pytest.raises(UsageError, match=re.escape(problem)):
        plan_of({"methods": ["octomap"], "sequences": [HALL], "seeds": seeds})

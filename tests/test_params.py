from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dynaviz.contracts import params, registry
from dynaviz.errors import DataError, UsageError


@dataclass(frozen=True)
class Params:
    resolution: float = 0.1
    rounds: int = 3
    strict: bool = False
    bands: tuple[float, ...] = (1.0, 2.0)

    def __post_init__(self) -> None:
        if self.resolution <= 0:
            raise ValueError(f"resolution = {self.resolution}: must be positive")


METHOD = SimpleNamespace(info=SimpleNamespace(name="toy"), Params=Params)


@pytest.fixture
def presets(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "city.toml"
    path.write_text("[toy]\nresolution = 0.2\nrounds = 5\n[other]\nfoo = 1\n")
    monkeypatch.setattr(params, "preset_files", lambda: {"city": [path]})


def test_each_value_knows_the_layer_that_set_it(presets: None, tmp_path: Path) -> None:
    file = tmp_path / "mine.toml"
    file.write_text("[toy]\nrounds = 7\nbands = [3, 4.5]\n")
    resolved = params.resolve(METHOD, "city", file, ["strict=true", "toy.resolution=1"])
    assert resolved.params == Params(1.0, 7, True, (3, 4.5))
    assert resolved.source == {
        "resolution": "--set",
        "rounds": str(file),
        "strict": "--set",
        "bands": str(file),
    }
    assert params.resolve(METHOD, "city").source["rounds"] == "preset city"
    assert set(params.resolve(METHOD).source.values()) == {"default"}


@pytest.mark.parametrize(
    ("setting", "expected"),
    [
        ("resolutoin=1", "Did you mean 'resolution'"),
        ("resolution", "KEY=VALUE"),
        ("resolution=wide", "type float"),
        ("rounds=true", "type int"),
        ("rounds=1.5", "type int"),
        ("strict=1", "type bool"),
        ("resolution=-1", "must be positive"),
    ],
)
def test_an_invalid_setting_says_what_to_do(setting: str, expected: str) -> None:
    with pytest.raises(UsageError, match=expected):
        params.resolve(METHOD, settings=[setting])


def test_the_first_parameter_that_does_not_fit_is_named_with_what_fits() -> None:
    toy = SimpleNamespace(near=0.5, far=-1.0, depth=float("nan"))
    params.require(toy, "near", lambda metres: metres > 0, "metres above 0")
    with pytest.raises(ValueError, match=r"^far = -1\.0: give metres above 0$"):
        params.require(toy, "near far depth", lambda metres: metres > 0, "metres above 0")


def test_unknown_preset_names_the_known_ones(presets: None) -> None:
    with pytest.raises(UsageError, match="Did you mean 'city'"):
        params.resolve(METHOD, "citty")


@pytest.mark.parametrize("content", ["resolution = = 1", "\xff\xfe"])
def test_an_invalid_file_is_named(tmp_path: Path, content: str) -> None:
    file = tmp_path / "bad.toml"
    file.write_bytes(content.encode("latin1"))
    with pytest.raises(DataError, match=r"bad\.toml"):
        params.resolve(METHOD, config=file)
    with pytest.raises(DataError, match="No such file"):
        params.resolve(METHOD, config=tmp_path / "absent.toml")


def test_the_description_of_a_preset_is_in_its_file(tmp_path: Path) -> None:
    bare, described = tmp_path / "bare.toml", tmp_path / "described.toml"
    bare.write_text("[toy]\nrounds = 5\n")
    described.write_text('[preset]\ndescription = "A city"\n\n[toy]\nrounds = 5\n')
    assert params.preset_description([bare, described]) == "A city"
    assert params.preset_description([bare]) == ""
    assert params.resolve(METHOD, config=described).params.rounds == 5
    assert all(params.preset_description(files) for files in registry.preset_files().values())


@given(
    resolution=st.floats(1e-3, 1e3),
    rounds=st.integers(-5, 5),
    strict=st.booleans(),
    bands=st.lists(st.floats(allow_nan=False, allow_infinity=False)),
    seed=st.integers(0, 9),
)
def test_config_file_round_trip(
    tmp_path_factory: pytest.TempPathFactory, resolution, rounds, strict, bands, seed
) -> None:
    before = Params(resolution, rounds, strict, tuple(bands))
    file = tmp_path_factory.mktemp("config") / "config.toml"
    file.write_bytes(params.to_toml("toy", before, {"seed": seed, "online": True}))
    after = params.resolve(METHOD, config=file)
    assert (after.params, after.seed, after.online) == (before, seed, True)


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        ("run = 5", r"run = 5 is not a table. Write a table: \[run\]"),
        ("octomap = 5", r"octomap = 5 is not a table"),
        ("[[octomap]]\nresolution = 1.0", "Write a table"),
        ("[run]\nseed = -1", "invalid seed = -1 in"),
        ("[run]\nonline = 1", "invalid online = 1 in"),
        ("[octomap]\nresolution = " + "9" * 400, "give a value of type float"),
        ("[octomap]\nresolution = " + "9" * 5000, "not valid TOML"),
        ("a = " + "[" * 50_000, "not valid TOML"),
    ],
)
def test_files_without_valid_parameters_are_reported(
    tmp_path: Path, content: str, expected: str
) -> None:
    (tmp_path / "config.toml").write_text(content)
    with pytest.raises((DataError, UsageError), match=expected):
        params.resolve(registry.load("methods", "octomap"), config=tmp_path / "config.toml")

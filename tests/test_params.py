from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dynaviz import params, registry
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
    assert resolved.source == {"resolution": "--set", "rounds": str(file), "strict": "--set", "bands": str(file)}
    assert params.resolve(METHOD, "city").source["rounds"] == "preset city"
    assert set(params.resolve(METHOD).source.values()) == {"default"}


@pytest.mark.parametrize(
    ("setting", "says"),
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
def test_a_bad_setting_is_answered_with_what_to_do(setting: str, says: str) -> None:
    with pytest.raises(UsageError, match=says):
        params.resolve(METHOD, settings=[setting])


def test_unknown_preset_names_the_known_ones(presets: None) -> None:
    with pytest.raises(UsageError, match="Did you mean 'city'"):
        params.resolve(METHOD, "citty")


@pytest.mark.parametrize("content", ["resolution = = 1", "\xff\xfe"])
def test_a_file_that_is_no_toml_is_named(tmp_path: Path, content: str) -> None:
    file = tmp_path / "bad.toml"
    file.write_bytes(content.encode("latin1"))
    with pytest.raises(DataError, match=r"bad\.toml"):
        params.resolve(METHOD, config=file)
    with pytest.raises(DataError, match="No such file"):
        params.resolve(METHOD, config=tmp_path / "absent.toml")


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
    ("content", "says"),
    [
        ("run = 5", r"has run = 5. Give a table: \[run\]"),
        ("octomap = 5", r"has octomap = 5. Give a table"),
        ("[[octomap]]\nresolution = 1.0", "Give a table"),
        ("[run]\nseed = -1", "has seed = -1 in"),
        ("[run]\nonline = 1", "has online = 1 in"),
        ("[octomap]\nresolution = " + "9" * 400, "give a value of type float"),
        ("[octomap]\nresolution = " + "9" * 5000, "is not TOML"),
        ("a = " + "[" * 50_000, "is not TOML"),
    ],
)
def test_files_that_hold_no_parameters_are_told(tmp_path: Path, content: str, says: str) -> None:
    (tmp_path / "config.toml").write_text(content)
    with pytest.raises((DataError, UsageError), match=says):
        params.resolve(registry.load("methods", "octomap"), config=tmp_path / "config.toml")

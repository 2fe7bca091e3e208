"""Every verb takes the options of what it does, under the same names, and passes them on."""

from __future__ import annotations

import dataclasses
import importlib
import inspect
import pydoc
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import typer

import dynaviz as dv
from dynaviz.benchmarking.plan_file import KEYS
from dynaviz.cli import app, main
from dynaviz.contracts.options import options_of
from dynaviz.runs import execution, playback
from dynaviz.runs.options import (
    MethodKeywords,
    MethodOptions,
    RunKeywords,
    RunOptions,
)
from dynaviz.sources import opening
from dynaviz.sources.options import SequenceKeywords, SequenceOptions

SEQUENCE = {
    "frames": "1:3",
    "stride": 2,
    "sensor": "vlp16",
    "poses": "p.tum",
    "points_in": "world",
    "deskew": False,
    "extrinsic": "1,2,3,0,0,0",
    "refine_poses": True,
}
METHOD = {"preset": "av2", "config": Path("c.toml"), "settings": ("a=1",), "seed": 7, "threads": 1}
RUN = {
    **METHOD,
    "online": True,
    "variant": "v",
    "record": "scores",
    "record_budget": "1GB",
    "view": True,
    "tiles": "50",
    "workers": 2,
    "scheduler": "s:1",
    "maps": False,
    "review": Path("r.json"),
}
OPENS = {
    "run": ["octomap", "SEQ"],
    "clean": ["SEQ", "-o", "m.pcd"],
    "score": ["m.pcd", "SEQ"],
    "live": ["SEQ"],
    "info": ["SEQ"],
    "doctor": ["SEQ"],
    "convert": ["SEQ", "OUT"],
    "tune": ["SEQ", "-m", "octomap", "-o", "OUT"],
    "bench": ["-s", "SEQ", "-m", "octomap", "-o", "OUT"],
}
RUNS = {
    "run": RUN,
    "clean": {name: value for name, value in RUN.items() if name != "maps"},
    "live": METHOD,
}
WITHOUT_SEQUENCE = {"demo", "check", "compare", "explore", "list",
                    "report", "simulate", "view", "why"}  # fmt: skip


class Seen(Exception):
    """The options that reached the one place that opens sequences, or that runs methods."""

    def __init__(self, options: Any):
        self.options = options


def flags(options: dict[str, Any]) -> list[str]:
    names = {"settings": "--set", "maps": "--map", "online": "--online"}
    words: list[str] = []
    for name, value in options.items():
        flag = names.get(name, "--" + name.replace("_", "-"))
        if isinstance(value, bool):
            words.append(flag if value else flag.replace("--", "--no-", 1))
        else:
            words += [flag, *(value if isinstance(value, tuple) else [str(value)])]
    return words


@pytest.fixture
def caught(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)

    def seen(source: Any, options: SequenceOptions, **more: Any) -> Any:
        raise Seen(options)

    for module in (
        "dynaviz.sources.opening",
        "dynaviz.api",
        "dynaviz.cleaning",
        "dynaviz.benchmarking.tune",
        "dynaviz.benchmarking.source",
    ):
        monkeypatch.setattr(f"{module}.open_source", seen)


def typed(monkeypatch: pytest.MonkeyPatch, *words: str) -> Any:
    monkeypatch.setattr("sys.argv", ["dynaviz", *words])
    with pytest.raises(Seen) as found:
        main()
    return found.value.options


def test_options_and_keywords_have_the_same_names() -> None:
    for options, keywords in (
        (SequenceOptions, SequenceKeywords),
        (MethodOptions, MethodKeywords),
        (RunOptions, RunKeywords),
    ):
        written = {each.name: each.annotation for each in options_of(options)}
        inherited = MethodKeywords.__annotations__ if keywords is RunKeywords else {}
        typed = {**inherited, **keywords.__annotations__}
        assert written == {name: kind.__forward_arg__ for name, kind in typed.items()}
    assert SEQUENCE.keys() == {each.name for each in dataclasses.fields(SequenceOptions)}
    assert RUN.keys() == {each.name for each in dataclasses.fields(RunOptions)}
    defaults = SequenceOptions()
    assert all(getattr(defaults, name) != value for name, value in SEQUENCE.items())


def test_options_of_bench_files_are_those_of_opening() -> None:
    assert KEYS["opening"].keys() == SequenceKeywords.__annotations__.keys()
    assert all(isinstance(SEQUENCE[name], kind) for name, kind in KEYS["opening"].items())


VERBS = {
    dv.open: (SequenceOptions,),
    dv.score: (SequenceOptions,),
    dv.tune: (SequenceOptions,),
    dv.run: (SequenceOptions, RunOptions),
    dv.clean: (SequenceOptions, RunOptions),
}


@pytest.mark.parametrize("verb", VERBS, ids=lambda verb: verb.__name__)
def test_help_shows_every_keyword_with_type_and_default(verb: Any) -> None:
    shown = pydoc.plain(pydoc.render_doc(verb))
    for kind in VERBS[verb]:
        for each in dataclasses.fields(kind):
            name = each.name
            assert re.search(rf"\b{name}: '[^']+' = {re.escape(repr(each.default))}[,)]", shown)
            assert re.search(rf"^ +{name}: [A-Z]", shown, re.M), "with what it does"
    assert "**options" not in shown


@pytest.mark.parametrize("verb", VERBS, ids=lambda verb: verb.__name__)
def test_a_mistyped_keyword_is_suggested(verb: Any, tmp_path: Path) -> None:
    given = inspect.signature(verb).parameters.values()
    required = {each.name: "octomap" for each in given if each.default is each.empty}
    with pytest.raises(TypeError) as caught:
        verb(**required, refine_pose=True)
    problem = f"{verb.__name__}() has no keyword argument 'refine_pose'"
    assert str(caught.value) == f"{problem}. Did you mean 'refine_poses'?"


def test_every_command_is_listed_here() -> None:
    commands = set(typer.main.get_command(app).commands)  # type: ignore[attr-defined]  # a group
    assert commands == OPENS.keys() | WITHOUT_SEQUENCE


@pytest.mark.parametrize("command", OPENS)
def test_commands_pass_all_options_of_opening(
    command: str, caught: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = typed(monkeypatch, command, *OPENS[command], *flags(SEQUENCE))
    left_to_the_run = command in ("run", "clean", "bench")  # refines into the folder of the run
    assert found == SequenceOptions(**{**SEQUENCE, "refine_poses": not left_to_the_run})


@pytest.mark.parametrize("command", RUNS)
def test_commands_pass_all_options_of_running(
    command: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    opened = opening.open_source(SCANS, SequenceOptions())
    for module in ("dynaviz.sources.opening", "dynaviz.api", "dynaviz.cleaning"):
        monkeypatch.setattr(f"{module}.open_source", lambda *given, **more: opened)

    def ran(method: str, sequence: Any, options: Any, **more: Any) -> Any:
        raise Seen((options, more.get("refine_poses")))

    monkeypatch.setattr(execution, "run_method", ran)
    monkeypatch.setattr("dynaviz.cleaning.run_method", ran)
    monkeypatch.setattr(
        playback, "play_live", lambda *given, options, **more: ran("", None, options)
    )
    found, refine_poses = typed(
        monkeypatch, command, *OPENS[command], "--refine-poses", *flags(RUNS[command])
    )
    if command == "live":
        assert found == MethodOptions(**METHOD)
    else:
        assert found == RunOptions(**{**RUN, "maps": False})
        assert refine_poses


SCANS = [(np.ones((9, 3)), np.eye(4))]


@pytest.mark.parametrize(
    "verb",
    [
        lambda **options: dv.open("SEQ", **options),
        lambda **options: dv.run("octomap", "SEQ", **options),
        lambda **options: dv.clean("SEQ", "m.pcd", **options),
        lambda **options: dv.score("m.pcd", "SEQ", **options),
        lambda **options: dv.tune("SEQ", "octomap", "OUT", **options),
        lambda **options: dv.bench(
            {"methods": ["octomap"], "sequences": ["SEQ"], "opening": options}, "OUT"
        ),
    ],
    ids=["open", "run", "clean", "score", "tune", "bench"],
)
def test_python_verbs_pass_all_options_of_opening(verb: Any, caught: None) -> None:
    with pytest.raises(Seen) as found:
        verb(**SEQUENCE)
    assert dataclasses.replace(found.value.options, refine_poses=True) == SequenceOptions(
        **SEQUENCE
    )


@pytest.mark.parametrize("verb", [dv.run, dv.clean])
def test_python_verbs_that_run_a_method_take_all_options(
    verb: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    def ran(method: str, sequence: Any, options: Any, **more: Any) -> Any:
        raise Seen(options)

    for module in ("dynaviz.api", "dynaviz.cleaning"):
        monkeypatch.setattr(f"{module}.run_method", ran)
    given = ("octomap", SCANS) if verb is dv.run else (SCANS, "m.pcd")
    with pytest.raises(Seen) as found:
        verb(*given, **RUN)
    assert found.value.options == RunOptions(**{**RUN, "maps": False})


@pytest.mark.parametrize("verb", ["clean", "live", "score", "tune"])
def test_a_command_has_the_defaults_of_its_function(verb: str) -> None:
    command = vars(importlib.import_module(f"dynaviz.cli.{verb}"))[verb]
    theirs, own = (inspect.signature(each).parameters for each in (command, getattr(dv, verb)))
    shared = [
        name for name in own if name in theirs and isinstance(own[name].default, int | float | str)
    ]
    assert shared
    assert {name: theirs[name].default or own[name].default for name in shared} == {
        n: own[n].default for n in shared
    }

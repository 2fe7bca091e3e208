"""What people expect of a command line.

A version, short help, JSON on standard output, folders of runs, completion.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from helpers.worlds import room

import dynaviz as dv
from dynaviz.benchmarking.plan_file import _source
from dynaviz.io.pcd import write_pcd
from dynaviz.sources.datasets import open_sequence

Command = Callable[..., tuple[int, str, str]]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A little room without ground truth in the public benchmark's layout, and a run on it."""
    path = tmp_path_factory.mktemp("data") / "room"
    for scan in room(frames=3, rays=800).scans:
        write_pcd(
            path / f"pcd/{scan.index:06d}.pcd",
            dict(zip("xyz", scan.points.T, strict=True)),
            scan.T_world_sensor,
        )
    dv.run("octomap", path, out=path / "run", record="scores", threads=1)
    return path


def test_the_version(run_command: Command) -> None:
    assert run_command("--version") == (0, f"dynaviz {dv.__version__}\n", "")
    assert "__version__" in dir(dv)
    assert "clean" in dir(dv)


def test_short_help(run_command: Command) -> None:
    assert run_command("run", "-h")[:2] == run_command("run", "--help")[:2]


def test_json_on_standard_output(run_command: Command, folder: Path, tmp_path: Path) -> None:
    options = ("--record", "none", "--no-map", "--quiet", "--threads", 1, "--json", "-")
    code, out, err = run_command("run", "octomap", folder, "-o", tmp_path / "run", *options)
    assert (code, err) == (0, "")
    assert json.loads(out) == json.loads((tmp_path / "run/result.json").read_text())
    assert {path.name for path in (tmp_path / "run").iterdir()} == {
        "result.json",
        "labels.npz",
        "config.toml",
    }
    facts = json.loads(run_command("info", folder, "--json", "-")[1])
    assert (facts["distance"], facts["rate"]) == ("0.4 m", "unknown")
    assert facts["sensor"].startswith("unknown; estimated from the scans: 1.0")
    assert {
        row["name"]
        for row in json.loads(run_command("list", "methods", "--json", "-")[1])["methods"]
    } > {"octomap"}
    assert (
        json.loads(run_command("info", folder / "run", "--failures", "--json", "-")[1])["points"]
        == 2400
    )


@pytest.mark.parametrize(("file", "options"), [("result.json", ()), ("run.rrd", ("--failures",))])
def test_the_folder_of_a_run_is_accepted(
    run_command: Command, folder: Path, file: str, options: tuple[str, ...]
) -> None:
    of_folder = run_command("info", folder / "run", *options)
    assert of_folder[0] == 0
    assert of_folder[1] == run_command("info", folder / "run" / file, *options)[1]


def test_a_comparison_of_folders(run_command: Command, folder: Path, tmp_path: Path) -> None:
    code, out, _ = run_command(
        "compare", folder / "run", folder / "run", "-o", tmp_path / "c.rrd", "--json", "-"
    )
    assert code == 0
    assert json.loads(out)


def test_parameters_are_described(run_command: Command) -> None:
    rows = {
        row["name"]: row
        for row in json.loads(run_command("list", "seethrough", "--json", "-")[1])["parameters"]
    }
    assert "from 0 to less than 1" in rows["prior"]["range"]
    assert rows["join_angle"]["meaning"].startswith(
        "points are joined to objects across about this angle plus"
    )
    assert all(row["meaning"] for row in rows.values())


def test_sequences_of_a_bench_may_be_named() -> None:
    assert (_source("mine=some/folder", "").name, _source("b=simulate:demo:20", "").name) == (
        "mine",
        "b",
    )
    assert _source("simulate:demo:20", "").name == "demo-20"


def test_scenes_with_a_number_of_frames() -> None:
    assert len(open_sequence("simulate:demo:3")) == 3
    assert (
        open_sequence("simulate:demo:3:7").name
        == open_sequence("simulate:demo?frames=3&seed=7").name
    )


def test_names_are_completed() -> None:
    words = {
        "COMP_WORDS": "dynaviz run octomap_",
        "COMP_CWORD": "2",
        "_DYNAVIZ_COMPLETE": "complete_bash",
    }
    code = "import sys; sys.argv = ['dynaviz']; from dynaviz.cli import main; main()"
    done = subprocess.run(
        [sys.executable, "-c", code], env={**os.environ, **words}, capture_output=True, text=True
    )
    assert done.stdout.split() == ["octomap_g", "octomap_gf"]

"""Commands: what they print, which files they write, and the errors they report."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.worlds import room

from dynaviz import __main__ as start
from dynaviz import cli
from dynaviz.cli import app
from dynaviz.cli.groups import RENAMED
from dynaviz.io.pcd import write_pcd

Command = Callable[..., tuple[int, str, str]]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The little room in the public benchmark's layout."""
    path = tmp_path_factory.mktemp("data") / "room"
    scans = room(frames=5).scans
    for scan in scans:
        fields = {
            **dict(zip("xyz", scan.points.T, strict=True)),
            "intensity": np.zeros(len(scan), np.float32),
        }
        write_pcd(path / f"pcd/{scan.index:06d}.pcd", fields, scan.T_world_sensor)
    points, labels = (
        np.concatenate([getattr(scan, name) for scan in scans]) for name in ("points", "labels")
    )
    write_pcd(
        path / "gt_cloud.pcd",
        {**dict(zip("xyz", points.T, strict=True)), "intensity": labels.astype(np.float32)},
    )
    return path


def one_line(err: str) -> str:
    assert err.count("\n") == 1, err
    return err


def test_run_writes_all_files_and_shows_the_scores(
    run_command: Command, folder: Path, tmp_path: Path
) -> None:
    code, out, err = run_command("run", "octomap", folder, "-o", tmp_path, "--threads", 1)
    assert code == 0, err
    assert "octomap" in out
    assert re.search(r"^octomap on room: .*label 5/5 frames.* in [\d.]+ s$", err, re.M), err
    files = {path.name for path in tmp_path.iterdir()}
    assert files == {
        "run.rrd",
        "result.json",
        "labels.npz",
        "static_map.pcd",
        "dynamic_points.pcd",
        "config.toml",
    }
    result = json.loads((tmp_path / "result.json").read_text())
    assert result["counts"]["dynamic_removed"] > 0
    assert result["sequence"]["name"] == "room"
    assert result["instrumented"]
    assert result["recording_sha256"]
    assert result["n_parameters"] == 5
    assert result["runtime"]["threads"] == 1


def test_running_with_the_written_configuration_gives_the_same_labels(
    run_command: Command, folder: Path, tmp_path: Path
) -> None:
    assert (
        run_command(
            "run",
            "octomap_g",
            folder,
            "-o",
            tmp_path / "a",
            "--record",
            "none",
            "--set",
            "resolution=0.3",
            "--seed",
            4,
            "--online",
        )[0]
        == 0
    )
    assert (
        run_command(
            "run",
            "octomap_g",
            folder,
            "-o",
            tmp_path / "b",
            "--record",
            "scores",
            "--config",
            tmp_path / "a/config.toml",
        )[0]
        == 0
    )
    a, b = (json.loads((tmp_path / name / "result.json").read_text()) for name in "ab")
    assert a["labels_sha256"] == b["labels_sha256"]
    assert (b["seed"], b["online"], b["parameters"]["resolution"]) == (4, True, 0.3)
    assert (a["instrumented"], a["recording_sha256"]) == (False, None)
    assert not b["instrumented"], "a recording of scores has no states"


def test_frames_and_stride_select(run_command: Command, folder: Path, tmp_path: Path) -> None:
    assert (
        run_command(
            "run",
            "octomap",
            folder,
            "-o",
            tmp_path,
            "--record",
            "none",
            "--frames",
            "1:5",
            "--stride",
            2,
        )[0]
        == 0
    )
    with np.load(tmp_path / "labels.npz") as z:
        assert z["frames"].tolist() == [11, 13]


@pytest.mark.parametrize(
    "typed",
    [
        "run octomap {} --frames 9:",
        "run octomap {} --frames a:b",
        "run octomap {} --stride 0",
        "run octomapp {}",
        "run octomap {} --set resolution",
        "run octomap {} --set resolution=-1",
        "run octomap {} --preset nowhere",
        "run octomap {} --sensor eye",
        "config octomap --set foo=1",
        "simulate moon somewhere",
        "info absent.rrd",
        "info absent.json",
        "shot absent.rrd -o x.png",
        "view absent.rrd",
        "run",
        "run octomap",
        "rum octomap {}",
        "run octomap {} --fraems 0:3",
        "run octomap {} --record all",
        "run octomap {} --threads none",
        "run octomap {} --seed -1",
        "list everything",
        "bench",
    ],
)
def test_a_mistake_gives_one_line(run_command: Command, folder: Path, typed: str) -> None:
    code, _, err = run_command(*(word.format(folder) for word in typed.split()))
    assert code == 2, err
    assert 30 < len(one_line(err)) < 300
    assert err.startswith("dynaviz: ")


def test_a_file_in_place_of_the_folder_is_an_error(
    run_command: Command, folder: Path, tmp_path: Path
) -> None:
    (tmp_path / "file").write_text("mine")
    for out in ("file", "file/sub"):
        code, _, err = run_command("run", "octomap", folder, "-o", tmp_path / out)
        assert code == 2
        assert f"{tmp_path / 'file'} is a file: choose another folder with -o." in err
    assert (tmp_path / "file").read_text() == "mine"


def test_help_without_arguments_lists_commands_and_where_to_start() -> None:
    for words in ((), ("--help",)):
        done = subprocess.run(
            [sys.executable, "-m", "dynaviz", *words], capture_output=True, text=True, check=False
        )
        shown = done.stdout + done.stderr
        _, _, start = shown.partition("Start with:\n")
        assert [line.split()[:2] for line in start.splitlines() if line] == [
            ["dynaviz", name] for name in ("demo", "clean", "explore")
        ]
        assert all(
            f"\n  {command.name} " in done.stdout + done.stderr
            for command in app.registered_commands
        )


def test_invalid_data_give_one_line(run_command: Command, folder: Path, tmp_path: Path) -> None:
    whole = (folder / "pcd/000010.pcd").read_bytes()
    for name, content in {
        "truncated": whole[:-100],
        "blind": whole.replace(b"VIEWPOINT", b"# VIEWPOINT"),
        "garbage": b"\x00\x01" * 50,
    }.items():
        (tmp_path / name / "pcd").mkdir(parents=True)
        (tmp_path / name / "pcd/000000.pcd").write_bytes(content)
    (tmp_path / "empty").mkdir()
    (tmp_path / "texts").mkdir()
    (tmp_path / "texts/notes.txt").write_text("hello")
    says = {
        "truncated": "000000.pcd",
        "blind": "VIEWPOINT",
        "garbage": "000000.pcd",
        "empty": "empty",
        "texts": "texts",
        "absent": "absent",
    }
    for name, word in says.items():
        code, _, err = run_command("run", "octomap", tmp_path / name, "-o", tmp_path / "out")
        assert (code, word in one_line(err)) == (2, True), err
        assert not list((tmp_path / "out").rglob("*.*")), "nothing half-written is left"


@pytest.mark.parametrize("name", RENAMED)
def test_earlier_commands_name_their_successors(run_command: Command, name: str) -> None:
    code, _, err = run_command(name, "anything", "--at-all")
    assert (code, one_line(err)) == (
        2,
        f"dynaviz: 'dynaviz {name}' is now 'dynaviz {RENAMED[name]}'\n",
    )
    assert run_command(RENAMED[name].split()[0], "--help")[0] == 0


def test_list_and_info(run_command: Command, folder: Path) -> None:
    code, out, _ = run_command("list")
    assert code == 0
    assert all(
        name in out
        for name in ("octomap_gf", "semantickitti", "hdl64e", "av2", "demo", "breakdown")
    )
    code, out, _ = run_command("list", "octomap", "--preset", "av2", "--set", "prob_hit=0.6")
    assert code == 0
    assert all(text in out for text in ("preset av2", "--set", "default", "0.6"))
    assert "Velodyne" in run_command("list", "vlp16")[1]
    code, _, err = run_command("list", "octomapp")
    assert (code, "Did you mean 'octomap'?" in one_line(err)) == (2, True)
    code, _, err = run_command("list", "methods", "--preset", "av2")
    assert (code, "Give the name of a method" in one_line(err)) == (2, True)
    code, out, _ = run_command("info", folder)
    assert code == 0
    assert "ground truth" in out
    assert "15,000" in out


def test_info_of_a_run(run_command: Command, folder: Path, tmp_path: Path) -> None:
    assert run_command("run", "octomap", folder, "-o", tmp_path)[0] == 0
    for name in ("run.rrd", "result.json"):
        code, out, err = run_command("info", tmp_path / name)
        assert code == 0, err
        assert "octomap" in out


def test_help_begins_with_examples(run_command: Command) -> None:
    for verb in (command.name for command in app.registered_commands):
        code, out, _ = run_command(verb, "--help")
        assert code == 0
        assert out.index(f"  dynaviz {verb}") < out.index("Options:")


@pytest.mark.parametrize("extension", [False, True])
def test_an_interrupt_while_the_command_line_is_imported(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], extension: bool
) -> None:
    """An extension module, such as those of numpy, reports it as an ImportError."""

    class Interrupt:
        @staticmethod
        def find_spec(name: str, *_: object) -> None:
            if name == "dynaviz.cli" and extension:
                raise ImportError("initialization failed") from KeyboardInterrupt()
            if name == "dynaviz.cli":
                raise KeyboardInterrupt

    monkeypatch.setattr(sys, "meta_path", [Interrupt, *sys.meta_path])
    monkeypatch.delitem(sys.modules, "dynaviz.cli")
    monkeypatch.setattr(sys, "argv", ["dynaviz"])
    with pytest.raises(SystemExit) as end:
        start.main()
    assert (end.value.code, capsys.readouterr().err) == (130, "dynaviz: interrupted.\n")


def test_an_interrupt_while_an_extension_module_is_imported(
    monkeypatch: pytest.MonkeyPatch, run_command: Callable[..., tuple[int, str, str]]
) -> None:
    """Such a module reports it as an ImportError."""

    def load(*arguments: Any, **options: Any) -> None:
        raise ImportError("initialization failed") from KeyboardInterrupt()

    monkeypatch.setattr(cli, "app", load)
    assert run_command("info", "somewhere") == (130, "", "dynaviz: interrupted.\n")

"""``dynaviz simulate implant:SEQ`` and ``implant:`` paths, as a user types them."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import dynaviz
from dynaviz.io.pcd import read_pcd
from dynaviz.synthetic.simulate import simulate

Command = Callable[..., tuple[int, str, str]]
QUERY = "cars=0&trucks=0&cyclists=1&persons=2&parks=0&seed=4"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return simulate("demo", tmp_path_factory.mktemp("cli") / "street", frames=6)


def digests(folder: Path) -> dict[str, str]:
    return {
        str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def test_implants_are_written_run_and_scored(
    run_command: Command, folder: Path, tmp_path: Path
) -> None:
    code, out, err = run_command("simulate", f"implant:{folder}?{QUERY}", tmp_path / "x")
    assert code == 0, err
    assert "6 frames" in out
    assert "Rays without a return: known from the regular scan pattern" in out
    assert "Scores: DA over the implants and the points labelled dynamic" in out
    assert {"pcd", "gt_cloud.pcd", "sequence.toml", "implants.toml"} == {
        p.name for p in (tmp_path / "x").iterdir()
    }
    assert 'implanted person"' in (tmp_path / "x/sequence.toml").read_text()
    assert (read_pcd(tmp_path / "x/gt_cloud.pcd")["class"] >= 60001).sum() > 100
    code, out, err = run_command(
        "run", "removert", tmp_path / "x", "-o", tmp_path / "run", "--record", "none"
    )
    assert code == 0, err
    by_path = dynaviz.open(f"implant:{folder}?{QUERY}")
    written = dynaviz.open(tmp_path / "x")
    for k in range(len(written)):
        assert written[k].points.tobytes() == by_path[k].points.tobytes()
        np.testing.assert_array_equal(written[k].labels, by_path[k].labels)
        np.testing.assert_array_equal(written[k].instances, by_path[k].instances)
    code, out, err = run_command(
        *("score", tmp_path / "run/static_map.pcd", f"implant:{folder}?{QUERY}"),
        *("-o", tmp_path / "score", "--record", "none"),
    )
    assert code == 0, err
    assert "street-implants-seed4" in out


def test_the_same_seed_and_the_scene_file_give_the_same_bytes(
    run_command: Command, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert run_command("simulate", f"implant:{folder}?{QUERY}", tmp_path / "a/x")[0] == 0
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    assert run_command("simulate", f"implant:{folder}?{QUERY}", tmp_path / "b/x")[0] == 0
    assert digests(tmp_path / "a/x") == digests(tmp_path / "b/x")
    code, _, err = run_command(
        "simulate", f"implant:{folder}?scene={tmp_path}/a/x/implants.toml", tmp_path / "c/x"
    )
    assert code == 0, err
    first, again = digests(tmp_path / "a/x"), digests(tmp_path / "c/x")
    assert {name for name in first if first[name] != again[name]} == {
        "sequence.toml"
    }  # it has the name


def test_info_on_a_path(run_command: Command, folder: Path) -> None:
    code, out, err = run_command("info", f"implant:benchmark:{folder}?{QUERY}")
    assert code == 0, err
    assert "1 cyclist, 2 person" in out


def test_frames_of_the_sequence(run_command: Command, folder: Path, tmp_path: Path) -> None:
    words = ("simulate", f"implant:{folder}?{QUERY}&panel=none", tmp_path / "x", "--frames", "1:4")
    code, _, err = run_command(*words)
    assert code == 0, err
    assert sorted(path.name for path in (tmp_path / "x/pcd").iterdir()) == [
        f"{k:06d}.pcd" for k in (1, 2, 3)
    ]
    assert len(dynaviz.open(f"implant:{folder}?{QUERY}&frames=1:4")) == 3


@pytest.mark.parametrize(
    ("path", "message"),
    [
        ("implant:", "gives no sequence"),
        ("implant:nowhere?cars=2", "nowhere: does not exist. Give the folder of a sequence."),
        ("implant:{folder}?carz=2", "unknown option 'carz=2'. Did you mean 'cars'?"),
        ("implant:{folder}?scene=none.toml", "none.toml: No such file"),
        ("implant:{folder}?panel=nobody&persons=1", "unknown method 'nobody'"),
    ],
)
def test_errors_are_one_line(run_command: Command, folder: Path, path: str, message: str) -> None:
    code, _, err = run_command("info", path.format(folder=folder))
    assert code == 2
    lines = [line for line in err.splitlines() if "warning" not in line]
    assert len(lines) == 1
    assert message in lines[0]

"""``dynaviz why``, as a user types it."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest
from helpers.worlds import room

from dynaviz import api
from dynaviz.sources.datasets.convert import convert

Command = Callable[..., tuple[int, str, str]]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the little room in ``room``, and a run of OctoMap on every second frame from
    the second one.
    """
    path = tmp_path_factory.mktemp("why")
    convert(room(frames=6, rays=400), path / "room")
    sequence = api.open(path / "room", frames="1:", stride=2)
    api.run("octomap", sequence, out=path / "run", record="scores", settings=("resolution=0.4",))
    return path


@pytest.fixture
def run(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of the run; the working folder is that of its sequence."""
    monkeypatch.chdir(folder)
    return folder / "run"


def test_it_shows_the_ledger_and_the_rule(run_command: Command, run: Path, tmp_path: Path) -> None:
    file = tmp_path / "why.json"
    code, out, err = run_command("why", run, "--frame", 1, "--point", 40, "--json", file)
    assert code == 0, err
    ledger = json.loads(file.read_bytes())["ledger"]
    assert (ledger["frame"], ledger["index"], ledger["searched"]) == (1, 13, 3)
    assert "OctoMap on room: point 40 of frame 1, at (" in out
    assert "of 3" in out  # scans
    assert "log-odds" in out
    assert "1*" in out  # the frame of the point
    verdict = "yes" if ledger["removed"] else "no "
    assert f"{verdict} {ledger['rules'][0]['text']}" in out


def test_it_reads_recordings_and_finds_moved_sequences(
    run_command: Command, run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    moved = run.parent / "moved"
    (run.parent / "room").rename(moved)
    try:
        code, _, err = run_command("why", run / "run.rrd", "--frame", 0, "--point", 5)
        assert code == 2
        assert "Give the sequence of the run: --sequence PATH" in err
        code, out, err = run_command(
            "why", run / "run.rrd", "--frame", 0, "--point", 5, "--sequence", moved
        )
        assert code == 0, err
    finally:
        moved.rename(run.parent / "room")
    assert "point 5 of frame 0" in out


def test_labels_of_another_program_have_rays_but_no_ledger(
    run_command: Command, run: Path, tmp_path: Path
) -> None:
    scored = tmp_path / "scored"
    code, _, err = run_command(
        "score", run / "static_map.pcd", "room", "--frames", "1:", "--stride", 2, "-o", scored
    )
    assert code == 0, err
    code, out, err = run_command("why", scored / "result.json", "--frame", 1, "--point", 40)
    assert code == 0, err
    assert (
        "The labels come from another program, so there is no ledger: only the rays are known."
        in out
    )
    assert "1*" in out
    assert "Removed if" not in out
    (scored / "labels.npz").unlink()
    code, _, err = run_command("why", scored, "--frame", 1, "--point", 40)
    assert code == 2
    assert "labels.npz: does not exist. Give the folder of a finished run" in err


def test_wrong_arguments_give_one_line(run_command: Command, run: Path) -> None:
    for words, problem in (
        ((run, "--frame", 3, "--point", 0), "frame 3: the run has the frames 0 to 2"),
        ((run, "--frame", 0, "--point", 400), "point 400: frame 0 has the points 0 to 399"),
        (
            (run.parent / "room", "--frame", 0, "--point", 0),
            "contains no result.json and no run.rrd",
        ),
    ):
        code, out, err = run_command("why", *words)
        assert code == 2
        assert not out
        assert problem in err
        assert sum("dynaviz:" in line for line in err.splitlines()) == 1


@pytest.fixture(scope="module")
def recorded(folder: Path) -> Path:
    """A recorded run with cases, whose data are gone afterwards."""
    convert(room(frames=6, rays=900), folder / "other")
    api.run("octomap", folder / "other", out=folder / "recorded", settings=("resolution=0.3",))
    (folder / "other").rename(folder / "moved_away")
    return folder / "recorded"


def test_cases_and_places_are_answered_from_the_recording(
    run_command: Command, recorded: Path, tmp_path: Path
) -> None:
    file = tmp_path / "why.json"
    code, out, err = run_command("why", recorded, "--case", 1, "--json", file)
    assert code == 0, err
    assert "Case 1 of " in out
    assert "repeated" not in out
    found = json.loads(file.read_bytes())
    assert found["deciding"]
    assert all(row["span"] for row in found["deciding"])
    x, y, z = found["ledger"]["position"]
    for words in (
        ("--near", f"{x:.2f},{y:.2f},{z:.2f}"),
        ("--frame", found["ledger"]["frame"], "--point", found["ledger"]["point"]),
    ):
        code, out, err = run_command("why", recorded, *words, "--json", file)
        assert code == 0, err
        again = json.loads(file.read_bytes())
        assert again["ledger"]["position"] == pytest.approx([x, y, z], abs=0.02)
    code, out, err = run_command("why", recorded, "--case", 1, "--again")
    assert code == 2  # it would need the data
    assert "--sequence" in err


def test_a_point_without_stored_evidence_repeats_the_run_and_says_so(
    run_command: Command, run: Path
) -> None:
    code, out, err = run_command("why", run, "--frame", 1, "--near", "-2.92,-5.96,4.0")
    assert code == 0, err
    assert "The run was repeated, because its recording has no evidence on this point." in out


@pytest.mark.parametrize(
    ("words", "problem"),
    [
        ((), "ask about one thing: --frame F --point P, --case N, or --near X,Y,Z"),
        (("--case", 1, "--near", "0,0,0"), "ask about one thing"),
        (("--case", 1, "--frame", 0), "leave out --frame"),
        (("--point", 1), "point 1: give its frame, too"),
        (("--case", 999), "case 999: the run has the cases 1 to "),
        (("--near", "1,2"), "--near 1,2: give three numbers"),
        (("--near", "900,0,0"), "900,0,0: no recorded point is within 0.5 m"),
        (("--near", "900,0,0", "--frame", 1), "frame 1 has no point within 0.5 m; the nearest is"),
    ],
)
def test_questions_that_cannot_be_answered(
    run_command: Command, run: Path, words: tuple[object, ...], problem: str
) -> None:
    code, _, err = run_command("why", run, *words)
    assert code == 2
    assert problem in err

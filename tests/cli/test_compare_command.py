"""dynaviz compare, as a user types it."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest
from helpers.worlds import room

import dynaviz as dv

Command = Callable[..., tuple[int, str, str]]


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    folder = tmp_path_factory.mktemp("runs")
    for name, size in (("a", 0.2), ("b", 0.6)):
        dv.run(
            "octomap",
            room(5, 1500),
            out=folder / name,
            record="scores",
            settings=(f"resolution={size}",),
        )
    return folder / "a/run.rrd", folder / "b/run.rrd"


def test_tables_a_recording_and_json(
    run_command: Command, recordings: tuple[Path, Path], tmp_path: Path
) -> None:
    out, plain = tmp_path / "deep/both.rrd", tmp_path / "both.json"
    code, shown, err = run_command("compare", *recordings, "-o", out, "--json", plain)
    assert code == 0, err
    assert "1/1 recordings" in err
    content = json.loads(plain.read_text())
    score = content["pairs"][0]["scores"]["AA"]
    assert f"{score['first']:.2f}" in shown
    assert f"{score['delta']:+.2f}" in shown
    assert "Static surfaces that change most" in shown
    assert "contains no coordinates" in content["pairs"][0]["places_note"]
    assert sorted(path.name for path in tmp_path.rglob("*.*")) == ["both.json", "both.rrd"]
    code, shown, _ = run_command("info", out)
    assert (code, "octomap resolution=0.6" in shown) == (0, True)


def test_the_default_output_is_in_the_working_directory(
    run_command: Command,
    recordings: tuple[Path, Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run_command("compare", *recordings, recordings[0])[0] == 0
    assert [path.name for path in tmp_path.iterdir()] == ["compare.rrd"]


def test_fail_below_sets_the_exit_code(
    run_command: Command, recordings: tuple[Path, Path], tmp_path: Path
) -> None:
    out = ("-o", tmp_path / "x.rrd")
    delta = dv.compare(*recordings).pairs[0].scores.AA.delta
    assert delta is not None
    for order, change in ((recordings, delta), (recordings[::-1], -delta)):
        assert run_command("compare", *order, *out, "--fail-below", change - 1e-6)[0] == 0
        code, shown, err = run_command("compare", *order, *out, "--fail-below", change + 1e-6)
        assert code == 1
        assert "AA" in err
        assert "below" in err
        assert "Scores" in shown
    code, _, err = run_command("compare", recordings[0], *recordings, *out, "--fail-below", 100)
    assert code == 1
    assert [line.split()[1] for line in err.splitlines() if line.startswith("dynaviz:")] == [
        "B",
        "C",
    ]


@pytest.mark.parametrize(
    "typed",
    [
        "{0}",
        "{0} absent.rrd",
        "{0} {1} -o {1}",
        "{0} {1} --json {0}/x.json",
        "{0} {0} --fail-below x",
    ],
)
def test_errors_have_no_traceback(
    run_command: Command,
    recordings: tuple[Path, Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    typed: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    code, _, err = run_command("compare", *typed.format(*recordings).split())
    assert code == 2
    assert "Traceback" not in err
    errors = [line for line in err.splitlines() if line.startswith("dynaviz:")]
    assert len(errors) == 1


def test_help_begins_with_examples(run_command: Command) -> None:
    code, out, _ = run_command("compare", "--help")
    assert code == 0
    assert out.index("  dynaviz compare") < out.index("Options:")

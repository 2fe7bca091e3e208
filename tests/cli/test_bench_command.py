"""dynaviz bench as a user types it."""

from __future__ import annotations

import io
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from dynaviz.benchmarking import bench as bench_module
from dynaviz.benchmarking.leaderboard import BenchRow, Leaderboard, SearchResult
from dynaviz.benchmarking.plan import BenchCell, ParameterSet, SequenceSpec
from dynaviz.cli.bench_progress import BenchProgress
from dynaviz.cli.console import progress

Command = Callable[..., tuple[int, str, str]]


def failed(folder: Path, error: str, variant: str = "") -> BenchRow:
    parameter_set = ParameterSet("octomap", variant, {})
    return BenchRow(
        BenchCell(SequenceSpec("street"), parameter_set, "", "none"), folder, error=error
    )


def open_terminal(monkeypatch: pytest.MonkeyPatch) -> io.StringIO:
    """A wide terminal as standard error."""
    terminal = io.StringIO()
    terminal.isatty = lambda: True  # type: ignore[method-assign]
    monkeypatch.setattr(sys, "stderr", terminal)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "300")
    return terminal


def shown(item: object) -> str:
    console = Console(width=150, file=io.StringIO())
    console.print(item)
    return console.file.getvalue()


@pytest.fixture
def planned(monkeypatch: pytest.MonkeyPatch) -> list[dict[str, Any]]:
    """The tables that the command passes to ``bench``, which does not run."""
    tables: list[dict[str, Any]] = []

    def bench(table: dict[str, Any], out: Path, **options: object) -> Leaderboard:
        tables.append(table)
        return Leaderboard([])

    monkeypatch.setattr(bench_module, "bench", bench)
    return tables


def test_a_seed_of_zero_overrides_the_file(
    run_command: Command, planned: list[dict[str, Any]], tmp_path: Path
) -> None:
    (tmp_path / "bench.toml").write_text('[search]\nkind = "bayes"\nseed = 5\n')
    for typed, seed in (([], 5), (["--seed", 0], 0), (["--seed", 3], 3)):
        assert run_command("bench", tmp_path / "bench.toml", "-o", tmp_path, *typed)[0] == 0
        assert planned[-1]["search"]["seed"] == seed


def test_a_scheduler_overrides_the_workers_of_the_file(
    run_command: Command, planned: list[dict[str, Any]], tmp_path: Path
) -> None:
    (tmp_path / "bench.toml").write_text('workers = 4\nrecord = "scores"\n')
    there = ["--scheduler", "tcp://127.0.0.1:9"]
    for typed, keys in (
        (there, {"record"}),
        ([*there, "--workers", 2], {"record", "workers"}),
        (["--timing"], {"timing"}),
    ):
        assert run_command("bench", tmp_path / "bench.toml", "-o", tmp_path, *typed)[0] == 0
        assert planned[-1].keys() - {"sequences", "variants"} == keys


def test_a_seed_below_zero_is_refused(run_command: Command, tmp_path: Path) -> None:
    code, _, err = run_command("bench", "-s", "simulate:demo", "-o", tmp_path, "--seed", -1)
    assert (code, err.count("\n"), "--seed" in err) == (2, 1, True), err


def test_a_seed_without_a_search_is_that_of_methods(
    run_command: Command, planned: list[dict[str, Any]], tmp_path: Path
) -> None:
    words = ("bench", "-s", "simulate:demo", "-o", tmp_path)
    assert run_command(*words, "--seed", 4)[0] == 0
    assert run_command(*words, "--seeds", "0,2")[0] == 0
    assert [(each["seeds"], each.get("search")) for each in planned] == [
        ([4], None),
        ([0, 2], None),
    ]
    code, _, err = run_command(*words, "--seeds", "0,a")
    assert (code, "Give them with commas" in err) == (2, True)
    code, _, err = run_command(*words, "--seeds", "0,1", "--seed", 1)
    assert (code, "exclude each other" in err) == (2, True)


def test_an_error_is_shown_unchanged(
    run_command: Command,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> None:
    row, terminal = (
        failed(tmp_path / "[auto]", "no [auto] at [/tmp/x]", "act=[auto]"),
        open_terminal(monkeypatch),
    )
    with progress("bench", keep=False) as report:
        live = BenchProgress(report, cells=True)
        live.preparing("read [/street]", 1, 2)
        live.running(row.cell, "label [/2]", 1, 2)
        live.ended(row)
    assert "bench: read [/street]" in terminal.getvalue()
    assert "bench: octomap-act=[auto] on street, label [/2]" in terminal.getvalue()
    assert "octomap-act=[auto] on street: failed: no [auto] at [/tmp/x]" in terminal.getvalue()
    board = Leaderboard([row])
    assert "octomap-act=[auto]" in shown(board)
    assert "no [auto] at [/tmp/x]" in shown(board)
    monkeypatch.undo()
    monkeypatch.setattr(bench_module, "bench", lambda *given, **options: board)
    code, out, _ = run_command("bench", "-s", "simulate:demo", "-o", tmp_path)
    assert code == 1
    assert f"{tmp_path}/[auto]/error" in out.replace("\n", "")


def test_progress_shows_speed_and_the_time_left(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    now = [100.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    row = failed(tmp_path, "cannot be read")
    with progress("bench", keep=False) as report:
        lines = BenchProgress(report, cells=False)
        lines.planned(4)
        lines.preparing("survey street", 1, 20)
        now[0] += 10.0
        lines.preparing("survey street", 11, 20)
        lines.running(row.cell, "label", 7, 20)
        lines.ended(replace(row, error=None, kept=True))  # takes no time
        now[0] += 10.0
        lines.ended(row)
    printed = capsys.readouterr().err.splitlines()
    assert printed[0] == "bench: survey street 11/20 frames, 1.0 frames/s, 9 s left"
    assert [line.partition("]")[0] for line in printed[1:3]] == ["[1/4", "[2/4, 20 s left"]


def test_the_named_error_file_exists(
    run_command: Command, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    board = Leaderboard([failed(tmp_path, "cannot be read")])
    monkeypatch.setattr(bench_module, "bench", lambda *given, **options: board)
    for name in ("error.json", "error.log"):
        (tmp_path / name).touch()
        assert (
            f"{name}. The same command"
            in run_command("bench", "-s", "simulate:demo", "-o", tmp_path)[1]
        )


@pytest.mark.parametrize("variant", ["", "resolution=0.2"])
def test_failed_trials_are_counted(
    run_command: Command, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, variant: str
) -> None:
    result = SearchResult(
        ParameterSet("octomap", variant, {}), tmp_path / "best.toml", 90.0, 80.0, 7, 2
    )
    monkeypatch.setattr(
        bench_module, "bench", lambda *given, **options: Leaderboard([], searches=[result])
    )
    assert (
        "of 7 trials (2 failed)" in run_command("bench", "-s", "simulate:demo", "-o", tmp_path)[1]
    )


def test_an_interrupted_bench_states_how_to_continue(
    run_command: Command, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def bench(*table: object, **options: object) -> Leaderboard:
        raise KeyboardInterrupt

    monkeypatch.setattr(bench_module, "bench", bench)
    code, _, err = run_command("bench", "-s", "simulate:demo", "-o", tmp_path)
    assert code == 130
    assert err == (
        f"dynaviz: interrupted. Finished runs are kept in {tmp_path}. The same command continues "
        "with the others.\n"
    )
    assert (
        "The same command without --fresh continues"
        in run_command("bench", "-o", tmp_path, "--fresh")[2]
    )


def test_quiet_shows_no_progress(
    run_command: Command, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def bench(*table: object, callbacks: Any, **options: object) -> Leaderboard:
        callbacks.planned(2)
        callbacks.running(failed(tmp_path, "").cell, "observe", 1, 1)
        callbacks.ended(failed(tmp_path, "broken"))
        return Leaderboard([])

    monkeypatch.setattr(bench_module, "bench", bench)
    assert run_command("bench", "-o", tmp_path)[2] != ""
    assert run_command("bench", "-o", tmp_path, "--quiet")[2] == ""

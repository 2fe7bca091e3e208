"""dynaviz report --format board: sequences are found again by the command of a run."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from helpers.mos_files import write_helimos


@pytest.mark.slow
def test_write_again_and_after_a_move(run_command, tmp_path: Path) -> None:
    root = write_helimos(tmp_path / "data")
    words = (
        "run",
        "dufomap",
        f"helimos_val:{root}",
        "--frames",
        "1:4",
        "--record",
        "none",
        "-o",
        tmp_path / "runs/a",
    )
    assert run_command(*words)[0] == 0
    board = ("report", tmp_path / "runs", "--format", "board", "-o")
    code, out, _ = run_command(*board, tmp_path / "first")
    assert code == 0
    assert "1 run scored." in out
    assert (tmp_path / "first/index.html").is_file()
    assert (
        "0 runs scored, 1 taken over from the earlier board."
        in run_command(*board, tmp_path / "first")[1]
    )
    root.rename(root.with_name("moved"))
    code, out, _ = run_command(*board, tmp_path / "second")
    assert code == 0
    assert "a: not scored: the sequence was not found; give it with --sequence." in out
    moved = f"helimos_val:{root.with_name('moved')}"
    assert "1 run scored." in run_command(*board, tmp_path / "second", "--sequence", moved)[1]
    first, second = (
        json.loads((tmp_path / name / "board.json").read_bytes()) for name in ("first", "second")
    )
    assert second == first


def test_a_sequence_is_only_for_a_board(run_command, tmp_path: Path) -> None:
    code, _, err = run_command("report", tmp_path, "--sequence", "x")
    assert (code, err) == (2, "dynaviz: --sequence: not with a report. Add --format board\n")

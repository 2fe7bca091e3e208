"""dynaviz report --format board: sequences are found again by the command of a run."""

from __future__ import annotations

import json
from pathlib import Path

from helpers.mos_files import write_helimos


def test_write_and_recompute(run_command, tmp_path: Path) -> None:
    root = write_helimos(tmp_path / "data")
    words = ("run", "dufomap", f"helimos_val:{root}", "--frames", "1:4", "--record", "none", "-o", tmp_path / "runs/a")
    assert run_command(*words)[0] == 0
    code, out, _ = run_command("report", tmp_path / "runs", "--format", "board")
    assert code == 0
    assert "1 run scored." in out
    assert (tmp_path / "runs/board/index.html").is_file()
    code, out, _ = run_command("report", tmp_path / "runs", "--format", "board", "--check", "--rerun")
    assert code == 0
    assert "1 entry recomputed: all digests and scores are the same." in out
    board = tmp_path / "runs/board/board.json"
    plain = json.loads(board.read_text())
    plain["entries"][0]["protocols"]["points"]["scores"]["SA"] = 1.0
    board.write_text(json.dumps(plain))
    code, out, _ = run_command("report", tmp_path / "runs", "--format", "board", "--check")
    assert code == 1
    assert "board.json has other scores" in out
    root.rename(root.with_name("moved"))
    code, out, _ = run_command("report", tmp_path / "runs", "--format", "board", "--check")
    assert code == 1
    assert "the sequence helimos_ouster_val was not found; give it with --sequence" in out
    moved = f"helimos_val:{root.with_name('moved')}"
    assert (
        "other scores"
        in run_command("report", tmp_path / "runs", "--format", "board", "--check", "--sequence", moved)[1]
    )


def test_rerun_needs_check(run_command, tmp_path: Path) -> None:
    code, _, err = run_command("report", tmp_path, "--format", "board", "--rerun")
    assert (code, err) == (2, "dynaviz: --rerun: only with --check\n")
    code, _, err = run_command("report", tmp_path, "--check")
    assert (code, err) == (2, "dynaviz: --check: not with a report. Add --format board\n")

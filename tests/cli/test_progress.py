"""Progress in logs and on terminals: counts, speed and the time left."""

from __future__ import annotations

import io
import subprocess
import sys

import pytest

from dynaviz.cli import console
from dynaviz.cli.console import PhaseTimer, duration, progress


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """The time in seconds, as the single item of a list."""
    now = [100.0]
    monkeypatch.setattr(console.time, "monotonic", lambda: now[0])
    return now


def test_speed_and_time_left_start_after_the_first_step(clock: list[float]) -> None:
    timer = PhaseTimer("frames", 1)
    assert timer.line("label", 1, 100) == "label 1/100 frames"
    clock[0] += 3.0
    assert timer.line("label", 40, 100) == "label 40/100 frames, 13.0 frames/s, 5 s left"
    assert timer.line("label", 100, 100) == "label 100/100 frames, 33.0 frames/s"


def test_durations_have_one_unit() -> None:
    assert [duration(seconds) for seconds in (4.6, 89, 600, 9000)] == [
        "5 s",
        "89 s",
        "10 min",
        "2.5 h",
    ]


def test_log_lines_are_rare_and_complete(
    clock: list[float], capsys: pytest.CaptureFixture[str]
) -> None:
    with progress("octomap on street", unit={"fetch": "MB"}) as report:
        for done in range(1, 16):
            clock[0] += 1.0
            report("fetch", done, 15)
        clock[0] += 7.0
        report("label", 1, 1)
    lines = capsys.readouterr().err.splitlines()
    assert lines == [
        "octomap on street: fetch 10/15 MB, 1.0 MB/s, 5 s left",
        "octomap on street: label 1/1 steps",
        "octomap on street: fetch 15/15 MB, label 1/1 steps in 22 s",
    ]


def test_a_quick_command_writes_one_line_and_a_failed_one_none(
    clock: list[float], capsys: pytest.CaptureFixture[str]
) -> None:
    with progress("octomap on street") as report:
        clock[0] += 4.0
        report("label", 5, 5)
    assert capsys.readouterr().err == "octomap on street: label 5/5 frames in 4.0 s\n"
    with pytest.raises(OSError, match="full"):
        _fill_the_disk()
    assert capsys.readouterr().err == ""


def _fill_the_disk() -> None:
    with progress("octomap on street") as report:
        report("label", 3, 5)
        raise OSError("the disk is full")


def test_bars_show_speed_and_time_left(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = io.StringIO()
    terminal.isatty = lambda: True  # type: ignore[method-assign]
    monkeypatch.setattr(sys, "stderr", terminal)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "80")
    with progress("octomap on street") as report:
        for done in range(1, 4):
            report("label", done, 3)
    assert "octomap on street: label" in terminal.getvalue()
    assert "3/3" in terminal.getvalue()
    assert "frames/s" in terminal.getvalue()


def test_the_command_line_imports_without_unix_modules() -> None:
    code = (
        "import sys\n"
        "for name in ('fcntl', 'termios', 'resource', 'pwd', 'grp'): sys.modules[name] = None\n"
        "import dynaviz.cli, dynaviz.cli.bench_progress, dynaviz.benchmarking.bench, "
        "dynaviz.tasks.worker\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr

"""A library that crashes on a recording ends its command with one line."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from helpers.guessing_method import record
from helpers.worlds import room

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="needs a system that forks")
COMPARE = ("compare", "a.rrd", "b.rrd")


def command(body: str, words: tuple[str, ...] = COMPARE) -> subprocess.Popen[str]:
    """Run Python statements as a command."""
    lines = "".join(f"    {line}\n" for line in body.splitlines())
    start = f"import os, signal, sys, time\nfrom dynaviz import isolated\ndef run():\n{lines}"
    code = f"{start}isolated.run(run, {words!r})"
    return subprocess.Popen(
        [sys.executable, "-c", code], text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )


def outcome(body: str, words: tuple[str, ...] = COMPARE) -> tuple[int, str, str]:
    process = command(body, words)
    out, err = process.communicate(timeout=60)
    return process.returncode, out, err


def test_a_recording_that_makes_rerun_abort_is_refused_in_one_line(tmp_path: Path) -> None:
    recording = record(room(2, 30), tmp_path / "a run.rrd", "errors")
    abort = (
        "import os, sys\nfrom rerun.chunk import RrdReader\nRrdReader.store = lambda self: "
        "os.abort()\n"
    )
    run = (
        f"sys.argv = ['dynaviz', 'info', {str(recording)!r}]\nfrom dynaviz.__main__ import "
        "main\nmain()"
    )
    done = subprocess.run(
        [sys.executable, "-c", abort + run], capture_output=True, text=True, check=False
    )
    assert done.returncode == 2
    assert done.stderr == (
        "dynaviz: info: a library crashed (SIGABRT). Most likely a file is damaged.\n"
    )


def test_the_last_words_of_a_crashing_library_are_left_out() -> None:
    code, out, err = outcome(
        "print('so far', flush=True); os.write(2, b'free(): invalid pointer'); os.abort()"
    )
    assert (code, out) == (2, "so far\n")
    assert err.count("\n") == 1
    assert err.startswith("dynaviz: compare: a library crashed (SIGABRT).")


def test_a_killed_command_reports_that_memory_may_have_run_out() -> None:
    code, _, err = outcome("os.kill(os.getpid(), signal.SIGKILL)")
    assert (code, err) == (
        2,
        "dynaviz: compare was killed (SIGKILL). Most likely the memory ran out.\n",
    )


def test_exit_code_and_everything_printed_are_kept() -> None:
    code, out, err = outcome("print(1); print(2, file=sys.stderr); os.write(2, b'3'); sys.exit(1)")
    assert (code, out, err) == (1, "1\n", "2\n3")


def test_other_commands_run_in_the_process_itself() -> None:
    process = command("print(os.getpid())", ("run", "octomap", "a.rrd"))
    out, _ = process.communicate(timeout=60)
    assert out == f"{process.pid}\n"


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_to_the_command_reaches_its_child_once(number: signal.Signals) -> None:
    body = (
        "count = []\n"
        "for number in (signal.SIGINT, signal.SIGTERM):\n"
        "    signal.signal(number, lambda number, frame: count.append(number))\n"
        "print('ready', flush=True)\n"
        "while not count: time.sleep(0.01)\n"
        "time.sleep(0.2)\n"
        "sys.exit(100 + sum(count))"
    )
    process = command(body)
    assert process.stdout is not None
    assert process.stdout.readline() == "ready\n"
    process.send_signal(number)
    process.communicate(timeout=60)
    assert process.returncode == 100 + number


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux ends a child with its parent")
def test_a_killed_parent_takes_its_child_along() -> None:
    process = command("print('ready', flush=True)\ntime.sleep(600)")
    assert process.stdout is not None
    process.stdout.readline()
    process.kill()
    process.communicate(timeout=60)  # ends once neither process has the pipe open

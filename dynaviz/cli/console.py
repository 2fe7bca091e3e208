"""Output shared by the commands.

A console, and progress as bars on a terminal or as lines in a log.
"""

from __future__ import annotations

import contextlib
import json
import shutil
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dynaviz.progress import silent

if TYPE_CHECKING:
    from rich.console import Console, RenderableType

    from dynaviz.progress import Progress

_quiet = False  # set by --quiet
LOG_INTERVAL = 10.0  # seconds between two log lines
Unit = str | Mapping[str, str]
"""What a step of a phase is, in the plural; a mapping gives one for each phase."""


def console() -> Console:
    """Standard output; wide if it is not a terminal, so that tables in logs are not cut."""
    from rich.console import Console

    return Console(width=None if sys.stdout.isatty() else 160)


def print_json(content: Any, target: Path | None) -> bool:
    """Write plain values as JSON to a file, or to standard output for ``-``.

    Returns:
        Whether standard output has the JSON, so that nothing else may be printed there.
    """
    if target is None:
        return False
    text = json.dumps(content, indent=1, allow_nan=False)
    if str(target) == "-":
        print(text)
        return True
    from dynaviz.io.atomic import write_atomic

    write_atomic(target, text.encode())
    return False


def set_quiet(quiet: bool) -> None:
    """Show no progress from now on."""
    global _quiet
    _quiet = quiet


def is_quiet() -> bool:
    """Whether ``--quiet`` was given."""
    return _quiet


def program() -> str:
    """How to call this program: its name if the shell finds it, else as it was called."""
    if shutil.which("dynaviz"):
        return "dynaviz"
    return sys.argv[0] if Path(sys.argv[0]).name == "dynaviz" else f"{sys.executable} -m dynaviz"


def written(folder: Path, recorded: bool) -> str:
    """Where the files of a run are, and how to open its recording."""
    if not recorded:
        return f"Written to {folder}."
    opened = f"Written to {folder}. Open it with: {program()} view {folder / 'run.rrd'}"
    return f"{opened}\nClick the failures, and see why: {program()} explore {folder}"


def show(*items: RenderableType) -> None:
    """Print, with styles if the terminal supports them."""
    out = console()
    for item in items:
        out.print(item)


def warn(item: RenderableType) -> None:
    """Print on standard error, in 100 columns at most."""
    from rich.console import Console

    out = Console(stderr=True)
    out.print(item, width=min(out.width, 100))


class PhaseTimer:
    """Formats the progress of one phase, with its speed and the time left.

    The first step of a phase often includes compilation or opening files, so speed is measured from
    its end.

    Args:
        unit: what a step is, in the plural.
        done: the number of steps done now.
    """

    def __init__(self, unit: str, done: int):
        self.unit = unit
        self._done = done
        self._since = time.monotonic()

    def speed(self, done: int) -> float | None:
        """Steps per second; None until a second step is done."""
        seconds = time.monotonic() - self._since
        return (done - self._done) / seconds if done > self._done and seconds > 0 else None

    def line(self, phase: str, done: int, total: int) -> str:
        """Text for a log, such as ``label 40/100 frames, 12.3 frames/s, 5 s left``."""
        parts = [f"{phase} {done}/{total} {self.unit}"]
        if speed := self.speed(done):
            parts.append(f"{speed:,.1f} {self.unit}/s")
            if done < total:
                parts.append(f"{duration((total - done) / speed)} left")
        return ", ".join(parts)


def duration(seconds: float) -> str:
    """A duration in one unit: seconds below 90 s, minutes below 90 min, otherwise hours."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    if seconds < 90 * 60:
        return f"{seconds / 60:.0f} min"
    return f"{seconds / 3600:.1f} h"


@contextlib.contextmanager
def progress(title: str, unit: Unit = "frames", keep: bool = True) -> Iterator[Progress]:
    """Give a function that takes (phase, done, total) and shows it on standard error.

    Args:
        title: what has these phases.
        unit: what a step is.
        keep: keep the bars of phases that are over, which few commands have many of.
    """
    units = unit if isinstance(unit, Mapping) else {}
    default = unit if isinstance(unit, str) else "steps"

    def start(phase: str, done: int) -> PhaseTimer:
        return PhaseTimer(units.get(phase, default), done)

    if _quiet:
        yield silent
    elif sys.stderr.isatty():
        with _bars(title, start, keep) as report:
            yield report
    else:
        lines = _LogLines(title, start)
        yield lines.report
        lines.end()


@contextlib.contextmanager
def _bars(title: str, start: Callable[[str, int], PhaseTimer], keep: bool) -> Iterator[Progress]:
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TaskID,
        TextColumn,
        TimeRemainingColumn,
    )

    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(20),
        MofNCompleteColumn(),
        TextColumn("{task.fields[speed]}"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True), transient=True) as bars:
        tasks: dict[str, tuple[TaskID, PhaseTimer]] = {}

        def report(phase: str, done: int, total: int) -> None:
            if phase not in tasks:
                tasks[phase] = (
                    bars.add_task(f"{title}: {phase}", total=total, speed=""),
                    start(phase, done),
                )
            task, timer = tasks[phase]
            speed = timer.speed(done)
            text = "" if speed is None else f"{speed:,.1f} {timer.unit}/s"
            bars.update(task, completed=done, speed=text, visible=keep or done < total)

        yield report


class _LogLines:
    """Progress in a log: a line now and then, and one at the end with all phases.

    Args:
        title: what has these phases.
        start: gives the timer of a phase.
    """

    def __init__(self, title: str, start: Callable[[str, int], PhaseTimer]):
        self._title = title
        self._start = start
        self._timers: dict[str, PhaseTimer] = {}
        self._totals: dict[str, int] = {}
        self._since = self._printed = time.monotonic()

    def report(self, phase: str, done: int, total: int) -> None:
        """As ``Progress``."""
        now = time.monotonic()
        if phase not in self._timers:
            self._timers[phase] = self._start(phase, done)
        self._totals[phase] = total
        if now - self._printed >= LOG_INTERVAL:
            self._printed = now
            self._print(self._timers[phase].line(phase, done, total))

    def end(self) -> None:
        """Print what all phases did, and how long they took."""
        did = [f"{name} {n}/{n} {self._timers[name].unit}" for name, n in self._totals.items()]
        if did:
            seconds = time.monotonic() - self._since
            took = f"{seconds:.1f} s" if seconds < 10 else duration(seconds)
            self._print(f"{', '.join(did)} in {took}")

    def _print(self, text: str) -> None:
        print(f"{self._title}: {text}", file=sys.stderr, flush=True)

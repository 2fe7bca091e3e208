"""What the verbs share: a console, and progress as a bar on a terminal or as plain lines in a log."""

from __future__ import annotations

import contextlib
import shutil
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console, RenderableType

    from dynaviz.progress import Progress

QUIET = 5.0  # seconds between two lines of a phase in a log


def console() -> Console:
    """Standard output; wide where it is no terminal, so that tables in logs are not cut."""
    from rich.console import Console

    return Console(width=None if sys.stdout.isatty() else 160)


def program() -> str:
    """What to type for this program: its name where the shell finds it, else as it was called."""
    if shutil.which("dynaviz"):
        return "dynaviz"
    return sys.argv[0] if Path(sys.argv[0]).name == "dynaviz" else f"{sys.executable} -m dynaviz"


def written(folder: Path, recorded: bool) -> str:
    """Where a run is, and how to look at it."""
    return f"Written to {folder}." + (f" Look at it: {program()} view {folder / 'run.rrd'}" if recorded else "")


def show(*what: RenderableType) -> None:
    """Print with styles where the terminal has them."""
    out = console()
    for item in what:
        out.print(item)


@contextlib.contextmanager
def progress(title: str) -> Iterator[Progress]:
    """Give a function that is told (phase, done, total) and shows it on standard error."""
    if sys.stderr.isatty():
        with _bars(title) as tell:
            yield tell
    else:
        yield _lines(title)


@contextlib.contextmanager
def _bars(title: str) -> Iterator[Progress]:
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description:<32}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bars:
        tasks: dict[str, int] = {}

        def tell(phase: str, done: int, total: int) -> None:
            if phase not in tasks:
                tasks[phase] = bars.add_task(f"{title}: {phase}", total=total)
            bars.update(tasks[phase], completed=done)  # type: ignore[arg-type]

        yield tell


def _lines(title: str) -> Progress:
    said: dict[str, float] = {}

    def tell(phase: str, done: int, total: int) -> None:
        now = time.monotonic()
        if done == total or now - said.setdefault(phase, now) > QUIET:
            said[phase] = now
            print(f"{title}: {phase} {done}/{total}", file=sys.stderr, flush=True)

    return tell

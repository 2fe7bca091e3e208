"""The command line: one file per verb, thin. Nothing heavy is imported before a verb needs it."""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import warnings
from collections.abc import Iterator
from types import FrameType
from typing import Any

import typer
from typer.core import TyperGroup

from dynaviz.cli import (
    bench,
    check,
    compare,
    config,
    convert,
    demo,
    doctor,
    download,
    export_labels,
    failures,
    info,
    list,
    repair,
    report,
    run,
    score,
    shot,
    simulate,
    view,
)
from dynaviz.errors import DynavizError, UsageError

WRONG_USAGE: Any = typer.BadParameter.__mro__[1]  # UsageError of click, or of the copy of it that typer has


class Commands(TyperGroup):
    """The verbs; wrong words after one are told in a line, as all else that a user can cause."""

    def invoke(self, ctx: Any) -> Any:
        """Run the verb that was typed."""
        try:
            return super().invoke(ctx)
        except WRONG_USAGE as error:
            problem = error.format_message().replace("Value error, ", "")
            help = f"{(error.ctx or ctx).command_path} --help"
            end = "" if problem.endswith((".", "?")) else "."
            raise UsageError(f"{problem[0].lower()}{problem[1:]}{end} Examples: {help}") from error


app = typer.Typer(
    name="dynaviz",
    cls=Commands,
    help="Clean LiDAR maps of moving objects, score the cleaning point by point, and replay every mistake.",
    epilog="Start with: dynaviz demo",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)
VERBS = (
    demo, run, score, failures, compare, bench, report, check, info, doctor, list, config, simulate, download, convert,
    export_labels, view, shot, repair
)  # fmt: skip
for verb in VERBS:
    verb.add_to(app)


def main() -> None:
    """Run a command; exit 0 done, 1 a check fell, 2 wrong usage or unusable input, 130 interrupted, 143 terminated."""
    signal.signal(signal.SIGTERM, _terminate)
    try:
        with _warnings_in_lines():
            app(standalone_mode=True)
    except DynavizError as error:
        if os.environ.get("DYNAVIZ_DEBUG"):
            raise
        print("dynaviz:", error, *_notes(error), file=sys.stderr)
        sys.exit(2)
    except (KeyboardInterrupt, SystemExit) as end:
        code = 130 if isinstance(end, KeyboardInterrupt) else end.code
        if code in (130, 143):
            print("dynaviz:", "interrupted." if code == 130 else "terminated.", *_notes(end), file=sys.stderr)
        sys.exit(code)


@contextlib.contextmanager
def _warnings_in_lines() -> Iterator[None]:
    """Tell each warning to users in a line, once; those to programmers come as Python shows them."""
    told, shown = set(), warnings.showwarning

    def show(message: Warning | str, category: type[Warning], *place: Any, **more: Any) -> None:
        line = f"dynaviz: warning: {str(message).removesuffix('.')}."
        if not issubclass(category, UserWarning):
            shown(message, category, *place, **more)
        elif line not in told:
            told.add(line)
            print(line, file=sys.stderr)

    with warnings.catch_warnings():
        warnings.simplefilter("always", UserWarning)
        warnings.showwarning = show
        yield


def _notes(error: BaseException | None) -> Iterator[str]:
    """What was added to an error on its way here, as where the rest of a recording lies; each once."""
    notes: dict[str, None] = {}
    while error is not None:
        notes |= dict.fromkeys(f"{note}." for note in getattr(error, "__notes__", ()))
        error = error.__cause__ or error.__context__
    yield from notes


def _terminate(number: int, frame: FrameType | None) -> None:
    """End as by an exception, so that files are closed or removed."""
    sys.exit(128 + number)

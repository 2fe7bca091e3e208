"""The command line: one small file per command.

Heavy modules are imported only by the commands that need them.

Private: other packages do not import it.
"""

from __future__ import annotations

import contextlib
import errno
import importlib
import itertools
import os
import signal
import sys
import warnings
from collections.abc import Iterator
from types import FrameType
from typing import Annotated, Any, NoReturn

import typer

from dynaviz.cli.console import set_quiet
from dynaviz.cli.groups import GROUPS, Command, CommandLineError, Commands
from dynaviz.errors import DataError, DynavizError, interrupted, on_command_line

__all__ = ["CommandLineError", "app", "main"]

START = """\b
Start with:
  dynaviz demo                           see it work on a simulated street
  dynaviz clean drive.bag -o clean.laz   clean your own data
  dynaviz explore clean_run              see and correct what was removed
"""

app = typer.Typer(
    name="dynaviz",
    cls=Commands,
    help="Remove dynamic points from LiDAR maps, score the result point by point, and replay every "
    "error.",
    epilog=START,
    no_args_is_help=True,
    context_settings={"help_option_names": ["-h", "--help"]},
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)
for name in itertools.chain(*GROUPS.values()):
    module = vars(importlib.import_module(f"{__name__}.{name}"))
    # list_, not to hide list
    app.command(name, cls=Command)(module[f"{name}_" if f"{name}_" in module else name])


def _show_version(wanted: bool) -> None:
    if wanted:
        from dynaviz import __version__

        print(f"dynaviz {__version__}")
        raise typer.Exit


@app.callback()
def _root(
    version: Annotated[
        bool,
        typer.Option(
            "--version", callback=_show_version, is_eager=True, help="Show the version and exit."
        ),
    ] = False,
) -> None:
    """Remove dynamic points from LiDAR maps, score the result point by point, and replay every
    error.
    """


def main() -> None:
    """Run a command.

    Exit codes: 0 done, 1 a check failed, 2 wrong usage or unusable input, 130 interrupted, 143
    terminated.
    """
    signal.signal(signal.SIGTERM, _terminate)
    try:
        with on_command_line():
            _run_command()
    finally:
        set_quiet(False)  # for whatever this process does next


def _run_command() -> None:
    try:
        with _one_line_warnings():
            app(standalone_mode=True)
    except DynavizError as error:
        if os.environ.get("DYNAVIZ_DEBUG"):
            raise
        print("dynaviz:", error, *_notes(error), file=sys.stderr)
        sys.exit(2)
    except SystemExit as end:
        _leave(end.code, end)
    except OSError as error:
        if error.errno != errno.ENAMETOOLONG:
            raise
        print(
            "dynaviz:",
            DataError(error.filename, "File name too long", hint="Give a shorter path"),
            file=sys.stderr,
        )
        sys.exit(2)
    except BaseException as error:
        if not interrupted(error):
            raise
        _leave(130, error)


def _leave(code: Any, end: BaseException) -> NoReturn:
    """Exit; if a signal ended the command, say so."""
    if code in (130, 143):
        print(
            "dynaviz:",
            "interrupted." if code == 130 else "terminated.",
            *_notes(end),
            file=sys.stderr,
        )
    sys.exit(code)


@contextlib.contextmanager
def _one_line_warnings() -> Iterator[None]:
    """Print each warning for users once, in one line.

    Warnings for programmers keep Python's format.
    """
    printed = set()
    showwarning = warnings.showwarning

    def show(
        message: Warning | str, category: type[Warning], *location: Any, **options: Any
    ) -> None:
        line = f"dynaviz: warning: {str(message).removesuffix('.')}."
        if not issubclass(category, UserWarning):
            showwarning(message, category, *location, **options)
        elif line not in printed:
            printed.add(line)
            print(line, file=sys.stderr)

    with warnings.catch_warnings():
        warnings.simplefilter("always", UserWarning)
        warnings.showwarning = show
        yield


def _notes(error: BaseException | None) -> Iterator[str]:
    """Notes that were added to an error, such as where a partial recording is; each once."""
    notes: dict[str, None] = {}
    while error is not None:
        notes |= dict.fromkeys(f"{note}." for note in getattr(error, "__notes__", ()))
        error = error.__cause__ or error.__context__
    yield from notes


def _terminate(number: int, frame: FrameType | None) -> None:
    """Exit through an exception, so that open files are closed or removed."""
    sys.exit(128 + number)

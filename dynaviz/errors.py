"""Errors caused by input or usage. Each message is one line: what happened, where, and what to do next."""

from __future__ import annotations

import os

_MAX_LENGTH = 2000  # characters


class DynavizError(Exception):
    """Base of all errors caused by input or usage; the command line prints the message and exits with code 2.

    The message is one line of limited length. Control characters, for example from a file's content, are escaped.
    """

    def __init__(self, message: str = "") -> None:
        if len(message) > _MAX_LENGTH:
            message = f"{message[: _MAX_LENGTH // 2]} ... {message[-_MAX_LENGTH // 2 :]}"
        super().__init__("".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in message))


class UsageError(DynavizError):
    """An invalid option, name or value."""


class DataError(DynavizError):
    """An invalid file or folder.

    The message reads ``PATH, AT: PROBLEM. HINT``.

    Args:
        path: the file or folder.
        problem: what is wrong, without a full stop.
        at: position in the file, for example ``byte 312`` or ``line 4``.
        hint: what to do next, a sentence without a full stop.
    """

    def __init__(self, path: str | os.PathLike[str], problem: str, *, at: str | None = None, hint: str | None = None):
        self.path, self.problem, self.at, self.hint = os.fspath(path), problem, at, hint
        place = self.path if at is None else f"{self.path}, {at}"
        super().__init__(f"{place}: {problem}." + (f" {hint}." if hint else ""))


class NoPoses(DataError):
    """Scans without poses; an odometry can estimate them."""


class PluginError(DynavizError):
    """A plug-in whose code cannot be loaded or violates its contract."""


class MissingDependency(DynavizError):
    """A missing dependency; the message gives the command that installs it."""


def interrupted(error: BaseException | None) -> bool:
    """Whether Ctrl-C caused an error; extension modules report it as an ImportError if it arrives while they load."""
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__ or error.__context__
    return error is not None

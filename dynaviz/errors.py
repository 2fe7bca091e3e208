"""What a user can cause: each message names the place and says what to do next, in one line."""

from __future__ import annotations

import os

_LONGEST = 2000  # characters


class DynavizError(Exception):
    """Base of all errors that a user can cause; the command line answers with its text and exit code 2.

    The text is one line that fits on a screen, whatever a file in question holds: control characters are escaped.
    """

    def __init__(self, message: str = "") -> None:
        if len(message) > _LONGEST:
            message = f"{message[: _LONGEST // 2]} ... {message[-_LONGEST // 2 :]}"
        super().__init__("".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in message))


class UsageError(DynavizError):
    """An option, name or value that cannot be used."""


class DataError(DynavizError):
    """A file or folder that cannot be used.

    The message reads ``PATH, AT: PROBLEM. HINT``.

    Args:
        path: the file or folder.
        problem: what is wrong with it, without a full stop.
        at: the place in the file, for example ``byte 312`` or ``line 4``.
        hint: what to do next, a sentence without a full stop.
    """

    def __init__(self, path: str | os.PathLike[str], problem: str, *, at: str | None = None, hint: str | None = None):
        self.path, self.problem, self.at, self.hint = os.fspath(path), problem, at, hint
        place = self.path if at is None else f"{self.path}, {at}"
        super().__init__(f"{place}: {problem}." + (f" {hint}." if hint else ""))


class PluginError(DynavizError):
    """A method, dataset or metric whose code cannot be loaded, or does not keep to its contract."""


class MissingDependency(DynavizError):
    """Something outside Python's packages that is needed here, with the command that installs it."""

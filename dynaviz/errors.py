"""Errors caused by input or usage. Each message is one line.

What happened, where, and what to do next.
"""

from __future__ import annotations

import contextlib
import os
import re
from collections.abc import Iterator

_MAX_LENGTH = 2000  # characters
_commands = False  # whether the reader typed a command; in all threads

# Options of the command line that are arguments of the Python functions as well, with or without a
# value.
_WITH_VALUE = (
    "frames|stride|sensor|poses|points-in|extrinsic|region|voxel-size|tiles|workers|scheduler"
    "|keep-dynamic|preset|config|seed|threads|record|record-budget|key|radius"
)
_SWITCHES = "deskew|refine-poses|mark|drop-unposed|online"
_VALUES = (
    "small-gicp|kiss-icp|sensor|world|autoware|none|errors"
    r"|(?=[^\s()]*[A-Z\d/.:#|])[^\s()]*[^\s().,:;']"
)
_OPTION = re.compile(
    rf"--(?:(?P<off>no-)?(?P<switch>{_SWITCHES})"
    r"|set (?P<parameter>\w+)=(?P<setting>[\w.-]*\w)"
    rf"|(?P<name>{_WITH_VALUE})(?: (?P<value>{_VALUES}))?)(?![\w-])"
)


@contextlib.contextmanager
def on_command_line() -> Iterator[None]:
    """Within it, texts name options as the command line has them.

    Otherwise as arguments of Python functions.
    """
    global _commands
    before = _commands
    _commands = True
    try:
        yield
    finally:
        _commands = before


def addressed(text: str) -> str:
    """A text for the user who reads it.

    In Python, ``--points-in world`` becomes ``points_in="world"``.
    """
    return text if _commands else _OPTION.sub(_argument, text)


def _argument(option: re.Match[str]) -> str:
    if option["switch"]:
        return f"{option['switch'].replace('-', '_')}={not option['off']}"
    if option["parameter"]:
        return f'settings={{"{option["parameter"]}": {option["setting"]}}}'
    name = option["name"].replace("-", "_")
    value = option["value"]
    if value is None:
        return name
    plain = re.fullmatch(r"[A-Z_|]+|\d+(\.\d+)?", value)  # a placeholder or a number
    return f"{name}={value}" if plain else f'{name}="{value}"'


class DynavizError(Exception):
    """Base of all errors caused by input or usage.

    The command line prints the message and exits with code 2.

    The message is one line of limited length. Control characters, for example from a file's
    content, are escaped.
    """

    def __init__(self, message: str = "") -> None:
        if len(message) > _MAX_LENGTH:
            message = f"{message[: _MAX_LENGTH // 2]} ... {message[-_MAX_LENGTH // 2 :]}"
        super().__init__(
            "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in message)
        )

    def __str__(self) -> str:
        return addressed(super().__str__())


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

    def __init__(
        self,
        path: str | os.PathLike[str],
        problem: str,
        *,
        at: str | None = None,
        hint: str | None = None,
    ):
        self.path = os.fspath(path)
        self.problem = problem
        self.at = at
        self.hint = hint
        place = self.path if at is None else f"{self.path}, {at}"
        super().__init__(f"{place}: {problem}." + (f" {hint}." if hint else ""))


class NoPoses(DataError):
    """Scans without poses; an odometry can estimate them."""


class PluginError(DynavizError):
    """A plug-in whose code cannot be loaded or violates its contract."""


class MissingDependency(DynavizError):
    """A missing dependency; the message gives the command that installs it."""


def interrupted(error: BaseException | None) -> bool:
    """Whether Ctrl-C caused an error.

    Extension modules report it as an ImportError if it arrives while they load.
    """
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__ or error.__context__
    return error is not None

"""Commands that read recordings run in a child process, so that the crash of a library gives one
line.

Rerun and Arrow are compiled, and a damaged file can make them abort the whole process, which no
``except`` catches. ``viz/chunks.py`` refuses such files before, but no such check is complete.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import signal
import sys
import tempfile
from collections.abc import Callable, Sequence
from types import FrameType
from typing import IO, Any

READING = ("info", "compare", "report", "why")
"""Commands that read recordings and end on their own."""
_SIGNALS = (signal.SIGINT, signal.SIGTERM)
_DIE_WITH_PARENT = 1  # PR_SET_PDEATHSIG


def run(command: Callable[[], None], words: Sequence[str]) -> None:
    """Run a command line, in a child process if it reads recordings and the system can fork.

    To be called before libraries are loaded: a process with threads does not fork safely.

    Args:
        command: runs the command line.
        words: the command line without the name of the program.
    """
    if not _reads(words) or not hasattr(os, "fork"):
        command()
        return
    with tempfile.TemporaryFile() as messages:
        signal.pthread_sigmask(signal.SIG_BLOCK, _SIGNALS)
        child = os.fork()
        if not child:
            _begin(messages)
            command()
            return
        code = _wait(child)
        if code >= 0 or os.environ.get("DYNAVIZ_DEBUG"):
            messages.seek(0)
            sys.stderr.write(messages.read().decode(errors="replace"))
    if -code in _SIGNALS:
        code = 128 - code
    elif code < 0:
        print("dynaviz:", _crash(-code, words), file=sys.stderr)
        code = 2
    sys.exit(code)


def without_pandas() -> None:
    """Arrow imports pandas before it converts its first array, for 0.15 s and 25 MB.

    Tell it that there is none.
    """
    if "pandas" not in sys.modules:
        import pyarrow

        absent = _Absent()
        sys.meta_path.insert(0, absent)
        try:
            pyarrow.array(memoryview(b""))
        finally:
            sys.meta_path.remove(absent)


class _Absent:
    """Finds no module pandas."""

    def find_spec(self, name: str, *place: Any) -> None:
        if name == "pandas":
            raise ModuleNotFoundError(name=name)


def _reads(words: Sequence[str]) -> bool:
    """Whether a command reads recordings and ends on its own.

    ``view`` does if it renders pictures.
    """
    pictures = any(word.startswith(("-o", "--out", "--clip")) for word in words)
    return bool(words) and (words[0] in READING or (words[0] == "view" and pictures))


def _begin(messages: IO[bytes]) -> None:
    """In the child: libraries print to a file, so that their last words before a crash can be left
    out.
    """
    with contextlib.suppress(OSError, AttributeError):  # only Linux has this
        ctypes.CDLL(None).prctl(_DIE_WITH_PARENT, signal.SIGKILL)
    with contextlib.suppress(OSError, AttributeError):  # standard error may be closed
        to_user = os.fdopen(
            os.dup(2), "w", buffering=1, encoding=sys.stderr.encoding, errors=sys.stderr.errors
        )
        os.dup2(messages.fileno(), 2)
        sys.stderr = sys.__stderr__ = to_user  # type: ignore[misc]
    signal.pthread_sigmask(signal.SIG_UNBLOCK, _SIGNALS)


def _wait(child: int) -> int:
    """The exit code of the child; minus a signal's number if that ended it."""

    def forward(number: int, frame: FrameType | None) -> None:
        if number != signal.SIGINT or not _in_foreground():
            with contextlib.suppress(ProcessLookupError):
                os.kill(child, number)

    for number in _SIGNALS:
        signal.signal(number, forward)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, _SIGNALS)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def _in_foreground() -> bool:
    """Whether Ctrl-C in the terminal reaches this process and its child."""
    try:
        with open("/dev/tty", "rb", buffering=0) as terminal:
            return os.tcgetpgrp(terminal.fileno()) == os.getpgrp()
    except OSError:
        return False


def _crash(number: int, words: Sequence[str]) -> str:
    """One line about a child that a signal ended."""
    name = signal.Signals(number).name
    if number == signal.SIGKILL:
        return f"{words[0]} was killed ({name}). Most likely the memory ran out."
    return f"{words[0]}: a library crashed ({name}). Most likely a file is damaged."

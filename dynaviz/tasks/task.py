"""The contract of a task: a piece of work whose files end up in a folder of its own."""

from __future__ import annotations

import contextlib
import json
import traceback
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Protocol, TypeVar

from dynaviz.errors import DynavizError
from dynaviz.io.atomic import write_atomic
from dynaviz.progress import Progress

ERRORS = ("error.json", "error.log")


class Task(Protocol):
    """A piece of work. It is pickled and sent to the process that runs it."""

    @property
    def path(self) -> Path:
        """Its folder, relative to that of the whole work."""
        ...

    @property
    def files(self) -> tuple[str, ...]:
        """The files that it may write. The last one is written last.

        If it exists, the others are complete.
        """
        ...

    @property
    def facts(self) -> Mapping[str, str]:
        """What ``error.json`` says about it besides the error."""
        ...

    @property
    def kind(self) -> str:
        """What it is called in errors."""
        ...

    @property
    def smaller(self) -> str:
        """How the user can make its files smaller, a sentence."""
        ...

    def run(self, folder: Path, threads: int | None, progress: Progress) -> Any:
        """Do the work in this process. The folder contains none of the files.

        Raises:
            DynavizError: for errors that the user can fix; all errors end up in ``error.json``.
        """
        ...

    def finished(self, folder: Path) -> bool:
        """Whether the folder contains the complete and right files."""
        ...


AnyTask = TypeVar("AnyTask", bound=Task)
TaskProgress = Callable[[AnyTask, str, int, int], None]
"""Called with a task, a phase of its run, the number of frames done and their total."""


def clear(task: Task, folder: Path) -> None:
    """Remove the files of an earlier run.

    The last one first, because its presence marks the others as complete.
    """
    for name in (*reversed(task.files), *ERRORS):
        (folder / name).unlink(missing_ok=True)


def fail(task: Task, folder: Path, error: str) -> None:
    """Write ``error.json`` in place of the answer."""
    (folder / task.files[-1]).unlink(missing_ok=True)
    write_atomic(
        folder / "error.json", json.dumps({**task.facts, "error": error}, indent=1).encode()
    )


def error_of(folder: Path) -> str | None:
    """The error in the ``error.json`` of a folder, or None."""
    with contextlib.suppress(OSError, ValueError, KeyError, TypeError):
        return str(json.loads((folder / "error.json").read_bytes())["error"])
    return None


def sentence(error: BaseException) -> str:
    """An error in one line; errors other than ``DynavizError`` with their type."""
    if isinstance(error, DynavizError):
        return str(error)
    return " ".join("".join(traceback.format_exception_only(error)).split())

"""Lock a folder for the process that writes into it."""

from __future__ import annotations

import contextlib
import json
import os
import shlex
import socket
import sys
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

from dynaviz.errors import DataError
from dynaviz.io.atomic import write_error

NAME = ".dynaviz.lock"
_KILLED = 10.0  # seconds after which a process that clears an old lock must have been killed
_PATIENCE = 1.0  # seconds that a process may take from creating its lock to writing who it is


@dataclass(frozen=True)
class Owner:
    """The process that holds a lock.

    Attributes:
        pid: its number.
        host: its machine.
        started: when it started, seconds since 1970: numbers of processes are used again.
        command: what it was called with.
    """

    pid: int
    host: str
    started: float
    command: str

    @classmethod
    def here(cls, command: str = "") -> Owner:
        """This process; its own arguments if no command is given."""
        import psutil

        started = psutil.Process().create_time()
        return cls(
            os.getpid(), socket.gethostname(), started, command or shlex.join(sys.argv)[:500]
        )

    @classmethod
    def of(cls, path: Path) -> Owner | None:
        """The process in a lock file; None if the file is gone or unreadable."""
        try:
            plain = json.loads(path.read_bytes())
            return cls(
                int(plain["pid"]),
                str(plain["host"]),
                float(plain["started"]),
                str(plain["command"]),
            )
        except (OSError, ValueError, TypeError, KeyError):
            return None

    def ended(self) -> bool:
        """Whether the process has ended.

        False for one on another machine, of which this is unknown.
        """
        import psutil

        if self.host != socket.gethostname():
            return False
        try:
            return bool(abs(psutil.Process(self.pid).create_time() - self.started) > 1)
        except psutil.NoSuchProcess:
            return True


@contextlib.contextmanager
def locked(folder: Path, command: str = "", name: str = NAME) -> Iterator[None]:
    """Let no other process write into a folder, which is created if it does not exist.

    The lock is a file in the folder, with the command. A killed process leaves it behind; it then
    has no effect. With another name, the lock guards one file of the folder.

    Raises:
        DataError: if a process, named in the message, holds the lock, or the folder cannot be
            written.
    """
    path = folder / name
    try:
        folder.mkdir(parents=True, exist_ok=True)
        while not _create(path, Owner.here(command)):
            _clear(path)
    except OSError as error:
        raise write_error(folder, error, "another folder with -o") from None
    try:
        yield
    finally:
        with contextlib.suppress(OSError):
            path.unlink()


def unfinished(folder: Path) -> DataError | None:
    """The error for a folder whose writer was killed, or is still writing.

    None for any other folder.
    """
    owner = Owner.of(folder / NAME)
    if owner is None:
        return None
    if owner.ended():
        return DataError(
            folder, "contains an unfinished run", hint=f"To finish it, run again: {owner.command}"
        )
    return _in_use(folder, owner)


def _create(path: Path, owner: Owner) -> bool:
    """Create the file; False if it exists."""
    try:
        file = os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY)
    except FileExistsError:
        return False
    try:
        with os.fdopen(file, "wb") as out:
            out.write(json.dumps(asdict(owner)).encode())
    except OSError:
        path.unlink(missing_ok=True)
        raise
    return True


def _clear(path: Path) -> None:
    """Remove the lock of a process that ended.

    Raises:
        DataError: if the process is alive.
    """
    # only one process at a time may remove a lock that is not its own
    guard = path.with_name(f"{path.name}.clearing")
    try:
        guard.mkdir()
    except FileExistsError:
        _wait_for(guard)
        return
    try:
        owner = Owner.of(path)
        if owner is not None and not owner.ended():
            raise _in_use(path.parent, owner)
        if owner is not None or _age(path) > _PATIENCE:
            path.unlink(missing_ok=True)
    finally:
        guard.rmdir()
    if owner is None:
        time.sleep(0.01)  # its process is about to write who it is


def _age(path: Path) -> float:
    """Seconds since a file or folder was last written; 0 if it is gone."""
    try:
        return time.time() - path.stat().st_mtime
    except OSError:
        return 0.0


def _wait_for(guard: Path) -> None:
    """Wait a moment for another process to remove an old lock.

    One that was killed at it has no effect later.
    """
    time.sleep(0.01)
    if _age(guard) > _KILLED:
        with contextlib.suppress(OSError):
            guard.rmdir()


def _in_use(folder: Path, owner: Owner) -> DataError:
    """The error for a folder into which a process writes."""
    problem = f"process {owner.pid} on {owner.host} ({owner.command}) is writing into this folder"
    hint = "Wait until it has ended, or choose another folder with -o"
    if owner.host != socket.gethostname():
        hint += f"; if it was killed, remove {folder / NAME}"
    return DataError(folder, problem, hint=hint)

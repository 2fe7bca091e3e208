"""Writing the file of a recording so that errors are noticed.

Through a pipe on Linux, directly elsewhere.
"""

from __future__ import annotations

import contextlib
import os
import select
import struct
import sys
import threading
import time
from pathlib import Path

try:
    import fcntl
    import termios
except ImportError:  # Windows
    PIPES = False
else:
    PIPES = sys.platform == "linux"  # the pipe is opened by its path in /dev/fd

PIPE_BYTES = 1 << 20


class FileWriter:
    """A file that a library writes by its path.

    Args:
        path: the file; existing content is lost.

    Raises:
        OSError: if it cannot be opened.
    """

    def __init__(self, path: Path) -> None:
        self._file = path.open("wb", buffering=0)
        self._path = path

    @property
    def inlet(self) -> str:
        """The path to write to."""
        return str(self._path)

    def settle(self) -> None:
        """Wait until everything written to the inlet is in the file.

        Raises:
            OSError: if writing failed, now or earlier; only ``PipeWriter`` notices.
        """

    def close(self) -> None:
        """Close the file, after the library has closed the inlet. May be called again.

        Raises:
            OSError: as ``settle``.
        """
        self._file.close()


class PipeWriter(FileWriter):
    """A file that a library writes through a pipe, so that write errors are raised here.

    Rerun writes files on its own thread. On a full disk that thread stops with a message on the
    screen, and later calls of ``flush`` may block forever. The pipe is always read, so nothing
    blocks, and this class raises the error.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._error: OSError | None = None
        self._closing = False
        self._copying = threading.Lock()
        self._out, self._in = os.pipe()
        with contextlib.suppress(
            OSError
        ):  # more than the system allows; a small pipe is only slower
            fcntl.fcntl(self._in, fcntl.F_SETPIPE_SZ, PIPE_BYTES)
        self._thread = threading.Thread(target=self._copy, name="recording", daemon=True)
        self._thread.start()

    @property
    def inlet(self) -> str:
        """The path to write to."""
        return f"/dev/fd/{self._in}"

    def settle(self) -> None:
        """Wait until everything written to the inlet is in the file."""
        while True:
            with self._copying:
                if self._error is not None:
                    raise self._error
                if not _pending_bytes(self._out):
                    return
            time.sleep(0)  # let the thread run

    def close(self) -> None:
        """Close the file, after the library has closed the inlet."""
        if self._file.closed:
            return
        try:
            self.settle()
        finally:
            self._closing = True
            os.write(self._in, b"\0")  # wakes the thread; nothing else writes any more
            self._thread.join()
            for end in (self._in, self._out):
                os.close(end)
            self._file.close()

    def _copy(self) -> None:
        ready = select.poll()
        ready.register(self._out, select.POLLIN)
        while not self._closing:
            ready.poll()
            with self._copying:
                if not self._closing:
                    self._write(os.read(self._out, PIPE_BYTES))

    def _write(self, data: bytes) -> None:
        rest = memoryview(data)
        try:
            while rest and self._error is None:
                rest = rest[self._file.write(rest) :]
        except OSError as error:
            self._error = error  # keep reading, so that the library does not block


def open_writer(path: Path) -> FileWriter:
    """Open the file of a recording for a library that writes it by its path.

    Raises:
        OSError: if it cannot be opened.
    """
    return PipeWriter(path) if PIPES else FileWriter(path)


def _pending_bytes(end: int) -> int:
    """Number of bytes in a pipe."""
    count: int = struct.unpack("i", fcntl.ioctl(end, termios.FIONREAD, bytes(4)))[0]
    return count

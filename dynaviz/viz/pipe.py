"""Where the bytes of a recording go: through a pipe, and into the file by our own hand."""

from __future__ import annotations

import contextlib
import fcntl
import os
import select
import struct
import termios
import threading
import time
from pathlib import Path
from typing import Any

PIPE_BYTES = 1 << 20


class PipeWriter:
    """A file that a library writes by its path; what goes wrong in writing is told here, whatever the library does.

    Rerun writes files on a thread of its own. On a full disk that thread ends with a message on the screen, and whoever
    flushes after it may wait for ever. A pipe never fills up as long as this reads it, so nobody waits, and the error
    is ours to raise.

    Args:
        path: the file; what was there is lost.

    Raises:
        OSError: where it cannot be opened.
    """

    def __init__(self, path: Path) -> None:
        self._error: OSError | None = None
        self._closing = False
        self._copying = threading.Lock()
        self._file = path.open("wb", buffering=0)
        self._out, self._in = os.pipe()
        with contextlib.suppress(OSError, AttributeError):  # not on every system; a small pipe is only slower
            fcntl.fcntl(self._in, fcntl.F_SETPIPE_SZ, PIPE_BYTES)
        self._thread = threading.Thread(target=self._copy, name="tap", daemon=True)
        self._thread.start()

    def __enter__(self) -> PipeWriter:
        return self

    def __exit__(self, *error: Any) -> None:
        self.close()

    @property
    def inlet(self) -> str:
        """The path to write to."""
        return f"/dev/fd/{self._in}"

    def settle(self) -> None:
        """Wait until all that went into the inlet is in the file.

        Raises:
            OSError: where it could not be written, now or earlier.
        """
        while True:
            with self._copying:
                if self._error is not None:
                    raise self._error
                if not _waiting(self._out):
                    return
            time.sleep(0)  # for the thread to take its turn

    def close(self) -> None:
        """Close the file, once the library has closed the inlet; may be called again.

        Raises:
            OSError: as ``settle``.
        """
        if self._file.closed:
            return
        try:
            self.settle()
        finally:
            self._closing = True
            os.write(self._in, b"\0")  # wakes the thread; nobody else writes any more
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
            self._error = error  # and read on, so that nobody waits


def _waiting(end: int) -> int:
    """How many bytes wait in a pipe."""
    count: int = struct.unpack("i", fcntl.ioctl(end, termios.FIONREAD, bytes(4)))[0]
    return count

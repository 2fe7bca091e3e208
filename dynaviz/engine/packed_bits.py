"""One bit per point: packed answers of runs of any length."""

from __future__ import annotations

import hashlib
import tempfile
import weakref
from typing import IO

import numpy as np

from dynaviz.arrays import U8, Bool

HELD = 1 << 23  # bytes in memory; more are stored in a temporary file


class PackedBits:
    """Booleans appended frame by frame, packed without gaps.

    ``np.unpackbits(packed)[:n]`` gives them back.

    Args:
        held: bytes in memory; more are stored in a temporary file, deleted when nothing uses it any
            more.
    """

    def __init__(self, held: int = HELD) -> None:
        self._bytes = bytearray()
        self._held = held
        self._file: IO[bytes] | None = None
        self._rest: Bool = np.empty(0, np.bool_)
        self._digest = hashlib.sha256()

    def append(self, bits: Bool) -> None:
        """Add (N,) bool."""
        bits = np.concatenate([self._rest, bits])
        whole = len(bits) // 8 * 8
        packed = np.packbits(bits[:whole]).tobytes()
        self._digest.update(packed)
        self._bytes += packed
        self._rest = bits[whole:]
        if len(self._bytes) > self._held:
            self._store()

    def packed(self) -> U8:
        """All bits so far, the last byte filled up with zeros.

        Read from the file as needed if there is one.
        """
        rest = np.packbits(self._rest).tobytes()
        if self._file is None:
            return np.frombuffer(bytes(self._bytes) + rest, np.uint8)
        self._store()
        stored = self._file.tell()
        self._file.write(rest)
        self._file.flush()
        packed = np.memmap(self._file, np.uint8, "r", shape=(stored + len(rest),))
        self._file.seek(stored)
        return packed

    def sha256(self) -> str:
        """Digest of ``packed()``."""
        digest = self._digest.copy()
        digest.update(np.packbits(self._rest).tobytes())
        return digest.hexdigest()

    def _store(self) -> None:
        if self._file is None:
            self._file = tempfile.TemporaryFile()  # noqa: SIM115  # closed with this object
            weakref.finalize(self, self._file.close)
        self._file.write(self._bytes)
        self._bytes.clear()

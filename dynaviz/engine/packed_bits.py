"""One bit per point: packed answers of runs of any length."""

from __future__ import annotations

import hashlib

import numpy as np

from dynaviz.arrays import U8, Bool


class PackedBits:
    """Booleans appended frame by frame, packed without gaps: ``np.unpackbits(packed)[:n]`` gives them back."""

    def __init__(self) -> None:
        self._bytes = bytearray()
        self._rest: Bool = np.empty(0, np.bool_)

    def append(self, bits: Bool) -> None:
        """Add (N,) bool."""
        bits = np.concatenate([self._rest, bits])
        whole = len(bits) // 8 * 8
        self._bytes += np.packbits(bits[:whole]).tobytes()
        self._rest = bits[whole:]

    def packed(self) -> U8:
        """All bits so far, the last byte filled up with zeros."""
        return np.frombuffer(bytes(self._bytes) + np.packbits(self._rest).tobytes(), np.uint8)

    def sha256(self) -> str:
        """Digest of ``packed()``."""
        return hashlib.sha256(self.packed().tobytes()).hexdigest()

"""LZF, the compression of PCD's ``binary_compressed``: runs of literals, and copies from up to 8 KiB back."""

import numpy as np
from numba import njit

_BITS = 14
_FAR = 1 << 13  # maximum distance of a copy, bytes
_LONG = 264  # maximum length of a copy, bytes
_RUN = 32  # maximum length of a run of literals, bytes


@njit(cache=True, nogil=True)
def decompress(source, out):
    """Decompress ``source`` into ``out``, both uint8; return -1, or the position in ``source`` of the first error."""
    i = 0
    o = 0
    n = len(source)
    while i < n:
        at = i
        control = int(source[i])
        i += 1
        if control < _RUN:
            length = control + 1
            if i + length > n or o + length > len(out):
                return at
            for k in range(length):
                out[o + k] = source[i + k]
            i += length
        else:
            length = (control >> 5) + 2
            if length == 9:
                if i >= n:
                    return at
                length += int(source[i])
                i += 1
            if i >= n:
                return at
            back = o - ((control & 31) << 8) - int(source[i]) - 1
            i += 1
            if back < 0 or o + length > len(out):
                return at
            for k in range(length):  # byte by byte, since the copy may overlap itself
                out[o + k] = out[back + k]
        o += length
    return -1 if o == len(out) else n


@njit(cache=True, nogil=True)
def compress(source, out):
    """Compress ``source`` into ``out``, both uint8; return the bytes written, at most len(source) * 33 / 32 + 2."""
    table = np.full(1 << _BITS, -1, np.int64)
    n = len(source)
    i = 0
    o = 1
    start = 0  # position of the control byte of the current run of literals
    run = 0
    while i < n:
        length = 0
        back = 0
        if i + 2 < n:
            triple = (np.uint32(source[i]) << 16) | (np.uint32(source[i + 1]) << 8) | np.uint32(source[i + 2])
            slot = (triple * np.uint32(2654435761) & np.uint32(0xFFFFFFFF)) >> np.uint32(32 - _BITS)
            seen = int(table[slot])
            table[slot] = i
            if seen >= 0 and i - seen <= _FAR:
                most = min(_LONG, n - i)
                while length < most and source[seen + length] == source[i + length]:
                    length += 1
                back = i - seen - 1
        if length < 3:
            out[o] = source[i]
            i += 1
            o += 1
            run += 1
            if run == _RUN:
                out[start] = run - 1
                start = o
                o += 1
                run = 0
            continue
        if run:
            out[start] = run - 1
        else:
            o -= 1
        if length < 9:
            out[o] = ((length - 2) << 5) | (back >> 8)
            o += 1
        else:
            out[o] = (7 << 5) | (back >> 8)
            out[o + 1] = length - 9
            o += 2
        out[o] = back & 255
        start = o + 1
        o += 2
        run = 0
        i += length
    if run:
        out[start] = run - 1
    else:
        o -= 1
    return o

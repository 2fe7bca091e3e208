"""LZF, the compression of PCD's ``binary_compressed``.

Runs of literals, and copies from up to 8 KiB back.
"""

from numba import njit

_RUN = 32  # maximum length of a run of literals, bytes


@njit(cache=True, nogil=True)
def decompress(source, out):
    """Decompress ``source`` into ``out``, both uint8.

    Return -1, or the position in ``source`` of the first error.
    """
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

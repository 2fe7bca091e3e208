"""Reason codes of points.

In memory, four bits per point, because methods store them for every point of a sequence.
"""

from __future__ import annotations

import numpy as np

from dynaviz.arrays import U8


def pack_codes(codes: U8) -> U8:
    """Pack codes (N,) uint8 from 0 to 15, two per byte: ((N + 1) // 2,) uint8."""
    even, odd = np.append(codes, np.zeros(len(codes) & 1, np.uint8)).reshape(-1, 2).T
    packed: U8 = even | odd << np.uint8(4)
    return packed


def unpack_codes(packed: U8, n: int) -> U8:
    """The first ``n`` codes, (n,) uint8, that ``pack_codes`` packed."""
    codes: U8 = np.stack([packed & 15, packed >> 4], 1).ravel()[:n]
    return codes

"""GPS time, which counts no leap seconds, and Unix time, which bags have."""

from __future__ import annotations

from datetime import UTC, datetime

import numpy as np

from dynaviz.arrays import F64, I64

GPS_EPOCH = 315_964_800
"""Unix time of 1980-01-06, seconds."""

ADJUSTED = 1_000_000_000
"""Seconds that LAS subtracts from GPS time, so that float64 has tenths of microseconds (adjusted standard GPS time)."""

# Days at whose begin a leap second was inserted since the GPS epoch (IERS Bulletin C 70: none after 2017).
_INSERTED = (
    (1981, 7), (1982, 7), (1983, 7), (1985, 7), (1988, 1), (1990, 1), (1991, 1), (1992, 7), (1993, 7), (1994, 7),
    (1996, 1), (1997, 7), (1999, 1), (2006, 1), (2009, 1), (2012, 7), (2015, 7), (2017, 1),
)  # fmt: skip
_LEAPS = np.array([datetime(year, month, 1, tzinfo=UTC).timestamp() for year, month in _INSERTED])


def leap_offset(unix: float) -> float:
    """Seconds to add to GPS time to get Unix time, at a Unix time in seconds."""
    return float(GPS_EPOCH - np.searchsorted(_LEAPS, unix, side="right"))


def adjusted_gps_time(unix_ns: I64) -> F64:
    """(N,) float64, seconds: adjusted standard GPS time of Unix times, (N,) int64 nanoseconds, of one sweep."""
    offset = ADJUSTED + (leap_offset(float(unix_ns[0]) / 1e9) if len(unix_ns) else 0.0)
    whole, rest = np.divmod(unix_ns, 1_000_000_000)
    seconds: F64 = (whole - int(offset)) + rest * 1e-9
    return seconds

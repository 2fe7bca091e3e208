"""How the clock of poses may differ from that of scans."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from dynaviz.arrays import I64
from dynaviz.io.las import leap_offset

WEEK = 604_800 * 10**9  # nanoseconds; GPS time may be that of the week
GPS_EPOCH = 315_964_800  # seconds since 1970
ADJUSTED = 10**9  # seconds; LAS stores GPS time minus this
TAI = 19  # seconds that TAI is ahead of GPS time
INSIDE = 0.9  # share of the scans that the poses cover on the right clock
SPAN = 0.25  # share by which the spans of scans and poses may differ if both start at once


def offsets(scans: I64, poses: I64) -> Mapping[str, int]:
    """Nanoseconds to add to the times of poses, by the reason; only those that cover most scans.

    Args:
        scans, poses: (N,), (K,) int64, nanoseconds.
    """
    found: dict[str, int] = {}
    first = int(poses.min())
    for name, shift in _known(scans, poses):
        if shift and covered(scans, poses + shift) >= INSIDE:
            found.setdefault(name, shift)
    start = int(scans.min()) - first
    spans = float(np.ptp(scans)), float(np.ptp(poses))
    if not found and start and abs(spans[0] - spans[1]) <= SPAN * max(spans):
        found["both start at the same moment"] = start
    return found


def covered(scans: I64, poses: I64) -> float:
    """Share of the scans within the span of the poses, give or take a step of the scans."""
    slack = np.ptp(scans) / max(len(scans) - 1, 1) + 1e6
    inside = (scans >= poses.min() - slack) & (scans <= poses.max() + slack)
    return float(inside.mean())


def _known(scans: I64, poses: I64) -> list[tuple[str, int]]:
    """Differences of known clocks."""
    at = float(scans[0]) / 1e9
    to_unix = round(leap_offset(at))  # from GPS time
    leaps = GPS_EPOCH - to_unix
    second = 10**9
    found = [
        (f"leap seconds ({leaps} s)", -leaps * second),
        (f"leap seconds ({leaps} s)", leaps * second),
        (f"leap seconds of TAI ({leaps + TAI} s)", -(leaps + TAI) * second),
        (f"leap seconds of TAI ({leaps + TAI} s)", (leaps + TAI) * second),
        ("GPS time instead of Unix time", to_unix * second),
        ("Unix time instead of GPS time", -to_unix * second),
        ("adjusted GPS time instead of Unix time", (to_unix + ADJUSTED) * second),
        ("Unix time instead of adjusted GPS time", -(to_unix + ADJUSTED) * second),
        ("Unix time since 1980", GPS_EPOCH * second),
    ]
    if 0 <= poses.min() < 2 * WEEK < scans.min():
        for shift in (to_unix, GPS_EPOCH, 0):
            weeks = (int(scans[0]) - shift * second) // WEEK
            for week in (weeks - 1, weeks):
                found.append(("seconds of the GPS week", week * WEEK + shift * second))
    if 0 <= scans.min() < 2 * WEEK < poses.min():
        for shift in (to_unix, GPS_EPOCH, 0):
            weeks = (int(poses[0]) - shift * second) // WEEK
            for week in (weeks, weeks + 1):
                found.append(("seconds of the GPS week", -(week * WEEK + shift * second)))
    return found

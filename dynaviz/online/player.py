"""Play a sequence to a live session at its own speed, and drop scans when late, as a robot does."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from itertools import chain, pairwise
from typing import Any, Protocol

import numpy as np

from dynaviz.contracts.method import Labels
from dynaviz.contracts.scan import Scan
from dynaviz.online.session import LiveSession

PERIOD = 0.1  # seconds between scans without stamps, unless the sensor's rate is known
QUANTILES = (50, 95, 99)


class PlayClock(Protocol):
    """Real or simulated time."""

    def now(self) -> float:
        """Seconds since any moment."""
        ...

    def sleep(self, seconds: float) -> None:
        """Let time pass."""
        ...


class WallClock:
    """Real time."""

    def now(self) -> float:
        """Seconds since any moment."""
        return time.perf_counter()

    def sleep(self, seconds: float) -> None:
        """Wait."""
        time.sleep(seconds)


@dataclass(frozen=True, eq=False)
class Played:
    """A scan that was labelled.

    Attributes:
        frame: its position among all scans, dropped ones included.
        scan: in the world frame.
        labels: of its points.
        seconds: how long the update took.
    """

    frame: int
    scan: Scan
    labels: Labels
    seconds: float


@dataclass
class PlayReport:
    """What was played.

    Attributes:
        method, source: names.
        rate: speed as a multiple of the recorded one; 0 for every scan, as fast as possible.
        dropped: positions of the scans that were dropped because a newer one had come.
        latencies: seconds of each update.
        points, dynamic: numbers over all labelled scans.
        seconds: how long it took in all.
        restarts: how often the map began anew.
    """

    method: str
    source: str
    rate: float
    dropped: list[int] = field(default_factory=list)
    latencies: list[float] = field(default_factory=list)
    points: int = 0
    dynamic: int = 0
    seconds: float = 0.0
    restarts: int = 0

    def latency(self, percent: float) -> float:
        """A quantile of the updates, seconds; NaN without any."""
        return float(np.percentile(self.latencies, percent)) if self.latencies else float("nan")

    def to_dict(self) -> dict[str, Any]:
        """Plain values, for JSON; latencies in milliseconds."""
        shown = {f"p{percent}_ms": round(1000 * self.latency(percent), 1) for percent in QUANTILES}
        return {
            "method": self.method,
            "source": self.source,
            "rate": self.rate,
            "frames": len(self.latencies) + len(self.dropped),
            "labelled": len(self.latencies),
            "dropped": self.dropped,
            "points": self.points,
            "dynamic_points": self.dynamic,
            "seconds": round(self.seconds, 3),
            "restarts": self.restarts,
            **(shown if self.latencies else {}),
        }

    def __str__(self) -> str:
        count = len(self.latencies)
        lost = len(self.dropped)
        share = 100 * self.dynamic / max(self.points, 1)
        lines = [
            f"{self.method} on {self.source}: {count} of {count + lost} scans labelled in "
            f"{self.seconds:.1f} s",
            f"dropped because a newer scan had come: {lost}",
            f"dynamic: {self.dynamic:,} of {self.points:,} points ({share:.1f} %)",
        ]
        if count:
            quantiles = ", ".join(
                f"p{percent} {1000 * self.latency(percent):.0f} ms" for percent in QUANTILES
            )
            lines.append(f"time per scan: {quantiles}, worst {1000 * max(self.latencies):.0f} ms")
        return "\n".join(lines)


def play(
    session: LiveSession,
    scans: Iterable[Scan],
    report: PlayReport,
    shown: Callable[[Played], None] = lambda played: None,
    clock: PlayClock | None = None,
    period: float = PERIOD,
) -> PlayReport:
    """Play scans; their stamps decide when each one comes.

    A scan is dropped if the next one has come before the session is ready for it: like a robot's
    queue of length one. Time stands still where the source is slower than its sensor, for example a
    simulation.

    Args:
        session: labels the scans.
        scans: in the world frame, in the order of time.
        report: with the names and the rate; filled, also if playing is interrupted, and returned.
        shown: called after each labelled scan; its time counts, too.
        clock: real time by default.
        period: seconds between scans that have no stamps.
    """
    clock = clock or WallClock()
    start = clock.now()
    asked = first = start
    try:
        for frame, (due, scan, next_due) in enumerate(_scheduled(scans, report.rate, period)):
            if report.rate > 0:
                now = clock.now() - start
                reading = min(clock.now() - asked, max(now - due, 0.0))
                start = start + reading
                now = now - reading
                if now >= next_due:
                    report.dropped.append(frame)
                    asked = clock.now()
                    continue
                if now < due:
                    clock.sleep(due - now)
            began = clock.now()
            labels = session.add(scan)
            seconds = clock.now() - began
            report.latencies.append(seconds)
            report.points += len(labels)
            report.dynamic += int(labels.dynamic.sum())
            shown(Played(frame, scan, labels, seconds))
            asked = clock.now()
    finally:
        report.seconds = clock.now() - first
        report.restarts = session.restarts
    return report


def _scheduled(
    scans: Iterable[Scan], rate: float, period: float
) -> Iterator[tuple[float, Scan, float]]:
    """When each scan comes, the scan, and when the next one comes, in seconds from the first on."""
    times = _Times(period, rate)
    for scan, following in pairwise(chain(scans, [None])):
        assert scan is not None
        due = times.of(scan)
        yield due, scan, np.inf if following is None else times.peek(following)


class _Times:
    """When scans come: by their stamps, or one period after the one before."""

    def __init__(self, period: float, rate: float) -> None:
        self._period = period
        self._rate = rate or 1.0
        self._first: int | None = None
        self._last = -period / self._rate

    def of(self, scan: Scan) -> float:
        """Seconds after the first scan at which this one comes.

        The next call is about a later one.
        """
        self._last = self.peek(scan)
        return self._last

    def peek(self, scan: Scan) -> float:
        """The same, without a step."""
        if scan.stamp_ns is None:
            return self._last + self._period / self._rate
        self._first = scan.stamp_ns if self._first is None else self._first
        return (scan.stamp_ns - self._first) / 1e9 / self._rate

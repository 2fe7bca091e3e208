"""Schedules: distance along a path over time, with smooth starts and stops."""

from __future__ import annotations

import numpy as np

from dynaviz.arrays import F64

STEP = 0.1  # seconds between knots while the speed changes


def cruise(start: float, end: float, speed: float, at: float, time: float) -> F64:
    """(2, 2) knots of a constant speed from start to end, that passes ``at`` metres at a time in
    seconds.
    """
    return np.array([[time - (at - start) / speed, start], [time + (end - at) / speed, end]])


def pause(
    start: float, end: float, speed: float, at: float, time: float, wait: float, braking: float
) -> F64:
    """Knots of a way with a stop ``at`` metres, from about a time in seconds on, for ``wait``
    seconds.
    """
    ramp = _ramp(speed, braking)
    length = float(ramp[-1, 1])
    arrive = max(start, at - length)
    leave = min(end, at + length)
    down = np.stack([-ramp[::-1, 0], -ramp[::-1, 1]], axis=1)  # the same ramp, backwards in time
    down = down[down[:, 1] >= arrive - at] + (time, at)
    up = ramp[ramp[:, 1] <= leave - at] + (time + wait, at)
    before = [down[0, 0] - (down[0, 1] - start) / speed, start]
    after = [up[-1, 0] + (end - up[-1, 1]) / speed, end]
    return _distinct(np.concatenate([[before], down, up, [after]]))


def park(start: float, end: float, speed: float, time: float, until: float, braking: float) -> F64:
    """Knots of a way that ends with a stop at a time in seconds.

    The mover stays there until another time.
    """
    knots = pause(start, end, speed, end, time, max(until - time, 0.0), braking)
    return _distinct(knots[knots[:, 0] <= max(until, time)])


def stand(
    end: float, speed: float, at: float, time: float, span: tuple[float, float], braking: float
) -> F64:
    """Knots of a way from 0 to ``end`` metres that passes ``at`` metres at about a time.

    The mover stands at the beginning and at the end, from the first to the last time of the span in
    seconds.
    """
    ramp = _ramp(min(speed, float(np.sqrt(braking * end))), braking)
    seconds, metres = ramp[-1]
    cruising = max(0.0, end - 2 * metres) / max(ramp[-1, 0] * braking, 1e-9)
    down = np.stack([2 * seconds + cruising - ramp[::-1, 0], end - ramp[::-1, 1]], axis=1)
    way = np.concatenate([ramp, down])
    way[:, 0] += time - np.interp(at, way[:, 1], way[:, 0])
    first = min(span[0], way[0, 0])
    last = max(span[1], way[-1, 0])
    return _distinct(np.concatenate([[[first, 0.0]], way, [[last, end]]]))


def _ramp(speed: float, braking: float) -> F64:
    """(K, 2) seconds and metres from a standing start to a speed in m/s."""
    seconds = np.append(np.arange(0, speed / braking, STEP), speed / braking)
    return np.stack([seconds, braking * seconds**2 / 2], axis=1)


def _distinct(knots: F64) -> F64:
    """Knots rounded to a millisecond and a millimetre, without repeats, and never backwards."""
    rounded: F64 = np.maximum.accumulate(knots.round(3), axis=0)
    distinct: F64 = rounded[np.append(True, (np.diff(rounded, axis=0) != 0).any(1))]
    return distinct

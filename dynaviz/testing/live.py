"""The check of methods that run live: the labels of online mode, and no trouble when a window forgets."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from dynaviz.arrays import U8, Bool
from dynaviz.method import Context, Live, Method
from dynaviz.scan import Scan
from dynaviz.spatial.extent import Extent
from dynaviz.spatial.window import Window
from dynaviz.testing.world import SENSOR, moved, turn

Answers = tuple[list[Bool], list[U8]]  # dynamic and reasons, scan by scan
SCANS = 8  # more than the burn-in of methods that wait before they judge
WIDE, NARROW = 100.0, 15.0  # metres: the reach of a window with all points, and of one that forgets
AWAY = 400.0  # metres that the sensor drives


def check_live(method: type[Method], params: Any, scans: Sequence[Scan]) -> tuple[list[Scan], Answers]:
    """Compare the labels live with those of online mode; then drive away and return in a window that forgets.

    Returns:
        The scans of that drive, and the answers.

    Raises:
        AssertionError: if labels differ.
    """
    scans = scans[:SCANS]
    online, live = (_answers(method, params, scans, window) for window in (None, Window(WIDE)))
    for k, name in enumerate(("labels", "reasons")):
        same = all(np.array_equal(*pair) for pair in zip(online[k], live[k], strict=True))
        assert same, f"{name} live differ from those of online mode, though the window reaches all points"
    away = [moved(scan, turn(0.0, AWAY, 0.0, 0.0)).without_truth() for scan in scans[:2]]
    tour = [dataclasses.replace(scan, index=n) for n, scan in enumerate([*scans, *away, *scans])]
    return tour, _answers(method, params, tour, Window(NARROW))


def _answers(method: type[Method], params: Any, scans: Sequence[Scan], window: Window | None) -> Answers:
    """Label each scan right after it was observed; live, forget it two scans later."""
    running: Any = method(params)
    running.begin(Context(window or Extent.of(*scans), SENSOR))
    answers: Answers = ([], [])
    for position, scan in enumerate(scans):
        if window is not None:
            window.follow(scan)
        running.observe(scan)
        labels = running.label(scan)
        answers[0].append(labels.dynamic.copy())
        answers[1].append(labels.reasons.copy())
        if isinstance(running, Live) and window is not None and position >= 2:
            running.forget(scans[position - 2].index)
    return answers

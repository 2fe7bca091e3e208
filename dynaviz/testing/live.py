"""The check of methods that run live.

The labels of recorded scans, and no trouble when a window forgets.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from dynaviz.arrays import U8, Bool
from dynaviz.blocks.window import Window
from dynaviz.contracts.extent import Extent
from dynaviz.contracts.method import Context, Live, Method
from dynaviz.contracts.scan import Scan
from dynaviz.testing.world import SENSOR, moved, turn

Answers = tuple[list[Bool], list[U8]]  # dynamic and reasons, scan by scan
SCANS = 8  # more than the burn-in of methods that wait before they judge
KEPT = 2  # scans before the last one that are not forgotten yet
# metres: the reach of a window with all points, and of one that forgets
WIDE = 100.0
NARROW = 15.0
AWAY = 400.0  # metres that the sensor drives


def check_live(
    method: type[Method], params: Any, scans: Sequence[Scan]
) -> tuple[list[Scan], Answers]:
    """Compare the labels live with those of online mode.

    Then drive away and return in a window that forgets.

    A method that needs the map of all scans cannot know it live. Its labels of a scan are those of
    an offline run over the scans that it was not made to forget, up to this one.

    Returns:
        The scans of that drive, and the answers.

    Raises:
        AssertionError: if labels differ.
    """
    scans = scans[:SCANS]
    live = _answers(method, params, scans, Window(WIDE))
    if method.info.needs_map:
        expected = _last_offline(method, params, scans)
        of = "an offline run over the remembered scans"
    else:
        expected = _answers(method, params, scans, None)
        of = "online mode"
    for k, name in enumerate(("labels", "reasons")):
        same = all(np.array_equal(*pair) for pair in zip(expected[k], live[k], strict=True))
        assert same, f"{name} live differ from those of {of}, though the window reaches all points"
    away = [moved(scan, turn(0.0, AWAY, 0.0, 0.0)).without_truth() for scan in scans[:2]]
    tour = [dataclasses.replace(scan, index=n) for n, scan in enumerate([*scans, *away, *scans])]
    return tour, _answers(method, params, tour, Window(NARROW))


def _answers(
    method: type[Method], params: Any, scans: Sequence[Scan], window: Window | None
) -> Answers:
    """Label each scan right after it was observed; live, forget it ``KEPT`` scans later."""
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
        if isinstance(running, Live) and window is not None and position >= KEPT:
            running.forget(scans[position - KEPT].index)
    return answers


def _last_offline(method: type[Method], params: Any, scans: Sequence[Scan]) -> Answers:
    """Label each scan as the last one of an offline run over it and those up to
    ``KEPT`` before it.
    """
    answers: Answers = ([], [])
    for end in range(1, len(scans) + 1):
        few = scans[max(end - 1 - KEPT, 0) : end]
        running = method(params)
        running.begin(
            Context(Extent.of(*few), SENSOR, raw_map=np.concatenate([scan.points for scan in few]))
        )
        for scan in few:
            running.observe(scan)
        labels = running.label(few[-1])
        answers[0].append(labels.dynamic)
        answers[1].append(labels.reasons)
    return answers

"""The failure cases of a recording: as the run told them, or found again in what a run that ended early has drawn."""

from __future__ import annotations

import os
from typing import Any

import numpy as np

from dynaviz import registry
from dynaviz.errors import DataError
from dynaviz.method import MethodInfo
from dynaviz.metric import Labelled
from dynaviz.scan import Label, Outcome, Scan
from dynaviz.viz.answers import Answers
from dynaviz.viz.reader import Drawn, Recording

_TRUTH = {
    Outcome.STATIC_KEPT: Label.STATIC,
    Outcome.FALSE_POSITIVE: Label.STATIC,
    Outcome.DYNAMIC_REMOVED: Label.DYNAMIC,
    Outcome.FALSE_NEGATIVE: Label.DYNAMIC,
}
_REMOVED = (Outcome.DYNAMIC_REMOVED, Outcome.FALSE_POSITIVE, Outcome.UNLABELLED_REMOVED)


def failures_of(path: str | os.PathLike[str]) -> dict[str, Any]:
    """The section ``failures`` of a recorded run (``eval/README.md``).

    For a run that was not finished it is computed from the points that were drawn, without classes and objects; a
    point that was drawn for several of its neighbours counts as these.

    Raises:
        DataError: for a recording that cannot be read, has no ground truth, or has neither result nor points.
    """
    recording = Recording(path)
    if not recording.properties["has_labels"]:
        raise DataError(path, "has no ground truth, so nobody knows what is wrong", hint="Give a run with ground truth")
    result = recording.result
    if result is not None and "failures" in result.sections:
        section: dict[str, Any] = result.sections["failures"]
        return section
    if recording.properties["mode"] == "scores":
        problem = "has no failure cases, and holds no points to find them"
        raise DataError(path, problem, hint="Run the method again, or with --record errors")
    return _found_again(recording)


def _found_again(recording: Recording) -> dict[str, Any]:
    p = recording.properties
    metric = registry.load("metrics", "failures")(MethodInfo(p["method"], p["title"], "", recording.reasons))
    for drawn, answers in zip(recording.drawn(), recording.answers(), strict=False):  # the last may lack its answers
        metric.update(_labelled(drawn, answers))
    section: dict[str, Any] = metric.finish()["failures"]
    return section


def _labelled(drawn: Drawn, answers: Answers) -> Labelled:
    """What was drawn of a frame as a labelled scan, a point for each that it stands for.

    All static points must count, for costs are shares of them; those that were kept were not drawn and have no place.
    """
    every = np.repeat(np.arange(len(drawn.xyz)), drawn.stands_for)
    every = every[drawn.outcome[every] != Outcome.STATIC_KEPT]
    kept = int((answers.outcome == Outcome.STATIC_KEPT).sum())
    points = np.concatenate([drawn.xyz[every], np.full((kept, 3), np.nan, np.float32)])
    outcome = np.concatenate([drawn.outcome[every], np.full(kept, Outcome.STATIC_KEPT, np.uint8)])
    reasons = np.concatenate([drawn.reasons[every], np.zeros(kept, np.uint8)])
    truth = np.full(len(points), Label.UNLABELLED, np.uint8)
    for of, label in _TRUTH.items():
        truth[outcome == of] = label
    T_world_sensor = np.eye(4)
    T_world_sensor[:3, 3] = drawn.position
    scan = Scan(answers.index, points, T_world_sensor, labels=truth)
    return Labelled.of(drawn.frame, scan, np.isin(outcome, _REMOVED), reasons)

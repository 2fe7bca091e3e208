"""The failure cases of a recording: as the run told them, or found again in what a run that ended early has drawn."""

from __future__ import annotations

import os

import numpy as np

from dynaviz import registry
from dynaviz.arrays import F32
from dynaviz.comparison.answers import Answers
from dynaviz.errors import DataError
from dynaviz.method import MethodInfo
from dynaviz.metric import Labelled
from dynaviz.results.sections import Failures, Sections
from dynaviz.scan import Outcome, Scan
from dynaviz.viz import paths
from dynaviz.viz.reader import DrawnPoints, RunRecording


def failures_of(path: str | os.PathLike[str]) -> Failures:
    """The section ``failures`` of a recorded run (``eval/README.md``).

    For a run that was not finished it is computed from the points that were drawn, without classes and objects; a
    point that was drawn for several of its neighbours counts as these.

    Raises:
        DataError: for a recording that cannot be read, has no ground truth, or has neither result nor points.
    """
    recording = RunRecording(path)
    if not recording.properties["has_labels"]:
        raise DataError(path, "has no ground truth, so nobody knows what is wrong", hint="Give a run with ground truth")
    result = recording.result
    if result is not None and result.sections.failures:
        return result.sections.failures
    if recording.properties["mode"] == "scores":
        problem = "has no failure cases, and holds no points to find them"
        raise DataError(path, problem, hint="Run the method again, or with --record errors")
    return _found_again(recording)


def _found_again(recording: RunRecording) -> Failures:
    p = recording.properties
    metric = registry.load("metrics", "failures")(MethodInfo(p["method"], p["title"], "", recording.reasons))
    positions = {frame: parts["Transform3D:translation"][0] for frame, parts in recording.rows(paths.SENSOR)}
    for drawn, answers in zip(recording.drawn(), recording.answers(), strict=False):  # the last may lack its answers
        if drawn.frame in positions:
            metric.update(_labelled(drawn, answers, positions[drawn.frame]))
    return Sections.of(metric.finish()).failures or Failures()


def _labelled(drawn: DrawnPoints, answers: Answers, position: F32) -> Labelled:
    """What was drawn of a frame as a labelled scan, a point for each that it stands for.

    All static points must count, for costs are shares of them; those that were kept have no place here, drawn or not.
    """
    wrong_or_moving = np.repeat(np.arange(len(drawn.xyz)), drawn.stands_for)
    wrong_or_moving = wrong_or_moving[drawn.outcome[wrong_or_moving] != Outcome.STATIC_KEPT]
    kept = np.flatnonzero(answers.outcome == Outcome.STATIC_KEPT)
    points = np.concatenate([drawn.xyz[wrong_or_moving], np.full((len(kept), 3), np.nan, np.float32)])
    rows = np.concatenate([drawn.point[wrong_or_moving], kept])
    T_world_sensor = np.eye(4)
    T_world_sensor[:3, 3] = position
    scan = Scan(answers.index, points, T_world_sensor, labels=answers.truth[rows])
    return Labelled.of(drawn.frame, scan, answers.dynamic[rows], answers.reasons[rows])

"""The failure cases of a recording: from its result, or computed from the drawn points if the run ended early."""

from __future__ import annotations

import os

import numpy as np

from dynaviz.arrays import F32
from dynaviz.contracts import registry
from dynaviz.contracts.method import MethodInfo
from dynaviz.contracts.metric import Labelled
from dynaviz.contracts.scan import Label, Outcome, Scan
from dynaviz.errors import DataError
from dynaviz.scores.comparison.frame_answers import FrameAnswers
from dynaviz.scores.scores import RANGE_EDGES
from dynaviz.scores.sections import Failures, Removals, RemovedFrame, RemovedInterval, Sections
from dynaviz.views import paths
from dynaviz.views.read.reader import DrawnPoints, RunRecording


def failures_of(path: str | os.PathLike[str]) -> Failures:
    """The section ``failures`` of a recorded run (``eval/README.md``).

    For an unfinished run it is computed from the drawn points, without classes and objects; a drawn point counts for
    all points that it stands for.

    Raises:
        DataError: for a recording that cannot be read, has no ground truth, or has neither result nor points.
    """
    recording = RunRecording(path)
    if not recording.properties["has_labels"]:
        hint = "Give a run with ground truth"
        raise DataError(path, "has no ground truth, so failures cannot be computed", hint=hint)
    result = recording.result
    if result is not None and result.sections.failures:
        return result.sections.failures
    if recording.properties["mode"] == "scores":
        problem = "contains neither failure cases nor points to compute them from"
        raise DataError(path, problem, hint="Run the method again, or with --record errors")
    with recording.decoding():
        return _compute(recording)


def removals_of(path: str | os.PathLike[str]) -> Removals | None:
    """The section ``removals`` of a recorded run without ground truth; None for a run with ground truth.

    For a run that did not finish, it is counted from the labels of the recorded frames, without clusters: these are
    found from all points, of which the recording contains only a part.

    Raises:
        DataError: for a recording that cannot be read, or has no labelled frame.
    """
    recording = RunRecording(path)
    if recording.properties["has_labels"]:
        return None
    result = recording.result
    return (result and result.sections.removals) or _count_removed(recording)


def _count_removed(recording: RunRecording) -> Removals:
    names = [*(reason.name for reason in recording.reasons), "unknown code"]
    reasons, frames = np.zeros(len(names), np.int64), []
    bands = np.zeros((2, len(RANGE_EDGES) + 1), np.int64)
    for answers in recording.answers():
        removed = answers.dynamic
        reasons += np.bincount(np.minimum(answers.reasons[removed], len(names) - 1), minlength=len(names))
        bands += [np.bincount(part, minlength=bands.shape[1]) for part in (answers.bands, answers.bands[removed])]
        frames.append(RemovedFrame(answers.frame, answers.index, len(answers), int(removed.sum())))
    if not frames:
        raise _without_labels(recording)
    ends = [0.0, *RANGE_EDGES, None]
    return Removals(
        points=int(bands[0].sum()),
        removed=int(bands[1].sum()),
        reasons={names[code]: int(reasons[code]) for code in np.argsort(-reasons, kind="stable") if reasons[code]},
        range=tuple(
            RemovedInterval(low=low, high=high, points=points, removed=removed)
            for low, high, points, removed in zip(ends[:-1], ends[1:], *bands.tolist(), strict=True)
        ),
        frame=tuple(frames),
    )


def _without_labels(recording: RunRecording) -> DataError:
    problem = "contains no labelled frame: its run ended while it observed the scans"
    return DataError(recording.path, problem, hint="Run the method again")


def _compute(recording: RunRecording) -> Failures:
    p = recording.properties
    metric = registry.load("metrics", "failures")(MethodInfo(p["method"], p["title"], "", recording.reasons))
    positions = {frame: parts["Transform3D:translation"][0] for frame, parts in recording.rows(paths.SENSOR)}
    for drawn, answers in zip(recording.drawn(), recording.answers(), strict=False):  # the last may lack its answers
        if drawn.frame in positions:
            static, dynamic = (int((answers.truth == label).sum()) for label in (Label.STATIC, Label.DYNAMIC))
            metric.add(_wrong_or_dynamic(drawn, answers, positions[drawn.frame]), static, dynamic)
    return Sections.of(metric.finish()).failures or Failures()


def _wrong_or_dynamic(drawn: DrawnPoints, answers: FrameAnswers, position: F32) -> Labelled:
    """The drawn points of a frame as a labelled scan; each is repeated for all points that it stands for."""
    chosen = np.flatnonzero(drawn.outcome != Outcome.STATIC_KEPT)
    chosen = np.repeat(chosen, drawn.stands_for[chosen])
    rows = drawn.point[chosen]
    T_world_sensor = np.eye(4)
    T_world_sensor[:3, 3] = position
    scan = Scan(answers.index, drawn.xyz[chosen], T_world_sensor, labels=answers.truth[rows])
    return Labelled.of(drawn.frame, scan, answers.dynamic[rows], answers.reasons[rows])

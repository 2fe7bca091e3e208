"""Names of the entities, properties and timelines of a recording, and the colours used in it."""

from __future__ import annotations

from dynaviz.contracts.probe import (
    Mask,
    Plane,
    PointClasses,
    Points,
    PolarGrid,
    RangeImage,
    Scalar,
    State,
    Voxels,
)
from dynaviz.contracts.scan import Outcome

APPLICATION = "dynaviz"
SCHEMA = 2  # version of a recording's content; readers refuse newer ones

FRAME = "frame"  # timeline: position in the run, 0, 1, ...
SENSOR_TIME = "sensor_time"  # timeline: the stamps of the data, if any
CASE = "case"  # timeline: the listed cases, 1, 2, ..., costliest first

ROOT = "/"  # the legend of outcomes
WORLD = "world"
SCAN = "world/scan"  # the frame's points, class = outcome
SCAN_ROWS = "scan_rows"  # of each of them its row in the scan, and how many it stands for
LEGEND = "legend"  # static picture: the colours of outcomes and rays
MAP = "world/map"  # static: the cleaned map: points kept in the whole run, downsampled
MAP_WRONG = "world/map/wrong"  # static: dynamic points kept, downsampled
REMOVED = "world/removed"  # static: points removed in the whole run, downsampled
REMOVED_WRONG = "world/removed/wrong"  # static: static points removed, downsampled
TRAJECTORY = "world/trajectory"  # static: path of the sensor
SENSOR = "world/sensor"  # the sensor's pose
RINGS = "world/sensor/rings"  # circles around the sensor, at 10 m and 20 m
FAILURES = "world/failures"  # a box around the wrong points of each failure case in this frame
CASE_NUMBERS = "dynaviz.Case"  # archetype: numbers of the cases of these boxes
CASES = "world/failures/cases"  # static: a box around each case over all of its frames
CLUSTERS = (
    "world/clusters"  # the same two for the suspicious clusters of a run without ground truth
)
CLUSTER_CASES = "world/clusters/cases"
# the box of the case at the index; on the timeline of frames, of the frame's costliest
CASE_BOX = "world/case/box"
CASE_NAME = "world/case/box/names"  # its label, above it
CASE_AROUND = "world/case/around"  # a circle around it, which the eye tracks
CASE_AIM = "world/case/aim"  # a line from the sensor to it
CASE_RAYS = "world/case/rays"  # rays of all scans that hit or crossed it
RAY_CLASSES = "world/case"  # the legend of these
CASE_POINTS = "case/points"  # static: some points of each case; not displayed
CASE_LEDGERS = "case/ledgers"  # ledgers of its points, packed; not displayed
# below it for each of the first cases and lane (``dynaviz.scores.spans``) a ``StateChange``
OBJECTS = "objects"
CASES_TABLE = "cases"  # a row of numbers and words per case
CASE_TEXT = "case"  # Markdown: what happened, and why
CASE_COST = "case_cost"  # curves over the timeline of cases: what each costs
CASE_SCORE = "case_score"  # the same: scores if the cases up to each were right

WHAT_IF = "what_if"  # timeline: values of parameters; entity: Markdown, what they would change
WHAT_IF_VALUE = "what_if/value"  # the same in one line, at the index of a value
WHAT_IF_SCORE = "what_if/score"  # curves: estimated scores and their whiskers
SAMPLE = "what_if/sample"  # points that can be judged again, packed; not displayed
ANSWERS = "answers"  # label, ground truth and reason of every point, lossless; not displayed
SCORES = "scores"
WRONG = "scores/wrong_points"
WORST = "scores/worst_frames"
ERROR_DISTANCE = "error_distance"
REASONS = "reasons"
REMOVED_POINTS = "removed_points"  # curves of a run without ground truth
REMOVED_TEXT = "report/removed"  # Markdown, the same
REPORT = "report"
FAILURE_LIST = "report/failures"
LOG = "log"

PROPERTIES = "run"  # recording property: method, sequence, settings, and the complete result
LIVE = "live"  # the same of a part of a live recording: method, source
OVERVIEW = "overview"  # the same of the overview of a run on tiles: title, sequence, frames

SOLID = (Points, PointClasses, Mask, Voxels, Plane)  # kinds of state drawn in the world
FLAT = (RangeImage, PolarGrid)  # kinds of state drawn as images


def state(method: str, state: State) -> str:
    """A method's state: below ``world`` if it has coordinates, else (images, numbers) below the
    method's name.
    """
    if issubclass(state.kind, (*FLAT, Scalar)):
        return f"{method}/{state.name}"
    return f"{WORLD}/{method}/{state.name}" if issubclass(state.kind, SOLID) else LOG


def in_state(path: str) -> str:
    """The outline of a case in a picture of a state."""
    return f"{path}/case"


def key(method: str, state: State) -> str:
    """The key of a tab of states, by its first state."""
    return f"{method}/keys/{state.name}"


def curve(name: str) -> str:
    """A metric's curve: at its own path if that starts with a known part, else below ``scores``."""
    return name if name.split("/")[0] in (SCORES, ERROR_DISTANCE, REASONS) else f"{SCORES}/{name}"


def histogram(name: str) -> str:
    """A metric's histogram by frame.

    That of the whole run is at ``.../run``, its 10 % line at ``.../p10``.
    """
    return name if name.split("/")[0] == ERROR_DISTANCE else f"{ERROR_DISTANCE}/{name}"


def boxes(name: str) -> str:
    """A metric's boxes by frame; those over all frames are at ``.../cases``."""
    return f"{WORLD}/{name}"


def names(boxes: str) -> str:
    """The labels of boxes."""
    return f"{boxes}/names"


NAMES: dict[Outcome, str] = {
    Outcome.STATIC_KEPT: "static, kept",
    Outcome.DYNAMIC_REMOVED: "dynamic, removed",
    Outcome.FALSE_POSITIVE: "false positive: static, but removed",
    Outcome.FALSE_NEGATIVE: "false negative: dynamic, but kept",
    Outcome.UNLABELLED_KEPT: "unlabelled, kept",
    Outcome.UNLABELLED_REMOVED: "unlabelled, removed",
}

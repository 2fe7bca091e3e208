"""Where everything lies in a recording, and in which colour: one name for each entity, property and timeline."""

from __future__ import annotations

from dynaviz.probe import Mask, Plane, PointClasses, Points, PolarGrid, RangeImage, Scalar, State, Voxels
from dynaviz.scan import Outcome

APPLICATION = "dynaviz"
SCHEMA = 1  # of a recording's content; a reader refuses what is newer

FRAME = "frame"  # timeline: position in the run, 0, 1, ...
SENSOR_TIME = "sensor_time"  # timeline: the data's own stamps, where it has any

ROOT = "/"  # holds the legend of outcomes
WORLD = "world"
SCAN = "world/scan"  # the frame's points, class = outcome
MAP = "world/map"  # static: what was kept in the whole run, thinned; the cleaned map
MAP_WRONG = "world/map/wrong"  # static: what was kept wrongly, thinned
REMOVED = "world/removed"  # static: what was removed in the whole run, thinned
REMOVED_WRONG = "world/removed/wrong"  # static: what was removed wrongly, thinned
TRAJECTORY = "world/trajectory"  # static: where the sensor went
SENSOR = "world/sensor"  # the sensor's pose
RINGS = "world/sensor/rings"  # circles around the sensor, at 10 m and 20 m
FAILURES = "world/failures"  # the frame's failure cases: a box around what is wrong in this frame
CASES = "world/failures/cases"  # static: a box around all of each case

ANSWERS = "answers"  # every point's answer, truth and reason, without loss; not for the eye
SCORES = "scores"
WRONG = "scores/wrong_points"
WORST = "scores/worst_frames"
ERROR_DISTANCE = "error_distance"
REASONS = "reasons"
REPORT = "report"
FAILURE_LIST = "report/failures"
LOG = "log"

PROPERTIES = "run"  # recording property: what ran on what, and the whole result

SOLID = (Points, PointClasses, Mask, Voxels, Plane)  # kinds of state that are drawn in the world
FLAT = (RangeImage, PolarGrid)  # kinds of state that are pictures


def state(method: str, state: State) -> str:
    """A method's state: in the world where it has a place there, beside it where it is a picture or a number."""
    if issubclass(state.kind, (*FLAT, Scalar)):
        return f"{method}/{state.name}"
    return f"{WORLD}/{method}/{state.name}" if issubclass(state.kind, SOLID) else LOG


def curve(name: str) -> str:
    """A metric's curve: by its own first part where that is a known one, else a score."""
    return name if name.split("/")[0] in (SCORES, ERROR_DISTANCE, REASONS) else f"{SCORES}/{name}"


def histogram(name: str) -> str:
    """A metric's histogram; the run's own lies at ``.../run``, and its 10 % line at ``.../p10``."""
    return name if name.split("/")[0] == ERROR_DISTANCE else f"{ERROR_DISTANCE}/{name}"


def boxes(name: str) -> str:
    """A metric's boxes; all that each case covers lies at ``.../cases``."""
    return f"{WORLD}/{name}"


Colour = tuple[int, int, int]

# Safe for the colour-blind: blue against orange against yellow differ in hue and lightness to every eye; grey recedes.
COLOURS: dict[Outcome, Colour] = {
    Outcome.STATIC_KEPT: (128, 128, 136),
    Outcome.DYNAMIC_REMOVED: (86, 160, 233),
    Outcome.FALSE_POSITIVE: (245, 225, 80),
    Outcome.FALSE_NEGATIVE: (240, 70, 20),
    Outcome.UNLABELLED_KEPT: (96, 96, 104),
    Outcome.UNLABELLED_REMOVED: (170, 110, 150),
}
NAMES: dict[Outcome, str] = {
    Outcome.STATIC_KEPT: "static, kept",
    Outcome.DYNAMIC_REMOVED: "dynamic, removed",
    Outcome.FALSE_POSITIVE: "false positive: static, but removed",
    Outcome.FALSE_NEGATIVE: "false negative: dynamic, but kept",
    Outcome.UNLABELLED_KEPT: "unlabelled, kept",
    Outcome.UNLABELLED_REMOVED: "unlabelled, removed",
}
SERIES: dict[str, Colour] = {  # curves of the headline scores
    "SA": (86, 180, 233),
    "DA": (230, 120, 20),
    "AA": (240, 240, 240),
    "HA": (160, 130, 200),
}
CLASSES: tuple[Colour, ...] = (  # a method's own classes, in the order of its legend
    (128, 128, 136),
    (230, 159, 0),
    (86, 180, 233),
    (0, 158, 115),
    (240, 228, 66),
    (0, 114, 178),
    (213, 94, 0),
    (204, 121, 167),
)
BACKGROUND: Colour = (18, 20, 26)

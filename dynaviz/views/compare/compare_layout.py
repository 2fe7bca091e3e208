"""The layout of a comparison: runs side by side, agreement, overlaid curves.

And the names of its entities.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import rerun.blueprint as rrb

from dynaviz.arrays import F32, F64
from dynaviz.colours import Colour
from dynaviz.views import object_lanes, paths
from dynaviz.views.layout import blueprint, follow, solid, with_key

COMPARE = "compare"  # the legend of agreement
GROUND = "compare/ground"  # static: the first run's map, darker
SCAN = "compare/scan"  # the frame's points by agreement
WHERE = (
    "compare/where"  # static: cells of the whole run in the colour of the better run; area = gain
)
PLACES = "compare/places"  # static: the places in the report, numbered
# curves: the gain of each frame, or in each case, above 0 if the second run is better
GAIN = "compare/gain"
CHANGED = "compare/changed_frames"  # marks on these curves
DISTANCE = "compare/error_distance"  # static: histograms of all runs, bars next to each other
REPORT = "compare/report"  # Markdown

CASE_BOX = (
    "compare/case/box"  # on the timeline of cases: where one run is right and the other wrong
)
CASE_AROUND = "compare/case/around"  # a circle around it, which the eye tracks
CASE_TEXT = "compare/case_text"
CASE_KEY = "case_key"  # of each run: what the colours of that state mean
CASE_STATES = "world/case"  # of each run: the state that shows most of the case

SIDES = "abcdefgh"  # roots of the runs
COLOURS: tuple[
    tuple[str, Colour], ...
] = (  # of the runs, on white and on black; none is the colour of an outcome
    ("green", (45, 165, 85)),
    ("purple", (180, 75, 225)),
    ("teal", (0, 140, 150)),
    ("pink", (225, 60, 140)),
    ("brown", (150, 100, 55)),
    ("indigo", (90, 85, 230)),
    ("olive", (125, 130, 40)),
    ("grey", (135, 135, 140)),
)
ABREAST = 4  # runs whose map and frame are both visible; with more, they share tabs


def two(names: Sequence[str], places: F64 | None, first: F32 | None = None) -> rrb.Blueprint:
    """The layout for two runs.

    Top left: the difference at the index, which run is right; below it how each run drew it. Behind
    it, which run is better where, and frames. Right: the report, curves and histograms.

    Args:
        names: of the runs.
        places: (N, 3) metres, world frame: points to look at; None if nothing is drawn.
        first: (1, P, 3) metres: the circle around the first case, at which the recording opens;
            None without cases.
    """
    gain = (
        f"gain per {'frame' if first is None else 'case or frame'}: above 0 {names[1]} is better, "
        f"below 0 {names[0]}"
    )
    numbers = [_lines(gain, [f"{GAIN}/**", CHANGED]), *_numbers(names)]
    if places is None:
        return blueprint(_column(numbers))
    which = "right in this frame: green A, purple B, white neither"
    context = [GROUND, f"a/{paths.TRAJECTORY}"]
    where = solid(
        "whole run: green A better, purple B better",
        [WHERE, PLACES, *context],
        above(places),
        COMPARE,
    )
    sensor = [f"a/{path}" for path in (paths.SENSOR, paths.RINGS)]
    who = solid(which, [SCAN, *sensor, *context], follow(f"a/{paths.RINGS}"), COMPARE)
    frames = [_frame(side, name) for side, name in zip(SIDES, names, strict=False)]
    if first is None:
        world: Any = rrb.Grid(where, who, *frames, grid_columns=2)
        return blueprint(rrb.Horizontal(world, _column(numbers), column_shares=[5, 3]))
    views = [_case(side, name, first) for side, name in zip(SIDES, names, strict=False)]
    box = [CASE_BOX, paths.names(CASE_BOX), CASE_AROUND]
    shown = [SCAN, GROUND, *box, f"a/{paths.TRAJECTORY}"]
    title = "difference: green only A right, purple only B right, white neither"
    difference = solid(title, shown, follow(CASE_AROUND, first), COMPARE)
    world = rrb.Vertical(
        rrb.Tabs(difference, where, who, *frames), rrb.Horizontal(*views), row_shares=[5, 4]
    )
    text = rrb.TextDocumentView(name="what and why", origin=CASE_TEXT, contents=[CASE_TEXT])
    column = rrb.Vertical(rrb.Tabs(text, object_lanes.view()), _column(numbers), row_shares=[1, 3])
    return blueprint(rrb.Horizontal(world, column, column_shares=[5, 3]), paths.CASE)


def many(names: Sequence[str], places: F64 | None) -> rrb.Blueprint:
    """The layout for more than two runs: a small map and a small frame of each.

    Arguments as for ``two``.
    """
    numbers = _column([object_lanes.view(), *_numbers(names)])
    if places is None:
        return blueprint(numbers)
    maps = [_map(side, name, places) for side, name in zip(SIDES, names, strict=False)]
    frames = [_frame(side, name) for side, name in zip(SIDES, names, strict=False)]
    if len(names) <= ABREAST:
        grid = rrb.Grid(*maps, *frames, grid_columns=len(names))
    else:
        tabs = [rrb.Tabs(*pair) for pair in zip(frames, maps, strict=True)]
        grid = rrb.Grid(*tabs, grid_columns=ABREAST)
    return blueprint(rrb.Horizontal(grid, numbers, column_shares=[5, 3]))


def _column(numbers: Sequence[Any]) -> Any:
    words = rrb.TextDocumentView(name="report", origin=REPORT)
    return rrb.Vertical(words, *numbers, row_shares=[3.5] + [1.0] * len(numbers))


def _numbers(names: Sequence[str]) -> list[Any]:
    few = len(names) <= 3
    key = ": " + ", ".join(
        f"{name[0]} {word}" for name, (word, _) in zip(names, COLOURS, strict=False)
    )
    scores = [_curves(score, names, key if few else "") for score in ("SA", "DA")]
    kinds = {"false_negative": "FN: distance [m]", "false_positive": "FP: distance [m]"}
    bars = [
        rrb.BarChartView(
            name=title,
            contents=[f"{DISTANCE}/{kind}/**"],
            plot_legend=rrb.PlotLegend(visible=False),
        )
        for kind, title in kinds.items()
    ]
    return [rrb.Horizontal(*scores), rrb.Horizontal(*bars)]


def _map(side: str, name: str, places: F64) -> Any:
    shown = [
        f"{side}/{path}" for path in (f"{paths.MAP}/**", f"{paths.REMOVED}/**", paths.TRAJECTORY)
    ]
    return solid(f"{name}: whole run", shown, above(places), f"{side}/{paths.WORLD}")


def _frame(side: str, name: str) -> Any:
    shown = [
        f"{side}/{path}"
        for path in (paths.SCAN, paths.MAP, paths.SENSOR, paths.RINGS, paths.TRAJECTORY)
    ]
    return solid(name, shown, follow(f"{side}/{paths.RINGS}"), f"{side}/{paths.WORLD}")


def _case(side: str, name: str, first: F32) -> Any:
    """The difference at the index, as a run drew it: its points, and the state that shows most."""
    of_run = (paths.SCAN, paths.MAP, paths.SENSOR, paths.TRAJECTORY, f"{CASE_STATES}/**")
    shown = [*(f"{side}/{path}" for path in of_run), CASE_BOX, paths.names(CASE_BOX), CASE_AROUND]
    view = solid(f"case: {name}", shown, follow(CASE_AROUND, first), f"{side}/{paths.WORLD}")
    return with_key([view], f"{side}/{CASE_KEY}", "colours of the method's state")


def _curves(score: str, names: Sequence[str], key: str) -> Any:
    contents = [f"{side}/{paths.SCORES}/{score}/so_far" for side in SIDES[: len(names)]]
    return _lines(f"{score} [%]{key or ' so far'}", contents, legend=not key)


def _lines(name: str, contents: list[str], legend: bool = False) -> Any:
    shown = rrb.PlotLegend(corner=rrb.Corner2D.LeftBottom, visible=legend)
    return rrb.TimeSeriesView(name=name, contents=contents, plot_legend=shown)


def above(points: F64) -> rrb.EyeControls3D:
    """A steep view from above on all (N, 3) points, with the long side across the picture."""
    if not len(points):
        points = np.zeros((1, 3))
    flat = points[:, :2] - points[:, :2].mean(0)
    axes = np.linalg.eigh(flat.T @ flat)[1]  # short, long
    spans = flat @ axes
    middle = points[:, :2].mean(0) + axes @ (spans.min(0) + spans.max(0)) / 2
    centre = np.array([*middle, np.median(points[:, 2])])
    along = axes[:, 1]
    across, length = np.ptp(spans, axis=0)
    length = max(float(length), 1.2 * float(across), 20.0)
    side = np.array([along[1], -along[0], 0.0])
    position = centre + 0.65 * length * (0.4 * side + np.array([0.0, 0.0, 0.95]))
    return rrb.EyeControls3D(
        kind=rrb.Eye3DKind.Orbital,
        position=position,
        look_target=centre,
        eye_up=[0.0, 0.0, 1.0],
        speed=length / 5,
    )

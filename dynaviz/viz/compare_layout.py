"""The layout of a comparison: runs side by side, who is right, curves over each other; and where its parts lie."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import rerun.blueprint as rrb

from dynaviz.scan import F32
from dynaviz.viz import paths

COMPARE = "compare"  # holds the legend of who is right
SCAN = "compare/scan"  # the frame's points by who is right
WHERE = "compare/where"  # static: cells of the whole run, in the colour of the better run, as large as its gain
PLACES = "compare/places"  # static: the places told, numbered
GAIN = "compare/gain"  # curves: the gain of each frame, above 0 where the second run is better
CHANGED = "compare/changed_frames"  # marks on these curves
DISTANCE = "compare/error_distance"  # static: histograms of both runs beside each other
REPORT = "compare/report"  # Markdown

SCORES = [f"{paths.SCORES}/{name}/so_far" for name in ("SA", "DA", "AA")]


def two(names: Sequence[str], map_points: F32 | None) -> rrb.Blueprint:
    """The layout for two runs.

    Args:
        names: of the runs.
        map_points: (N, 3) metres, world frame: where the map lies; None where nothing was drawn.
    """
    numbers = rrb.Vertical(
        rrb.Horizontal(*[_curves(score, names) for score in ("SA", "DA")]),
        _lines("who is better, frame by frame", [f"{GAIN}/**", CHANGED]),
        rrb.Tabs(_bars("false_negative", "kept"), _bars("false_positive", "removed")),
        _words(),
        row_shares=[4, 4, 4, 9],
    )
    if map_points is None:
        return _blueprint(numbers)
    world = rrb.Vertical(
        _where(map_points),
        rrb.Horizontal(*[_frame(side, name) for side, name in zip("ab", names, strict=True)], _who()),
        row_shares=[1, 1],
    )
    return _blueprint(rrb.Horizontal(world, numbers, column_shares=[5, 3]))


def _where(map_points: F32) -> Any:
    context = [f"a/{paths.MAP}", f"a/{paths.TRAJECTORY}"]
    return _solid("who is better, whole run", COMPARE, [WHERE, PLACES, *context], above(map_points))


def _who() -> Any:
    context = [f"a/{path}" for path in (paths.MAP, paths.SENSOR, paths.RINGS, paths.TRAJECTORY)]
    return _solid("who is right", COMPARE, [SCAN, *context], _follow("a"))


def _frame(side: str, name: str) -> Any:
    shown = [f"{side}/{path}" for path in (paths.SCAN, paths.MAP, paths.SENSOR, paths.RINGS, paths.TRAJECTORY)]
    return _solid(name, f"{side}/{paths.WORLD}", shown, _follow(side))


def _curves(score: str, names: Sequence[str]) -> Any:
    sides = "abcdefgh"[: len(names)]
    return _lines(f"{score} so far [%]", [f"{side}/{paths.SCORES}/{score}/so_far" for side in sides])


def _lines(name: str, contents: list[str]) -> Any:
    return rrb.TimeSeriesView(name=name, contents=contents, plot_legend=rrb.Corner2D.LeftBottom)


def _bars(kind: str, name: str) -> Any:
    view = f"{name}: error distance [m]"
    return rrb.BarChartView(name=view, contents=[f"{DISTANCE}/{kind}/**"], plot_legend=rrb.Corner2D.RightTop)


def _words() -> Any:
    return rrb.TextDocumentView(name="report", origin=REPORT)


def _solid(name: str, origin: str, contents: list[str], eye: rrb.EyeControls3D) -> Any:
    return rrb.Spatial3DView(
        name=name,
        origin=origin,
        contents=[f"/{path}" for path in contents],
        background=[*paths.BACKGROUND, 255],
        line_grid=False,
        eye_controls=eye,
    )


def _follow(side: str) -> rrb.EyeControls3D:
    """Behind and above the sensor, and along with it."""
    return rrb.EyeControls3D(
        kind=rrb.Eye3DKind.Orbital,
        tracking_entity=f"/{side}/{paths.RINGS}",
        position=[-22.0, -16.0, 22.0],
        look_target=[0.0, 0.0, 0.0],
        eye_up=[0.0, 0.0, 1.0],
    )


def above(points: F32) -> rrb.EyeControls3D:
    """A steep look from above on the bulk of the points, their long side across the picture."""
    points = points[np.isfinite(points).all(1)]
    if not len(points):
        points = np.zeros((1, 3), np.float32)
    centre = np.median(points, axis=0)
    flat = points[:, :2] - centre[:2]
    along = np.linalg.eigh(flat.T @ flat)[1][:, -1]
    low, high = np.quantile(flat @ along, [0.05, 0.95])
    centre[:2] += along * (low + high) / 2
    length = max(float(high - low), 10.0)
    side = np.array([along[1], -along[0], 0.0])
    position = centre + 0.62 * length * (0.55 * side + np.array([0.0, 0.0, 0.95]))
    return rrb.EyeControls3D(
        kind=rrb.Eye3DKind.Orbital, position=position, look_target=centre, eye_up=[0.0, 0.0, 1.0], speed=length / 5
    )


def _blueprint(body: Any) -> rrb.Blueprint:
    return rrb.Blueprint(
        body,
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline=paths.FRAME, fps=10.0, play_state="paused"),
        auto_layout=False,
        auto_views=False,
    )

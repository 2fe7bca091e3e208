"""The viewer's layout, built from the states of a method; it is part of the recording."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import rerun.blueprint as rrb

from dynaviz import colours
from dynaviz.arrays import F64
from dynaviz.method import MethodInfo
from dynaviz.probe import RangeImage, Scalar, State
from dynaviz.spatial.extent import CELL, Extent
from dynaviz.viz import paths

STACK = 4  # range images in one tab
SO_FAR = [f"{paths.SCORES}/{name}/so_far" for name in ("SA", "DA", "AA")]

WRONG = "wrong points per frame"  # no legend: it would hide the worst frames; the colours are those of the points


def layout(info: MethodInfo, extent: Extent, geometry: bool) -> rrb.Blueprint:
    """The layout of a run's recording.

    Left: the map of the whole run with its wrong points; below it the points of the frame and the method's states.
    Middle: failure cases, report and log. Right: scores, wrong points per frame, and distances of errors.

    Args:
        info: of the method; each of its ``emits`` gets a view.
        extent: of the map, for the initial camera.
        geometry: whether the recording contains coordinates.
    """
    columns = [_text(), _numbers(info)]
    if geometry:
        columns.insert(0, _world(info, extent))
    body = rrb.Horizontal(*columns, column_shares=[10, 6, 5][-len(columns) :])
    return blueprint(body)


def blueprint(body: Any) -> rrb.Blueprint:
    """A layout with collapsed panels and the time cursor on frames."""
    return rrb.Blueprint(
        body,
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline=paths.FRAME, fps=10.0, play_state="paused"),
        auto_layout=False,
        auto_views=False,
    )


def _world(info: MethodInfo, extent: Extent) -> Any:
    common = [paths.SENSOR, paths.TRAJECTORY]
    everything = solid("map", [f"{paths.MAP}/**", f"{paths.REMOVED}/**", paths.CASES, *common], _eye(extent))
    frame = solid("frame", [paths.SCAN, paths.MAP, paths.RINGS, paths.FAILURES, *common], follow())
    states = _tabs(info)
    below = rrb.Horizontal(frame, rrb.Tabs(*states)) if states else frame
    return rrb.Vertical(everything, below, row_shares=[3, 2])


def _text() -> Any:
    others = rrb.Tabs(
        rrb.TextDocumentView(name="report", origin=paths.REPORT, contents=[paths.REPORT]),
        rrb.TextLogView(name="log", origin=paths.LOG),
    )
    return rrb.Vertical(rrb.TextDocumentView(name="failures", origin=paths.FAILURE_LIST), others, row_shares=[5, 3])


def _tabs(info: MethodInfo) -> list[Any]:
    """A tab for each state that is drawn; consecutive range images share one, because they are wide and low."""
    tabs = []
    for kind, group in itertools.groupby(info.emits, lambda state: state.kind):
        views = [_state(info.name, state) for state in group if issubclass(kind, (*paths.SOLID, *paths.FLAT))]
        together = STACK if kind is RangeImage else 1
        for first in range(0, len(views), together):
            stack = views[first : first + together]
            tabs.append(rrb.Vertical(*stack, name=f"{stack[0].name} to {stack[-1].name}") if stack[1:] else stack[0])
    return tabs


def _numbers(info: MethodInfo) -> Any:
    others = [f"- {path}" for path in (*SO_FAR, f"{paths.WRONG}/**", paths.WORST)]
    scores = rrb.Tabs(
        _curves("scores so far [%]", SO_FAR),
        _curves("all scores", [f"{paths.SCORES}/**", *others]),
        _curves("reasons", [f"{paths.REASONS}/**"]),
        *[
            _curves(state.name, [paths.state(info.name, state)])
            for state in info.emits
            if issubclass(state.kind, Scalar)
        ],
    )
    distance = rrb.Tabs(
        _bars("FN: distance [m]", _run_histogram("false_negative")),
        _bars("FP: distance [m]", _run_histogram("false_positive")),
        _bars("this frame", [f"{paths.ERROR_DISTANCE}/{kind}" for kind in _KINDS], rrb.Corner2D.RightTop),
    )
    wrong = _curves(WRONG, [f"{paths.WRONG}/**", paths.WORST], rrb.PlotLegend(visible=False))
    return rrb.Vertical(scores, wrong, distance)


_KINDS = ("false_negative", "false_positive")


def _run_histogram(kind: str) -> list[str]:
    return [f"{paths.ERROR_DISTANCE}/{kind}/{part}" for part in ("run", "p10")]


def _curves(name: str, contents: list[str], legend: Any = rrb.Corner2D.RightBottom) -> Any:
    return rrb.TimeSeriesView(name=name, contents=contents, plot_legend=legend)


def _bars(name: str, contents: list[str], legend: Any = None) -> Any:
    return rrb.BarChartView(name=name, contents=contents, plot_legend=legend or rrb.PlotLegend(visible=False))


def solid(name: str, contents: list[str], eye: rrb.EyeControls3D, origin: str = paths.WORLD) -> Any:
    """A 3D view without a grid."""
    return rrb.Spatial3DView(
        name=name,
        origin=origin,
        contents=[f"/{path}" for path in contents],
        background=[*colours.BACKGROUND, 255],
        line_grid=False,
        eye_controls=eye,
    )


def _state(method: str, state: State) -> Any:
    path = paths.state(method, state)
    if issubclass(state.kind, paths.FLAT):
        return rrb.Spatial2DView(name=state.name, origin=path, background=[*colours.BACKGROUND, 255])
    return solid(state.name, [path, paths.MAP, paths.RINGS, paths.SENSOR, paths.TRAJECTORY], follow())


def follow(rings: str = paths.RINGS) -> rrb.EyeControls3D:
    """A camera behind and above the sensor at the centre of the rings, moving with it."""
    return rrb.EyeControls3D(
        kind=rrb.Eye3DKind.Orbital,
        tracking_entity=f"/{rings}",
        position=[-22.0, -16.0, 22.0],
        look_target=[0.0, 0.0, 0.0],
        eye_up=[0.0, 0.0, 1.0],
    )


def _eye(extent: Extent) -> rrb.EyeControls3D:
    """An oblique view from above on the bulk of the map, with its long side across the picture."""
    centre, along, length = _bulk(extent)
    side = np.array([along[1], -along[0], 0.0])
    position = centre + 0.68 * length * (0.7 * side + np.array([0.0, 0.0, 1.0]))
    return rrb.EyeControls3D(
        kind=rrb.Eye3DKind.Orbital, position=position, look_target=centre, eye_up=[0.0, 0.0, 1.0], speed=length / 5
    )


def _bulk(extent: Extent) -> tuple[F64, F64, float]:
    """Centre, long horizontal axis (unit vector) and length along it (metres) of the middle nine tenths of the map."""
    if not len(extent.cells):
        return np.zeros(3), np.array([1.0, 0.0, 0.0]), 20.0
    cells = (extent.cells + 0.5) * CELL
    centre = np.median(cells, axis=0)
    flat = cells[:, :2] - centre[:2]
    along = np.linalg.eigh(flat.T @ flat)[1][:, -1]
    low, high = np.quantile(flat @ along, [0.05, 0.95])
    centre[:2] += along * (low + high) / 2
    return centre, np.array([*along, 0.0]), max(float(high - low), 10.0)

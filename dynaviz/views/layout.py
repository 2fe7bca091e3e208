"""The viewer's layout, built from the states of a method and from what a run found.

It is part of the recording.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from dynaviz import colours
from dynaviz.arrays import F32, F64
from dynaviz.contracts.extent import CELL, Extent
from dynaviz.contracts.method import MethodInfo
from dynaviz.contracts.probe import Scalar, State, Voxels
from dynaviz.contracts.scan import ERRORS
from dynaviz.views import keys, object_lanes, paths

LEGEND_SHARES = [9.4, 1.7, 6.9]  # heights of the case, the legend of colours, and the frame
KEY_SHARE = 4.0  # height of the views of states, in heights of their key
CLEAR = 0.75  # opacity of voxels: wrong points inside remain visible
SO_FAR = [f"{paths.SCORES}/{name}/so_far" for name in ("SA", "DA", "AA")]
IF_FIXED = [f"{paths.CASE_SCORE}/{name}" for name in ("SA", "DA")]

BACKGROUND = [*colours.BACKGROUND, 255]
# hovering over a point or ray lists at most three components, so this is not one of theirs
WITHOUT_LABELS = [
    rr.Points3D.from_fields(show_labels=False),
    rr.LineStrips3D.from_fields(show_labels=False),
]

# A plot shows only curves of the current timeline, so each has some for frames and some for cases:
# it is never empty.
SCORE_CURVES = "scores [%]"
WRONG = "wrong points, or % lost"
REMOVED = "removed points"
# direction to the camera
BEHIND: F64 = np.array([-0.63, -0.46, 0.63]) / np.linalg.norm([-0.63, -0.46, 0.63])
# metres: circles around the sensor; the camera tracks them, and their size sets its distance
RINGS = (
    10.0,
    20.0,
)
TURN = np.linspace(0.0, 2 * np.pi, 73)
CIRCLE: F64 = np.stack([np.cos(TURN), np.sin(TURN), 0 * TURN], 1)
CIRCLES: F32 = (np.array(RINGS)[:, None, None] * CIRCLE).astype(np.float32)


@dataclass(frozen=True, slots=True)
class Findings:
    """What a run found, as far as it decides the layout.

    Attributes:
        truth: whether the run had ground truth.
        cases: whether there is a timeline of cases; the recording then opens at the first one.
        tracked: by path, (N, P, 3) metres, world frame: the lines of the first case that cameras
            track.
        state: name of the state to show first, or None.
        reasons: paths of the curves of reasons to show; None for all.
        turned: whether it is known what other parameters would change.
    """

    truth: bool = True
    cases: bool = False
    tracked: Mapping[str, F32] = field(default_factory=dict)
    state: str | None = None
    reasons: tuple[str, ...] | None = None
    turned: bool = False


def layout(info: MethodInfo, extent: Extent, geometry: bool, found: Findings) -> rrb.Blueprint:
    """The layout of a run's recording.

    Left: the case, or behind it the map of the whole run; below it the points of the frame and the
    method's states. Middle: the case in words, all cases, report and log. Right: scores, wrong
    points per frame, distances of errors.

    Args:
        info: of the method; each of its ``emits`` gets a view.
        extent: of the map, for the initial camera.
        geometry: whether the recording contains coordinates.
        found: what the run found; while it is running, what can be expected.
    """
    columns = [_text(found), _numbers(info, found) if found.truth else _removed(info, found)]
    if geometry:
        columns.insert(0, _world(info, extent, found))
    body = rrb.Horizontal(*columns, column_shares=[10, 6, 5][-len(columns) :])
    return blueprint(body, paths.CASE if found.cases else paths.FRAME)


def blueprint(body: Any, timeline: str = paths.FRAME) -> rrb.Blueprint:
    """A layout with collapsed panels and the time cursor at the start of a timeline."""
    return rrb.Blueprint(
        body,
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline=timeline, fps=10.0, play_state="paused"),
        auto_layout=False,
        auto_views=False,
    )


def _world(info: MethodInfo, extent: Extent, found: Findings) -> Any:
    common = [paths.SENSOR, paths.TRAJECTORY]
    boxes = _with_names(paths.CASES, paths.CLUSTER_CASES)
    above: Any = solid(
        "map", [f"{paths.MAP}/**", f"{paths.REMOVED}/**", *boxes, *common], _eye(extent)
    )
    if found.cases:
        case = [paths.CASE_BOX, paths.CASE_NAME, paths.CASE_AROUND, paths.CASE_RAYS]
        above = rrb.Tabs(solid("case", [paths.SCAN, paths.MAP, *case, *common], _aim(found)), above)
    here = [
        paths.SCAN,
        paths.MAP,
        paths.RINGS,
        *_with_names(paths.FAILURES, paths.CLUSTERS),
        paths.CASE_AIM,
    ]
    frame = solid("frame", [*here, *common], _aim(found, paths.CASE_AIM))
    tabs = _tabs(info, found)
    # verdicts, not quantities
    state = found.state or next((state.name for state in info.emits if state.legend), None)
    below = rrb.Horizontal(frame, _open_at(state, tabs)) if tabs else frame
    legend = rrb.Spatial2DView(
        name="colours of points and rays", origin=paths.LEGEND, background=BACKGROUND
    )
    return rrb.Vertical(above, legend, below, row_shares=LEGEND_SHARES)


def _with_names(*boxes: str) -> list[str]:
    return [*boxes, *map(paths.names, boxes)]


def _open_at(state: str | None, tabs: list[Any]) -> Any:
    names = [tab.name for tab in tabs]
    name = None if state is None else keys.plain(state)
    return rrb.Tabs(*tabs, active_tab=names.index(name) if name in names else 0)


def _text(found: Findings) -> Any:
    others = rrb.Tabs(
        rrb.TextDocumentView(name="report", origin=paths.REPORT, contents=[paths.REPORT]),
        rrb.TextLogView(name="log", origin=paths.LOG),
        *([_what_if()] if found.turned else []),
    )
    cases = rrb.TextDocumentView(
        name="failures" if found.truth else "suspicious", origin=paths.FAILURE_LIST
    )
    if not found.cases:
        return rrb.Vertical(cases, others, row_shares=[5, 3])
    case = rrb.TextDocumentView(
        name="what and why", origin=paths.CASE_TEXT, contents=[paths.CASE_TEXT]
    )
    return rrb.Vertical(case, cases, others, row_shares=[9, 8, 5])


def _what_if() -> Any:
    """A table of other parameters, and curves over the timeline of their values."""
    table = rrb.TextDocumentView(
        name="other parameters", origin=paths.WHAT_IF, contents=[paths.WHAT_IF]
    )
    curves = _curves(
        "scores, on the timeline what_if", [f"{paths.WHAT_IF_SCORE}/**"], rrb.Corner2D.LeftBottom
    )
    value = rrb.TextDocumentView(name="value", origin=paths.WHAT_IF_VALUE)
    return rrb.Vertical(table, value, curves, name="what if", row_shares=[5, 1, 3])


def _tabs(info: MethodInfo, found: Findings) -> list[Any]:
    """The states that are drawn, by tab, each with its key below."""
    tabs = []
    for states in keys.tabs(info):
        views = [_state(info.name, state, found) for state in states]
        name = ", ".join(map(keys.title, states))
        tabs.append(with_key(views, paths.key(info.name, states[0]), keys.heading(states), name))
    return tabs


def with_key(views: Sequence[Any], path: str, heading: str, name: str | None = None) -> Any:
    """Views of states, one above the other, with their key below."""
    key = rrb.Spatial2DView(name=heading, origin=path, background=BACKGROUND)
    shares = [KEY_SHARE / len(views)] * len(views) + [1 + 0.4 * (len(views) - 1)]
    return rrb.Vertical(*views, key, name=name, row_shares=shares)


def _numbers(info: MethodInfo, found: Findings) -> Any:
    others = [f"- {path}" for path in (*SO_FAR, f"{paths.WRONG}/**", paths.WORST)]
    scores = rrb.Tabs(
        _curves(SCORE_CURVES, [*SO_FAR, *IF_FIXED], rrb.Corner2D.LeftBottom),
        _curves("all scores", [f"{paths.SCORES}/**", *others], rrb.Corner2D.LeftBottom),
        *_reasons_and_scalars(info, found),
    )
    distance = rrb.Tabs(
        _bars("FN: distance [m]", _run_histogram("false_negative")),
        _bars("FP: distance [m]", _run_histogram("false_positive")),
        _bars(
            "this frame",
            [f"{paths.ERROR_DISTANCE}/{kind}" for kind in ERRORS],
            rrb.Corner2D.RightTop,
        ),
    )
    # No legend: it would hide the worst frames; the colours are those of the points.
    wrong = _curves(WRONG, [f"{paths.WRONG}/**", paths.WORST, f"{paths.CASE_COST}/**"])
    return rrb.Vertical(
        scores, rrb.Tabs(wrong, object_lanes.view()) if found.cases else wrong, distance
    )


def _removed(info: MethodInfo, found: Findings) -> Any:
    """The plots of a run without ground truth."""
    removed = _curves(REMOVED, [f"{paths.REMOVED_POINTS}/**", f"{paths.CASE_COST}/**"])
    tabs = rrb.Tabs(removed, *_reasons_and_scalars(info, found))
    return rrb.Vertical(
        tabs, rrb.TextDocumentView(name="removed", origin=paths.REMOVED_TEXT), row_shares=[1, 2]
    )


def _reasons_and_scalars(info: MethodInfo, found: Findings) -> list[Any]:
    shown = [f"{paths.REASONS}/**"] if found.reasons is None else list(found.reasons)
    return [
        *([_curves("reasons", shown, rrb.Corner2D.LeftTop)] if shown else []),
        *[
            _curves(keys.title(state), [paths.state(info.name, state)])
            for state in info.emits
            if issubclass(state.kind, Scalar)
        ],
    ]


def _run_histogram(kind: str) -> list[str]:
    return [f"{paths.ERROR_DISTANCE}/{kind}/{part}" for part in ("run", "p10")]


def _curves(name: str, contents: list[str], legend: Any = None) -> Any:
    return rrb.TimeSeriesView(name=name, contents=contents, plot_legend=legend or _NO_LEGEND)


_NO_LEGEND = rrb.PlotLegend(visible=False)


def _bars(name: str, contents: list[str], legend: Any = None) -> Any:
    return rrb.BarChartView(name=name, contents=contents, plot_legend=legend or _NO_LEGEND)


def solid(
    name: str,
    contents: list[str],
    eye: rrb.EyeControls3D,
    origin: str = paths.WORLD,
    overrides: Any = None,
) -> Any:
    """A 3D view without a grid, and without labels of what does not ask for them."""
    return rrb.Spatial3DView(
        name=name,
        origin=origin,
        contents=[f"/{path}" for path in contents],
        background=BACKGROUND,
        line_grid=False,
        eye_controls=eye,
        defaults=WITHOUT_LABELS,
        overrides=overrides,
    )


def _state(method: str, state: State, found: Findings) -> Any:
    path = paths.state(method, state)
    if issubclass(state.kind, paths.FLAT):
        return rrb.Spatial2DView(name=keys.title(state), origin=path, background=BACKGROUND)
    errors = [paths.SCAN, paths.CASE_BOX, paths.CASE_NAME, paths.CASE_AROUND]
    # without the map, which would be drawn over the state
    context = [paths.RINGS, paths.SENSOR, paths.TRAJECTORY]
    return solid(
        keys.title(state),
        [path, *errors, *context],
        _aim(found),
        overrides={f"/{path}": rr.VoxelGridMap.from_fields(opacity=CLEAR)}
        if state.kind is Voxels
        else None,
    )


def _aim(found: Findings, path: str = paths.CASE_AROUND) -> rrb.EyeControls3D:
    return follow(path, found.tracked[path]) if found.cases else follow()


def follow(path: str = paths.RINGS, lines: F32 = CIRCLES) -> rrb.EyeControls3D:
    """A camera behind and above the middle of lines, mostly circles around the sensor, moving with
    it.

    The viewer sets the distance to 1.5 half diagonals of their box if it has loaded them before it
    draws first, and else keeps the stated one: both are the same.

    Args:
        path: of the lines.
        lines: (N, P, 3) metres: as they are when the recording opens.
    """
    low = lines.min((0, 1)).astype(np.float64)
    high = lines.max((0, 1)).astype(np.float64)
    middle = (low + high) / 2
    return rrb.EyeControls3D(
        kind=rrb.Eye3DKind.Orbital,
        tracking_entity=f"/{path}",
        position=middle + 0.75 * np.linalg.norm(high - low) * BEHIND,
        look_target=middle,
        eye_up=[0.0, 0.0, 1.0],
    )


def _eye(extent: Extent) -> rrb.EyeControls3D:
    """A steep view from above on the bulk of the map, with its long side across the picture."""
    centre, along, length, width = _bulk(extent)
    side = np.array([along[1], -along[0], 0.0])
    position = centre + max(0.6 * length, 0.95 * width) * (0.35 * side + np.array([0.0, 0.0, 0.94]))
    return rrb.EyeControls3D(
        kind=rrb.Eye3DKind.Orbital,
        position=position,
        look_target=centre,
        eye_up=[0.0, 0.0, 1.0],
        speed=length / 5,
    )


def _bulk(extent: Extent) -> tuple[F64, F64, float, float]:
    """The middle nine tenths of the map.

    Centre, long horizontal axis (unit vector), length and width (metres).
    """
    if not len(extent.cells):
        return np.zeros(3), np.array([1.0, 0.0, 0.0]), 20.0, 10.0
    cells = (extent.cells + 0.5) * CELL
    centre = np.median(cells, axis=0)
    flat = cells[:, :2] - centre[:2]
    axes = np.linalg.eigh(flat.T @ flat)[1]  # short, long
    low, high = np.quantile(flat @ axes, [0.05, 0.95], axis=0)
    centre[:2] += axes @ (low + high) / 2
    width, length = np.maximum(high - low, 10.0)
    return centre, np.array([*axes[:, 1], 0.0]), float(length), float(width)

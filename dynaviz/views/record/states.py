"""Drawing a method's states, by kind."""

from __future__ import annotations

from typing import Any

import numpy as np
import rerun as rr

from dynaviz import colours, kernels
from dynaviz.arrays import F32, U8
from dynaviz.contracts.probe import (
    Mask,
    Plane,
    PointClasses,
    Points,
    PolarGrid,
    RangeImage,
    Scalar,
    State,
    Value,
    Voxels,
)
from dynaviz.contracts.scan import Scan
from dynaviz.views import keys, paths
from dynaviz.views.record.budget import Budget

PICTURE = 256  # pixels: the edge of a polar grid seen from above
CORNERS = 48  # of the polygon that approximates a disc
CIRCLE = np.linspace(0.0, 2 * np.pi, CORNERS, endpoint=False)
# a range image at most this much wider than high; its rows are repeated, or it would be a hairline
WIDE = 4.5
EMPTY = 255  # class of empty pixels
GREYS = 255  # steps of the values of a picture
FINEST = 64  # steps of a metre: positions of thinned points, which then take two thirds of the room
PACKED = 6  # level of compression of PNG, of 9


def legend(state: State) -> Any:
    """The viewer's legend of a state's classes; None if it has none."""
    if not state.legend:
        return None
    shades = colours.CLASSES
    known = [(i, name, shades[i % len(shades)]) for i, name in enumerate(state.legend) if name]
    empty = [(EMPTY, "", colours.BACKGROUND)] if issubclass(state.kind, paths.FLAT) else []
    # the viewer would make up a colour for classes without one
    return rr.AnnotationContext([*known, *empty])


def draw(value: Value, state: State, scan: Scan, budget: Budget | None) -> Any:
    """The archetype to log for a state.

    Args:
        value: as emitted; no reference to its arrays is kept.
        state: its declaration.
        scan: the current scan.
        budget: chooses the points or voxels to draw; None for all.

    Returns:
        None if there is nothing to draw.
    """
    match value:
        case Points(xyz, values):
            chosen = _chosen(xyz, budget)
            shades = (
                [colours.STATE] if values is None else _coloured(values[chosen], state.value_range)
            )
            places = xyz[chosen] if budget is None else np.round(xyz[chosen] * FINEST) / FINEST
            return rr.Points3D(places, colors=shades, radii=rr.Radius.ui_points(2.0))
        case PointClasses(classes):
            chosen = _chosen(scan.points, budget)
            return rr.Points3D(
                scan.points[chosen],
                class_ids=classes[chosen],
                radii=rr.Radius.ui_points(2.0),
            )
        case Mask(mask):
            xyz = scan.points[mask]
            return rr.Points3D(
                xyz[_chosen(xyz, budget)], colors=[colours.STATE], radii=rr.Radius.ui_points(2.5)
            )
        case Voxels():
            return _voxels(value, state, budget)
        case Plane():
            return _disc(value)
        case RangeImage(ranges, _):
            return _picture(_higher(ranges), state) if ranges.size else None
        case PolarGrid(values, _):
            return _picture(from_above(values), state) if values.size else None
        case Scalar(number):
            return rr.Scalars(number)
    return None


def from_above(values: F32) -> F32:
    """A polar grid as an image from above.

    Sensor in the centre, azimuth 0 to the right, 90 degrees up.

    Args:
        values: (rings, sectors) float32.

    Returns:
        (PICTURE, PICTURE) float32, NaN outside the outermost ring.
    """
    rings, sectors = values.shape
    x = (np.arange(PICTURE) + 0.5) / PICTURE * 2 - 1
    radius = np.hypot(x[None, :], x[:, None])
    turn = np.arctan2(-x[:, None], x[None, :]) / (2 * np.pi) % 1.0
    ring = np.minimum(radius * rings, rings - 1).astype(np.intp)
    sector = np.minimum(turn * sectors, sectors - 1).astype(np.intp)
    return np.where(radius < 1, values[ring, sector], np.float32(np.nan))


def _voxels(value: Voxels, state: State, budget: Budget | None) -> Any:
    cells = kernels.as_readonly(value.keys, np.int32)
    chosen = (
        slice(None)
        if budget is None
        else budget.chosen(kernels.thinning.centres(cells, float(value.size)))
    )
    cells = cells[chosen]
    edges = [value.size] * 3
    if value.values is None:
        return rr.VoxelGridMap(
            cells, edges, colors=np.tile(np.array(colours.STATE, np.uint8), (len(cells), 1))
        )
    values = value.values[chosen]
    shown = keys.stretched(*(state.value_range or _range(values)))
    return rr.VoxelGridMap(cells, edges, values=values, value_range=shown, colormap="viridis")


def _disc(plane: Plane) -> Any:
    """A translucent polygon in the plane, visible from both sides."""
    normal = plane.normal / np.linalg.norm(plane.normal)
    side = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
    side /= np.linalg.norm(side)
    ahead = np.cross(normal, side)
    centre = (
        plane.centre
        - (plane.centre @ normal - plane.offset / np.linalg.norm(plane.normal)) * normal
    )
    rim = centre + plane.radius * (np.cos(CIRCLE)[:, None] * side + np.sin(CIRCLE)[:, None] * ahead)
    corner = np.arange(CORNERS)
    fan = np.stack([np.full(CORNERS, CORNERS), corner, (corner + 1) % CORNERS], 1)
    return rr.Mesh3D(
        vertex_positions=[*rim, centre], triangle_indices=fan, albedo_factor=[*colours.STATE, 110]
    )


def _picture(values: F32, state: State) -> Any:
    """An image with two bytes per pixel, or one of classes; empty pixels are dark."""
    if state.legend:
        return rr.SegmentationImage(
            np.where(np.isnan(values), EMPTY, values).astype(np.uint8), opacity=1.0
        )
    low, high = state.value_range or _range(values)
    first, last = keys.stretched(low, high, keys.GREYS)
    step = (high - low) / GREYS  # as fine as the greys: finer steps only take more room
    if state.kind is RangeImage and low == 0.0:
        return _distances(values, step, (first, last))
    steps = np.round((np.clip(values, low, high) - low) / step)
    small = np.where(np.isnan(values), first, low + steps * step).astype(np.float16)
    return rr.DepthImage(
        small,
        meter=1.0,
        colormap="grayscale",
        depth_range=[first, last],
        magnification_filter="nearest",
    )


def _distances(values: F32, step: float, shown: tuple[float, float]) -> Any:
    """An image of distances as PNG, half as large; 0 for empty pixels.

    Args:
        values: metres.
        step: metres of a unit of a pixel; the viewer shows metres again.
        shown: metres, the first and the last of the greys.
    """
    import cv2

    units = np.clip(np.round(np.nan_to_num(values) / step), 1, GREYS)
    units = np.where(np.isnan(values), 0, units).astype(np.uint16)
    _, packed = cv2.imencode(".png", units, [cv2.IMWRITE_PNG_COMPRESSION, PACKED])
    first, last = shown
    return rr.EncodedDepthImage(
        blob=packed.tobytes(),
        media_type="image/png",
        meter=1.0 / step,
        colormap="grayscale",
        depth_range=[first / step, last / step],
        magnification_filter="nearest",
    )


def repeated(rows: int, columns: int) -> int:
    """How often each row of a wide range image is drawn."""
    return max(1, round(columns / (WIDE * rows)))


def _higher(ranges: F32) -> F32:
    """A wide range image with each row repeated."""
    return np.repeat(ranges, repeated(*ranges.shape), axis=0)


def _coloured(values: F32, value_range: tuple[float, float] | None) -> U8:
    """(N, 3) uint8 RGB of (N,) values."""
    low, high = value_range or _range(values)
    share = np.clip((np.nan_to_num(values, nan=low) - low) / (high - low or 1.0), 0, 1)
    return keys.coloured(share)


def _range(values: F32) -> tuple[float, float]:
    finite = values[np.isfinite(values)]
    if not len(finite):
        return 0.0, 1.0
    low = float(finite.min())
    high = float(finite.max())
    return low, high if high > low else low + 1.0


def _chosen(points: F32, budget: Budget | None) -> Any:
    return slice(None) if budget is None else budget.chosen(points)

"""Cases are outlined where their points are in pictures of a method's states."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.worlds import room

import dynaviz as dv
from dynaviz.arrays import F64
from dynaviz.contracts.probe import ImageSpan, PolarGrid, RangeImage
from dynaviz.contracts.scan import Scan
from dynaviz.views import paths
from dynaviz.views.read.reader import RunRecording
from dynaviz.views.record import states
from dynaviz.views.record.case_timeline import PICTURES
from dynaviz.views.record.outlines import FlatStates
from dynaviz_methods.dynablox.free_space import SensorView
from dynaviz_methods.shared.range_images import SHARED as IMAGES
from dynaviz_methods.shared.range_images import image_views, picture, whole
from dynaviz_methods.shared.sky import DepthImage

TURN = 0.7
POSE = np.array(
    [
        [math.cos(TURN), -math.sin(TURN), 0, 3.0],
        [math.sin(TURN), math.cos(TURN), 0, -2.0],
        [0, 0, 1, 1.5],
        [0, 0, 0, 1],
    ]
)


def object_at(azimuth: float, distance: float = 9.0) -> tuple[F64, F64, F64]:
    """Points on an object around the sensor, and the corners of its box, in the world."""
    random = np.random.default_rng(3)
    middle = POSE[:3, 3] + np.array(
        [distance * math.cos(azimuth + TURN), distance * math.sin(azimuth + TURN), -0.4]
    )
    points = middle + random.uniform(-0.6, 0.6, (400, 3))
    return points, points.min(0), points.max(0)


def shown(image: Any, path: str, low: F64, high: F64) -> tuple[F64, F64]:
    """The pixels with a value in a picture as drawn, and the outline of a box in it."""
    flat = FlatStates()
    flat.add(path, image)
    outline = flat.outline(path, low, high, POSE)
    assert outline is not None
    rows = states.repeated(*image.ranges.shape)
    drawn = np.argwhere(np.repeat(~np.isnan(image.ranges), rows, 0))[:, ::-1] + 0.5
    return drawn, outline


def removert(points: F64) -> RangeImage:
    view = image_views((2.0,), (-30.0, 10.0), (-180.0, 180.0))
    camera = POSE[:3, 3].copy(), np.ascontiguousarray(POSE[:3, :3].T), view, False
    xyz = np.ascontiguousarray(points.T, np.float32)
    flat, _ = IMAGES.range_image.nearest(xyz, *whole(len(points)), *camera, 1, np.float32(0.1))
    return picture(flat, view[0])


def freedom(points: F64) -> RangeImage:
    image = DepthImage(40, math.radians(10), math.radians(-30), 80.0, 0, 1)
    depth, hole = image.of(Scan(0, points.astype(np.float32), POSE))
    return RangeImage(np.where(hole == 0, depth, np.nan).astype(np.float32), image.span)


def dynablox(points: F64) -> RangeImage:
    view = SensorView(40, 720, 10.0, -30.0)
    local = (points - POSE[:3, 3]) @ POSE[:3, :3]
    _, columns, top, per_row, per_column = view.numbers
    row = (top - np.arctan2(local[:, 2], np.hypot(local[:, 0], local[:, 1]))) * per_row + 0.5
    column = (np.arctan2(local[:, 1], local[:, 0]) + math.pi) * per_column + 0.5
    ranges = np.full((view.rows, view.columns), np.nan, np.float32)
    ranges[row.astype(int), column.astype(int) % int(columns)] = 9.0
    return RangeImage(ranges, view.span)


@pytest.mark.parametrize("azimuth", [0.0, 1.2, -2.0, 3.0])
@pytest.mark.parametrize("image_of", [removert, freedom, dynablox])
def test_an_outline_contains_the_pixels_of_its_object(image_of: Any, azimuth: float) -> None:
    points, low, high = object_at(azimuth)
    drawn, outline = shown(image_of(points), "image", low, high)
    first = outline.min(0)
    last = outline.max(0)
    assert len(drawn) > 10
    assert (drawn >= first).all()
    assert (drawn <= last).all()
    assert (last - first < 2.5 * np.ptp(drawn, axis=0) + 12).all()  # and little else


def test_in_a_polar_grid_the_outline_is_seen_from_above() -> None:
    points, low, high = object_at(0.4)
    flat = FlatStates()
    grid = PolarGrid(np.full((20, 60), np.nan, np.float32), 30.0)
    ring = np.hypot(*(points - POSE[:3, 3])[:, :2].T) / 30.0 * 20
    sector = np.arctan2(*(points - POSE[:3, 3])[:, 1::-1].T) / (2 * np.pi) % 1.0 * 60
    grid.values[ring.astype(int), sector.astype(int)] = 1.0
    flat.add("grid", grid)
    outline = flat.outline("grid", low, high, POSE)
    assert outline is not None
    drawn = np.argwhere(~np.isnan(states.from_above(grid.values)))[:, ::-1]
    assert np.linalg.norm(drawn.mean(0) - outline[:4].mean(0)) < 8


def test_nothing_is_outlined_out_of_view_or_without_directions() -> None:
    _, low, high = object_at(0.0)
    flat = FlatStates()
    above = ImageSpan(math.pi, -math.pi, math.radians(60), math.radians(30))
    flat.add("above", RangeImage(np.ones((20, 90), np.float32), above))
    flat.add("unknown", RangeImage(np.ones((20, 90), np.float32)))
    flat.add("near", PolarGrid(np.ones((20, 60), np.float32), 4.0))
    assert flat.paths == ["above", "near"]
    assert flat.outline("above", low, high, POSE) is None
    assert flat.outline("near", low, high, POSE) is None


@pytest.mark.filterwarnings("ignore:.*sensor is unknown")
@pytest.mark.parametrize(("method", "state"), [("removert", "difference_1"), ("erasor", "ratio")])
def test_recordings_outline_the_case_on_both_timelines(
    method: str, state: str, tmp_path: Path
) -> None:
    dv.run(method, room(6, 1500), out=tmp_path, record="errors")
    recording = RunRecording(tmp_path / "run.rrd")
    path = f"{method}/{state}/case"
    cases = dict(recording.rows(path, paths.CASE))
    strips = [row["LineStrips2D:strips"] for row in cases.values() if len(row) > 1]
    assert 0 < len(strips) <= PICTURES
    assert all([len(part) for part in strip] == [5] for strip in strips)
    assert all("Clear:is_recursive" in row for row in cases.values() if len(row) == 1)
    frames = dict(recording.rows(path))
    shown = dict(recording.rows(paths.CASE_BOX))
    assert frames
    assert frames.keys() <= shown.keys()

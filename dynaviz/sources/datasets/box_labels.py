"""Derive point labels from boxes with track ids, for driving data sets without point labels."""

from __future__ import annotations

from collections.abc import Collection, Container, Iterable
from dataclasses import dataclass

import numpy as np

from dynaviz.arrays import F64, Bool, Intp
from dynaviz.contracts.scan import Label
from dynaviz.sources.datasets.truth import Truth

MIN_SPEED = 0.5  # metres per second, averaged over a track, above which the track is dynamic
MIN_WAY = 1.0  # metres from the first to the last position, if the data have no times
MARGIN = 0.05  # metres by which boxes are enlarged, because annotated boxes are tight
BORDER = 0.25  # metres around a moving box in which points are unlabelled
GROUND = 0.12  # metres at the bottom of the enlarged box that count as ground


@dataclass(frozen=True, slots=True, eq=False)
class OrientedBox:
    """An object in a frame.

    Attributes:
        track: number of the object, from 1; the same in all frames.
        class_id: number of its class, from 1; 0 if the data set's class is not mapped.
        T_frame_box: (4, 4) float64, metres. The box frame has its origin at the centre of the
            bottom face, x along the length, z up; the other frame is the frame of the points.
        size: length, width, height, metres.
        extrapolated: not annotated in this frame; if it moves, its points are unlabelled.
    """

    track: int
    class_id: int
    T_frame_box: F64
    size: tuple[float, float, float]
    extrapolated: bool = False


def moving_tracks(
    sightings: Iterable[tuple[int, float | None, F64]], speed: float = MIN_SPEED
) -> frozenset[int]:
    """Tracks whose mean speed from their first to their last position exceeds ``speed``.

    Args:
        sightings: track, time in seconds, and position (3,) float64, metres, world frame; in order
            of time. If times are None, tracks that end over ``MIN_WAY`` from their start move.
        speed: metres per second.
    """
    first: dict[int, tuple[float | None, F64]] = {}
    last: dict[int, tuple[float | None, F64]] = {}
    for track, seconds, position in sightings:
        first.setdefault(track, (seconds, position))
        last[track] = seconds, position
    moving = set()
    for track, (start, origin) in first.items():
        end, goal = last[track]
        least = MIN_WAY if start is None or end is None else speed * (end - start)
        if np.sqrt(((goal - origin) ** 2).sum()) > least:
            moving.add(track)
    return frozenset(moving)


def track_facts(tracks: Collection[int], moving: Collection[int]) -> dict[str, str]:
    """Number of tracks of a sequence, for ``dynaviz info``."""
    return (
        {"objects with boxes": f"{len(tracks):,}, of which {len(moving):,} move"} if tracks else {}
    )


def truth_from_boxes(
    points: F64, boxes: Iterable[OrientedBox], moving: Container[int], annotated: Bool | None = None
) -> Truth:
    """Ground truth of a frame: dynamic in moving boxes, unlabelled around them, static elsewhere.

    Args:
        points: (N, 3) float64, metres, in the frame of the boxes; non-finite points are in no box.
        boxes: all objects of the frame, moving or not.
        moving: tracks that move.
        annotated: (N,) bool, points in the annotated region; all others are unlabelled. Default:
            all points.
    """
    n = len(points)
    classes = np.zeros(n, np.uint16)
    instances = np.zeros(n, np.int32)
    border = np.zeros(n, np.bool_)
    dynamic = np.zeros(n, np.bool_)
    for box in boxes:
        rows, local = _candidates(points, box)
        inside = rows[_inside(local, box, MARGIN, GROUND)]
        if box.class_id:
            classes[inside] = box.class_id
            instances[inside] = box.track
        if box.track in moving:
            border[rows[_inside(local, box, BORDER)]] = True
            if not box.extrapolated:
                dynamic[inside] = True
    labels = np.full(n, Label.STATIC, np.uint8)
    if annotated is not None:
        labels[~annotated] = Label.UNLABELLED
    labels[border] = Label.UNLABELLED
    labels[dynamic] = Label.DYNAMIC
    return Truth(labels, classes, instances)


def _candidates(points: F64, box: OrientedBox) -> tuple[Intp, F64]:
    """Indices of points that may lie in a box or its border, and their (rows, 3) coordinates in the
    box frame.
    """
    origin = box.T_frame_box[:3, 3]
    axes = box.T_frame_box[:3, :3]
    reach = sum(box.size) + 2 * BORDER  # beyond any corner
    rows = np.flatnonzero(np.abs(points[:, 0] - origin[0]) < reach)
    rows = rows[np.abs(points[rows, 1] - origin[1]) < reach]
    with np.errstate(over="ignore", invalid="ignore"):  # such points are in no box
        x, y, z = (points[rows, axis] - origin[axis] for axis in range(3))
        return rows, np.stack(
            [axes[0, k] * x + axes[1, k] * y + axes[2, k] * z for k in range(3)], axis=1
        )


def _inside(local: F64, box: OrientedBox, margin: float, ground: float = 0.0) -> Bool:
    """Mask of points, in the box frame, inside the box enlarged by a margin, without its lowest
    ``ground`` metres.
    """
    length, width, height = box.size
    along, across, up = local.T
    inside: Bool = (np.abs(along) < length / 2 + margin) & (np.abs(across) < width / 2 + margin)
    inside &= (up > ground - margin) & (up < height + margin)
    return inside
